"""Recordings onto the body: laws on planted motions, clear refusals, real clips where present."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from recon.batch.collection import SourceClip, clips_by_collection, contents_of_clips, skeleton_key
from recon.batch.corpus import conversion_checksum, convert_corpus
from recon.batch.corpus_jobs import split_at_jumps
from recon.body.contacts import MAXIMUM_SPEED
from recon.body.landmarks import landmark
from recon.body.levelling import levelling_rotation, rotated_motion, standing_flat
from recon.body.model import BodyModel
from recon.body.soles import Soles, Stance
from recon.core import rotations as so3
from recon.core.fingers import FINGERS
from recon.core.motion import Motion
from recon.core.skeleton import JOINTS, LEGS
from recon.export.bvh import skeleton_of, write_bvh
from recon.formats.motions import load_motion
from recon.ingest import Conversion, convert
from recon.ingest.conversion import jump_frames, resampled
from recon.ingest.maps import alignments_from_rest, recognise, right_handed_skeleton
from recon.ingest.marker_sets import STANDOFF, full_body_markers, nominal_offsets
from recon.mocap.recording import MarkerRecording, SkeletonRecording
from tests.ingest.walker import MARKERS

FPS = 60.0
FRAMES = 66


@pytest.fixture(scope="module")
def bundled() -> BodyModel:
    """In single precision, as conversions use it; one thread, before any slower fixture."""
    torch.set_num_threads(1)
    torch.manual_seed(0)
    return BodyModel.load()


@pytest.fixture(scope="module")
def planted(bundled: BodyModel) -> Motion:
    """Somebody of their own shape stands, waves, bends and turns a little; on the ground."""
    time = torch.arange(FRAMES) / FPS
    waves = torch.zeros(FRAMES, 22, 3)
    for joint in range(1, 22):
        axis = torch.nn.functional.normalize(torch.randn(3), dim=0)
        size = 0.04 if joint in (*LEGS, 1, 2) else 0.25
        swing = size * (2 * torch.pi * time * (0.4 + 0.03 * joint) + joint).sin()
        waves[:, joint] = swing[:, None] * axis
    waves[:, 16, 2] -= 0.9
    waves[:, 17, 2] += 0.9
    upright = so3.exp(torch.tensor([torch.pi / 2, 0.0, 0.0]))
    turn = so3.about_z(0.3 * time)
    local = so3.exp(waves)
    local[:, 0] = turn @ upright
    shape = torch.zeros(bundled.shape_size)
    shape[:3] = torch.tensor([0.8, -0.6, 0.5])
    motion = Motion.create(torch.zeros(FRAMES, 3), local, shape, FPS)
    down = Stance.of(motion, bundled, Soles.of(bundled)).ground_height()
    place = torch.stack((0.05 * time, 0.1 * time, torch.full_like(time, -down)), -1)
    return motion.replace(translation=place)


@pytest.fixture(scope="module")
def recording(planted: Motion, bundled: BodyModel) -> SkeletonRecording:
    return skeleton_of(planted, bundled, "planted")


@pytest.fixture(scope="module")
def converted(recording: SkeletonRecording, bundled: BodyModel) -> Conversion:
    return convert(recording, bundled)


def test_our_own_skeleton_comes_back(
    converted: Conversion, planted: Motion, bundled: BodyModel
) -> None:
    truth = bundled.pose(planted).joints
    ours = converted.joints + torch.tensor([0.0, 0.0, converted.ground_shift])
    assert (ours - truth).norm(dim=-1).mean() < 0.005  # metres
    angles = so3.geodesic_angle(bundled.pose(converted.motion).orientations,
                          bundled.pose(planted).orientations)  # fmt: skip
    assert torch.rad2deg(angles).mean() < 4.0  # degrees
    assert converted.motion.fps == FPS
    assert abs(converted.ground_shift) < 0.01  # metres
    assert max(converted.residuals.values()) < 10.0  # millimetres
    assert converted.report["slip_mps"] == pytest.approx(
        converted.report["slip_source_mps"], abs=0.01
    )  # m/s


def test_foreign_bone_frames_are_calibrated(
    recording: SkeletonRecording, converted: Conversion, bundled: BodyModel
) -> None:
    """Frames of bones turned by constants, other lengths of names: the same motion."""
    turned = so3.exp(torch.randn(len(recording.parents), 3)).double().numpy()
    foreign = dataclasses.replace(
        recording,
        joint_names=tuple(f"rig:{name}" for name in recording.joint_names),
        orientations=recording.orientations @ turned,
        rest_offsets=np.einsum(
            "jba,jb->ja",
            turned[[max(p, 0) for p in recording.parents]],
            recording.rest_offsets,
        ),
    )
    found = convert(foreign, bundled)
    assert (found.joints - converted.joints).norm(dim=-1).mean() < 0.012  # metres


def test_t_pose_gives_first_alignments(recording: SkeletonRecording, bundled: BodyModel) -> None:
    skeleton = recognise(recording)
    found = alignments_from_rest(recording, skeleton, bundled)
    assert found is not None
    identity = torch.eye(3).expand_as(found)
    assert (
        torch.rad2deg(so3.geodesic_angle(found, identity)).max() < 10.0
    )  # degrees, another shape
    collapsed = dataclasses.replace(recording, rest_offsets=np.abs(recording.rest_offsets))
    assert alignments_from_rest(collapsed, skeleton, bundled) is None


@pytest.mark.parametrize("fault", ["mirrored", "names"])
def test_left_and_right_of_skeletons_are_told_by_the_body(
    recording: SkeletonRecording, converted: Conversion, bundled: BodyModel, fault: str
) -> None:
    """Mirrored ones gave bodies with knees that bend backwards, and `hand` was ignored."""
    sides = {"left": "right", "right": "left"}
    named = [name.partition("_") for name in recording.joint_names]
    bad = dataclasses.replace(
        recording, joint_names=tuple(sides.get(a, a) + b + c for a, b, c in named)
    )
    if fault == "mirrored":
        signs = np.array([-1.0, 1.0, 1.0])
        bad = dataclasses.replace(
            recording,
            rest_offsets=recording.rest_offsets * signs,
            positions=recording.positions * signs,
            orientations=recording.orientations * np.outer(signs, signs),
        )
    found = convert(bad, bundled, hand=None if fault == "mirrored" else "right")
    assert (found.joints - converted.joints).norm(dim=-1).mean() < 0.001  # metres
    said = {"mirrored": "mirrored back", "names": "left and right joints were exchanged"}
    assert any(said[fault] in decision for decision in found.decisions)
    if fault == "mirrored":
        given = right_handed_skeleton(bad, recognise(bad), "left")
        np.testing.assert_array_equal(given.positions, recording.positions)


def test_fingers_of_skeletons_are_said_to_be_left_out(
    recording: SkeletonRecording, converted: Conversion, bundled: BodyModel
) -> None:
    assert not any("fingers" in said for said in converted.decisions)
    wrist = recording.joint("left_wrist")
    more = [f"l_{finger}_{k}" for finger in FINGERS for k in (0, 1, 2)]
    rows = [*range(len(recording.parents)), *[wrist] * len(more)]
    grown = dataclasses.replace(
        recording,
        joint_names=(*recording.joint_names, *more),
        parents=(*recording.parents, *[wrist] * len(more)),
        rest_offsets=recording.rest_offsets[rows],
        positions=recording.positions[:, rows],
        orientations=recording.orientations[:, rows],
    )
    said = convert(grown.window(0, 9), bundled).decisions
    assert any("15 joints of fingers are left out" in one for one in said)


def test_another_rate_on_request(converted: Conversion, bundled: BodyModel) -> None:
    slow = resampled(converted, bundled, 30.0)
    assert slow.motion.fps == 30.0
    assert torch.allclose(slow.motion.translation, converted.motion.translation[::2], atol=1e-6)
    assert torch.equal(slow.contacts, converted.contacts[::2])


def test_unknown_skeletons_are_refused_and_mapped(
    recording: SkeletonRecording, bundled: BodyModel, tmp_path: Path
) -> None:
    names = tuple(f"bone{k}" for k in range(len(recording.joint_names)))
    strange = dataclasses.replace(recording, joint_names=names)
    with pytest.raises(ValueError, match=r"its joints are bone0.*--mapping"):
        recognise(strange)
    mapping = tmp_path / "mine.toml"
    lines = [f'{ours} = "bone{k}"' for k, ours in enumerate(JOINTS)]
    mapping.write_text("[joints]\n" + "\n".join(lines))
    found = recognise(strange, mapping)
    assert {JOINTS[j]: name for j, name in found.positions} == dict(
        zip(JOINTS, names[: len(JOINTS)], strict=True)
    )
    mapping.write_text('[joints]\nleft_knee = "patella"')
    with pytest.raises(ValueError, match=r"left_knee = 'patella', but planted has bone0"):
        recognise(strange, mapping)
    mapping.write_text('[joints]\nleft_knee = "bone4"')
    with pytest.raises(ValueError, match="positions of left_hip, left_ankle"):
        recognise(strange, mapping)
    with pytest.raises(FileNotFoundError):
        recognise(strange, tmp_path / "none.toml")


def test_feet_are_the_last_rows(recording: SkeletonRecording) -> None:
    skeleton = recognise(recording)
    first, last = skeleton.feet_rows
    assert [JOINTS[j] for j in skeleton.joints[first:last]] == [
        "left_ankle", "right_ankle", "left_foot", "right_foot",
    ]  # fmt: skip


def test_standing_flat() -> None:
    feet = torch.zeros(40, 4, 3)
    feet[:, :2, 2] = 0.08
    feet[20:, 0, 0] = torch.arange(20) * 0.01  # 0.6 m/s at 60 Hz
    feet[30:, 1, 2] = 0.16  # raised heel
    flat = standing_flat(feet, FPS)
    assert flat[:19, 0].all()
    assert not flat[21:, 0].any()
    assert flat[:28, 1].all()
    assert not flat[31:, 1].any()


def test_soles_lie_under_the_feet(bundled: BodyModel) -> None:
    soles = Soles.of(bundled)
    points = bundled.template[soles.points]
    assert (points[0, :, 0] > 0).all()
    assert (points[1, :, 0] < 0).all()
    assert float(points[..., 1].max() - bundled.template[:, 1].min()) < 0.03  # metres
    heels, balls = bundled.template[soles.heels], bundled.template[soles.balls]
    assert (balls[..., 2].mean(1) - heels[..., 2].mean(1)).min() > 0.1  # metres
    assert MAXIMUM_SPEED == 0.25


def test_a_tilted_floor_is_levelled() -> None:
    """Feet that stand here and there on a slope of three degrees, in noise."""
    place = torch.rand(200, 2, 2) * torch.tensor([3.0, 0.8])
    points = torch.cat((place, torch.full((200, 2, 1), 0.1)), -1)
    tilt = so3.exp(torch.tensor([0.02, -0.05, 0.0]))
    yes = torch.ones(200, 2, dtype=torch.bool)
    sloped = points @ tilt.mT + 0.003 * torch.randn(200, 2, 3)
    found = levelling_rotation(Stance(sloped, yes, yes))
    assert found is not None
    up = found @ tilt @ torch.tensor([0.0, 0.0, 1.0])
    assert torch.rad2deg(torch.acos(up[2].clamp(max=1))) < 0.3  # degrees
    assert levelling_rotation(Stance(points, yes, yes)) is None
    stairs = points + torch.tensor([0.0, 0.0, 0.15]) * (place[..., :1] > 2)
    assert levelling_rotation(Stance(stairs, yes, yes)) is None


def test_turning_the_world(planted: Motion, bundled: BodyModel) -> None:
    rotation = so3.exp(torch.tensor([0.1, -0.2, 0.3]))
    before = bundled.pose(planted).joints
    after = bundled.pose(rotated_motion(planted, rotation, bundled)).joints
    assert torch.allclose(after, before @ rotation.mT, atol=1e-5)


def test_jumps_split_a_recording(recording: SkeletonRecording) -> None:
    assert jump_frames(recording) == ()
    jumpy = recording.positions.copy()
    jumpy[62:] += 2.0
    broken = dataclasses.replace(recording, positions=jumpy)
    assert jump_frames(broken) == (61,)
    pieces, rejected = split_at_jumps(SourceClip("c", "clip", Path("clip.bvh")), broken)
    assert [(p.name, p.recording.frames) for p in pieces] == [("clip.0", 62)]
    assert rejected[0]["kept"] is False
    assert rejected[0]["frames"] == 4
    assert "1 jumps" in str(rejected[0]["reason"])


def test_a_root_in_another_unit_than_the_bones_is_told(
    recording: SkeletonRecording, bundled: BodyModel
) -> None:
    """A motion of 118 m/s had no warning."""
    root = recording.positions[:, :1]
    far = dataclasses.replace(recording, positions=recording.positions + 500 * root)
    told = [one.message for one in convert(far, bundled).warnings]
    assert any("another unit than the bones" in one for one in told)


def test_collections_read_manifests(recording: SkeletonRecording, tmp_path: Path) -> None:
    folder = tmp_path / "lab"
    folder.mkdir()
    write_bvh(folder / "a.bvh", recording)
    (folder / "b.bvh").write_text("damaged")
    (folder / "manifest.csv").write_text(
        "path,subject,action,skeleton\n"
        "a.bvh,7,walk on uneven terrain,one common skeleton\nb.bvh,8,walk,\nc.bvh,8,walk,\n"
    )
    ((a, b, c),) = clips_by_collection(tmp_path)
    assert (a.subject, a.on_flat_ground, a.reliable_contacts) == ("7", False, False)
    assert (b.on_flat_ground, b.reliable_contacts) == (True, True)
    found = {content.clip.name: content for content in contents_of_clips([a, b, c])}
    assert skeleton_key(found["a"].read()).startswith("pelvis,")
    with pytest.raises(ValueError, match="no line MOTION"):
        found["b"].read()
    with pytest.raises(ValueError, match="no such file"):
        found["c"].read()
    with pytest.raises(FileNotFoundError):
        clips_by_collection(tmp_path / "nowhere")


def test_a_corpus_is_resumed(recording: SkeletonRecording, tmp_path: Path) -> None:
    source, out = tmp_path / "in", tmp_path / "out"
    source.mkdir()
    write_bvh(source / "a.bvh", recording)
    (source / "damaged.bvh").write_text("no")
    rows = convert_corpus(source, out, processes=1)
    assert [(row["clip"], row["kept"]) for row in rows] == [("damaged", False), ("a", True)]
    path = out / "in" / "a.npz"
    first = path.stat().st_mtime_ns
    motion = load_motion(path)
    assert motion.contacts is not None
    assert motion.joints is not None
    assert motion.motion.frames == FRAMES
    assert {row["clip"] for row in json.loads((out / "report.json").read_text())} == {
        "a", "damaged",
    }  # fmt: skip
    again = convert_corpus(source, out, processes=1)
    assert path.stat().st_mtime_ns == first
    assert {row["clip"]: row["kept"] for row in again} == {"a": True, "damaged": False}


def test_settings_have_a_hash(bundled: BodyModel) -> None:
    other = dataclasses.replace(bundled, checksum="another")
    assert conversion_checksum(bundled) != conversion_checksum(other)


def marker_recording(planted: Motion, body: BodyModel) -> tuple[MarkerRecording, Tensor]:
    """Markers off the skin, some hidden at times, and where they really are."""
    vertices = [landmark(name) for name in MARKERS.values()]
    posed = body.pose(planted)
    bones = body.weights[vertices].argmax(-1)
    offsets = nominal_offsets(body, vertices) + 0.004 * torch.randn(len(vertices), 3)
    points = posed.points(torch.tensor(vertices))
    points = points + (posed.orientations[:, bones] @ offsets[..., None])[..., 0]
    visible = torch.rand(points.shape[:2]) > 0.1
    shown = points.where(visible[..., None], 0.0)
    labels = tuple(f"Anna:{label}" for label in MARKERS)
    recording = MarkerRecording(
        "planted", (*labels, "Anna:LHipAngles"),
        np.concatenate([shown.numpy(), np.ones((FRAMES, 1, 3))], 1).astype(float),
        np.concatenate([visible.numpy(), np.ones((FRAMES, 1), bool)], 1), FPS, (),
    )  # fmt: skip
    return recording, points


def test_markers_bring_back_the_motion(planted: Motion, bundled: BodyModel) -> None:
    recording, _ = marker_recording(planted, bundled)
    found = convert(recording, bundled)
    truth = bundled.pose(planted).joints
    ours = found.joints + torch.tensor([0.0, 0.0, found.ground_shift])
    assert (ours - truth).norm(dim=-1).mean() < 0.02  # metres
    assert np.mean(list(found.residuals.values())) < 6.0  # millimetres
    assert any("LHipAngles" in decision for decision in found.decisions)


def test_marker_sets_that_are_no_body(planted: Motion, bundled: BodyModel) -> None:
    recording, _ = marker_recording(planted, bundled)
    low = ("LASI", "RASI", "PSI", "LTHI", "LKNE", "LTIB", "LANK", "LHEE", "LTOE")
    leg = [name for name in recording.marker_names if name.endswith(low)]
    with pytest.raises(ValueError, match=r"without a marker: right thigh .* trunk"):
        full_body_markers(recording.select(leg), bundled)
    few = recording.select([n for n in recording.marker_names if n[5:] in ("LASI", "C7")])
    with pytest.raises(ValueError, match=r"at least 10 markers .*, got 2 .*left thigh"):
        full_body_markers(few, bundled)
    other = dataclasses.replace(bundled, name="mine", checksum="other")
    with pytest.raises(ValueError, match="not of 'mine'"):
        full_body_markers(recording, other)


def test_nominal_offsets_point_off_the_skin(bundled: BodyModel) -> None:
    found = nominal_offsets(bundled, [landmark("nose"), landmark("left_heel")])
    assert torch.allclose(found.norm(dim=-1), torch.tensor(STANDOFF), atol=1e-6)
    assert found[0, 2] > 0.005  # the nose looks ahead, the heel back
    assert found[1, 2] < -0.003


@pytest.mark.parametrize("rate", [0.0, -30.0])
def test_rates_are_checked(recording: SkeletonRecording, bundled: BodyModel, rate: float) -> None:
    with pytest.raises(ValueError, match="expected a number above 0"):
        convert(recording, bundled, fps=rate)


def test_a_real_clip(data: Path, bundled: BodyModel) -> None:
    """CMU 02_01: asked is a residual under 25 mm and no more slip than the source has."""
    found = convert(data / "mocap" / "cmu" / "bvh31" / "02_01.bvh.xz", bundled)
    assert float(found.report["residual_mm"] or 99) < 8.0  # millimetres
    assert float(found.report["slip_mps"] or 9) < 1.05 * float(
        found.report["slip_source_mps"] or 0
    )
    assert found.motion.frames == 343
    assert found.motion.start_time == pytest.approx(1 / 120)  # after a T-pose

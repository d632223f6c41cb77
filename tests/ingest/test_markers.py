"""Recordings of markers with what goes wrong in practice: gaps, jumps, exchanged labels."""

import dataclasses
import json
from importlib import resources
from pathlib import Path

import numpy as np
import pytest
import torch

import recon
from observations.markers3d import Markers3D
from recon.body.landmarks import landmark
from recon.body.model import BodyModel
from recon.body.soles import Soles
from recon.core.motion import Motion
from recon.core.skeleton import JOINTS, joint_index
from recon.diagnosis.findings import Finding
from recon.formats.motions import load_motion
from recon.ingest import Conversion, convert
from recon.ingest.conversion import on_ground
from recon.ingest.marker_exchanges import (
    opposite_label,
    pairs_exchanged_throughout,
    side_pairs,
    with_exchanges_undone,
)
from recon.ingest.marker_gaps import gap_findings, observed_joints, placed_frames, with_gaps_filled
from recon.ingest.marker_observation import seen_markers
from recon.ingest.marker_poses import natural_pose
from recon.ingest.marker_sets import full_body_markers
from recon.mocap.recording import MarkerRecording
from tests.ingest.walker import LABELS

ARM = [LABELS.index(label) for label in ("LELB", "LWRA", "LWRB")]


def hidden(
    recording: MarkerRecording, frames: slice, columns: list[int] | slice
) -> MarkerRecording:
    visible = recording.visible.copy()
    visible[frames, columns] = False
    return dataclasses.replace(
        recording,
        visible=visible,
        positions=np.where(visible[..., None], recording.positions, 0.0),
    )


def codes(found: tuple[Finding, ...]) -> list[str]:
    return [finding.code for finding in found]


def test_another_person_and_a_size_of_nobody_are_said(
    markers: MarkerRecording, single: BodyModel
) -> None:
    """Only `recon fit` said it of labels that move to another subject, or of a wrong unit."""
    moved = markers.positions + np.where(np.arange(markers.frames) < 15, 0.0, 1.0)[:, None, None]
    found = convert(
        dataclasses.replace(markers, positions=moved * markers.visible[..., None]), single
    )
    assert "identity change" in codes(found.warnings)
    assert "body size" not in codes(found.warnings + found.diagnosis)
    found = convert(dataclasses.replace(markers, positions=0.4 * markers.positions), single)
    assert "body size" in codes(found.warnings)
    assert "identity change" not in codes(found.warnings)


@pytest.fixture(scope="module")
def with_gaps(markers: MarkerRecording, single: BodyModel) -> Conversion:
    """No marker in frames 0-7 and 14-18 of 30, and never one on the left arm."""
    spoiled = hidden(markers, slice(0, 8), slice(None))
    spoiled = hidden(spoiled, slice(14, 19), slice(None))
    return convert(hidden(spoiled, slice(None), ARM), single)


def test_frames_without_markers_are_joined_or_left_out(
    with_gaps: Conversion, walk: Motion, single: BodyModel
) -> None:
    """They became a T-pose that floated metres above the ground. Those before the first marker
    are left out: nobody knows where the body was."""
    assert with_gaps.motion.frames == walk.frames - 8
    assert with_gaps.motion.start_time == pytest.approx(8 / 30)
    assert any("the first 8 of 30 frames" in said for said in with_gaps.decisions)
    assert with_gaps.observed is not None
    empty = ~with_gaps.observed.any(-1)
    assert empty.nonzero()[:, 0].tolist() == [*range(6, 11)]
    steps = with_gaps.joints.diff(dim=0).norm(dim=-1)
    assert steps[5:11].max() < 1.5 * single.pose(walk).joints.diff(dim=0).norm(dim=-1).max()
    assert not with_gaps.contacts[empty].any()


def test_gaps_and_limbs_without_markers_are_said(with_gaps: Conversion) -> None:
    found = {finding.code: finding for finding in with_gaps.warnings}
    assert found["gap"].frames == ((6, 10),)
    assert found["gap"].value == pytest.approx(5 / 30)
    assert set(found["unseen"].joints) == {"left_elbow", "left_wrist"}
    assert "left arm (never seen)" in found["unseen"].message


def test_an_arm_without_markers_hangs(with_gaps: Conversion) -> None:
    """It stood out to the side, as in the T-pose of the body's zero."""
    assert with_gaps.observed is not None
    arm = [joint_index("left_elbow"), joint_index("left_wrist")]
    assert not with_gaps.observed[:, arm].any()
    assert with_gaps.observed[:6, joint_index("right_wrist")].all()
    shoulder, elbow = (
        with_gaps.joints[:, joint_index(f"left_{j}")] for j in ("shoulder", "elbow")
    )
    down = (shoulder - elbow)[:, 2] / (shoulder - elbow).norm(dim=-1)
    assert down.min() > 0.8
    assert natural_pose().shape == (21, 3, 3)


def test_what_was_seen_is_written(
    with_gaps: Conversion, single: BodyModel, tmp_path: Path
) -> None:
    with_gaps.save(tmp_path / "m.npz", single)
    back = load_motion(tmp_path / "m.npz").observed
    assert back is not None
    assert with_gaps.observed is not None
    assert torch.equal(back, with_gaps.observed)
    lists = with_gaps.findings()
    assert {"gap", "unseen"} <= {entry["code"] for entry in lists["warnings"]}
    assert any(entry["joints"] == ("C7",) for entry in lists["diagnosis"])


def test_the_report_beside_the_motion_holds_the_lists(
    with_gaps: Conversion, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("recon.ingest.single.convert", lambda *_, **__: with_gaps)
    (tmp_path / "raw.trc").write_bytes(b"markers")
    out = tmp_path / "m.npz"
    recon.convert(tmp_path / "raw.trc").save(out)
    report = json.loads((tmp_path / "m.npz.json").read_bytes())
    assert {entry["code"] for entry in report["warnings"]} == {"gap", "unseen"}
    assert report["repairs"] == []
    assert {entry["code"] for entry in report["diagnosis"]} == {"residual"}
    assert set(report["warnings"][0]) == {
        "code",
        "message",
        "joints",
        "frames",
        "value",
        "sensors",
    }


def test_a_good_recording_raises_nothing(
    markers: MarkerRecording, walk: Motion, single: BodyModel
) -> None:
    found = convert(markers, single)
    assert found.warnings == ()
    assert found.repairs == ()
    assert found.observed is not None
    assert found.observed.all()
    assert found.report["n_glitch"] == 0
    turned = single.pose(walk).joints
    assert (found.joints - turned - (found.joints - turned).mean((0, 1))).norm(dim=-1).max() < 0.02


def test_markers_are_fitted_on_one_thread(
    markers: MarkerRecording, single: BodyModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On all processors of a busy machine a conversion took ten times the CPU time."""
    threads: list[int] = []

    def fitted(*_: object, **__: object) -> None:
        threads.append(torch.get_num_threads())
        raise KeyError

    monkeypatch.setattr("recon.ingest.marker_conversion.fit_markers", fitted)
    torch.set_num_threads(2)
    with pytest.raises(KeyError):
        convert(markers, single)
    assert threads == [1]
    assert torch.get_num_threads() == 2


def test_too_few_markers_place_nothing() -> None:
    visible = torch.zeros(3, 6, dtype=torch.bool)
    visible[0, :3] = True
    visible[1, 3:5] = True
    visible[2, 3:] = True
    # the torso carries the first three
    assert placed_frames(visible, (0, 0, 3, 18, 19, 20)).tolist() == [True, False, True]


def test_markers_show_the_joints_beside_and_before_them(single: BodyModel) -> None:
    vertices = tuple(landmark(name) for name in ("left_elbow_lateral", "sacrum", "c7", "t10"))
    seen = observed_joints(torch.ones(1, 4, dtype=torch.bool), vertices, single)[0]
    shown = {name for name, here in zip(JOINTS, seen.tolist(), strict=True) if here}
    assert {"pelvis", "left_elbow", "left_shoulder", "spine3"} <= shown
    assert shown.isdisjoint({"left_wrist", "right_elbow", "right_wrist", "left_knee"})


def test_a_limb_is_joined_over_its_own_gap(walk: Motion) -> None:
    """The trunk is seen in between, and only the arm is made up."""
    turned = torch.ones(walk.frames, 22, dtype=torch.bool)
    arm = joint_index("left_shoulder")
    turned[10:20, arm] = False
    found = with_gaps_filled(walk, torch.arange(walk.frames), turned)
    others = [j for j in range(22) if j != arm]
    assert torch.equal(found.rotations[:, others], walk.rotations[:, others])
    assert torch.equal(found.rotations[:10, arm], walk.rotations[:10, arm])
    turns = found.rotations[9:20, arm].mT @ found.rotations[10:21, arm]
    angles = ((turns.diagonal(dim1=-1, dim2=-2).sum(-1) - 1) / 2).clamp(-1, 1).arccos()
    assert angles.std() < 1e-3


def test_short_gaps_of_limbs_are_not_worth_a_word() -> None:
    observed = torch.ones(100, 22, dtype=torch.bool)
    observed[40:50, joint_index("left_wrist")] = False
    assert gap_findings(observed, 50.0) == []
    observed[40:60, joint_index("left_wrist")] = False
    (found,) = gap_findings(observed, 50.0)
    assert (found.code, found.frames, found.joints) == ("unseen", ((40, 59),), ("left_wrist",))


def exchanged(recording: MarkerRecording, pairs: list[tuple[str, str]], frames: slice):
    order = list(range(len(LABELS)))
    for a, b in pairs:
        i, j = LABELS.index(a), LABELS.index(b)
        order[i], order[j] = j, i
    positions = recording.positions.copy()
    positions[frames] = recording.positions[frames][:, order]
    return dataclasses.replace(recording, positions=positions)


def test_labels_that_change_over_are_put_back(markers: MarkerRecording) -> None:
    pair = ("LKNE", "LANK")
    found, said = with_exchanges_undone(exchanged(markers, [pair], slice(12, 20)))
    np.testing.assert_array_equal(found.positions, markers.positions)
    assert (said[0].code, said[0].frames, set(said[0].joints)) == (
        "points exchanged", ((12, 19),), set(pair),
    )  # fmt: skip
    # one exchange only: the shorter part is the wrong one
    found, said = with_exchanges_undone(exchanged(markers, [pair], slice(20, None)))
    np.testing.assert_array_equal(found.positions, markers.positions)
    assert said[0].frames == ((20, 29),)


def test_sides_that_change_over_are_put_back(markers: MarkerRecording) -> None:
    pairs = [(LABELS[a], LABELS[b]) for a, b in side_pairs(list(LABELS))]
    assert len(pairs) == 14
    found, said = with_exchanges_undone(exchanged(markers, pairs, slice(8, 15)))
    np.testing.assert_array_equal(found.positions, markers.positions)
    assert codes(tuple(said)) == ["sides exchanged"]


def test_fast_markers_keep_their_labels(markers: MarkerRecording) -> None:
    """At 10 frames a second hands pass where other markers were."""
    fast = dataclasses.replace(
        markers, positions=markers.positions[::5], visible=markers.visible[::5], fps=6.0
    )
    assert with_exchanges_undone(fast) == (fast, [])


@pytest.mark.slow
def test_two_markers_exchanged_throughout(markers: MarkerRecording, single: BodyModel) -> None:
    pair = ("LWRA", "RKNE")
    found = convert(exchanged(markers, [pair], slice(None)), single)
    assert codes(found.repairs) == ["points exchanged"]
    assert set(found.repairs[0].joints) == set(pair)
    assert float(found.report["residual_mm"] or 99) < 8


def test_pairs_lie_in_each_others_place() -> None:
    places = np.arange(4.0)[None, :, None] * np.ones((5, 1, 3))
    seen = np.ones((5, 4), dtype=bool)
    swapped = places[:, [0, 2, 1, 3]]
    assert pairs_exchanged_throughout("abcd", swapped, seen, places) == [(1, 2)]
    assert pairs_exchanged_throughout("abcd", places, seen, places) == []
    seen[:, 1] = False
    assert pairs_exchanged_throughout("abcd", swapped, seen, places) == []


@pytest.mark.parametrize(
    ("label", "other"),
    [("LASI", "RASI"), ("r_knee_study", "l_knee_study"), ("left_heel", "right_heel"),
     ("Hip_L", "Hip_R"), ("C7", None), ("Sternum", None)],
)  # fmt: skip
def test_counterparts_of_labels(label: str, other: str | None) -> None:
    assert opposite_label(label) == other


def test_augmented_keypoints_are_left_out(markers: MarkerRecording, single: BodyModel) -> None:
    """OpenCap writes markers that a network placed beside the keypoints they were made from."""
    names = (".ASIS", ".PSIS", "_knee", "_mknee", "_ankle", "_toe", "_shoulder")
    study = tuple(f"{side}{name}_study" for side in "rL" for name in names)
    both = (*study, "RKnee", "LKnee", "RAnkle", "LAnkle")
    count = len(both)
    recording = dataclasses.replace(
        markers,
        marker_names=both,
        positions=markers.positions[:, :count],
        visible=markers.visible[:, :count],
    )
    used = full_body_markers(recording, single)
    assert set(used.labels) <= set(study)
    assert not used.inside


def test_virtual_points_are_left_out_by_conversions_and_fits(
    markers: MarkerRecording, single: BodyModel
) -> None:
    """Fits left them out, conversions pulled the body to them: LTB1 is a point in the room there,
    and a marker of the shank elsewhere."""
    names = ("LTB1", "LTB2", "RTB1")
    shins = markers.positions[:, [LABELS.index(label) for label in ("LTIB", "LTIB", "RTIB")]]
    both = dataclasses.replace(
        markers,
        marker_names=(*markers.marker_names, *names),
        positions=np.concatenate((markers.positions, shins + np.array([0.0, 0.4, 0.3])), 1),
        visible=np.ones((markers.frames, len(LABELS) + 3), dtype=bool),
    )
    found, without = convert(both, single), convert(markers, single)
    assert found.residuals.keys() == without.residuals.keys()
    assert (found.joints - without.joints).norm(dim=-1).max() < 1e-3  # metres
    assert [one.joints for one in found.warnings if one.code == "outliers"] == [names]
    seen, decisions = seen_markers(both, single)
    assert isinstance(seen, Markers3D)
    assert not seen.visible[0, :, -3:].any()
    assert seen.visible[0, :, :-3].all()
    assert any("LTB1, LTB2" in said and "left out" in said for said in decisions)


def test_contacts_on_a_belt_are_not_told(walk: Motion, single: BodyModel, tmp_path: Path) -> None:
    whole = load_motion(Path(str(resources.files("recon") / "assets" / "demo.npz"))).motion
    seconds = torch.arange(whole.frames) / whole.fps
    drift = (whole.translation[-1] - whole.translation[0]) / seconds[-1]
    drift[2] = 0.0
    belt = whole.replace(translation=whole.translation - seconds[:, None] * drift)
    found = on_ground(belt, {"c7": 1.0}, (), single, Soles.of(single), n_glitch=0)
    assert codes(found.warnings) == ["treadmill"]
    found.save(tmp_path / "m.npz", single)
    assert load_motion(tmp_path / "m.npz").contacts is None
    still = on_ground(whole, {"c7": 1.0}, (), single, Soles.of(single), n_glitch=0)
    assert still.warnings == ()
    # the belt's stance gives the same ground as the floor's
    low, floor = (f.joints[..., 2].amin() for f in (found, still))
    torch.testing.assert_close(low, floor, atol=0.01, rtol=0)

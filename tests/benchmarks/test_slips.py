"""Every slip changes what it says and nothing else, and verdicts count what they should."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from benchmarks.protocol import demo_clip
from benchmarks.slips import mistakes, points
from benchmarks.slips.__main__ import of_good, of_slips
from benchmarks.slips.good import GoodWindow, alarms, listed
from benchmarks.slips.judging import (
    claimed_samples,
    mirror_image,
    motion_error,
    rigidly_aligned,
    spoiled_samples,
    verdict_of,
)
from benchmarks.slips.kinds import SLIPS, Slip
from benchmarks.slips.recordings import CLEAN, Recording, Sensor, cameras_of, observed
from observations.keypoints2d import Keypoints2D
from recon.body.model import BodyModel
from recon.core.skeleton import JOINTS
from recon.diagnosis.findings import Finding
from recon.method.sensor import Sensor as Seen

FRAMES = 30
BODY = BodyModel.load()


def recorded(sensor: Sensor) -> Recording:
    whole = demo_clip(2 * FRAMES)
    truth = whole.window(0, FRAMES)
    stranger = whole.window(FRAMES, 2 * FRAMES).replace(start_time=truth.start_time)
    cameras = cameras_of(sensor, truth, BODY, 3)
    clean = observed(sensor, truth, BODY, cameras, CLEAN[sensor], 3)
    return Recording("demo", sensor, truth, stranger, BODY, cameras, CLEAN[sensor], 3, clean)


RECORDED = {sensor: recorded(sensor) for sensor in ("joints3d", "markers3d", "camera", "cameras")}


def same(a: Seen, b: Seen) -> bool:
    """Whether two observations are equal in values, weights, clock and camera."""
    poses = [seen.camera.T_camera_world for seen in (a, b) if isinstance(seen, Keypoints2D)]
    return (
        all(torch.equal(pose, poses[0]) for pose in poses)
        and torch.equal(points.values_of(a), points.values_of(b))
        and torch.equal(points.weights_of(a), points.weights_of(b))
        and (a.fps, a.start_time) == (b.fps, b.start_time)
    )


def test_there_are_45_slips_with_names_of_their_own() -> None:
    assert len(SLIPS) == 45
    assert len({slip.key for slip in SLIPS}) == 45


@pytest.mark.parametrize("slip", SLIPS, ids=lambda slip: slip.key)
def test_a_slip_spoils_what_is_seen_and_leaves_its_source_alone(slip: Slip) -> None:
    recording = RECORDED[slip.sensor]
    before = tuple(seen.map(torch.clone) for seen in recording.clean)
    spoiled = slip.spoil(recording, slip.size)
    assert not all(same(a, b) for a, b in zip(spoiled, recording.clean, strict=True))
    assert all(same(a, b) for a, b in zip(before, recording.clean, strict=True))
    for seen, clean in zip(spoiled, recording.clean, strict=True):
        assert points.values_of(seen).shape == points.values_of(clean).shape
        assert points.values_of(seen).isfinite().all()
        hidden = points.weights_of(seen) == 0
        assert (points.values_of(seen)[hidden] == 0).all()


@pytest.mark.parametrize("slip", SLIPS, ids=lambda slip: slip.key)
def test_a_slip_is_the_same_every_time(slip: Slip) -> None:
    recording = RECORDED[slip.sensor]
    first, second = (slip.spoil(recording, slip.size) for _ in range(2))
    assert all(same(a, b) for a, b in zip(first, second, strict=True))


@pytest.mark.parametrize(
    "slip", [s for s in SLIPS if s.sensor == "cameras" and " one " in f" {s.name} "],
    ids=lambda slip: slip.key,
)  # fmt: skip
def test_a_slip_of_one_view_leaves_the_others_alone(slip: Slip) -> None:
    recording = RECORDED["cameras"]
    spoiled = slip.spoil(recording, slip.size)
    changed = [not same(a, b) for a, b in zip(spoiled, recording.clean, strict=True)]
    assert changed == [False, True, False]


def test_exchanged_sides_are_undone_by_exchanging_them_again() -> None:
    seen = RECORDED["joints3d"].clean[0]
    pairs = points.pairs_of_sides(points.point_names(seen))
    assert len(pairs) == 8
    once = points.exchanged(seen, pairs, slice(5, 10))
    assert same(points.exchanged(once, pairs, slice(5, 10)), seen)
    changed = (points.values_of(once) != points.values_of(seen)).any(-1)[0]
    assert changed.any(1).nonzero()[:, 0].tolist() == list(range(5, 10))
    assert changed.any(0).sum() == 16


def test_a_held_point_stands_still_and_the_others_move() -> None:
    seen = mistakes.hold("left_wrist")(RECORDED["joints3d"], 0.5)[0]
    moves = points.values_of(seen)[0].diff(dim=0).norm(dim=-1)
    still = (moves == 0).sum(0)
    assert still[points.point_names(seen).index("left_wrist")] == 14
    assert still.sum() == 14


def test_a_share_of_zeros_counts_as_seen() -> None:
    seen = mistakes.zeros(RECORDED["markers3d"], 0.2)[0]
    zero = (points.values_of(seen) == 0).all(-1)
    assert float(zero.float().mean()) == pytest.approx(0.2, abs=0.03)
    assert (points.weights_of(seen) == 1).all()


def test_orders_of_frames() -> None:
    order = points.shuffled(30, 8, 0)
    assert order.sort().values.tolist() == list(range(30))
    assert ((order - torch.arange(30)).abs() < 8).all()
    assert order.tolist() != list(range(30))
    repeats = points.repeating(1000, 0.5, 0)
    assert (repeats <= torch.arange(1000)).all()
    assert float((repeats.diff() == 0).float().mean()) == pytest.approx(0.5, abs=0.05)


def test_the_other_person_stands_where_the_size_says() -> None:
    recording = RECORDED["joints3d"]
    frame = FRAMES // 2
    own, other = (
        BODY.pose(motion).joints[frame, 0]
        for motion in (recording.truth, mistakes.beside(recording, 0.6, frame))
    )
    assert float((own - other)[:2].norm()) == pytest.approx(0.6, abs=1e-4)
    seen = mistakes.somebody_else(recording, 0.6)[0]
    assert torch.equal(points.values_of(seen)[:, :frame],
                       points.values_of(recording.clean[0])[:, :frame])  # fmt: skip


def test_a_delayed_view_shows_what_was_before() -> None:
    view = RECORDED["cameras"].clean[0]
    late = points.delayed(view, 4)
    assert torch.equal(points.values_of(late)[:, 4:], points.values_of(view)[:, :-4])
    assert (points.weights_of(late)[:, :4] == 0).all()


def test_a_mirrored_view_is_mirrored_back() -> None:
    view = RECORDED["cameras"].clean[0]
    torch.testing.assert_close(
        points.values_of(points.mirrored(points.mirrored(view))), points.values_of(view)
    )


def test_a_turned_camera_stays_in_its_place() -> None:
    view = RECORDED["cameras"].clean[1]
    assert isinstance(view, Keypoints2D)
    off = points.misplaced(view, 4.0, 0)
    assert isinstance(off, Keypoints2D)
    eyes = [v.camera.T_world_camera[0, 0] for v in (view, off)]
    torch.testing.assert_close(eyes[0][:3, 3], eyes[1][:3, 3], atol=1e-4, rtol=0)
    turn = eyes[0][:3, :3].T @ eyes[1][:3, :3]
    angle = torch.rad2deg(torch.acos((turn.trace() - 1) / 2))
    assert float(angle) == pytest.approx(4.0, abs=0.01)


def test_errors_are_those_of_what_is_spoiled() -> None:
    recording = RECORDED["joints3d"]
    truth = recording.truth
    every = torch.ones(FRAMES, 22, dtype=torch.bool)
    lifted = truth.replace(translation=truth.translation + torch.tensor([0.0, 0.0, 0.3]))
    assert motion_error(lifted, recording, "world", every) == pytest.approx(0.3, abs=1e-4)
    assert motion_error(lifted, recording, "pelvis", every) == pytest.approx(0.0, abs=1e-5)
    assert motion_error(lifted, recording, "path", every) == pytest.approx(0.0, abs=1e-5)
    assert motion_error(lifted, recording, "posture", every) == pytest.approx(0.0, abs=1e-3)
    fast = replace(truth, fps=2 * truth.fps)
    assert motion_error(fast, recording, "speed", every) == pytest.approx(2.0, abs=1e-3)
    assert motion_error(truth, recording, "world", every) == pytest.approx(0, abs=1e-5)


def test_joints_that_are_declared_inferred_are_not_judged_unless_most_are() -> None:
    slip = next(s for s in SLIPS if s.joints == ("left_wrist",))
    observed = np.ones((FRAMES, 22), dtype=bool)
    wrist = spoiled_samples(slip, FRAMES)
    assert wrist.sum() == FRAMES
    assert torch.equal(claimed_samples(slip, observed, FRAMES), wrist)
    observed[5:, JOINTS.index("left_wrist")] = False
    rest = claimed_samples(slip, observed, FRAMES)
    assert torch.equal(rest, torch.from_numpy(observed))
    assert claimed_samples(slip, np.zeros((FRAMES, 22), dtype=bool), FRAMES).all()


def test_a_mirror_image_is_no_rotation_but_a_rotation_is_aligned() -> None:
    joints = BODY.pose(RECORDED["joints3d"].truth).joints
    turn = points.turned(torch.tensor([70.0]), 1)[0, :3, :3]
    torch.testing.assert_close(rigidly_aligned(joints @ turn.T + 1, joints), joints,
                               atol=1e-4, rtol=0)  # fmt: skip
    torch.testing.assert_close(mirror_image(mirror_image(joints)), joints)


def test_verdicts() -> None:
    slip = SLIPS[0]
    right, wrong, unseen = (Finding(c, "") for c in ("sides exchanged", "rate", "unseen"))
    silent = verdict_of(slip, "a", 0.01, 0.05, (), ())
    assert (silent.caught, silent.named, silent.judged) == (False, False, True)
    warned = verdict_of(slip, "b", 0.01, 0.05, (), (wrong, right))
    assert (warned.caught, warned.named) == (True, True)
    repaired = verdict_of(slip, "c", 0.01, 0.0115, (unseen, right), ())
    assert (repaired.caught, repaired.named) == (True, True)
    in_vain = verdict_of(slip, "d", 0.01, 0.05, (right,), ())
    assert (in_vain.caught, in_vain.named) == (False, True)
    harmless = verdict_of(slip, "e", 0.01, 0.01, (), ())
    assert (harmless.caught, harmless.judged) == (True, False)
    table = of_slips({slip: [silent, warned, repaired, in_vain, harmless]})
    assert table.rows[0][-3:] == table.rows[1][-3:] == ["2/5", "3/5", "3/4"]
    assert table.note.startswith("As good or warned: 60.0 %")


def test_good_windows_are_counted_by_sensor_and_by_collection() -> None:
    table = of_good({
        GoodWindow("07_01@0.03", "joints3d: 4 cm"): set(),
        GoodWindow("07_02@0.03", "joints3d: 1 cm"): {"floor"},
        GoodWindow("opensim/rajagopal_walk.trc"): set(),
    })  # fmt: skip
    assert table.rows == [
        ["real opensim", 1, "0", None],
        ["simulated joints3d", 2, "1", "1 floor"],
        ["all", 3, "1 (33.3 %)", None],
    ]


def test_the_list_of_good_windows() -> None:
    assert len(listed("test")) == 300
    assert len(set(listed("test"))) == 300
    assert not set(listed("test")) & set(listed("validation"))


def test_only_what_is_not_so_is_a_false_alarm() -> None:
    said = tuple(Finding(code, "") for code in ("treadmill", "unseen", "floor"))
    run = GoodWindow("opensim/hamner_subject02_running.trc", start=2.0)
    assert [f.code for f in alarms(run, said)] == ["floor"]
    walk = GoodWindow("07_01@0.03", "joints3d: 4 cm")
    assert [f.code for f in alarms(walk, said)] == ["treadmill", "floor"]

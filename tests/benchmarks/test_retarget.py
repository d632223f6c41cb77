"""What the table of retargeting compares, on motions whose answer is known."""

import math
import tomllib
from pathlib import Path

import pytest
import torch

from benchmarks.retarget import itself, measured, summary, with_sums
from benchmarks.retarget_baselines import (
    copied,
    copied_to_ground,
    foot_ik,
    physics_only,
    scaled,
    sole_heights,
    soles_down,
)
from benchmarks.retarget_clips import (
    FPS,
    IDENTITIES,
    LONGEST,
    SHORTEST,
    Job,
    draw_targets,
    evenly,
    grounded,
    is_high,
    load_jobs,
    lowest,
    middle,
)
from recon.benchmark.dataset import Splits
from recon.body.model import BodyModel
from recon.core import rotations as so3
from recon.core.motion import Motion
from recon.core.struct import concatenate
from recon.formats.motions import MotionFile, save_motion
from recon.physics.metrics import PhysicsSamples
from tests.benchmarks.test_windows import splits_of

BODY = BodyModel.load()
TALL = torch.zeros(16).index_fill(0, torch.tensor(0), 1.5)


def squatting(frames: int = 21, bend: float = 0.6) -> Motion:
    """Feet flat on the ground, hips and knees that bend and stretch in one place."""
    angle = 0.2 + bend * (1 - torch.linspace(0, 2 * math.pi, frames).cos()) / 2
    side = torch.tensor([1.0, 0.0, 0.0])
    rotations = torch.eye(3).expand(frames, 22, 3, 3).clone()
    rotations[:, 0] = so3.exp(math.pi / 2 * side)
    for joints, share in (((1, 2), -1.5), ((4, 5), 2.0), ((7, 8), -0.5)):
        rotations[:, list(joints)] = so3.exp(share * angle[:, None] * side)[:, None]
    motion = Motion.create(torch.zeros(frames, 3), rotations, torch.zeros(16), FPS)
    ankles = BODY.pose(motion).joints[:, [7, 8]].mean(1)
    return grounded(motion.replace(translation=-(ankles - ankles[:1])), BODY, 0.0)


def test_the_committed_table_keeps_its_promises() -> None:
    splits, listed = Splits.load(), tomllib.loads(IDENTITIES.read_text())
    held = {"test": splits.test, "validation": splits.validation}
    names = [row[0] for part in held for row in listed[part]]
    assert len(set(names)) == len(names)
    for part, subjects in held.items():
        targets = [row[3] for row in listed[part]]
        assert {splits.subject(row[0]) for row in listed[part]} >= set(subjects)
        assert all(SHORTEST <= row[2] <= LONGEST for row in listed[part])
        assert sum(isinstance(to, str) for to in targets) == len(targets) // 2
        assert all(to in listed["people"] for to in targets if isinstance(to, str))
        drawn = torch.tensor([to for to in targets if not isinstance(to, str)])
        assert drawn.shape[1] == BODY.shape_size
        assert drawn.abs().max() <= 2
        assert 0.6 < drawn.std() < 1.1
        assert len(torch.unique(drawn, dim=0)) == len(drawn)
    held_out = {*splits.test, *splits.validation}
    assert not any(splits.subject(clip) in held_out for clip in listed["people"])


def test_targets_are_drawn_once_and_never_a_clips_own() -> None:
    people = {"a": [0.0] * 4, "b": [1.0] * 4}
    own = [[0.0] * 4] * 8
    targets = draw_targets(own, people, 3)
    assert targets == draw_targets(own, people, 3)
    assert targets != draw_targets(own, people, 4)
    assert targets[::2] == ["b"] * 4


def test_clips_are_spread_cut_and_filtered() -> None:
    assert evenly(list("abcdefg"), 3) == ["a", "d", "g"]
    assert evenly(["a"], 3) == ["a"]
    motion = squatting()
    assert middle(motion) is None
    assert middle(motion.resample(200.0)) == (0, 200)
    assert not is_high(motion, BODY)
    lift = torch.tensor([0.0, 0.0, 0.3])
    assert is_high(motion.replace(translation=motion.translation + lift), BODY)


def test_jobs_are_on_the_ground_at_20_hz_for_their_body(tmp_path: Path) -> None:
    motion = squatting(101).replace(fps=50.0)
    motion = motion.replace(translation=motion.translation + 0.1)
    save_motion(tmp_path / "07_01.npz", MotionFile(motion))
    save_motion(tmp_path / "dataset_1.npz", MotionFile(motion))
    splits = splits_of(tmp_path, "")
    table = tmp_path / "table.toml"
    table.write_text(
        f'test = [["07_01", 1, 39, "b"], ["07_01", 0, 30, {[0.5] * 16}]]\n'
        f"[people]\nb = {[1.0] * 16}\n"
    )
    jobs = load_jobs(tmp_path, splits, "test", "open", BODY, table)
    assert [(job.motion.frames, job.motion.fps, job.real) for job in jobs] == [
        (39, 20.0, True),
        (30, 20.0, False),
    ]
    torch.testing.assert_close(jobs[0].target, torch.ones(16))
    assert lowest(jobs[0].motion, BODY).quantile(0.25).abs() < 1e-5
    assert not jobs[0].flies
    table.write_text('test = [["16_15", 0, 39, "b"]]\n')
    with pytest.raises(FileNotFoundError, match="16_15"):
        load_jobs(tmp_path, splits, "test", "open", BODY, table)


def test_copies_keep_the_pelvis_and_touch_the_ground() -> None:
    motion = squatting()
    copy = copied(BODY, motion, TALL)
    torch.testing.assert_close(
        BODY.pose(copy).joints[:, 0], BODY.pose(motion).joints[:, 0], atol=1e-5, rtol=0
    )
    assert lowest(copy, BODY).min() < -0.02
    assert lowest(copied_to_ground(BODY, motion, TALL), BODY).min().abs() < 1e-5


@pytest.mark.parametrize("method", [scaled, foot_ik])
def test_the_own_body_does_what_it_did(method) -> None:
    motion = squatting()
    made = method(BODY, motion, motion.shape)
    torch.testing.assert_close(BODY.pose(made).joints, BODY.pose(motion).joints, atol=5e-3, rtol=0)


def test_feet_reach_the_ground_and_stay_where_they_are() -> None:
    """Thighs and shins of other proportions move flat feet up and down; reaching undoes it."""
    random = torch.Generator().manual_seed(0)
    shape, motion = 2 * torch.randn(16, generator=random), squatting()
    soles = [sole_heights(BODY.pose(f(BODY, motion, shape))) for f in (scaled, foot_ik)]
    feet = [BODY.pose(f(BODY, motion, shape)).joints[:, 10] for f in (scaled, foot_ik)]
    assert soles[1].abs().max() < 2e-3 < soles[0].abs().max()
    assert feet[1].diff(dim=0).norm(dim=-1).max() < 1e-3 < feet[0].diff(dim=0).norm(dim=-1).max()
    before, after = (
        BODY.pose(m) for m in (scaled(BODY, motion, shape), foot_ik(BODY, motion, shape))
    )
    torch.testing.assert_close(
        before.orientations[:, 10], after.orientations[:, 10], atol=1e-5, rtol=0
    )


def slip_of(samples: PhysicsSamples) -> float:
    return float(samples.slip[samples.soles_touch].mean())


def test_physics_alone_lowers_slip_and_stays_near(monkeypatch: pytest.MonkeyPatch) -> None:
    random = torch.Generator().manual_seed(0)
    shape, motion = 2 * torch.randn(16, generator=random), squatting()
    monkeypatch.setattr("recon.fitting.retargeting.SETTLING_ITERATIONS", 8)
    job = Job("clip", "one", motion, shape, False, False)
    (before, _), (after, more) = (measured(f, [job], BODY) for f in (scaled, physics_only))
    a, b = (concatenate(samples) for samples in (before, after))
    assert slip_of(b) < 0.3 * slip_of(a)
    assert b.lowest.abs().mean() < a.lowest.abs().mean()
    turned = more["turned"]
    assert turned is not None
    assert 0 < turned < 5


def test_rows_are_pooled_by_subject_and_sums_count_copies() -> None:
    motion = squatting(9)
    jobs = [Job(name, name, motion, TALL, False, name == "b") for name in ("a", "b")]
    table = {}
    for name, method in {"truth": itself, "copy": copied, "scaled": scaled}.items():
        samples, _ = measured(method, jobs, BODY)
        table[name] = summary(samples, jobs)
    with_sums(table)
    groups = ["pooled", "without flight", "bodies drawn", "mean", "a", "b"]
    assert list(table["copy"]) == groups  # nobody's target is a recorded person's
    assert table["copy"]["a"] == table["copy"]["without flight"]
    for group in table["copy"].values():
        assert group["penetrate"] > 0.02
        assert group["sum"] is None  # nothing floats
    assert soles_down(motion, BODY).all()


def test_subjects_apart_count_in_their_own_row_alone() -> None:
    """Subject 16, who walks like a training subject, was among the pooled frames."""
    motion = squatting(9)
    jobs = [Job(name, name, motion, TALL, False, False) for name in ("a", "b")]
    samples, _ = measured(copied, jobs, BODY)
    table = summary(samples, jobs, apart=("b",))
    assert table["pooled"] == table["without flight"] == table["a"]
    assert table["mean"]["penetrate"] == pytest.approx(table["a"]["penetrate"])
    assert "b" in table


def test_a_clip_of_another_length_is_refused() -> None:
    job = Job("clip", "one", squatting(), TALL, False, False)
    with pytest.raises(ValueError, match="keeps its times"):
        measured(lambda _, motion, _shape: motion.window(0, 9), [job], BODY)

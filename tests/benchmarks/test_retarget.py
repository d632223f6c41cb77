"""What the table of retargeting compares, on motions whose answer is known."""

import math
import tomllib
from pathlib import Path

import pytest
import torch

from benchmarks.retarget import (
    COPY,
    FPS,
    IDENTITIES,
    METHODS,
    PHYSICS,
    SCALED,
    TRUTH,
    Job,
    grounded,
    load_jobs,
    lowest,
    measured,
    soles_down,
    table,
)
from recon.benchmark.dataset import Splits
from recon.body.model import BodyModel
from recon.core import rotations as so3
from recon.core.motion import Motion, MotionFile
from recon.formats.motions import save_motion
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
    later = {"hdm_bk", "hdm_dg", "prmd_s08"}
    held = {"test": set(splits.test) - later, "validation": set(splits.validation) - later}
    names = [row[0] for part in held for row in listed[part]]
    assert len(set(names)) == len(names)
    for part, subjects in held.items():
        targets = [row[3] for row in listed[part]]
        assert {splits.subject(row[0]) for row in listed[part]} >= set(subjects)
        assert all(2 * FPS <= row[2] <= 10 * FPS for row in listed[part])
        assert sum(isinstance(to, str) for to in targets) == len(targets) // 2
        assert all(to in listed["people"] for to in targets if isinstance(to, str))
        drawn = torch.tensor([to for to in targets if not isinstance(to, str)])
        assert drawn.shape[1] == BODY.shape_size
        assert drawn.abs().max() <= 2
        assert 0.6 < drawn.std() < 1.1
        assert len(torch.unique(drawn, dim=0)) == len(drawn)
    held_out = {*splits.test, *splits.validation}
    assert not any(splits.subject(clip) in held_out for clip in listed["people"])


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
    jobs = load_jobs(tmp_path, splits, "test", BODY, table)
    assert [(job.motion.frames, job.motion.fps) for job in jobs] == [(39, 20.0), (30, 20.0)]
    torch.testing.assert_close(jobs[0].target, torch.ones(16))
    assert lowest(jobs[0].motion, BODY).quantile(0.25).abs() < 1e-5
    assert not jobs[0].flies
    table.write_text('test = [["16_15", 0, 39, "b"]]\n')
    with pytest.raises(FileNotFoundError, match="16_15"):
        load_jobs(tmp_path, splits, "test", BODY, table)


def test_a_copy_keeps_the_pelvis_and_the_scaled_motion_is_grounded() -> None:
    motion = squatting()
    copy = METHODS[COPY](BODY, motion, TALL)
    torch.testing.assert_close(
        BODY.pose(copy).joints[:, 0], BODY.pose(motion).joints[:, 0], atol=1e-5, rtol=0
    )
    assert lowest(copy, BODY).min() < -0.02
    own = METHODS[SCALED](BODY, motion, motion.shape)
    torch.testing.assert_close(BODY.pose(own).joints, BODY.pose(motion).joints, atol=5e-3, rtol=0)


def test_physics_lowers_slip(monkeypatch: pytest.MonkeyPatch) -> None:
    random = torch.Generator().manual_seed(0)
    shape, motion = 2 * torch.randn(16, generator=random), squatting()
    monkeypatch.setattr("recon.fitting.retargeting.SETTLING_ITERATIONS", 8)
    job = Job("clip", "one", motion, shape, False)
    before, after = (measured(METHODS[name], job, BODY) for name in (SCALED, PHYSICS))
    slip = [float(s.slip[s.soles_touch].mean()) for s in (before, after)]
    assert slip[1] < 0.3 * slip[0]
    assert after.lowest.abs().max() < 0.01  # metres


def test_sums_count_copies_and_people_apart_stand_alone() -> None:
    """Subject 16, who walks like a training subject, was among the pooled frames."""
    motion = squatting(9)
    jobs = [Job(name, name, motion, TALL, name == "b") for name in ("a", "b", "c")]
    samples = {
        name: [measured(METHODS[name], job, BODY) for job in jobs]
        for name in (TRUTH, COPY, SCALED)
    }
    copy = table(samples, jobs, apart=("c",)).rows[1]
    assert copy[0] == COPY
    assert isinstance(copy[1], float)
    assert copy[1] > 2  # centimetres below the ground
    assert copy[-1] is None  # nothing floats
    assert soles_down(motion, BODY).all()


def test_a_clip_of_another_length_is_refused() -> None:
    job = Job("clip", "one", squatting(), TALL, False)
    with pytest.raises(ValueError, match="keeps its times"):
        measured(lambda _, motion, _shape: motion.window(0, 9), job, BODY)

"""Long recordings: one clip out of windows, as good as in one piece, whatever the clocks."""

from dataclasses import dataclass, field

import pytest
import torch

from observations.joints3d import Joints3D
from recon.core import rotations as so3
from recon.core.motion import Motion
from recon.core.skeleton import JOINTS
from recon.fitting import long
from recon.fitting.long import fit_long
from recon.fitting.long_recording import LongRecording, OverlapEnergy
from recon.fitting.settings import FitSettings
from recon.formats.motions import load_motion
from recon.formats.observations import PositionsFile, save_observation
from recon.method import terms
from recon.method.free import FreeMotion
from recon.method.reconstruction import reconstruct, solve
from recon.method.stages import Stage
from recon.method.terms import Term
from recon.method.windows import joined_windows
from recon.solver.lbfgs import LBFGS
from tests import laws
from tests.verbs import fit_files


class Unbent(FreeMotion):
    """A prior over bodies that do not bend; first guesses do, towards their points."""

    def encode(self, motion):
        rest = torch.eye(3).to(motion.rotations).expand_as(motion.rotations[..., 1:, :, :])
        rotations = torch.cat((motion.rotations[..., :1, :, :], rest), -3)
        return super().encode(motion.replace(rotations=rotations))


class At30(Unbent):
    """A prior that knows one rate only, as HuMoR does."""

    def encode(self, motion):
        return super().encode(motion.resample(30.0))


@dataclass
class Rigid:
    """A cheap method: where the body is and what shape it has; it does not bend."""

    prior: FreeMotion = field(default_factory=Unbent)
    iterations: int = 15

    def stages(self, data):
        steady = (Term("smooth", terms.joint_acceleration, 0.1), Term("shape", terms.shape, 1e-4))
        free = frozenset({"translation", "root", "shape"})
        return (Stage("place", self.prior, (*data, *steady), free, LBFGS(self.iterations)),)


def swaying(body, seconds=6.0, fps=15.0) -> Motion:
    """A body that walks in circles without bending, as long as you like."""
    time = 5.0 + torch.arange(round(seconds * fps) + 1, dtype=torch.float64) / fps
    first = laws.a_motion(body, clips=1, frames=1)
    turns = so3.about_z(1.5 * time) @ first.rotations[:, :, 0]
    rest = torch.eye(3, dtype=torch.float64).expand(1, len(time), 21, 3, 3)
    path = torch.stack(((1.5 * time).cos(), (1.5 * time).sin(), 0.1 * (4 * time).sin()), -1)
    return Motion.create(
        translation=first.translation + 0.5 * path,
        rotations=torch.cat((turns[:, :, None], rest), 2),
        shape=first.shape,
        fps=fps,
        start_time=5.0,
    )


def seen(body, motion, noise=0.02, seed=1) -> Joints3D:
    joints = body.pose(motion).joints
    generator = torch.Generator().manual_seed(seed)
    joints = joints + noise * torch.randn(joints.shape, generator=generator, dtype=joints.dtype)
    visible = torch.ones(joints.shape[:-1], dtype=torch.bool)
    return Joints3D(joints, visible, tuple(range(22)), motion.fps, motion.start_time)


def error(body, motion, truth):
    """Mean joint error, metres."""
    there = truth.at(motion.times, motion.fps)
    return (body.pose(motion).joints - body.pose(there).joints).norm(dim=-1).mean()


def test_windows_give_what_one_piece_gives(toy_body):
    truth = swaying(toy_body)
    observation = seen(toy_body, truth, noise=0.04)
    whole = solve([observation], Rigid(), toy_body).clip(0)
    result = fit_long([observation], Rigid(), toy_body, window=2.5, overlap=0.75)
    motion = result.clip(0)
    assert len(result.windows) == 3
    assert result.failed == (False,)
    assert torch.allclose(motion.times, truth.times)
    assert error(toy_body, motion, truth[0]) < 1.1 * error(toy_body, whole, truth[0])
    joints = toy_body.pose(motion).joints
    speed = joints.diff(dim=0).norm(dim=-1)
    jump = joints.diff(n=2, dim=0).norm(dim=-1).amax(-1)
    borders = {round((moment - 5.0) * 15) for span in result.windows for moment in span}
    inner = [frame for frame in borders if 0 < frame < truth.frames - 1]
    assert len(inner) == 4
    assert max(jump[k - 1] for k in inner) < speed.quantile(0.99)


def test_all_windows_share_the_shape_found_first(body):
    observation = seen(body, swaying(body))
    told = []
    result = fit_long(
        [observation], Rigid(), body, window=2.0, overlap=0.5,
        watch=lambda stage, _: told.append(stage),
    )  # fmt: skip
    names = [report.stage.name for report in result.reports]
    assert names == ["shape: place", "apart: place", "tied: place"] == list(dict.fromkeys(told))
    assert ["shape" in report.stage.free for report in result.reports] == [True, False, False]
    assert [len(report.solution.value) for report in result.reports] == [4, 2, 2]
    assert result.motion.shape.abs().max() > 1e-3


def test_windows_are_fitted_in_bounded_batches(toy_body, monkeypatch):
    observation, method = seen(toy_body, swaying(toy_body)), Rigid(iterations=3)
    ask = {"window": 1.2, "overlap": 0.3}
    together = []

    def counting(observations, *others, **options):
        together.append(len(observations[0].positions))
        return reconstruct(observations, *others, **options)

    monkeypatch.setattr(long, "reconstruct", counting)
    at_once = fit_long([observation], method, toy_body, **ask)
    assert together == [6, 3, 3]
    together.clear()
    monkeypatch.setattr("recon.fitting.long_recording.AT_ONCE", 2)
    few = fit_long([observation], method, toy_body, **ask)
    assert together == [2, 2, 2, 2, 1, 2, 1]
    for a, b in zip(at_once.reports, few.reports, strict=True):
        assert torch.allclose(a.solution.value, b.solution.value, rtol=1e-6)
    assert torch.allclose(at_once.body.joints, few.body.joints, atol=1e-6)


@pytest.mark.parametrize("fps", [60.0, 25.0, 29.97])
def test_a_prior_with_a_rate_of_its_own_meets_any_clock(fps, toy_body):
    truth = swaying(toy_body, seconds=4.0, fps=fps)
    observation, method = seen(toy_body, truth, noise=0.0), Rigid(At30(), iterations=25)
    result = fit_long([observation], method, toy_body, window=2.0, overlap=0.5)
    motion = result.clip(0)
    assert len(result.windows) == 3
    assert motion.fps == 30.0
    assert abs(motion.stop_time - truth.stop_time) < 1 / 30
    known = motion.resample(30.0, min(motion.duration, truth.duration))
    assert error(toy_body, known, truth[0]) < 5e-3  # metres; a frame late would be 3 cm


def test_observations_with_clocks_of_their_own_add_up(toy_body):
    truth = swaying(toy_body, fps=100.0)
    first = seen(toy_body, truth.at(5.0 + torch.arange(60).double() / 10, 10.0), noise=0.0)
    later = seen(toy_body, truth.at(6.013 + torch.arange(60).double() / 15.1, 15.1), noise=0.0)
    recording = LongRecording.cut_into_windows([first, later], toy_body, 2.0, 0.5)
    rows = list(range(len(recording.windows.starts)))
    batches = list(recording.batches_of_equal_clocks(rows))
    assert sorted(row for batch in batches for row in batch) == rows
    assert len(batches) == len(rows)  # the second clock stands differently every time
    alone = LongRecording.cut_into_windows([first], toy_body, 2.0, 0.5)
    assert list(alone.batches_of_equal_clocks(rows)) == [rows]
    assert not recording.observations_of(0)[1].visible[0, 0].any()  # it has not begun
    result = fit_long([first, later], Rigid(), toy_body, window=2.0, overlap=0.5)
    assert error(toy_body, result.clip(0), truth[0]) < 0.02


def test_a_window_without_data_stays_with_its_neighbours(toy_body):
    truth = swaying(toy_body)
    observation = seen(toy_body, truth, noise=0.0)
    seen_there = observation.visible.clone()
    seen_there[:, 35:55] = False
    blind = observation.replace(
        visible=seen_there, positions=observation.positions * seen_there[..., None]
    )
    result = fit_long([blind], Rigid(), toy_body, window=2.5, overlap=0.75)
    start, stop = result.windows[1]
    assert (start - 5) * 15 < 35
    assert (stop - 5) * 15 > 55
    joints = toy_body.pose(result.clip(0)).joints
    assert joints.isfinite().all()
    away = (joints - toy_body.pose(truth[0]).joints).norm(dim=-1).mean(-1)
    assert away[[30, 60]].max() < 0.02  # metres


def test_ties_bring_neighbours_together(toy_body, monkeypatch):
    observation = seen(toy_body, swaying(toy_body, seconds=3.0), noise=0.1)
    gaps = []

    def comparing(motions):
        first, second = motions
        there = [toy_body.pose(m.at(second.times[:1], 15.0)).joints for m in (first, second)]
        gaps.append((there[0] - there[1]).norm(dim=-1).mean())
        return joined_windows(motions)

    monkeypatch.setattr(long, "joined_windows", comparing)
    for tie in (0.0, 1.0):
        monkeypatch.setattr(long, "TIE", tie)
        fit_long([observation], Rigid(iterations=40), toy_body, window=2.0, overlap=0.7)
    assert gaps[1] < 0.7 * gaps[0]  # where the second window begins, the first one counts


def test_a_window_that_fails_is_named_and_the_others_go_on(toy_body):
    observation = seen(toy_body, swaying(toy_body))
    wild = observation.positions.clone()
    wild[:, 3:6] = 1e200  # its square overflows
    result = fit_long(
        [observation.derived(positions=wild)], Rigid(), toy_body, window=2.0, overlap=0.5
    )
    assert result.failed_windows == (0,)
    assert result.failed == (True,)
    joints = result.body.joints[0]
    assert joints.isfinite().all()
    clean = fit_long([observation], Rigid(), toy_body, window=2.0, overlap=0.5)
    after = round((result.windows[0][1] - 5.0) * 15) + 1
    gap = (joints - clean.body.joints[0])[after:].norm(dim=-1)
    assert gap.max() < 0.05  # metres; the shape comes from fewer windows


def test_the_tie_is_an_energy(toy_body):
    motion = laws.a_motion(toy_body, frames=8)
    weight = torch.linspace(0, 1, 8, dtype=torch.float64).expand(2, 8).clone()
    tie = OverlapEnergy(toy_body.pose(motion).joints, weight, 30.0)
    laws.check_energy(tie, toy_body, motion, motion)
    away = laws.estimate_of(toy_body, motion.replace(translation=motion.translation + 0.01))
    assert torch.allclose(tie(away), 0.5 * 22 * 3 * 0.01**2 * weight.sum(-1))
    early = laws.estimate_of(toy_body, motion.window(0, 4))
    assert torch.allclose(tie(early), torch.zeros(2).double(), atol=1e-18)


def test_bad_requests_are_refused(toy_body):
    observation = seen(toy_body, swaying(toy_body, seconds=3.0))
    with pytest.raises(ValueError, match="nothing to fit"):
        fit_long([], Rigid(), toy_body)
    two = observation[torch.tensor([0, 0])]
    with pytest.raises(ValueError, match="one clip"):
        fit_long([two], Rigid(), toy_body)
    with pytest.raises(ValueError, match="40 %"):
        fit_long([observation], Rigid(), toy_body, window=1.0, overlap=0.6)


def test_long_files_are_fitted_by_windows_and_the_report_says_so(body, tmp_path, monkeypatch):
    monkeypatch.setattr("recon.fitting.clip.LONG", 2.0)
    monkeypatch.setattr("recon.fitting.clip.prior_stages", lambda *_: Rigid(iterations=5).stages)
    truth = swaying(body, seconds=8.0, fps=6.0)
    observation = seen(body, truth)
    save_observation(
        tmp_path / "seen.npz",
        PositionsFile(
            kind="joints3d",
            positions=observation.positions[0].numpy(),
            visible=observation.visible[0].numpy(),
            names=tuple(JOINTS),
            fps=6.0,
        ),
    )
    out = tmp_path / "motion.npz"
    report = fit_files([tmp_path / "seen.npz"], out, FitSettings(repair=False))
    assert [stage["name"] for stage in report["stages"][-2:]] == ["apart: place", "tied: place"]
    assert len(report["windows"]) == 2
    assert not any(window["failed"] for window in report["windows"])
    assert load_motion(out).motion.frames == truth.frames


@pytest.mark.parametrize("fps", [1 / 30, 0.5])
def test_windows_of_slow_clocks_have_frames_enough(fps, toy_body):
    """A frame every half a minute ended in a division by zero, every two seconds in a refusal."""
    slow = swaying(toy_body, seconds=4.0).replace(fps=fps, start_time=0.0)
    cut = LongRecording.cut_into_windows(
        (seen(toy_body, slow),), toy_body, window=6.0, overlap=1.0
    )
    assert cut.windows.frames >= 8

"""What the benchmark of stages 1 and 2 compares, and on what."""

from pathlib import Path

import numpy as np
import torch

from benchmarks.smoothers import butterworth, whittaker
from benchmarks.windows import draw_girth, load_windows, noisy_joints, occluded_points
from priors.training.dataset import Splits
from recon import rotations as so3
from recon.body import BodyModel
from recon.formats.amass import save_motion
from recon.motion import Motion


def turning(frames: int, fps: float) -> Motion:
    """A standing body that turns."""
    angle = torch.linspace(0, 1, frames)
    upright = so3.exp(torch.tensor([torch.pi / 2, 0.0, 0.0]))
    rotations = torch.eye(3).expand(frames, 22, 3, 3).clone()
    rotations[:, 0] = so3.about_z(angle) @ upright
    return Motion.create(
        torch.tensor([[0.0, 0.0, 1.0]]).expand(frames, 3), rotations, torch.zeros(16), fps
    )


def test_smoothers_leave_what_is_smooth() -> None:
    line = torch.linspace(0, 1, 60, dtype=torch.float64)[None, :, None, None].expand(2, 60, 3, 3)
    torch.testing.assert_close(whittaker(line, 100.0), line)
    still = torch.ones(2, 60, 3, 3, dtype=torch.float64)
    torch.testing.assert_close(butterworth(still, 30.0, 3.0), still)


def test_smoothers_take_noise_away() -> None:
    noise = torch.randn(2, 60, 22, 3, dtype=torch.float64)
    for smooth in (butterworth(noise, 30.0, 2.5), whittaker(noise, 30.0)):
        assert smooth.std() < 0.5 * noise.std()
        assert smooth.mean().abs() < 0.1


def test_girth_keeps_the_bones_and_changes_the_rest() -> None:
    body = BodyModel.load()
    shapes = [draw_girth(body, torch.zeros(16), np.random.default_rng(i)) for i in range(5)]
    assert torch.equal(shapes[0], draw_girth(body, torch.zeros(16), np.random.default_rng(0)))
    for shape in shapes:
        moved = (body.rest_joints(shape) - body.joint_template).norm(dim=-1)
        assert moved.max() < 0.05  # metres, summed along the tree
        skin = (body.rest_vertices(shape) - body.template).norm(dim=-1)
        assert skin.mean() > 0.002


def test_windows_are_cut_where_the_splits_say(tmp_path: Path) -> None:
    save_motion(tmp_path / "07_01.npz", turning(400, 120.0))
    (tmp_path / "splits.toml").write_text(
        """
        subjects = {}
        test = {subjects = ["07"]}
        validation = {subjects = [], every_tenth = []}
        licence = {non_commercial = []}
        excluded = {clips = []}
        windows = {test = [["07_01", 0.0], ["07_01", 1.1667]]}
        """
    )
    body, splits = BodyModel.load(), Splits.load(tmp_path / "splits.toml")
    windows = load_windows(tmp_path, splits, "test", body)
    assert windows.truth.translation.shape == (2, 60, 3)
    assert windows.subjects == ("07", "07")
    assert windows.truth.fps == 30
    turned = so3.geodesic(windows.truth.rotations[1, 0, 0], windows.truth.rotations[0, 35, 0])
    assert turned.item() < 1e-3  # radians: 1.1667 s is frame 35

    noisy = noisy_joints(windows.truth, body, seed=3)
    errors = noisy.positions - body.pose(windows.truth).joints
    assert 0.038 < errors.std().item() < 0.042  # metres
    occluded, points = occluded_points(windows.truth, body)
    assert torch.equal(occluded.visible, points[..., 2] >= 0.9)
    assert occluded.visible.any()
    assert (occluded.positions[~occluded.visible] == 0).all()

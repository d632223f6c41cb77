"""The windows that benchmarks are measured on, and what means over them are."""

from itertools import pairwise
from pathlib import Path

import numpy as np
import torch

from benchmarks.protocol import cells, evenly, mean_of
from recon.benchmark.dataset import Splits
from recon.benchmark.methods import butterworth, whittaker
from recon.benchmark.protocols import noisy_joints, occluded_points, with_gap
from recon.benchmark.windows import TrueWindows, load_windows, shape_with_random_girth
from recon.body.model import BodyModel
from recon.core import rotations as so3
from recon.core.motion import Motion, MotionFile
from recon.core.struct import stack
from recon.formats.motions import save_motion


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
    shapes = [
        shape_with_random_girth(body, torch.zeros(16), np.random.default_rng(i)) for i in range(5)
    ]
    assert torch.equal(
        shapes[0], shape_with_random_girth(body, torch.zeros(16), np.random.default_rng(0))
    )
    for shape in shapes:
        moved = (body.rest_joints(shape) - body.joint_template).norm(dim=-1)
        assert moved.max() < 0.05  # metres, summed along the tree
        skin = (body.rest_vertices(shape) - body.template).norm(dim=-1)
        assert skin.mean() > 0.002


def splits_of(folder: Path, windows: str) -> Splits:
    (folder / "splits.toml").write_text(
        f"""
        subjects = {{}}
        test = {{subjects = ["07"]}}
        validation = {{subjects = [], every_tenth = []}}
        licence = {{non_commercial = []}}
        excluded = {{clips = []}}
        windows = {{test = {{60 = [{windows}]}}}}
        """
    )
    return Splits.load(folder / "splits.toml")


def test_windows_are_cut_where_the_splits_say(tmp_path: Path) -> None:
    save_motion(tmp_path / "07_01.npz", turning(400, 120.0))
    body, splits = BodyModel.load(), splits_of(tmp_path, '["07_01", 0.0], ["07_01", 1.1667]')
    windows = load_windows(tmp_path, splits, "test", body)
    assert windows.truth.translation.shape == (2, 60, 3)
    assert windows.subjects == ("07", "07")
    assert windows.truth.fps == 30
    turned = so3.geodesic_angle(
        windows.truth.rotations[1, 0, 0], windows.truth.rotations[0, 35, 0]
    )
    assert turned.item() < 1e-3  # radians: 1.1667 s is frame 35

    noisy = noisy_joints(windows.truth, body, seed=3)
    errors = noisy.positions - body.pose(windows.truth).joints
    assert 0.038 < errors.std().item() < 0.042  # metres
    occluded, points = occluded_points(windows.truth, body)
    assert torch.equal(occluded.visible, points[..., 2] >= 0.9)
    assert occluded.visible.any()
    assert (occluded.positions[~occluded.visible] == 0).all()


def test_windows_of_a_length_that_is_not_listed_lie_about_the_listed_ones_and_share_no_frame(
    tmp_path: Path,
) -> None:
    """Ten pairs of the windows of version 0.1.0 overlapped, one by 97 %."""
    save_motion(tmp_path / "07_01.npz", turning(800, 120.0))  # 200 frames at 30 Hz
    save_motion(tmp_path / "07_02.npz", turning(280, 120.0))  # 70 of them: too short
    listed = ("01", 0.0), ("01", 0.7), ("01", 3.5), ("01", 4.6), ("02", 0.0)
    splits = splits_of(tmp_path, ", ".join(f'["07_{name}", {at}]' for name, at in listed))
    body = BodyModel.load()
    windows = load_windows(tmp_path, splits, "test", body, frames=90)
    # 0.7 s would begin at frame 6, inside the first; 3.5 s is frame 105, less 15; then 110 at most
    assert windows.names == ("07_01@0.00", "07_01@3.00")
    assert windows.listed == 5
    assert windows.truth.frames == 90
    short = load_windows(tmp_path, splits, "test", body)
    assert len(short.names) == 5
    torch.testing.assert_close(windows.truth.rotations[1, 15:75], short.truth.rotations[2])
    assert torch.equal(windows.truth.shape[0], short.truth.shape[0])


def three_windows() -> TrueWindows:
    still = stack([turning(4, 30.0)] * 3)
    return TrueWindows(
        still, torch.zeros(3, 4, 22).bool(), ("07", "16", "49"), ("a@0", "b@0", "c@0"), 3, ("16",)
    )


def test_means_are_over_the_subjects_who_are_not_apart() -> None:
    """Test subject 16 walks like a training subject, and was averaged with the others."""
    windows = three_windows()
    metrics = {"joints_all": ("joints cm", 100, 1), "gone": ("?", 1, 1)}
    assert cells([{"joints_all": one} for one in (1.0, 10.0, 3.0)], windows, metrics) == [
        200.0,
        None,
    ]
    alone = mean_of([10.0], windows.take([1]))
    assert alone is not None
    assert alone.mean == 10.0
    assert mean_of([None, 1.0, None], windows) is None


def test_few_windows_are_spread_over_the_list() -> None:
    windows = three_windows()
    assert evenly(windows, None) == evenly(windows, 7) == [0, 1, 2]
    assert evenly(windows, 2) == [0, 2]


def test_no_clip_of_validation_or_test_people_is_trained_on() -> None:
    """Clips of validation subject 10, and clips that may be of test people, were trained on."""
    splits = Splits.load()
    takes = [f"u_train_soccer_soccer_{take}" for take in (2, 4, 5)]
    assert set(splits.parts(takes).values()) == {"validation"}
    assert len(splits.excluded) >= 5
    assert splits.parts(list(splits.excluded)) == {}
    assert splits.parts(["16_15", "35_01", "07_01", "10_04", "salsa_01"]) == {
        "16_15": "apart", "35_01": "train", "07_01": "test", "10_04": "validation",
        "salsa_01": "train",
    }  # fmt: skip


def test_listed_test_windows_share_no_frame_and_are_enough() -> None:
    """Ten pairs of the 64 windows of version 0.1.0 overlapped, one by 97 %."""
    splits = Splits.load()
    for frames, wanted in {60: 60, 90: 40}.items():
        rows = splits.windows["test"][frames]
        for clip in {clip for clip, _ in rows}:
            starts = sorted(round(start * 30) for other, start in rows if other == clip)
            assert all(b - a >= frames for a, b in pairwise(starts)), clip
        counted = [clip for clip, _ in rows if splits.subject(clip) in splits.test]
        assert len(counted) >= wanted
        elsewhere = {splits.subject(clip) for clip, _ in splits.windows["strangers"][60]}
        assert elsewhere == {"hdm_bk", "hdm_dg"}
        assert {splits.subject(clip) for clip in counted} == set(splits.test) - elsewhere
        assert {splits.subject(clip) for clip, _ in rows} - set(splits.test) == set(splits.apart)
    assert splits.windows["validation"][60][0] == ("06_01", 1.3)


def test_contacts_are_those_that_the_recording_was_labelled_with(tmp_path: Path) -> None:
    motion = turning(400, 120.0)
    labels = torch.zeros(400, 22)
    labels[200:, 7] = 1.0  # from 1.667 s on
    save_motion(tmp_path / "07_01.npz", MotionFile(motion, contacts=labels))
    splits = splits_of(tmp_path, '["07_01", 1.0]')
    contacts = load_windows(tmp_path, splits, "test", BodyModel.load()).contacts[0]
    assert contacts.sum() == contacts[:, 7].sum() == 40
    assert contacts[20:, 7].all()


def test_nothing_is_seen_in_a_gap() -> None:
    body = BodyModel.load()
    upper = (0, 12, 15)
    whole = noisy_joints(turning(60, 30.0)[None], body, seed=0, noise=0.01, joints=upper)
    seen = with_gap(whole, slice(15, 45))
    assert seen.joints == upper
    assert not seen.visible[:, 15:45].any()
    assert (seen.positions[:, 15:45] == 0).all()
    assert seen.visible[:, :15].all()
    assert torch.equal(seen.positions[:, 45:], whole.positions[:, 45:])
    assert whole.visible.all()

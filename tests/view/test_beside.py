"""Two motions side by side: clear of each other, on one ground, at the same moments."""

from pathlib import Path

import pytest
import torch

from recon.body.model import BodyModel
from recon.core.motion import Motion, MotionFile
from recon.formats.motions import save_motion
from recon.view import Figure
from recon.view.files import at_common_times, put_beside, view
from recon.view.viewpoint import following_viewpoints
from tests.walking import a_walk

BODY = BodyModel.load()


def tall(motion: Motion) -> Motion:
    return motion.replace(shape=torch.eye(16)[0])


def test_the_other_is_to_the_right_and_nowhere_near() -> None:
    first = Figure(BODY, a_walk(BODY), "a")
    far = torch.tensor([5.0, -3.0, 0.0])
    other = Figure(
        BODY, tall(a_walk(BODY).replace(translation=a_walk(BODY).translation + far)), "b"
    )
    moved = put_beside(first, other)
    torch.testing.assert_close(moved.motion.translation[..., 2], other.motion.translation[..., 2])
    shift = moved.motion.translation - other.motion.translation
    torch.testing.assert_close(shift, shift[:1].expand_as(shift))
    apart = first.posed.joints[:, :, None] - moved.posed.joints[:, None]
    assert 0.15 < float(apart[..., :2].norm(dim=-1).min()) < 0.6  # metres
    view = following_viewpoints((first, moved), (320, 320))[0]
    left, right = (f.posed.joints[0].double().numpy() for f in (first, moved))
    assert view.project(left)[0][:, 0].max() < view.project(right)[0][:, 0].min()
    depths = [view.project(joints)[1].mean() for joints in (left, right)]
    assert depths[0] == pytest.approx(depths[1], abs=0.05)  # metres: sizes can be compared


def test_both_play_from_their_first_frames_while_both_last() -> None:
    file = MotionFile(a_walk(BODY, seconds=1.0, fps=50.0), contacts=torch.rand(51, 22))
    other = MotionFile(a_walk(BODY, seconds=0.6, fps=30.0).replace(start_time=7.0))
    cut, second = at_common_times(file, other)
    assert cut.contacts is not None
    assert (cut.motion.frames, second.frames, len(cut.contacts)) == (31, 31, 31)
    assert (second.fps, second.start_time) == (50, 0)
    torch.testing.assert_close(second.translation[-1], other.motion.translation[-1])


def test_files_are_drawn_side_by_side(tmp_path: Path) -> None:
    walk = a_walk(BODY, seconds=0.02)
    (tmp_path / "other").mkdir()
    paths = [tmp_path / "walk.npz", tmp_path / "other" / "walk.npz"]
    for path, motion in zip(paths, (walk, tall(walk)), strict=True):
        save_motion(path, MotionFile(motion))
    page, picture = tmp_path / "two.html", tmp_path / "two.png"
    view(paths[0], beside=paths[1], html=page, png=picture)
    text = page.read_text(encoding="utf-8")
    assert "walk: 1.70 m, 71 kg" in text
    assert "walk (2): 1.83 m, 83 kg" in text
    assert picture.stat().st_size > 0

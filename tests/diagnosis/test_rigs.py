"""Rigs: the clock and the pose of one camera are found together, and clean rigs are left alone."""

import functools
import math

import numpy as np
import pytest
import torch

from observations.keypoints2d import Keypoints2D
from recon.core import rotations as so3
from recon.diagnosis.checks import BEFORE
from recon.diagnosis.examination import checked
from recon.diagnosis.images import Images
from recon.diagnosis.registration import PARTS, ViewAlignment
from recon.diagnosis.rigs import with_certain_corrections
from tests.diagnosis.test_views import checked_clip, screened
from tests.filmed import bundled, cameras, view, walk

NAMES = ("one", "two", "three")
AXIS = torch.tensor([0.6, 0.64, 0.48])
FPS = 30.0


@functools.cache
def rig(late: float = 0.0, degrees: float = 0.0, count: int = 3) -> tuple[Keypoints2D, ...]:
    """Forty frames of a walk; the second camera is late by seconds and turned by degrees."""
    motion = walk(60)
    lenses = cameras(motion, count, first=0.7)
    times = motion.times[10:50]
    views: list[Keypoints2D] = []
    for k, lens in enumerate(lenses):
        shown = motion.at(times - (late if k == 1 else 0.0), FPS).replace(start_time=0.0)
        views.append(view(shown, lens, seed=k))
    turn = so3.exp(math.radians(degrees) * AXIS)
    camera = views[1].camera
    pose = camera.T_camera_world.clone()
    pose[..., :3, :] = turn @ pose[..., :3, :]
    views[1] = views[1].replace(camera=camera.replace(T_camera_world=pose))
    return tuple(views)


def images(views: tuple[Keypoints2D, ...]) -> Images:
    return Images.of(views, NAMES[: len(views)], bundled())


def degrees_between(a: np.ndarray, b: np.ndarray) -> float:
    return math.degrees(math.acos(min((float(np.trace(a @ b.T)) - 1) / 2, 1.0)))


@pytest.mark.parametrize(
    ("late", "degrees"),
    [(0.08, 1.0), (-0.2, 2.0), (0.02, 0.3), (0.05, 0.0), (0.0, 0.4)],
)
def test_clock_and_pose_of_a_view_are_found_together(late: float, degrees: float) -> None:
    """Either was looked for while the other was taken for right: of 80 ms and 1 degree neither
    was found, and nothing was said, as the rays still passed within 9 cm of each other."""
    given, good = images(rig(late, degrees)), images(rig(late))
    found = with_certain_corrections(given)
    (one,) = found.applied
    assert one.view == 1
    assert found.undecided == ()
    assert one.late / FPS == pytest.approx(late, abs=0.005)
    assert degrees_between(found.images.pose[1, 0, :3, :3], good.pose[1, 0, :3, :3]) < 0.15
    assert np.array_equal(found.images.pose[0], given.pose[0])
    assert found.images.pixels[0] is given.pixels[0] or np.array_equal(
        found.images.pixels[0], given.pixels[0]
    )
    if not late:
        assert one.late == 0
        assert np.array_equal(found.images.pixels[1], given.pixels[1])
    if not degrees:
        assert np.array_equal(found.images.pose[1], given.pose[1])


def test_what_is_found_is_as_sure_as_it_says() -> None:
    given = images(rig(0.08, 1.0))
    one = ViewAlignment.of(given, 1, np.array([3.0, 3.0, 3.0]), PARTS).best_correction()
    assert one is not None
    std = np.sqrt(np.diag(one.covariance))
    assert abs(one.late - 0.08 * FPS) < 4 * std[0]
    true = -math.radians(1.0) * AXIS.numpy()
    assert (np.abs(one.values[1:4] - true) < 4 * std[1:4]).all()
    assert (np.abs(one.values[4:]) < 4 * std[4:]).all()
    assert std[0] / FPS < 0.005
    assert np.degrees(std[1:4]).max() < 0.2


def test_a_clean_rig_is_left_alone() -> None:
    found = with_certain_corrections(images(rig()))
    assert found.applied == ()
    assert found.undecided == ()


def test_a_fit_is_told_what_was_found() -> None:
    clip = checked(checked_clip(*rig(0.08, 1.0)), BEFORE)
    assert [found.code for found in clip.repairs] == ["views out of step"]
    assert clip.warnings == ()
    message = clip.repairs[0].message
    assert message.startswith("two contradicts the other views: its clock is ")
    assert "ms late" in message
    assert "degrees" in message
    assert clip.observations[0] is rig(0.08, 1.0)[0]


def test_a_turned_view_is_not_taken_for_one_of_another_size() -> None:
    """Keypoints of a good view were made 1 % larger where another one was turned by 1 degree."""
    for late in (0.08, -0.08):
        _, repairs, _ = screened(rig(late, 1.0))
        assert ["two contradicts" in found.message for found in repairs] == [True]


def test_the_clock_of_a_person_who_stands_still_is_left_as_it_is() -> None:
    """Noise looks like velocity: a clock was corrected by 25 ms where nobody had moved."""
    motion = walk(60)
    still = motion.at(torch.full((40,), float(motion.times[20]), dtype=torch.float64), FPS)
    lenses = cameras(motion, 3, first=0.7)
    views = [view(still.replace(start_time=0.0), lens, seed=k) for k, lens in enumerate(lenses)]
    pose = views[1].camera.T_camera_world.clone()
    pose[..., :3, :] = so3.exp(math.radians(1.0) * AXIS) @ pose[..., :3, :]
    views[1] = views[1].replace(camera=views[1].camera.replace(T_camera_world=pose))
    (one,) = with_certain_corrections(images(tuple(views))).applied
    assert one.view == 1
    assert one.late == 0
    assert one.degrees == pytest.approx(1.0, abs=0.15)


def test_two_views_do_not_tell_which_of_them_is_turned() -> None:
    """Rays that missed each other by less than 6 cm passed without a word."""
    views = rig(0.08, 1.0, count=2)
    out, repairs, warnings = screened(views)
    assert repairs == []
    (said,) = warnings
    assert said.code == "view at odds"
    assert "do not tell which of them" in said.message
    assert "ms late" in said.message
    assert all(a is b for a, b in zip(out, views, strict=True))


def test_the_clock_of_two_views_is_found_to_a_part_of_a_frame() -> None:
    """The keypoints were moved by whole frames only."""
    _, repairs, warnings = screened(rig(-0.21, count=2))
    assert warnings == []
    assert [found.code for found in repairs] == ["views out of step"]
    assert repairs[0].value == pytest.approx(-0.21, abs=0.005)

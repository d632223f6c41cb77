"""Regions of two people who overlap, by networks that are replaced by the truth."""

import numpy as np
import pytest

from recon.films.blazepose import BlazePose, Pose, Region
from recon.films.tracking import Tracker

IMAGE = np.zeros((480, 640, 3), np.uint8)
REST = np.random.default_rng(1).uniform(-60, 60, (33, 2))
RATE = 30.0


class TwoPeople(BlazePose):
    """Networks that see one person at 200 and one at 360 pixels, and may mistake the second."""

    def __init__(self) -> None:
        self.mistaken: tuple[bool, ...] = ()
        """Whether the image or its mirror image (False, True) shows the first for the second."""

    def find(self, *_):
        return [(region_at(x), 0.9) for x in (200.0, 360.0)]

    def poses(self, _, region):
        return self._at(region, mirror=False), self._at(region, mirror=True)

    def _at(self, region, *, mirror):
        second = region.centre[0] > 280
        x = 360.0 if second and mirror not in self.mistaken else 200.0
        full = np.ones(33)
        points = np.array([[x, 240.0], [x, 120.0]])
        pixels = REST + np.array([x, 240])
        return Pose(pixels, full, full, full > 0, 0.9, region, points)


def region_at(x: float) -> Region:
    return Region.of_points(np.array([x, 240.0]), np.array([x, 120.0]))


@pytest.mark.parametrize("mirror", [False, True])
def test_of_image_and_mirror_image_the_one_counts_that_stays_with_the_person(mirror):
    """One image showed the person in front, and two tracks were taken for one person."""
    networks = TwoPeople()
    tracker = Tracker(networks, RATE)
    for frame in range(12):
        networks.mistaken = (mirror,) if frame >= 4 else ()
        seen = tracker.detect_next(IMAGE, frame, 0)
        places = {one.track: one.pose.pixels.mean(0)[0] for one in seen}
        assert places == pytest.approx({0: 200 + REST[:, 0].mean(), 1: 360 + REST[:, 0].mean()})


def test_two_regions_are_never_on_one_person():
    networks = TwoPeople()
    tracker = Tracker(networks, RATE)
    tracks = []
    for frame in range(30):
        networks.mistaken = (False, True) if 5 <= frame < 20 else ()
        tracks.append([one.track for one in tracker.detect_next(IMAGE, frame, 0)])
    assert tracks[4] == [0, 1]
    assert all(one == [0] for one in tracks[5:20])
    assert len(tracks[-1]) == 2
    assert tracks[-1][0] == 0


def test_a_cut_ends_all_tracks():
    tracker = Tracker(TwoPeople(), RATE)
    assert [one.track for one in tracker.detect_next(IMAGE, 0, 0)] == [0, 1]
    assert [one.track for one in tracker.detect_next(IMAGE, 1, 1)] == [2, 3]

"""Checks of 2D keypoints before a fit: each mistake is found, named and undone where that is sure.

One walk of one second before one and before three cameras; a good recording is left alone.
"""

import functools
from dataclasses import replace

import numpy as np
import pytest
import torch

from observations.keypoints2d import Keypoints2D
from recon.core import rotations as so3
from recon.core.layouts import keypoint_names
from recon.core.motion import Motion
from recon.diagnosis.examination import CheckedClip
from recon.diagnosis.findings import Finding
from recon.diagnosis.keypoints import screen_views
from recon.fitting.methods import FitOptions
from recon.reading.images import keypoints_of
from recon.simulation.images import keypoints2d
from recon.simulation.points import Corruption
from tests.filmed import bundled, cameras, turned, view, walk

NAMES = ("one", "two", "three")
POINTS = keypoint_names("openpose25")
FRAMES = 30


@functools.cache
def filmed(count: int) -> tuple[Keypoints2D, ...]:
    """The walk before so many cameras."""
    motion = walk(FRAMES)
    return tuple(view(motion, c, seed=k) for k, c in enumerate(cameras(motion, count, first=0.7)))


def screened(
    views: tuple[Keypoints2D, ...],
) -> tuple[list[Keypoints2D], list[Finding], list[Finding]]:
    out, found = screen_views(views, NAMES[: len(views)], bundled())
    return out, list(found.repairs), list(found.warnings)


def checked_clip(*views: Keypoints2D) -> CheckedClip:
    """The views before any check."""
    return CheckedClip(
        observations=views, names=NAMES[: len(views)], options=FitOptions(), body=bundled()
    )


def second(views: tuple[Keypoints2D, ...], other: Keypoints2D) -> tuple[Keypoints2D, ...]:
    """The views with another second one."""
    return (views[0], other, *views[2:])


def with_pixels(seen: Keypoints2D, frames: slice, point: str, pixels: torch.Tensor) -> Keypoints2D:
    out = seen.pixels.clone()
    out[0, frames, POINTS.index(point)] = pixels
    return seen.replace(pixels=out)


def renamed(seen: Keypoints2D, frames: slice, pairs: list[tuple[str, str]]) -> Keypoints2D:
    """Points that carry each other's name for some frames."""
    order = list(range(len(POINTS)))
    for a, b in pairs:
        order[POINTS.index(a)], order[POINTS.index(b)] = POINTS.index(b), POINTS.index(a)
    pixels, confidence = seen.pixels.clone(), seen.confidence.clone()
    pixels[0, frames] = seen.pixels[0, frames][:, order]
    confidence[0, frames] = seen.confidence[0, frames][:, order]
    return seen.replace(pixels=pixels, confidence=confidence)


SIDES = [(n, n.replace("left", "right")) for n in POINTS if n.startswith("left")]


def mirrored(seen: Keypoints2D) -> Keypoints2D:
    width = float(seen.camera.image_size[0])
    flipped = seen.pixels * torch.tensor([-1.0, 1.0]) + torch.tensor([width, 0.0])
    return seen.replace(pixels=torch.where(seen.confidence[..., None] > 0, flipped, 0.0))


def twisted(seen: Keypoints2D, degrees: torch.Tensor) -> Keypoints2D:
    """The camera's poses turned about a skew axis; one angle for a fixed camera."""
    turn = torch.eye(4).repeat(len(degrees), 1, 1)
    axis = torch.tensor([0.6, 0.64, 0.48])
    turn[:, :3, :3] = so3.exp(torch.deg2rad(degrees)[:, None] * axis)
    camera = seen.camera
    return seen.replace(camera=camera.replace(T_camera_world=turn @ camera.T_camera_world))


def reprojected(after: Keypoints2D, true: Keypoints2D) -> float:
    """Median distance, in pixels, of what both cameras say about the true view's points."""
    at = torch.full_like(true.confidence, 4.0)
    points = true.camera.unproject(true.pixels, at)
    away = (after.camera.project(points).pixels - after.pixels).norm(dim=-1)
    return float(away[(after.confidence > 0) & (true.confidence > 0)].median())


@pytest.mark.parametrize("count", [1, 2, 3])
def test_good_views_are_left_alone(count: int) -> None:
    views = filmed(count)
    out, repairs, warnings = screened(views)
    assert repairs == []
    assert warnings == []
    assert all(a is b for a, b in zip(out, views, strict=True))


def test_neighbouring_frames_tell_nothing_where_they_are_seconds_apart() -> None:
    """A film of one picture a second seemed to be out of order, or to go over to others."""
    motion, rows = walk(30, 60), [0, 15, 29] * 4
    one = view(motion, cameras(motion, first=0.7)[0])
    there_and_back = one.replace(pixels=one.pixels[:, rows], confidence=one.confidence[:, rows])
    assert [found.code for found in screened((there_and_back,))[2]] == ["frame order"]
    seldom = there_and_back.replace(fps=1.0)
    out, repairs, warnings = screened((seldom,))
    assert (out[0] is seldom, repairs, warnings) == (True, [], [])


def test_zeros_with_a_confidence_are_not_seen() -> None:
    """Exact zeros that counted as detections pulled bodies into the corner of the image."""
    hidden = torch.rand(FRAMES, generator=torch.Generator().manual_seed(0)) < 0.3
    (one,) = filmed(1)
    spoilt = with_pixels(one, hidden, "left_knee", torch.zeros(2))  # type: ignore[arg-type]
    (out,), repairs, _ = screened((spoilt,))
    assert [found.code for found in repairs] == ["zeros"]
    assert repairs[0].joints == ("left_knee",)
    knee = out.confidence[0, :, POINTS.index("left_knee")]
    assert torch.equal(knee > 0, ~hidden & (one.confidence[0, :, POINTS.index("left_knee")] > 0))


def test_zeros_stay_zeros_behind_a_lens() -> None:
    """Undistorting moved exact zeros, after which nothing told them from detections."""
    motion = walk(3)
    file = keypoints2d(motion, bundled(), cameras(motion)[0], Corruption(), 0)
    pixels = file.pixels.copy()
    pixels[1, 4] = 0.0
    lens = replace(file.camera, distortion=np.array([-0.2, 0.05, 0.0, 0.0]))
    seen = keypoints_of(replace(file, pixels=pixels, camera=lens), bundled())
    assert torch.equal(seen.pixels[0, 1, 4], torch.zeros(2))
    assert seen.pixels[0, 2, 4].norm() > 100


def test_a_held_point_is_not_seen_while_it_is_held() -> None:
    (one,) = filmed(1)
    ankle = one.pixels[0, 9, POINTS.index("left_ankle")]
    (out,), repairs, _ = screened((with_pixels(one, slice(10, 18), "left_ankle", ankle),))
    assert [(f.code, f.joints, f.frames) for f in repairs] == [
        ("constant point", ("left_ankle",), ((10, 17),))
    ]
    assert not out.confidence[0, 10:18, POINTS.index("left_ankle")].any()


def test_frames_that_are_copies_are_not_seen() -> None:
    (one,) = filmed(1)
    pixels, confidence = one.pixels.clone(), one.confidence.clone()
    pixels[0, 11:20:2], confidence[0, 11:20:2] = pixels[0, 10:19:2], confidence[0, 10:19:2]
    (out,), repairs, _ = screened((one.replace(pixels=pixels, confidence=confidence),))
    assert [found.code for found in repairs] == ["repeated frames"]
    assert not out.confidence[0, 11:20:2].any()
    assert out.confidence[0, 10:19:2].any()


def test_many_outliers_are_taken_out_and_few_are_left_to_the_robust_kernel() -> None:
    (one,) = filmed(1)
    generator = torch.Generator().manual_seed(1)
    wild = torch.rand(one.confidence.shape, generator=generator) < 0.1
    anywhere = torch.rand(one.pixels.shape, generator=generator) * 1000
    spoilt = one.replace(pixels=torch.where(wild[..., None], anywhere, one.pixels))
    (out,), repairs, _ = screened((spoilt,))
    assert [found.code for found in repairs] == ["outliers"]
    far = (spoilt.pixels - one.pixels).norm(dim=-1) > 200
    assert not out.confidence[far & (one.confidence > 0)].bool().float().mean() > 0.1
    same = ~wild & (one.confidence > 0)
    assert out.confidence[same].bool().float().mean() > 0.99


def test_outliers_do_not_hide_by_making_the_body_look_larger() -> None:
    """Outliers made bones look long, at the ends of a clip by four times; by that scale they were
    near enough. A third outlier within five frames hid the others for good."""
    (one,) = filmed(1)
    generator = torch.Generator().manual_seed(4)
    wild = torch.rand(one.confidence.shape, generator=generator) < 0.15
    wild &= one.confidence > 0
    anywhere = torch.rand(one.pixels.shape, generator=generator) * torch.tensor([1920.0, 1080.0])
    spoilt = one.replace(pixels=torch.where(wild[..., None], anywhere, one.pixels))
    (out,), repairs, warnings = screened((spoilt,))
    assert [f.code for f in repairs] == ["outliers"]
    assert warnings == []
    far = wild & ((spoilt.pixels - one.pixels).norm(dim=-1) > 200)
    assert int((far & (out.confidence > 0)).sum()) == 0
    kept = (out.confidence > 0)[~wild & (one.confidence > 0)]
    assert kept.float().mean() > 0.98


def test_another_person_from_mid_clip_on_is_said() -> None:
    """A jump of the whole body by 0.6 m in one frame was followed as one person."""
    motion = walk(2 * FRAMES)
    camera = cameras(motion, 3, first=0.7)
    other = turned(motion, 0.5)
    there = motion.translation[FRAMES] + torch.tensor([0.4, 0.4, 0.0])
    other = other.replace(
        translation=other.translation - other.translation[FRAMES] + there,
    )
    joined = Motion.create(
        torch.cat((motion.translation[:FRAMES], other.translation[FRAMES:])),
        torch.cat((motion.rotations[:FRAMES], other.rotations[FRAMES:])),
        motion.shape,
        motion.fps,
    )
    views = tuple(view(joined, c, seed=k) for k, c in enumerate(camera))
    _, repairs, warnings = screened(views)
    assert repairs == []
    assert [f.code for f in warnings] == ["identity change"]
    assert warnings[0].frames[0][0] == FRAMES


def test_frames_out_of_order_are_said() -> None:
    motion = walk(2 * FRAMES)
    one = view(motion, cameras(motion, 1, first=0.7)[0])
    order = torch.randperm(2 * FRAMES, generator=torch.Generator().manual_seed(0))
    spoilt = one.replace(pixels=one.pixels[:, order], confidence=one.confidence[:, order])
    _, _, warnings = screened((spoilt,))
    assert "frame order" in [f.code for f in warnings]


def test_a_camera_that_is_turned_is_turned_back() -> None:
    """One view 2.8 pixels off in its image was 29 cm wrong about the pelvis, and nothing said."""
    views = filmed(3)
    spoilt = twisted(views[1], torch.tensor([3.0]))
    out, repairs, warnings = screened(second(views, spoilt))
    assert [f.code for f in repairs] == ["view at odds"]
    assert warnings == []
    assert "two" in repairs[0].message
    assert repairs[0].value == pytest.approx(3.0, abs=0.2)
    assert reprojected(spoilt, views[1]) > 50
    assert reprojected(out[1], views[1]) < 5


def test_a_camera_that_moves_is_followed() -> None:
    views = filmed(3)
    turning = twisted(views[1], torch.linspace(0, 6, FRAMES)).camera
    points = views[1].camera.unproject(views[1].pixels, torch.full_like(views[1].confidence, 4.0))
    spoilt = views[1].replace(pixels=turning.project(points).pixels)
    out, repairs, _ = screened(second(views, spoilt))
    assert [f.code for f in repairs] == ["camera moves"]
    assert out[1].camera.T_camera_world.shape == (1, FRAMES, 4, 4)
    away = (out[1].camera.project(points).pixels - spoilt.pixels).norm(dim=-1)
    assert away[views[1].confidence > 0].median() < 5


@pytest.mark.parametrize(("count", "frames"), [(3, 4), (3, -6), (2, -6)])
def test_a_view_out_of_step_is_moved_in_time(count: int, frames: int) -> None:
    motion = walk(2 * FRAMES)
    lenses = cameras(motion, count, first=0.7)
    views = [view(motion.window(10, 50), c, seed=k) for k, c in enumerate(lenses)]
    late = motion.window(10 - frames, 50 - frames).replace(
        start_time=motion.window(10, 50).start_time
    )
    views[1] = view(late, lenses[1], seed=1)
    _, repairs, _ = screened(tuple(views))
    assert [f.code for f in repairs] == ["views out of step"]
    assert repairs[0].value == pytest.approx(frames / motion.fps, abs=0.5 / motion.fps)


@pytest.mark.parametrize("rows", [(1,), (0, 1, 2)])
def test_mirrored_images_are_mirrored_back(rows: tuple[int, ...]) -> None:
    views = filmed(3)
    spoilt = tuple(mirrored(v) if k in rows else v for k, v in enumerate(views))
    out, repairs, _ = screened(spoilt)
    assert [f.code for f in repairs] == ["mirrored"]
    assert torch.allclose(out[1].pixels, views[1].pixels, atol=1e-3)


def test_mirrored_videos_whose_keypoints_are_named_anew_are_put_right_in_both() -> None:
    """A detector that looks at a mirrored person calls the right hand left."""
    views = filmed(3)
    spoilt = tuple(renamed(mirrored(v), slice(None), SIDES) for v in views)
    out, repairs, _ = screened(spoilt)
    assert [f.code for f in repairs] == ["mirrored", "sides exchanged"]
    assert torch.allclose(out[1].pixels, views[1].pixels, atol=1e-3)


def test_keypoints_of_another_resolution_are_scaled() -> None:
    views = filmed(3)
    small = views[1].replace(pixels=views[1].pixels / 1.5)
    out, repairs, _ = screened(second(views, small))
    assert [f.code for f in repairs] == ["view at odds"]
    assert repairs[0].value == pytest.approx(1 / 1.5, rel=0.02)
    assert (out[1].pixels - views[1].pixels).norm(dim=-1).median() < 5


def test_a_view_that_shows_somebody_else_is_left_out() -> None:
    views = filmed(3)
    stranger = turned(walk(FRAMES, first=25), 2.0)
    stranger = stranger.replace(translation=stranger.translation + torch.tensor([0.5, 0.5, 0.0]))
    lens = cameras(walk(FRAMES), 3, first=0.7)[1]
    other = view(stranger.replace(start_time=walk(FRAMES).start_time), lens, seed=8)
    out, repairs, _ = screened(second(views, other))
    assert repairs[-1].code == "view at odds"
    assert "left out" in repairs[-1].message
    assert not out[1].confidence.any()
    assert out[0] is views[0]


def test_two_views_of_different_people_are_said_to_contradict_each_other() -> None:
    views = filmed(2)
    other = with_pixels(views[1], slice(None), "nose", views[1].pixels[0, :, 0])
    other = twisted(other, torch.tensor([12.0]))
    _, _, warnings = screened((views[0], other))
    assert "view at odds" in [f.code for f in warnings]


@pytest.mark.parametrize("factor", [0.5, 1.5])
def test_the_scale_of_a_calibration_is_told_by_the_size_of_the_body(factor: float) -> None:
    def spread(seen: Keypoints2D) -> Keypoints2D:
        pose = seen.camera.T_camera_world.clone()
        pose[..., :3, 3] *= factor
        return seen.replace(camera=seen.camera.replace(T_camera_world=pose))

    _, repairs, warnings = screened(tuple(spread(v) for v in filmed(3)))
    assert repairs == []
    assert [f.code for f in warnings] == ["scale"]
    assert warnings[0].value == pytest.approx(factor, rel=0.12)


def test_views_of_several_clocks_are_checked_apart() -> None:
    """A view of another rate has no common moments with the others, and is checked alone."""
    views = filmed(3)
    other = renamed(views[1], slice(8, 18), SIDES)
    other = other.replace(
        pixels=other.pixels[:, 1:], confidence=other.confidence[:, 1:], start_time=1 / 30
    )
    out, repairs, _ = screened(second(views, other))
    assert [(f.code, f.frames) for f in repairs] == [("sides exchanged", ((7, 16),))]
    assert torch.equal(out[1].pixels, views[1].pixels[:, 1:])


@pytest.mark.parametrize("frames", [1, 2, 3, 5])
@pytest.mark.parametrize("layout", ["coco17", "h36m17", "smpl22"])
def test_short_clips_of_any_layout_are_looked_at(frames: int, layout: str) -> None:
    motion = walk(frames)
    views = [view(motion, c, seed=k, layout=layout) for k, c in enumerate(cameras(motion, 3))]
    _, repairs, warnings = screened(tuple(views))
    assert repairs == []
    assert warnings == []


def test_views_in_which_nothing_is_seen_say_nothing() -> None:
    views = filmed(3)
    nothing = views[1].replace(
        pixels=torch.zeros_like(views[1].pixels), confidence=torch.zeros_like(views[1].confidence)
    )
    for some in [second(views, nothing), (nothing,), (nothing, nothing), (nothing,) * 3]:
        _, repairs, warnings = screened(some)
        assert repairs == []
        assert warnings == []

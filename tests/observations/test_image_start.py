"""A first guess from one camera: heading, distance, what is missing, and how headings change."""

import math

import pytest
import torch

from observations.keypoints2d import Keypoints2D
from observations.start.images import bone_distance, image_start, smooth_path
from recon.core import rotations as so3
from recon.core.motion import Motion
from tests.filmed import bundled, cameras, turned, view, walk

pytestmark = pytest.mark.numerics


def facing(motion: Motion) -> torch.Tensor:
    """Direction of the body's front over the ground, radians."""
    front = motion.rotations[..., 0, :, 2]
    return torch.atan2(front[..., 1], front[..., 0])


def heading_error(found: Motion, truth: Motion) -> float:
    """Median over the frames, degrees."""
    away = (facing(found) - facing(truth) + math.pi).remainder(math.tau) - math.pi
    return math.degrees(away.abs().median())


def distances(motion: Motion, seen: Keypoints2D) -> torch.Tensor:
    return seen.camera.to_camera(bundled().pose(motion).joints[..., :1, :])[..., 0, 2].flatten()


def distance_error(found: Motion, truth: Motion, seen: Keypoints2D) -> float:
    """Median over the frames, as a share."""
    ratio = distances(found, seen) / distances(truth, seen)
    return float((ratio - 1).abs().median())


def hidden(seen: Keypoints2D, where) -> Keypoints2D:
    confidence = seen.confidence.clone()
    confidence[where] = 0
    return seen.replace(
        confidence=confidence, pixels=seen.pixels.where(confidence[..., None] > 0, 0.0)
    )


def legs(seen: Keypoints2D) -> list[int]:
    parts = ("knee", "ankle", "heel", "toe")
    return [k for k, name in enumerate(seen.points.names) if name.endswith(parts)]


@pytest.mark.parametrize("angle", [0, 60, 120, 180, 240, 300])
def test_heading_and_distance_of_a_walk_are_found(angle):
    truth = turned(walk(), math.radians(angle))
    seen = view(truth, cameras(truth)[0])
    found = seen.start(bundled())
    assert heading_error(found, truth) < 30
    assert distance_error(found, truth, seen) < 0.1
    assert found.fps == truth.fps
    assert (found.shape == 0).all()


@pytest.mark.parametrize("layout", ["openpose25b", "coco17", "halpe26", "mediapipe33", "h36m17"])
def test_every_layout_starts(layout):
    truth = walk()
    seen = view(truth, cameras(truth)[0], layout=layout)
    found = seen.start(bundled())
    assert heading_error(found, truth) < 30
    assert distance_error(found, truth, seen) < 0.12


def test_missing_first_frames_take_the_place_of_the_next():
    """HuMoR starts from frame 0 and is lost where nobody is in it."""
    truth = walk()
    seen = hidden(view(truth, cameras(truth)[0]), (0, slice(0, 8)))
    found = seen.start(bundled())
    assert heading_error(found, truth) < 30
    assert distance_error(found, truth, seen) < 0.1
    assert found.valid.all()
    assert torch.equal(found.rotations[0, 0], found.rotations[0, 8])


def test_missing_bones_do_not_push_the_body_away():
    """HuMoR counts bones that are not seen as bones of no length."""
    truth = walk()
    seen = view(truth, cameras(truth)[0])
    without = hidden(seen, (0, slice(None), legs(seen)))
    found = without.start(bundled())
    assert distance_error(found, truth, seen) < 0.15
    assert heading_error(found, truth) < 45


def test_a_recording_with_nobody_in_it_still_gives_a_finite_guess():
    truth = walk()
    seen = hidden(view(truth, cameras(truth)[0]), (0, slice(None)))
    found = seen.start(bundled())
    assert all(tensor.isfinite().all() for tensor in found.tensors().values())


def test_a_moving_camera_finds_the_same_person():
    truth = walk()
    camera = cameras(truth)[0]
    T = camera.T_camera_world.expand(truth.frames, 4, 4).clone()
    T[:, :3, 3] += torch.linspace(0, 0.3, truth.frames)[:, None]  # metres
    seen = view(truth, camera.replace(T_camera_world=T))
    found = seen.start(bundled())
    assert heading_error(found, truth) < 30
    assert distance_error(found, truth, seen) < 0.1


def test_clips_of_a_batch_are_guessed_as_alone():
    truth = walk()
    seen = view(truth, cameras(truth)[0])
    other = view(turned(truth, 2.0), cameras(truth)[0])
    both = seen.replace(
        pixels=torch.cat((seen.pixels, other.pixels)),
        confidence=torch.cat((seen.confidence, other.confidence)),
        camera=seen.camera.map(lambda t: t.expand(2, *t.shape[1:])),
    )
    found, alone = both.start(bundled()), other.start(bundled())
    torch.testing.assert_close(found.translation[1], alone.translation[0], atol=1e-4, rtol=0)
    torch.testing.assert_close(found.rotations[1], alone.rotations[0])


def test_the_distance_of_a_frame_is_that_of_its_longest_bones():
    """A body of known size in the image plane, one arm towards the camera."""
    truth = walk()
    seen = view(truth, cameras(truth)[0], noise=0.0)
    rest = seen.points.at_rest(bundled(), torch.zeros(16)) - bundled().joint_template[0]
    camera = seen.camera.replace(T_camera_world=torch.eye(4)[None, None])
    flat = rest * torch.tensor([1.0, 1.0, 0.0]) + torch.tensor([0.0, 0.0, 3.0])
    short = flat.clone()
    elbow, wrist = (seen.points.names.index(f"left_{name}") for name in ("elbow", "wrist"))
    short[wrist] = short[elbow]
    pixels = camera.project(torch.stack((flat, short))[None]).pixels
    distance = bone_distance(seen.points, rest, pixels, torch.ones(1, 2, 25), camera)
    assert distance[0, 0] == pytest.approx(3.0, rel=0.02)
    assert distance[0, 1] == pytest.approx(3.0, rel=0.02)


def test_headings_are_chosen_together():
    """One frame that fits best the wrong way round is no reason to spin."""
    angles = torch.arange(36) * math.tau / 36
    misfit = 0.1 * (1 - (angles - angles[9]).cos()).expand(1, 20, 36).clone()
    misfit[:, 10] = 0.1 * (1 - (angles - angles[27]).cos())
    assert (smooth_path(misfit, angles, 30.0) == 9).all()
    turning = torch.stack([1 - (angles - angles[k]).cos() for k in range(20)])[None]
    path = smooth_path(turning, angles, 30.0)
    assert (path[0] - torch.arange(20)).abs().max() <= 2


def test_a_guess_projects_onto_the_person():
    truth = walk()
    seen = view(truth, cameras(truth)[0])
    start = image_start(
        bundled(), seen.points, seen.pixels, seen.confidence, seen.camera, fps=30.0, start_time=2.0
    )
    assert start.start_time == 2.0
    pixels = seen.camera.project(bundled().pose(start).joints[..., :1, :]).pixels
    true = seen.camera.project(bundled().pose(truth).joints[..., :1, :]).pixels
    assert (pixels - true).norm(dim=-1).median() < 40  # of 1080
    up = so3.about_z(torch.tensor(0.0)) @ start.rotations[0, :, 0, :, 1, None]
    torch.testing.assert_close(up[..., 0], torch.tensor([0.0, 0.0, 1.0]).expand(24, 3))

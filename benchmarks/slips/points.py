"""Makes single mistakes in 3D points, image points or cameras, for `benchmarks.slips.mistakes`."""

import math
from collections.abc import Sequence

import torch
from jaxtyping import Float, Int
from torch import Generator, Tensor

from observations.joints3d import Joints3D
from observations.keypoints2d import Keypoints2D
from observations.markers3d import Markers3D
from recon.body.landmarks import KEYPOINTS_43
from recon.core import rotations as so3
from recon.core.camera import Camera
from recon.core.skeleton import JOINTS
from recon.method.sensor import Sensor as Seen

Values = Float[Tensor, "clips time points dims"]
_MAX_OUTLIER_M = 0.5
"""Largest distance (m) of an outlier along every axis, as in `recon.simulate`."""


def point_names(seen: Seen) -> tuple[str, ...]:
    """Return the names of an observation's points, in their order."""
    if isinstance(seen, Joints3D):
        return tuple(JOINTS[k] for k in seen.joints)
    if isinstance(seen, Keypoints2D):
        return seen.points.names
    return KEYPOINTS_43


def values_of(seen: Seen) -> Values:
    """Return positions in metres, or pixels."""
    if isinstance(seen, Keypoints2D):
        return seen.pixels
    assert isinstance(seen, Joints3D | Markers3D)
    return seen.positions


def weights_of(seen: Seen) -> Float[Tensor, "clips time points"]:
    """Return confidences of keypoints; one where a point in space is visible."""
    if isinstance(seen, Keypoints2D):
        return seen.confidence
    assert isinstance(seen, Joints3D | Markers3D)
    return seen.visible.float()


def edited(seen: Seen, values: Values, weights: Tensor | None = None) -> Seen:
    """Return the observation with other values, and weights if given; unseen values are zero."""
    weights = weights_of(seen) if weights is None else weights
    values = torch.where(weights[..., None] > 0, values, 0.0)
    if isinstance(seen, Keypoints2D):
        return seen.replace(pixels=values, confidence=weights)
    return seen.derived(positions=values, visible=weights > 0)


def pairs_of_sides(names: Sequence[str]) -> list[tuple[int, int]]:
    """Return indices of every left point and its right counterpart."""
    return [
        (k, names.index("right" + name.removeprefix("left")))
        for k, name in enumerate(names)
        if name.startswith("left_")
    ]


def exchanged(seen: Seen, pairs: Sequence[tuple[int, int]], frames: slice) -> Seen:
    """Exchange the names of the two points of every pair in some frames."""
    values, weights = values_of(seen).clone(), weights_of(seen).clone()
    for a, b in pairs:
        values[:, frames, [a, b]] = values[:, frames, [b, a]]
        weights[:, frames, [a, b]] = weights[:, frames, [b, a]]
    return edited(seen, values, weights)


def held(seen: Seen, point: int, frames: slice) -> Seen:
    """Repeat a point's value of the first of some frames in the others."""
    values, weights = values_of(seen).clone(), weights_of(seen).clone()
    values[:, frames, point] = values[:, frames.start, point][:, None]
    weights[:, frames, point] = weights[:, frames.start, point][:, None]
    return edited(seen, values, weights)


def zeroed(seen: Seen, share: float, seed: int) -> Seen:
    """Write a share of the visible points as zeros that count as seen."""
    weights = weights_of(seen)
    generator = Generator().manual_seed(seed)
    lost = torch.rand(weights.shape, generator=generator) < share
    return edited(seen, torch.where(lost[..., None], 0.0, values_of(seen)))


def displaced(seen: Seen, point: int, offset: Sequence[float]) -> Seen:
    """Move a point away from its place in all frames, by metres or pixels along every axis."""
    values = values_of(seen).clone()
    values[:, :, point] += values.new_tensor(offset)
    return edited(seen, values)


def moved(seen: Seen, offset: Sequence[float]) -> Seen:
    """Move all points in space by an offset (m)."""
    return edited(seen, values_of(seen) + values_of(seen).new_tensor(offset))


def scaled(seen: Seen, factors: Sequence[float]) -> Seen:
    """Multiply all points in space by a factor per axis."""
    return edited(seen, values_of(seen) * values_of(seen).new_tensor(factors))


def reordered(seen: Seen, order: Int[Tensor, " time"]) -> Seen:
    """Reorder frames: frame k gets the data of frame order[k]."""
    return edited(seen, values_of(seen)[:, order], weights_of(seen)[:, order])


def shuffled(frames: int, block: int, seed: int) -> Int[Tensor, " time"]:
    """Return an order of frames that is random within blocks."""
    generator = Generator().manual_seed(seed)
    starts = range(0, frames, block)
    sizes = [min(block, frames - start) for start in starts]
    parts = [
        start + torch.randperm(size, generator=generator)
        for start, size in zip(starts, sizes, strict=True)
    ]
    return torch.cat(parts)


def repeating(frames: int, share: float, seed: int) -> Int[Tensor, " time"]:
    """Return an order in which a share of the frames is replaced by the last one before."""
    generator = Generator().manual_seed(seed)
    kept = torch.rand(frames, generator=generator) >= share
    kept[0] = True
    return torch.where(kept, torch.arange(frames), 0).cummax(0).values


def wild(seen: Seen, share: float, seed: int) -> Seen:
    """Move a share of the points: up to half a metre per axis, or anywhere in the image."""
    values, generator = values_of(seen), Generator().manual_seed(seed)
    hit = torch.rand(values.shape[:-1], generator=generator) < share
    anywhere = torch.rand(values.shape, generator=generator)
    if isinstance(seen, Keypoints2D):
        elsewhere = anywhere * values.new_tensor(seen.camera.image_size)
    else:
        elsewhere = values + 2 * _MAX_OUTLIER_M * (anywhere - 0.5)
    return edited(seen, torch.where(hit[..., None], elsewhere, values))


def joined(before: Seen, after: Seen, frame: int) -> Seen:
    """Join one observation up to a frame with another from that frame on."""
    values = torch.cat((values_of(before)[:, :frame], values_of(after)[:, frame:]), 1)
    weights = torch.cat((weights_of(before)[:, :frame], weights_of(after)[:, frame:]), 1)
    return edited(before, values, weights)


def mirrored(view: Seen) -> Seen:
    """Mirror the image, left to right, as front cameras of phones write it."""
    assert isinstance(view, Keypoints2D)
    pixels = view.pixels * view.pixels.new_tensor([-1.0, 1.0])
    width = float(view.camera.image_size[0])
    return edited(view, pixels + pixels.new_tensor([width, 0.0]))


def delayed(view: Seen, frames: int) -> Seen:
    """Delay the data by some frames; the first frames are empty."""
    values, weights = values_of(view).roll(frames, 1), weights_of(view).roll(frames, 1)
    weights[:, :frames] = 0
    return edited(view, values, weights)


def misplaced(view: Seen, degrees: float, seed: int) -> Seen:
    """Turn the calibrated camera about its centre by an angle, about a random axis."""
    assert isinstance(view, Keypoints2D)
    turn = turned(torch.tensor([degrees]), seed).to(view.pixels)
    return view.replace(camera=_after(view.camera, turn))


def drifting(camera: Camera, frames: int, degrees: float, seed: int) -> Camera:
    """Turn a fixed camera evenly by an angle over some frames, as when its tripod gives way."""
    return _after(camera, turned(torch.linspace(0, degrees, frames), seed))


def turned(degrees: Float[Tensor, " poses"], seed: int) -> Float[Tensor, "poses 4 4"]:
    """Return rotations (4 x 4) by angles about one random axis."""
    axis = torch.randn(3, generator=Generator().manual_seed(seed))
    axis = axis / axis.norm()
    turns = torch.eye(4).repeat(len(degrees), 1, 1)
    turns[:, :3, :3] = so3.exp(degrees[:, None] * (math.pi / 180) * axis)
    return turns


def spread_out(view: Seen, factor: float) -> Seen:
    """Declare the camera `factor` times as far from the origin."""
    assert isinstance(view, Keypoints2D)
    pose = view.camera.T_camera_world.clone()
    pose[..., :3, 3] *= factor
    return view.replace(camera=view.camera.replace(T_camera_world=pose))


def _after(camera: Camera, turn: Tensor) -> Camera:
    return camera.replace(T_camera_world=turn @ camera.T_camera_world)

"""A cloud whose points have fixed surface discs, with hand-written derivatives of distances.

Between two searches for the nearest discs everything about a pair is constant but the bones that
carry the disc and the shape of the body. Arrays have their points last, so that sums over three
coordinates are sums of long rows.
"""

from bisect import bisect_left
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from observations.surfels import Surfels, tukey_kernel, tukey_scale
from recon.body.derivatives import BELOW, joint_jacobian_by_shape
from recon.body.model import BodyModel
from recon.core import rotations as so3
from recon.core.arrays import cached_constant
from recon.core.motion import Motion
from recon.core.residuals import Residuals
from recon.core.struct import TensorStruct
from recon.method.protocols import REFERENCE_FPS, Decoded, Estimate
from recon.method.quadratic import FRAME, ClipModel
from recon.method.timing import at_observation_times, padded

_LEAST = 1e-6
"""Metres, and lengths of normals, by which nothing is divided."""


@dataclass(frozen=True)
class SurfaceDiscs(TensorStruct):
    """Surface discs, one paired with each point of a cloud, before pose and shape move them."""

    weights: Float[Tensor, "*batch moments 22 points"]
    """Skinning weights."""
    centres: Float[Tensor, "*batch moments 3 points"]
    """Centres of the discs on the average body, metres."""
    by_shape: Float[Tensor, "*batch moments shape coordinates"]
    """Derivatives of the centres by the shape's coefficients; x of all points, then y, then z."""
    normals: Float[Tensor, "*batch moments 3 points"]
    radii: Float[Tensor, "*batch moments points"]
    """Metres."""

    @classmethod
    def of(
        cls, surfels: Surfels, body: BodyModel, pairs: Int[Tensor, "*batch moments points"]
    ) -> "SurfaceDiscs":
        """Select the surface discs whose indices are in `pairs`, one for each point."""
        like, index = body.template, torch.from_numpy(surfels.vertices).to(pairs.device)

        def of_pairs(table: Float[Tensor, "discs rows"]) -> Float[Tensor, "*batch moments rows p"]:
            return table.mT[:, pairs].movedim(0, -2).contiguous()

        by_shape = of_pairs(body.shape_directions[index].mT.flatten(1))
        return cls(
            of_pairs(body.weights[index]), of_pairs(like[index]),
            by_shape.unflatten(-2, (-1, 3)).flatten(-2),
            of_pairs(torch.from_numpy(surfels.normals).to(like)),
            torch.from_numpy(surfels.radii).to(like)[pairs],
        )  # fmt: skip

    def unposed_centres(
        self, shape: Float[Tensor, "*batch shape"]
    ) -> Float[Tensor, "*batch moments 3 points"]:
        """Centres of the discs on unposed bodies of given shapes, metres."""
        count = shape.shape[-1]
        away = shape[..., None, None, :] @ self.by_shape[..., :count, :]
        return self.centres + away.unflatten(-1, self.centres.shape[-2:])[..., 0, :, :]

    def derivatives_by_shape(
        self,
        along: Float[Tensor, "*batch moments 3 points"],
        unposed: Float[Tensor, "*batch moments 3 points"],
        shifts: Float[Tensor, "*batch moments 22 3 shape"],
    ) -> Float[Tensor, "*batch moments shape points"]:
        """Derivatives by the shape of the posed disc centres along given unit vectors.

        Args:
            along: the unit vectors.
            unposed: these on the unposed body.
            shifts: derivatives of the places to which bones move the origin, metres.
        """
        count = shifts.shape[-1]
        own = self.by_shape[..., :count, :].unflatten(-1, (3, -1)) * unposed[..., None, :, :]
        carried = shifts.transpose(-1, -3).flatten(-3, -2) @ self.weights
        carried = carried.unflatten(-2, (count, 3)) * along[..., None, :, :]
        return (own + carried).sum(-2)


@dataclass(frozen=True)
class _PointsBesideDiscs:
    """Offsets of points from their posed discs: e from the centre, h along the normal n."""

    unposed: Float[Tensor, "*batch moments 3 points"]
    maps: Float[Tensor, "*batch moments 4 3 points"]
    """Affine maps that pose the discs: three rows that rotate, and one that translates."""
    length: Float[Tensor, "*batch moments points"]
    """Length of the posed normals before they are normalised."""
    normals: Float[Tensor, "*batch moments 3 points"]
    """n."""
    offsets: Float[Tensor, "*batch moments 3 points"]
    """e."""
    height: Float[Tensor, "*batch moments points"]
    """h = n·e."""
    beyond: Float[Tensor, "*batch moments points"]
    """Share q of the way along the disc, e - h n, that lies beyond its radius."""
    squared: Float[Tensor, "*batch moments points"]
    """d² = h² + q² |e - h n|²."""

    @classmethod
    def of(
        cls, points: Tensor, discs: SurfaceDiscs, bones: Tensor, unposed: Tensor
    ) -> "_PointsBesideDiscs":
        maps = (bones.flatten(-2).mT @ discs.weights).unflatten(-2, (4, 3))
        turns = maps[..., :3, :, :]
        placed = (unposed[..., None, :] * turns).sum(-3) + maps[..., 3, :, :]
        turned = (discs.normals[..., None, :] * turns).sum(-3)
        length = turned.square().sum(-2).sqrt().clamp(min=_LEAST)
        normals, offsets = turned / length[..., None, :], points - placed
        height = (offsets * normals).sum(-2)
        across = (offsets - height[..., None, :] * normals).square().sum(-2).sqrt()
        beyond = (1 - discs.radii / across.clamp(min=_LEAST)).clamp(min=0)
        squared = height.square() + (beyond * across).square()
        return cls(unposed, maps, length, normals, offsets, height, beyond, squared)

    @property
    def half_gradient(self) -> Float[Tensor, "*batch moments 3 points"]:
        """Half the derivative of squared distances by offsets: (1 - q) h n + q e (q: `beyond`)."""
        level = ((1 - self.beyond) * self.height)[..., None, :]
        return level * self.normals + self.beyond[..., None, :] * self.offsets


class _SquaredDistances(torch.autograd.Function):
    """Squared distances of points from their discs, metres²."""

    @staticmethod
    def forward(
        ctx: Any, bones: Tensor, unposed: Tensor, points: Tensor, discs: SurfaceDiscs
    ) -> Tensor:
        ctx.found, ctx.discs = _PointsBesideDiscs.of(points, discs, bones, unposed), discs
        return ctx.found.squared

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor, Tensor | None, None, None]:
        found, discs = ctx.found, ctx.discs
        gradient = 2 * gradients[0][..., None, :]
        placed = -gradient * found.half_gradient
        across = found.offsets - found.height[..., None, :] * found.normals
        turned = (
            gradient * ((1 - found.beyond) * found.height / found.length)[..., None, :] * across
        )
        turns = (
            found.unposed[..., None, :] * placed[..., None, :, :]
            + discs.normals[..., None, :] * turned[..., None, :, :]
        )
        of_maps = torch.cat((turns, placed[..., None, :, :]), -3).flatten(-3, -2)
        bones = (discs.weights @ of_maps.mT).unflatten(-1, (4, 3))
        unposed = None
        if ctx.needs_input_grad[1]:
            unposed = (found.maps[..., :3, :, :] * placed[..., None, :, :]).sum(-2)
        return bones, unposed, None, None


@dataclass(frozen=True)
class MatchedCloud(TensorStruct):
    """A cloud with fixed correspondences: the energy of `PointCloud` between two searches.

    Only moments with points in some clip are kept.
    """

    pairs: Int[Tensor, "*batch filled points"]
    """Number of the disc of each point."""
    points: Float[Tensor, "*batch filled 3 points"]
    """Positions in the frame of the recording, metres."""
    present: Bool[Tensor, "*batch filled points"]
    variance: Float[Tensor, "*batch filled 1"]
    """By which squared distances are divided."""
    worth: Float[Tensor, "*batch filled 1"]
    """Weights of these quotients."""
    discs: SurfaceDiscs
    surfels: Surfels
    kernel: Callable[[Tensor, Tensor], Tensor]
    filled: tuple[int, ...]
    """Numbers of the moments that are kept."""
    fps: float
    start_time: float
    moments: int
    """Of the cloud."""
    scale: Float[Tensor, "*batch"] | None = None
    """Scale of Tukey's kernel, metres; None where `kernel` is another one."""

    def __call__(self, estimate: Estimate) -> Float[Tensor, "*batch"]:
        """Energy ½ Σ kernel(distance²) over the points present, scaled to 30 Hz, metres²."""
        squared, covered = self.squared_distances(estimate)
        return covered._energy(squared)

    def _energy(self, squared: Float[Tensor, "*batch filled points"]) -> Float[Tensor, "*batch"]:
        relative, present = (squared / self.variance).flatten(-2), self.present.flatten(-2)
        if self.scale is None:
            counted = self.kernel(relative, present)
        else:
            counted = tukey_kernel(relative, self.scale)
        counted = self.worth.expand(squared.shape).flatten(-2) * counted.where(present, 0.0)
        return 0.5 * counted.sum(-1) * (REFERENCE_FPS / self.fps)

    def with_tukey_scale(self, estimate: Estimate) -> "MatchedCloud":
        """Return the cloud with the scale of Tukey's kernel fixed to its value at an estimate."""
        squared, covered = self.squared_distances(estimate)
        relative = squared / covered.variance
        return self.derived(scale=tukey_scale(relative.flatten(-2), covered.present.flatten(-2)))

    def residuals(self, estimate: Estimate) -> Residuals:
        """Distances of points from their discs, metres; one dimension."""
        squared, covered = self.squared_distances(estimate)
        away = squared.clamp(min=0).sqrt()[..., None]
        moments = torch.tensor(covered.filled, dtype=torch.long)
        return padded(away, covered.present, moments, self.moments)

    def squared_distances(
        self, estimate: Estimate
    ) -> tuple[Float[Tensor, "*batch covered points"], "MatchedCloud"]:
        """Squared distances of points, metres², and the part of the cloud that they belong to."""
        covered, bones, unposed = self._covered_bones_and_discs(estimate)
        squared = _SquaredDistances.apply(bones, unposed, covered.points, covered.discs)
        return squared.where(covered.present, 0.0), covered

    def _covered_bones_and_discs(
        self, estimate: Estimate
    ) -> tuple[
        "MatchedCloud",
        Float[Tensor, "*batch covered 22 4 3"],
        Float[Tensor, "*batch covered 3 points"],
    ]:
        """The cloud in frames that the motion covers, bone transforms there, and unposed discs."""
        bones, covered = self._at_own_frames(
            _bone_transforms(estimate).flatten(-3, -2), estimate.motion
        )
        unposed = covered.discs.unposed_centres(estimate.body.shape)
        if estimate.body.model.pose_directions is not None:
            vertices = torch.from_numpy(self.surfels.vertices).to(bones.device)
            every, _ = self._at_own_frames(estimate.body.pose_offsets(vertices), estimate.motion)
            pick = covered.pairs[..., None].expand(*covered.pairs.shape, 3)
            unposed = unposed + every.gather(-2, pick).mT
        return covered, bones.unflatten(-2, (-1, 4)), unposed

    def _at_own_frames(
        self, values: Float[Tensor, "*batch time rows 3"], motion: Motion
    ) -> tuple[Float[Tensor, "*batch covered rows 3"], "MatchedCloud"]:
        """Resample a motion's values to the cloud's frames that it covers; return both there."""
        values, seen = at_observation_times(
            values, motion, fps=self.fps, start_time=self.start_time, moments=self.moments
        )
        if len(self.filled) == self.moments and seen == slice(0, self.moments):
            return values, self
        some = slice(*(bisect_left(self.filled, end) for end in (seen.start, seen.stop)))
        rows = cached_constant(tuple(k - seen.start for k in self.filled[some]), values.device)
        covered = (slice(None),) * (len(self.present.shape) - 2) + (some,)
        scale, kept = self.scale, self.derived(scale=None)
        return values[..., rows, :, :], kept[covered].derived(
            scale=scale, filled=self.filled[some]
        )

    def add_surface_curvature(self, weight: float, model: ClipModel) -> None:
        """Add one clip's Gauss-Newton Hessian; a moment of the cloud counts at the nearest frame.

        A distance changes as its foot, the nearest place of the disc, moves along the line to the
        point.
        """
        motion, scene = model.motion, model.estimate.scene[model.clip]
        estimate = Estimate(Decoded(motion), model.body.pose(motion), scene)
        one, bones, unposed = self[model.clip]._covered_bones_and_discs(estimate)
        discs, found = (
            one.discs,
            _PointsBesideDiscs.of(one.points, one.discs, bones, unposed),
        )
        with torch.enable_grad():
            squared = found.squared.where(one.present, 0.0).requires_grad_()
            (slope,) = torch.autograd.grad(one._energy(squared), squared)
        distance = found.squared.sqrt()[..., None, :]
        along = torch.where(
            distance < _LEAST, found.normals, found.half_gradient / distance.clamp(min=_LEAST)
        )
        foot = one.points - distance * along
        place = [
            (one.start_time + k / one.fps - motion.start_time) * motion.fps for k in one.filled
        ]
        last = motion.frames - 1
        frame = cached_constant(tuple(min(max(round(p), 0), last) for p in place), along.device)
        orientations, joints = (every[frame] for every in model.posed)
        shaped = along[..., :0, :]
        if model.with_shape:
            pulled = (found.maps[..., :3, :, :] * along[..., None, :, :]).sum(-2)
            shifts = _shifts_by_shape(orientations, model.body, motion.shape.shape[-1])
            if scene.ground is not None:
                shifts = scene.ground.T_world_recording[:3, :3].mT @ shifts
            shaped = discs.derivatives_by_shape(along, pulled, shifts)
        if scene.ground is not None:
            T = scene.ground.T_world_recording
            along, foot = T[:3, :3] @ along, T[:3, :3] @ foot + T[:3, 3:]
        turned = _jacobian_by_rotations(foot, along, discs.weights, orientations, joints)
        rows = torch.cat((along, turned, shaped), -2)
        full = (rows * (2 * weight * slope)[:, None]) @ rows.mT
        # chain rule: `turn` is the Jacobian of joint rotations by the prior's pose variables
        turn, bent = model.turn[frame], slice(6, FRAME)
        full[:, bent] = turn.mT @ full[:, bent]
        full[:, :, bent] = full[:, :, bent] @ turn
        model.part.add_frames(frame, full)


def _jacobian_by_rotations(
    places: Float[Tensor, "moments 3 points"],
    along: Float[Tensor, "moments 3 points"],
    share: Float[Tensor, "moments 22 points"],
    orientations: Float[Tensor, "moments 22 3 3"],
    joints: Float[Tensor, "moments 22 3"],
) -> Float[Tensor, "moments 66 points"]:
    """Derivatives of u·x (points x, unit vectors u) by rotations R_a Exp(d_a) of all joints a.

    A step turns the share s_a of point x that hangs from joint a: s_a O_aᵀ ((x - p_a) × u). All
    bones are taken to carry the point to one place, as they do but where skin bends.

    Args:
        places: points x, world, metres.
        along: unit vectors u.
        share: skinning weights of the points.
        orientations: of the bones, O_a.
        joints: their origins p_a, metres.
    """
    wrench = torch.cat((along, torch.linalg.cross(places, along, dim=-2)), -2)
    arms = torch.cat((-(orientations.mT @ so3.hat(joints)), orientations.mT), -1)
    below = BELOW.to(share) @ share
    return (arms.flatten(1, 2) @ wrench) * below.repeat_interleave(3, 1)


def _shifts_by_shape(
    orientations: Float[Tensor, "moments 22 3 3"], body: BodyModel, count: int
) -> Float[Tensor, "moments 22 3 shape"]:
    """Derivatives of the translation part of `PosedBody.bones` by the shape, world, metres."""
    directions = body.joint_directions[..., :count].to(orientations)
    return joint_jacobian_by_shape(orientations, body, count) - orientations @ directions


def _bone_transforms(estimate: Estimate) -> Float[Tensor, "*batch time 22 4 3"]:
    """The bones' transforms (`PosedBody.bones`) from rest pose to the recording's frame."""
    bones, scene = estimate.body.bones, estimate.scene
    if scene.ground is None:
        return bones
    turns = scene.to_recording_directions(bones[..., :3, :].flatten(-3, -2))
    shift = scene.to_recording(bones[..., 3, :])
    return torch.cat((turns.unflatten(-2, (-1, 3)), shift[..., None, :]), -2)

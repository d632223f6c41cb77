"""Refines rough poses so that the body's surface fits the observed points (closest points).

Labels are off by centimetres to decimetres, and the points themselves by millimetres. So a pose is
drawn to both: to the places that labels name, as far as they are believed, and to the surface of
the part that is near.
"""

from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from observations.start.bone_poses import BonePoses, BoneTargets, PoseChangePenalty, PoseSolver
from observations.surfels import Surfels
from priors.labels.looking import PointLabels
from priors.labels.networks import squared_distances
from priors.labels.regions import REGIONS, Regions
from recon.body.model import BodyModel
from recon.core.motion import Motion
from recon.core.nearest import nearest_alike
from recon.core.raster import are_facing_eye
from recon.core.struct import concatenate

_PLACE_WEIGHT = 0.005
"""Metres² per metre² between two places on the unposed body. Labels are off by some centimetres,
which must not draw a point along the surface; what is a metre away costs as much as a surface that
is 7 cm away."""
_REGION = 0.01
"""Metres² of a region that the labels take for impossible, as of a surface 10 cm away. On three
validation windows with a fifth of the labels wrong, joints that are seen are 4.1 cm off; 4.7 where
labels do not count, and 5.6 and more where they count six times as much."""


def label_features(labels: PointLabels) -> Float[Tensor, "*batch points 16"]:
    """Features of labelled points, whose product with `surfel_features` is the cost of a match."""
    sure = labels.on_body[..., None]
    place = -2 * _PLACE_WEIGHT * labels.places
    size = torch.full_like(sure, _PLACE_WEIGHT)
    region = _REGION * (1 - labels.regions)
    return sure * torch.cat((place, size, region), -1)


def surfel_features(surfels: Surfels, body: BodyModel) -> Float[Tensor, "surfels 16"]:
    """Features of surfels whose product with `label_features` is the cost of matching a point."""
    index = torch.from_numpy(surfels.vertices).to(body.template.device)
    regions = Regions.of(body)
    place = regions.places[index]
    region = torch.nn.functional.one_hot(regions.of_vertex[index], len(REGIONS)).to(place)
    return torch.cat((place, place.square().sum(-1, keepdim=True), region), -1)


_STD = 0.04
"""Metres that a point may be away from the middle of the nearest of few surfels."""
_WORTH = 60.0
"""Points that err independently of each other, as which the surface of a moment counts."""
_ALONG = 0.2
"""Share of the way along the surface that a point draws a surfel, beside all the way to it."""


@dataclass(frozen=True)
class SeenSurface:
    """Labelled points of several frames with the sensor's position, and the body's surface."""

    body: BodyModel
    cover: Surfels
    points: Float[Tensor, "rows points 3"]
    present: Bool[Tensor, "rows points"]
    point_features: Float[Tensor, "rows points 16"]
    disc_features: Float[Tensor, "surfels 16"]
    bone: Int[Tensor, " surfels"]
    """The bone that moves each surfel most."""
    eye: Float[Tensor, "rows 3"] | None

    @classmethod
    def of(
        cls,
        body: BodyModel,
        cover: Surfels,
        points: Float[Tensor, "rows points 3"],
        labels: PointLabels,
        eye: Float[Tensor, "rows 3"] | None,
    ) -> "SeenSurface":
        """Collect points, with the cost of matching each with every surface disc by its label."""
        discs = surfel_features(cover, body)
        bone = body.weights[torch.from_numpy(cover.vertices)].argmax(-1)
        return cls(body, cover, points, labels.present, label_features(labels), discs, bone, eye)

    def rows(self, index: Int[Tensor, " some"]) -> "SeenSurface":
        """Return the surface points of the frames with the given indices."""
        eye = None if self.eye is None else self.eye[index]
        return replace(
            self, points=self.points[index], present=self.present[index],
            point_features=self.point_features[index], eye=eye,
        )  # fmt: skip

    def refined_to_surface(
        self,
        state: BonePoses,
        solver: PoseSolver,
        labelled: BoneTargets,
        sigmas: tuple[float, ...],
        penalty: PoseChangePenalty | None,
    ) -> BonePoses:
        """Refine poses by a Gauss-Newton step per kernel scale, with new closest points each time.

        Args:
            state: where to begin.
            solver: of the body.
            labelled: what the labels ask.
            sigmas: scales, metres.
            penalty: on changes between neighbouring frames; None leaves them independent.
        """

        def targets(now: BonePoses) -> BoneTargets:
            return concatenate([labelled, self._targets(now)], dim=1)

        return solver.minimised(state, targets, sigmas, penalty)

    def _targets(self, state: BonePoses) -> BoneTargets:
        """Match points with their nearest surface discs; return these as targets of bones."""
        middles, normals = self.cover.posed(self.body.pose(_motion_of_poses(state, self.body)))
        allowed = torch.ones_like(middles[..., 0], dtype=torch.bool)
        if self.eye is not None:
            allowed = are_facing_eye(middles, normals, self.eye)
        found = nearest_alike(
            self.points, self.present, self.point_features, middles, allowed, self.disc_features
        )
        pick = found[..., None].expand(*found.shape, 3)
        middle, normal = middles.gather(1, pick), normals.gather(1, pick)
        away = self.points - middle
        height = (away * normal).sum(-1, keepdim=True) * normal
        bone = self.bone[found]
        # the surfel's place in the frame of its bone, from the posed surface with blended skinning
        placed = state.bones[torch.arange(len(bone))[:, None], bone]
        place = (placed[..., :3].mT @ (middle - placed[..., 3])[..., None])[..., 0]
        count = self.present.sum(-1, keepdim=True).clamp(min=1)
        weight = self.present.to(place) * (_WORTH / count).clamp(max=1) / _STD**2
        return BoneTargets(middle + height + _ALONG * (away - height), weight, bone, place)


def _motion_of_poses(state: BonePoses, body: BodyModel) -> Motion:
    """The poses of all rows as the frames of one motion of the average body."""
    shape = state.translation.new_zeros(body.shape_size)
    return Motion.create(state.translation, state.rotations, shape, fps=30.0)


_HALF_COUNTED = 0.1
"""Scale in metres of the distance of a point from the surface: at this one, half counts."""
_SIGHT_RADIUS_M = 0.08
"""Metres at the body within which a point stands for a line of sight."""
_BEFORE = 0.12
"""Metres that a surface may be nearer to the sensor than the points along its line of sight."""


def misfits_of_frames(
    motion: Motion,
    body: BodyModel,
    surfels: Surfels,
    points: Float[Tensor, "rows points 3"],
    present: Bool[Tensor, "rows points"],
    eye: Float[Tensor, "rows 3"] | None,
) -> tuple[Float[Tensor, " rows"], Float[Tensor, " rows"]]:
    """Two misfits (0 to 1) per frame: distance of points, share of surface the sensor saw past.

    Args:
        motion: one clip, whose frames are the rows.
        body: whose motion it is.
        surfels: a sparse cover of its surface.
        points: seen in every row, metres.
        present: which of them exist.
        eye: the sensor's place in every row; None where points come from all sides.

    Returns:
        The mean of d² / (d² + 0.1²) over the distances d of points from the facing surface,
        metres, and the share of the facing surface where the sensor saw past it or through it,
        0 without a sensor.
    """
    middles, normals = surfels.posed(body.pose(motion))
    shown = torch.ones_like(present[:, :1]).expand(middles.shape[:2])
    if eye is not None:
        shown = are_facing_eye(middles, normals, eye)
    centre = points.mean(1, keepdim=True)  # subtracted: products of small numbers round less
    squared = squared_distances(points - centre, middles - centre)
    nearest = squared.masked_fill(~shown[:, None], torch.inf).amin(-1)
    share = (nearest / (nearest + _HALF_COUNTED**2)).nan_to_num(1.0).where(present, 0.0)
    misfit = share.sum(-1) / present.sum(-1).clamp(min=1)
    if eye is None:
        return misfit, torch.zeros_like(misfit)
    away = torch.where(present[..., None], points - eye[:, None], 0.0)
    far = away.norm(dim=-1)
    ray = away / far.clamp(min=1e-6)[..., None]
    towards = middles - eye[:, None]
    depth = towards.norm(dim=-1)
    cosine = (towards / depth.clamp(min=1e-6)[..., None]) @ ray.mT
    cosine = cosine.masked_fill(~present[:, None], -1.0)
    best = cosine.max(-1)
    lateral = (2 - 2 * best.values.clamp(max=1)).sqrt() * depth
    before = far.gather(-1, best.indices) - depth > _BEFORE
    against = shown & ((lateral > _SIGHT_RADIUS_M) | before)
    share = against.sum(-1) / shown.sum(-1).clamp(min=1)
    return misfit, share.to(misfit)

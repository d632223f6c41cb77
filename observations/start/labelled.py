"""A first guess from labelled clouds: any posture, tilt and heading, made consistent over time.

A cloud's labels say of every point where on the body it lies, roughly. So a pose follows as it
does from markers. What labels get wrong, they get wrong for a whole moment: left for right, the
front for the back. Therefore every moment is posed under each of these hypotheses, and those of
all moments are chosen together, by what the sensor saw and by how fast people turn.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from observations.start.bone_poses import (
    BonePoses,
    BoneTargets,
    PoseChangePenalty,
    PoseSolver,
    placed_rigidly,
)
from observations.start.surface_steps import SeenSurface, misfits_of_frames
from observations.surfels import Surfels
from priors.labels.looking import PointLabels
from priors.labels.regions import MIRRORED_REGIONS, REGION_OF_JOINT, REGIONS
from priors.pose.prior import PosePrior
from recon.body.model import BodyModel
from recon.core import rotations as so3
from recon.core.motion import Motion
from recon.core.struct import concatenate
from recon.method.windows import interpolated_poses
from recon.solver.viterbi import cheapest_path

RATE = 10.0
"""Moments per second that are posed; the others lie between them."""
_POINTS = 160
"""Points of a moment that are posed with."""
_COVER = 400
"""Surfels on which points are placed, and by which poses are judged."""
_LEAST_POINTS = 20
_WORTH = 40.0
"""Points that err independently of each other, as which the points of a moment count."""
_LEAST_STD = 0.03
"""Metres: no label is taken for more exact, as the body is taken for the average one."""
_ELSEWHERE = 0.3
"""Metres that a surfel of another region counts as farther away."""
_TRUNK = frozenset(REGIONS.index(name) for name in ("head", "chest", "belly", "pelvis"))
_HYPOTHESES = ((1, 1, 1), (-1, 1, 1), (-1, 1, -1))
"""Signs of the labels' places: as they are, left and right exchanged, turned about the long axis
of the body (left and right, front and back)."""
_RIGID = (0.5, 0.3, 0.2, 0.15)
_POSED = (0.6, 0.6, 0.4, 0.3, 0.2, 0.15, 0.12)
"""Scales of the robust kernel from step to step, metres."""
_NEARED = (0.3, 0.2, 0.2, 0.15)
_STEP_SCALES = (0.2, 0.2, 0.2, 0.15, 0.15, 0.15, 0.1, 0.1, 0.1)
"""Scales of the steps towards the surface, of every reading and of the chosen ones."""
_AGAINST, _LABELS = 0.5, 0.4
"""Weights beside the misfit: of the surface that the sensor looked through, and of labels that a
pose disagrees with."""
_SPIN, _SPREAD = 8.0, 4.0
"""Radians per second that the trunk turns, and metres per second that joints move about it, beyond
which a change is one of the reading rather than of the body."""
_CHANGE_COST, _MAX_CHANGE_COST = 0.4, 5.0
"""What such a change costs, and what any change costs at most."""


@dataclass(frozen=True)
class _FramesToPose:
    """Clouds of the frames of one clip, about ten per second, in which a pose is fitted."""

    frame_index: Int[Tensor, " rows"]
    points: Float[Tensor, "rows points 3"]
    present: Bool[Tensor, "rows points"]
    labels: PointLabels
    eye: Float[Tensor, "rows 3"] | None
    seconds: Float[Tensor, " between"]
    """Time from each moment to the next."""


def labelled_start(
    body: BodyModel,
    points: Float[Tensor, "*batch moments points 3"],
    present: Bool[Tensor, "*batch moments points"],
    labels: PointLabels,
    eye: Float[Tensor, "*batch moments 3"] | None,
    *,
    fps: float,
    start_time: float,
) -> Motion:
    """The average body in poses fitted to labelled points, about ten frames per second.

    Moments that show too little take the pose that lies between their neighbours'.

    Args:
        body: whose motion it is.
        points: metres, in the frame of the recording.
        present: which of them exist.
        labels: of the points.
        eye: where the sensor is; None for scans from all sides.
        fps: moments per second.
        start_time: of the first moment, seconds.
    """
    batch = points.shape[:-3]
    axes = len(batch)

    def with_one_batch_axis(values: Tensor) -> Tensor:
        return values[None].flatten(0, axes)

    eyes = (
        [None] * with_one_batch_axis(present).shape[0]
        if eye is None
        else list(with_one_batch_axis(eye).cpu())
    )
    known = labels.to(device="cpu", dtype=torch.float32).map(with_one_batch_axis)
    tracker = _PoseTracker.of(body)
    seen = zip(
        with_one_batch_axis(points).cpu(), with_one_batch_axis(present).cpu(), eyes, strict=True
    )
    clips = [
        tracker.tracked_poses(cloud, here, known[k], at, fps)
        for k, (cloud, here, at) in enumerate(seen)
    ]

    def joined(values: list[Tensor]) -> Tensor:
        return torch.stack(values).to(points).reshape(*batch, *values[0].shape)

    return Motion(
        translation=joined([place for place, _ in clips]),
        rotations=joined([turn for _, turn in clips]),
        shape=points.new_zeros(*batch, body.shape_size),
        valid=torch.ones_like(present[..., 0]),
        fps=fps,
        start_time=start_time,
    )


@dataclass(frozen=True)
class _PoseTracker:
    """Fits poses to the labelled clouds of a clip; holds the body's constants for that."""

    body: BodyModel
    solver: PoseSolver
    cover: Surfels
    place: Float[Tensor, "surfels 3"]
    """Places of the surfels on the unposed body, metres."""
    bone: Int[Tensor, " surfels"]
    region: Int[Tensor, " surfels"]

    @classmethod
    def of(cls, body: BodyModel) -> "_PoseTracker":
        body = body.to(device="cpu", dtype=torch.float32)
        cover = Surfels.of(body, _COVER)
        index = torch.from_numpy(cover.vertices)
        bone = body.weights[index].argmax(-1)
        region = torch.tensor(REGION_OF_JOINT)[bone]
        density = PosePrior.load().density.to(dtype=torch.float32)
        solver = PoseSolver(body.joint_template, density)
        return cls(body, solver, cover, body.template[index], bone, region)

    def tracked_poses(
        self,
        points: Float[Tensor, "moments points 3"],
        present: Bool[Tensor, "moments points"],
        labels: PointLabels,
        eye: Float[Tensor, "moments 3"] | None,
        fps: float,
    ) -> tuple[Float[Tensor, "moments 3"], Float[Tensor, "moments 22 3 3"]]:
        """Translations (metres) and joint rotations of one clip in every frame of its clouds."""
        count = len(points)
        moments = _frames_to_pose(points, present, labels, eye, fps)
        if moments is None:
            turn = so3.exp(torch.tensor([torch.pi / 2, 0.0, 0.0]))
            upright = torch.cat((turn[None], torch.eye(3).expand(21, 3, 3)))
            return torch.zeros(count, 3), upright.expand(count, 22, 3, 3)
        hypotheses = [self._targets(moments, signs) for signs in _HYPOTHESES]
        targets = concatenate(hypotheses)
        eyes = None if moments.eye is None else moments.eye.repeat(len(_HYPOTHESES), 1)
        read = [_labels_of_hypothesis(moments.labels, signs) for signs in _HYPOTHESES]
        surface = SeenSurface.of(self.body, self.cover, targets.points, concatenate(read), eyes)
        posed = self._poses_of_hypotheses(targets)
        posed = surface.refined_to_surface(posed, self.solver, targets, _NEARED, None)
        path = self._cheapest_hypotheses(moments, posed, hypotheses[0])
        rows = path * len(moments.frame_index) + torch.arange(len(path))
        penalty = PoseChangePenalty(place=0.1**-2, turn=0.5**-2, coordinates=0.7**-2)
        held = surface.rows(rows)
        found = held.refined_to_surface(
            posed[rows], self.solver, targets[rows], _STEP_SCALES, penalty
        )
        return interpolated_poses(
            found.translation, found.rotations, moments.frame_index, torch.arange(count)
        )

    def _targets(self, moments: _FramesToPose, signs: tuple[int, int, int]) -> BoneTargets:
        """The points with their places on bones under one hypothesis of the labels."""
        labels = _labels_of_hypothesis(moments.labels, signs)
        place, region = labels.places, labels.region.clamp(min=0)
        away = torch.cdist(place, self.place)
        away = away + _ELSEWHERE * (region[..., None] != self.region)
        bone = self.bone[away.argmin(-1)]
        variance = labels.std.square().clamp(min=_LEAST_STD**2)
        weight = (labels.on_body / variance).where(moments.present, 0.0)
        usual = float(moments.present.sum(-1).float().median())
        return BoneTargets(
            moments.points,
            weight * min(_WORTH / max(usual, 1.0), 1.0),
            bone,
            place - self.solver.rest[bone],
        )

    def _poses_of_hypotheses(self, targets: BoneTargets) -> BonePoses:
        """Poses of all frames under all hypotheses, each frame solved independently."""
        region = torch.tensor(REGION_OF_JOINT)[targets.bone]
        trunk = torch.isin(region, torch.tensor(sorted(_TRUNK)))
        place, turn = placed_rigidly(targets, self.solver.rest, trunk, _RIGID)
        start = BonePoses.of(
            place - self.solver.rest[0],
            turn,
            place.new_zeros(len(place), 63),
            self.solver,
        )
        return self.solver.minimised(start, lambda _: targets, _POSED, None)

    def _cheapest_hypotheses(
        self, moments: _FramesToPose, posed: BonePoses, targets: BoneTargets
    ) -> Int[Tensor, " rows"]:
        """Choose a hypothesis for every frame, with the least total cost over time (Viterbi)."""
        frames, hypotheses = len(moments.frame_index), len(_HYPOTHESES)
        motion = Motion.create(
            posed.translation, posed.rotations, self.body.template.new_zeros(self.body.shape_size),
            fps=RATE,
        )  # fmt: skip
        repeated = (hypotheses, 1, 1)
        eye = None if moments.eye is None else moments.eye.repeat(hypotheses, 1)
        misfit, contradicted = misfits_of_frames(
            motion, self.body, self.cover, moments.points.repeat(repeated),
            moments.present.repeat(hypotheses, 1), eye,
        )  # fmt: skip
        labels = concatenate([targets] * hypotheses)
        away = labels.residuals(posed).square().sum(-1)
        share = (away / (away + 0.15**2) * labels.weight).sum(-1)
        share = share / labels.weight.sum(-1).clamp(min=1e-9)
        cost = misfit + _AGAINST * contradicted + _LABELS * share
        cost = cost.view(hypotheses, frames).mT
        change = _costs_of_changing_hypothesis(posed, hypotheses, moments.seconds)
        return cheapest_path(cost[None], change)[0]


def _frames_to_pose(
    points: Tensor, present: Tensor, labels: PointLabels, eye: Tensor | None, fps: float
) -> _FramesToPose | None:
    """Select about ten frames per second with enough points; None if there are none."""
    enough = (present & (labels.on_body > 0)).sum(-1) >= _LEAST_POINTS
    frame_index = enough.nonzero()[:, 0]
    if len(frame_index) == 0:
        return None
    stride = max(1, round(fps / RATE))
    kept = [int(frame_index[0])]
    for k in frame_index[1:].tolist():
        if k - kept[-1] >= stride or k == int(frame_index[-1]):
            kept.append(k)
    frame_index = torch.tensor(kept)
    # random order, present points first: the first `_POINTS`, which are kept, cover all scan lines
    order = (
        present[frame_index].float()
        + torch.rand(present.shape[-1], generator=torch.Generator().manual_seed(0)) / 2
    )
    pick = order.argsort(-1, descending=True)[:, :_POINTS]

    def selected(values: Tensor) -> Tensor:
        some = values[frame_index]
        index = pick if some.ndim == 2 else pick[..., None].expand(*pick.shape, some.shape[-1])
        return some.gather(1, index)

    return _FramesToPose(
        frame_index,
        selected(points).float(),
        selected(present),
        labels.map(selected),
        None if eye is None else eye[frame_index].float(),
        frame_index.diff() / fps,
    )


def _labels_of_hypothesis(labels: PointLabels, signs: tuple[int, int, int]) -> PointLabels:
    """Return labels mirrored as a hypothesis says: -1 of `signs` mirrors that axis of places."""
    regions = labels.regions
    if signs[0] < 0:
        regions = regions[..., list(MIRRORED_REGIONS)]
    place = labels.places * labels.places.new_tensor(signs)
    return labels.derived(places=place, regions=regions)


def _costs_of_changing_hypothesis(
    posed: BonePoses, hypotheses: int, seconds: Float[Tensor, " between"]
) -> Float[Tensor, "between hypotheses hypotheses"]:
    """Cost of going from each hypothesis of a frame to each of the next, by implied speeds."""
    root = posed.root.unflatten(0, (hypotheses, -1)).transpose(0, 1)
    joints = posed.joints.unflatten(0, (hypotheses, -1)).transpose(0, 1)
    joints = joints - joints[..., :1, :]
    before, after = root[:-1, :, None], root[1:, None]
    spin = so3.geodesic_angle(*torch.broadcast_tensors(before, after)) / seconds[:, None, None]
    moved = (joints[:-1, :, None] - joints[1:, None]).norm(dim=-1).mean(-1)
    speed = moved / seconds[:, None, None]
    cost = _CHANGE_COST * ((spin / _SPIN).square() + (speed / _SPREAD).square())
    return cost.clamp(max=_MAX_CHANGE_COST)

"""Named points of the body: their places on it, and their measured positions in space."""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar, TypeVar

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from observations.checks import checked_clock, checked_indices, checked_positions, checked_std
from observations.noise import estimate_noise
from observations.start.rigid import rigid_start, with_limbs_towards_points
from recon.body.derivatives import BonePoints
from recon.body.model import BodyModel, PosedBody
from recon.core.arrays import Numbers, cached_constant
from recon.core.motion import Motion
from recon.core.residuals import Noise, geman_mcclure, squared
from recon.core.skeleton import PARENTS
from recon.method.protocols import REFERENCE_FPS, Estimate
from recon.method.quadratic import PointModel
from recon.method.sensor import Sensor

if TYPE_CHECKING:
    from observations.correspondences import BodyPoints
else:  # at run time Any replaces BodyPoints, whose module need not be imported
    from typing import Any as BodyPoints

OFFSET_UNIT = 0.05
"""Metres; offsets of keypoints in images are in this unit: they are seen in all frames and views
at once, so that a variable in metres would be stiff."""
_NEAR_JOINT_M = 0.2
"""Metres at rest within which a point on a neighbouring bone tells where a joint is."""


class PointsOfBody(Sensor):
    """Base of sensors that measure named points of the body, in space or in an image."""

    points: BodyPoints
    """The points of the body that are measured."""
    offset_rows: tuple[int, int] | None
    """First row, and the row after the last, of `Scene.offsets` that these points own: constant
    offsets from the body model that are estimated with the motion. None estimates none."""
    offset_unit: ClassVar[float] = 1.0
    """Metres that `Scene.offsets` of these points are in."""

    def predict(self, body: PosedBody) -> Float[Tensor, "*batch time points 3"]:
        """Predict the sensor's points on a posed body, world, metres."""
        return self.points.of(body)

    @property
    def point_ids(self) -> tuple[str, ...] | tuple[int, ...]:
        """Identifiers of the points: names, or numbers of joints or vertices."""
        return self.points.names

    def energy(self, points: Float[Tensor, "*batch frames points 3"]) -> Float[Tensor, "*batch"]:
        """Energy of predicted points (recording's frame, metres) in all frames of the data."""
        raise NotImplementedError

    def on_bones(self, body: BodyModel, shape: Float[Tensor, " shape"]) -> BonePoints:
        """Return the points as moved by the bones of a body of given shape, without offsets."""
        points = self.points.on(shape.device, shape.dtype)
        return BonePoints.create(
            body, shape, points.of_joints, points.of_vertices, points.vertices
        )

    def at_rest(self, body: BodyModel) -> Float[Tensor, "points 3"]:
        """Positions of the sensor's points on the average body in its rest pose, metres."""
        return self.points.at_rest(body, body.template.new_zeros(body.shape_size))

    def bones(self, body: BodyModel) -> tuple[int, ...]:
        """Joint index of the bone that moves each point."""
        del body
        return self.points.bones

    def point_names(self, body: BodyModel) -> tuple[str, ...]:
        """Names of the points, for reports."""
        del body
        return self.points.names

    def predicted(self, estimate: Estimate) -> Float[Tensor, "*batch time points 3"]:
        """Predict the points of an estimate with its offsets `Scene.offsets`, world, metres."""
        points = self.predict(estimate.body)
        if self.offset_rows is None:
            return points
        turns = estimate.body.orientations
        turns = turns[..., cached_constant(self.bones(estimate.body.model), turns.device), :, :]
        offsets = estimate.scene.offsets[..., None, slice(*self.offset_rows), :, None]
        return points + self.offset_unit * (turns @ offsets)[..., 0]

    def points_on_bones(
        self, body: BodyModel, shape: Float[Tensor, " shape"], offsets: Float[Tensor, "rows 3"]
    ) -> BonePoints:
        """Return the points as moved by a body's bones, shifted by `offsets` (`Scene.offsets`)."""
        found = self.on_bones(body, shape)
        if self.offset_rows is None:
            return found
        own = self.offset_unit * offsets[slice(*self.offset_rows)]
        return found.displaced(self.bones(body), own)

    def joints_located(self, body: BodyModel) -> Bool[Tensor, "*batch frames 22"]:
        """Whether some visible point locates each joint, in every frame."""
        located_joints = torch.from_numpy(self.located_joints(body)).to(self.shown.device)
        locates = located_joints.to(torch.get_default_dtype())
        return (self.shown.to(locates) @ locates) > 0

    def shown_joints(self, estimate: Estimate) -> Bool[np.ndarray, "frames 22"]:
        """Mask (frames, 22) of the first clip's joints that some visible point locates."""
        return self.shown[0].cpu().numpy() @ self.located_joints(estimate.body.model)

    def located_joints(self, body: BodyModel) -> Bool[np.ndarray, "points 22"]:
        """Mask (points, joints) of the joints that each point locates.

        They lie near it at rest, and its bone ends or begins there.
        """
        rest = self.at_rest(body).double().cpu().numpy()
        joints = body.joint_template.double().cpu().numpy()
        near = np.linalg.norm(rest[:, None] - joints[None], axis=-1) < _NEAR_JOINT_M
        touches = np.array([
            [bone == joint or PARENTS[joint] == bone or PARENTS[bone] == joint
             for joint in range(len(PARENTS))]
            for bone in self.bones(body)
        ])  # fmt: skip
        return near & touches


P = TypeVar("P", bound="TrackedPoints")


@dataclass(frozen=True)
class TrackedPoints(PointsOfBody):
    """Positions of points whose places on the body are known; an energy in metres²."""

    sees = "points"
    timed = ("positions", "visible", "std")
    level = True
    placed = True
    """Whether positions are places in the world rather than relative to the body."""
    on_skin: ClassVar[bool] = False
    """Whether the points lie on the skin rather than being joints of the skeleton."""
    positions: Float[Tensor, "*batch moments points 3"]
    """Positions in metres, in the frame of the recording (z up); zero where not visible."""
    visible: Bool[Tensor, "*batch moments points"]
    """Whether a point was seen at a moment."""
    fps: float
    """Rate of the moments in Hz."""
    start_time: float = 0.0
    """Time of the first moment, in seconds of the clock that all observations of a clip share."""
    kernel: Callable[[Tensor], Tensor] = squared
    """Robust kernel of squared distances in metres², such as `recon.core.residuals.squared`."""
    ground_known: bool = True
    """Whether the plane z = 0 of the recording is the ground."""
    offset_rows: tuple[int, int] | None = None
    """First row, and the row after the last, of `Scene.offsets` that these points own: constant
    offsets from the body model that are estimated with the motion. None estimates none."""
    std: Float[Tensor, "*batch moments points"] | None = None
    """Standard deviation of the coordinates of every point at every moment, metres; zero where it
    was not visible. Weights go with the inverse square, and their root mean square is the noise
    where a fit is given none. None counts all points alike and estimates the noise."""
    rms_std: float | None = field(init=False, default=None)
    """Root mean square of `std` over the visible points of the whole recording, metres. Its
    parts keep it, so that a point weighs the same in every window."""

    def _set_measured(
        self,
        positions: Numbers,
        visible: Numbers,
        clock: tuple[float, float],
        std: Numbers | float | None,
        places: tuple[str, Numbers],
        exist: Bool[Tensor, " points"] | None = None,
        **rest: Any,
    ) -> tuple[int, ...]:
        """Check a constructor's arguments, set the fields from them, return the checked places.

        Args:
            positions: what the caller gave.
            visible: what the caller gave.
            std: what the caller gave.
            clock: frames per second, and the time of the first.
            places: the name of what says where on the body points are, and numbers.
            exist: points that the body has; None where it has all.
            rest: fields that need no check.
        """
        kind = type(self).__name__
        positions, visible = checked_positions(kind, "positions", positions, "visible", visible)
        numbers = checked_indices(kind, *places, positions.shape[-2])
        fps, start_time = checked_clock(kind, *clock)
        if exist is not None:
            visible = visible & exist.to(visible.device)
            positions = positions.where(visible[..., None], 0.0)
        std, rms_std = checked_std(kind, std, visible, positions)
        self._set_fields(
            positions=positions, visible=visible, fps=fps, start_time=start_time, std=std,
            rms_std=rms_std, **rest,
        )  # fmt: skip
        return numbers

    def rigid_pairs(self, body: BodyModel) -> tuple[tuple[int, int], ...] | None:
        """Index pairs of points whose distance does not depend on the pose.

        None to derive them from `bones`.
        """
        del body

    @property
    def values(self) -> Tensor:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Positions of the points, frame of the recording, metres."""
        return self.positions

    @property
    def shown(self) -> Tensor:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Mask of the points that were seen."""
        return self.visible

    @property
    def weights(
        self,
    ) -> Float[Tensor, "*batch moments points"] | Bool[Tensor, "*b moments points"]:
        """Weight of each point: `rms_std` divided by the point's standard deviation.

        Zero where it was not visible.
        """
        if self.std is None or self.rms_std is None:
            return self.visible
        # made a tensor, since torch rounds number / tensor and tensor / tensor differently
        rms = self.std.new_tensor(self.rms_std)
        return (rms / self.std.where(self.visible, 1.0)).where(self.visible, 0.0)

    def expected(self, estimate: Estimate) -> tuple[Float[Tensor, "*batch seen points 3"], slice]:
        """Predicted points in the recording's frame, and the slice of frames that they cover.

        Points that are not placed in the world are moved, all of a moment alike, to where they
        explain most of what was measured.
        """
        points, seen = super().expected(estimate)
        if self.placed:
            return points, seen
        counted = self.weights[..., seen, :].to(points).square()[..., None]
        away = (counted * (self.positions[..., seen, :, :] - points)).sum(-2, keepdim=True)
        return points + away / counted.sum(-2, keepdim=True).clamp(min=1e-9), seen

    def point_model(self, points: Float[Tensor, "*batch moments points 3"]) -> PointModel:
        """Quadratic approximation of the energy near given points (recording's frame, metres)."""
        return quadratic_model(
            points, self.positions, self.weights, self.kernel, REFERENCE_FPS / self.fps
        )

    def energy(self, points: Float[Tensor, "*batch frames points 3"]) -> Float[Tensor, "*batch"]:
        """Energy ½ Σ kernel(w² |measured - predicted|²), scaled to 30 Hz; metres²."""
        return self.energy_of(self.positions - points, self.weights.to(points))

    def distances(self, points: Float[Tensor, "*batch frames points 3"]) -> Tensor:
        """Distances between measured and predicted points, metres."""
        return (self.positions - points).norm(dim=-1)

    def noise(self, guess: Motion, body: BodyModel, given: float | None = None) -> Noise:
        """Noise: the standard deviation of a coordinate, metres, as given or estimated from data.

        It is the one that is given, or the root mean square of those of the points, or estimated
        from the points' paths.
        """
        del guess, body
        found = given or self.rms_std or estimate_noise(self.positions, self.visible)
        return Noise(found, found)

    def robust_beyond(self: P, distance: float) -> P:
        """Return the sensor with Geman and McClure's robust kernel, of scale `distance` in metres.

        Where standard deviations are given, it is the distance of a point that has their root
        mean square; a point of twice that deviation may be twice as far away.
        """
        return self.derived(kernel=partial(geman_mcclure, sigma=distance))

    def start(self, body: BodyModel) -> Motion:
        """First guess of the motion from the data alone.

        The rest pose fitted to the torso, with limbs turned towards their points.
        """
        rest, bones = self.at_rest(body).to(self.positions), self.bones(body)
        start = rigid_start(
            body, rest, bones, self.positions, self.visible, fps=self.fps,
            start_time=self.start_time,
        )  # fmt: skip
        return with_limbs_towards_points(start, body, rest, bones, self.positions, self.visible)


def quadratic_model(
    points: Float[Tensor, "*batch moments points 3"],
    positions: Float[Tensor, "*batch moments points 3"],
    weights: Tensor,
    kernel: Callable[[Tensor], Tensor],
    rate: float,
) -> PointModel:
    """Second-order model of E = rate ½ Σ kernel(w² |p - observed|²) about points p."""
    away = points - positions
    slope = weights.to(points).square()
    value = slope * away.square().sum(-1)
    if kernel is not squared:
        with torch.enable_grad():
            variable = value.detach().requires_grad_()
            counted = kernel(variable)
            (by_square,) = torch.autograd.grad(counted.sum(), variable)
        value, slope = counted.detach(), by_square * slope
    slope = rate * slope
    identity = torch.eye(3, dtype=points.dtype, device=points.device)
    return PointModel(
        0.5 * rate * value.sum((-2, -1)),
        slope[..., None] * away,
        slope[..., None, None] * identity,
        isotropic=True,
    )

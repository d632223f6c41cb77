"""What joints and markers have in common: points with names, tracked in space."""

from abc import abstractmethod
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, ClassVar, TypeVar

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from observations.correspondences import joints_shown, told_joints
from observations.curvature import of_places
from observations.noise import estimate_noise
from observations.records.sensor import SensorRecord
from observations.start.rigid import limbs_towards, rigid_start
from observations.timing import (
    between_moments,
    moments_between,
    point_energy,
    point_residuals,
)
from recon.body.derivatives import CarriedPoints
from recon.body.landmarks import landmarks
from recon.body.model import BodyModel, PosedBody
from recon.core.camera import transform
from recon.core.motion import Motion
from recon.core.residuals import Noise, Residuals
from recon.core.robust import geman_mcclure
from recon.core.skeleton import JOINTS
from recon.method.protocols import REFERENCE_FPS, Estimate
from recon.method.quadratic import PointModel

OFFSET_UNIT = 0.05
"""Metres; offsets of keypoints in images are in this unit: they are seen in all frames and views
at once, so that a variable in metres would be stiff."""


def displaced(
    points: Float[Tensor, "*batch time points 3"],
    estimate: Estimate,
    bones: Sequence[int],
    rows: tuple[int, int] | None,
    unit: float = 1.0,
) -> Float[Tensor, "*batch time points 3"]:
    """Points of the model with their `Scene.offsets` added, which turn with their bones.

    Args:
        points: world, metres.
        estimate: the bones' orientations and the offsets.
        bones: of every point.
        rows: of the offsets, first and one past the last; None leaves the points where they are.
        unit: of the offsets, metres.
    """
    if rows is None:
        return points
    turns = estimate.body.orientations[..., list(bones), :, :]
    offsets = estimate.scene.offsets[..., None, slice(*rows), :, None]
    return points + unit * (turns @ offsets)[..., 0]


P = TypeVar("P", bound="TrackedPoints")


class TrackedPoints(SensorRecord):
    """Positions of points whose places on the body are known; an energy in metres²."""

    level: bool = True
    placed: bool = True
    """Whether positions are places in the world rather than relative to the body."""
    on_skin: ClassVar[bool]
    """Whether the points lie on the skin rather than being joints of the skeleton."""
    positions: Float[Tensor, "*batch moments points 3"]
    visible: Bool[Tensor, "*batch moments points"]
    std: Float[Tensor, "*batch moments points"] | None
    rms_std: float | None
    kernel: Callable[[Tensor], Tensor]
    offset_rows: tuple[int, int] | None

    @abstractmethod
    def on(self, posed: PosedBody) -> Float[Tensor, "*batch time points 3"]:
        """The points of a posed body, world, metres."""

    @abstractmethod
    def at_rest(self, body: BodyModel) -> Float[Tensor, "points 3"]:
        """The points of the average body in its rest pose, metres."""

    @abstractmethod
    def bones(self, body: BodyModel) -> tuple[int, ...]:
        """The body joint whose bone carries each point."""

    def rigid_pairs(self, body: BodyModel) -> tuple[tuple[int, int], ...] | None:
        """Pairs of points whose distance no pose changes; None where the bones alone tell them."""
        del body

    @abstractmethod
    def point_names(self, body: BodyModel) -> tuple[str, ...]:
        """Names of the points, for reports."""

    @property
    def places(self) -> Float[Tensor, "*batch moments points 3"]:
        """Positions of the points, frame of the recording, metres."""
        return self.positions

    @property
    def shown(self) -> Bool[Tensor, "*batch moments points"]:
        """Which points were seen."""
        return self.visible

    @property
    def weights(self) -> Float[Tensor, "*batch moments points"] | None:
        """`rms_std` over the standard deviation of every point; zero where it was not visible.

        None where no standard deviations are given.
        """
        if self.std is None or self.rms_std is None:
            return None
        # a quotient of tensors: that of a number and a tensor goes by way of the reciprocal
        rms = self.std.new_tensor(self.rms_std)
        return (rms / self.std.where(self.visible, 1.0)).where(self.visible, 0.0)

    def predict(self, estimate: Estimate) -> Float[Tensor, "*batch time points 3"]:
        """Positions of these points on the estimated body, in the world, metres."""
        points = self.on(estimate.body)
        if self.offset_rows is None:
            return points
        return displaced(points, estimate, self.bones(estimate.body.model), self.offset_rows)

    def __call__(self, estimate: Estimate) -> Float[Tensor, "*batch"]:
        """½ Σ kernel(w² |observed - predicted|²) over visible points, taken at 30 Hz.

        HuMoR section 6.5, joints3d and verts3d, with a weight w for every point.
        """
        return point_energy(
            estimate.scene.to_recording(self.predict(estimate)), estimate.motion,
            self.positions, self.visible,
            fps=self.fps, start_time=self.start_time, kernel=self.kernel, weights=self.weights,
            placed=self.placed,
        )  # fmt: skip

    def residuals(self, estimate: Estimate) -> Residuals:
        """Observed minus predicted position of every point at every moment, metres."""
        return point_residuals(
            estimate.scene.to_recording(self.predict(estimate)), estimate.motion,
            self.positions, self.visible, fps=self.fps, start_time=self.start_time,
            weights=self.weights, placed=self.placed,
        )  # fmt: skip

    def point_model(self, points: Float[Tensor, "*batch moments points 3"]) -> PointModel:
        """The energy about predicted points, frame of the recording, metres."""
        return of_places(
            points, self.positions, self.visible, self.kernel, self.weights,
            REFERENCE_FPS / self.fps,
        )  # fmt: skip

    @abstractmethod
    def on_bones(self, body: BodyModel, shape: Float[Tensor, " shape"]) -> CarriedPoints:
        """The points on a body of some shape, without offsets."""

    def carried(
        self, body: BodyModel, shape: Float[Tensor, " shape"], offsets: Float[Tensor, "rows 3"]
    ) -> CarriedPoints:
        """The points on a body of some shape; offsets as in `Scene.offsets`."""
        found = self.on_bones(body, shape)
        if self.offset_rows is None:
            return found
        return found.displaced(self.bones(body), offsets[slice(*self.offset_rows)])

    def noise(self, guess: Motion, body: BodyModel, given: float | None = None) -> Noise:
        """The standard deviation of a coordinate.

        It is the one that is given, or the root mean square of those of the points, or estimated
        from the points' paths.
        """
        del guess, body
        found = given or self.rms_std or estimate_noise(self.positions, self.visible)
        return Noise(found, found)

    def window(self: P, start: float, stop: float) -> P:
        """The part of the observation from one time to another, both included, in seconds."""
        clock = {"fps": self.fps, "start_time": self.start_time, "start": start, "stop": stop}
        positions, visible, first = moments_between(self.positions, self.visible, **clock)
        std = self.std
        if std is not None:
            std = moments_between(std[..., None], self.visible, **clock)[0][..., 0]
        return self.derived(positions=positions, visible=visible, std=std, start_time=first)

    def transformed(self: P, T_new_old: Float[np.ndarray, "4 4"]) -> P:
        """Points after a rigid transform of the frame that they are given in, metres."""
        T = torch.from_numpy(T_new_old).to(self.positions)
        positions = transform(T, self.positions).where(self.visible[..., None], 0.0)
        return self.derived(positions=positions)

    def robust_beyond(self: P, distance: float) -> P:
        """Points with Geman and McClure's kernel, whose scale is a distance in metres.

        Where standard deviations are given, it is the distance of a point that has their root
        mean square; a point of twice that deviation may be twice as far away.
        """
        return self.derived(kernel=partial(geman_mcclure, sigma=distance))

    def coarse(self: P, body: BodyModel, step: int = 2) -> P:
        """Every `step`-th moment; all of them where most are empty."""
        del body
        if 2 * int(self.visible.any(-1).sum()) < self.visible[..., 0].numel():
            return self
        every = (..., slice(None, None, step), slice(None))
        few: dict[str, Any] = {
            "positions": self.positions[..., ::step, :, :],
            "visible": self.visible[every],
            "std": None if self.std is None else self.std[every],
        }
        return self.derived(fps=self.fps / step, **few)

    def on_faster_clock(self: P, times: int) -> P:
        """Points on a clock that is so many times as fast, with empty moments in between."""
        axis = self.visible.ndim - 2

        def spread(values: Tensor) -> Tensor:
            return between_moments(values, axis, times)

        fields: dict[str, Any] = {
            "positions": spread(self.positions),
            "visible": spread(self.visible),
            "std": None if self.std is None else spread(self.std),
        }
        return self.derived(fps=self.fps * times, **fields)

    def start(self, body: BodyModel) -> Motion:
        """A first guess: the rest pose on the points of the torso, limbs towards their points."""
        rest, bones = self.at_rest(body).to(self.positions), self.bones(body)
        start = rigid_start(
            body, rest, bones, self.positions, self.visible, fps=self.fps,
            start_time=self.start_time,
        )  # fmt: skip
        return limbs_towards(start, body, rest, bones, self.positions, self.visible)

    def told_joints(self, body: BodyModel) -> Float[Tensor, "*batch 22"]:
        """Share of the moments in which the place of each joint is told by a visible point."""
        return told_joints(self.visible, self._shows(body))

    def shown_joints(self, estimate: Estimate) -> Bool[np.ndarray, "moments 22"]:
        """Joints of the first clip that a visible point tells the place of, at every moment."""
        return self.visible[0].cpu().numpy() @ self._shows(estimate.body.model)

    def _shows(self, body: BodyModel) -> Bool[np.ndarray, "points 22"]:
        rest = self.at_rest(body).double().cpu().numpy()
        return joints_shown(self.bones(body), rest, body)


Offset = tuple[float, float, float]
"""A vector in the frame of a bone, metres."""


class VertexPoints(TrackedPoints):
    """Points that are vertices of the body, or that its bones carry at known offsets from them."""

    on_skin: ClassVar[bool] = True
    vertices: tuple[int, ...]
    offsets: tuple[Offset, ...] | None = None
    """Constant offset of every point from its vertex, in the frame of the bone that moves it
    most, metres; None where the points are the vertices."""
    labels: tuple[str, ...] | None = None
    """What the recording calls every point; None where landmarks name them."""

    def on(self, posed: PosedBody) -> Float[Tensor, "*batch time points 3"]:
        """The points on a posed body, world, metres."""
        points = posed.points(torch.tensor(self.vertices, device=self.positions.device))
        if self.offsets is None:
            return points
        turns = posed.orientations[..., list(self.bones(posed.model)), :, :]
        return points + (turns @ points.new_tensor(self.offsets)[..., None])[..., 0]

    def on_bones(self, body: BodyModel, shape: Float[Tensor, " shape"]) -> CarriedPoints:
        """The points on a body of some shape."""
        vertices = torch.tensor(self.vertices, device=shape.device)
        identity = torch.eye(len(vertices), dtype=shape.dtype, device=shape.device)
        none = shape.new_zeros(len(vertices), len(JOINTS))
        found = CarriedPoints.create(body, shape, none, identity, vertices)
        if self.offsets is None:
            return found
        return found.displaced(self.bones(body), shape.new_tensor(self.offsets))

    def at_rest(self, body: BodyModel) -> Float[Tensor, "points 3"]:
        """The points on the average body in its rest pose, metres."""
        rest = body.template[list(self.vertices)]
        return rest if self.offsets is None else rest + rest.new_tensor(self.offsets)

    def bones(self, body: BodyModel) -> tuple[int, ...]:
        """The bone that moves each marker most."""
        return tuple(body.weights[list(self.vertices)].argmax(-1).tolist())

    def point_names(self, body: BodyModel) -> tuple[str, ...]:
        """Labels of the recording, or landmarks that points sit on, or numbers of vertices."""
        del body
        if self.labels is not None:
            return self.labels
        named = {vertex: name for name, vertex in landmarks().items()}
        return tuple(named.get(vertex, f"vertex {vertex}") for vertex in self.vertices)

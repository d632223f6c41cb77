"""The base class of sensors: data, their prediction from a posed body, and their energy."""

import dataclasses
import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, ClassVar, Literal, TypeVar

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from recon.body.model import BodyModel, PosedBody
from recon.core import rotations as so3
from recon.core.errors import ObservationError
from recon.core.motion import Motion
from recon.core.residuals import Noise, Residuals, Unit, squared
from recon.core.scene import Scene
from recon.core.struct import TensorStruct
from recon.method.protocols import REFERENCE_FPS, Estimate
from recon.method.timing import (
    at_observation_times,
    moment_numbers,
    padded,
    with_empty_frames_between,
)

if TYPE_CHECKING:
    from observations.depth import PointCloud
    from observations.keypoints2d import Keypoints2D
    from observations.points import TrackedPoints
    from recon.core.camera import Camera
else:  # at run time Any replaces these classes, so their modules need not be imported
    from typing import Any as Camera
    from typing import Any as Keypoints2D
    from typing import Any as PointCloud
    from typing import Any as TrackedPoints

R = TypeVar("R", bound="Sensor")
UPRIGHT = (math.pi / 2, 0.0, 0.0)
"""Rotation vector from the rest pose (y up, facing z) to the recording (z up, facing -y)."""


class Sensor(TensorStruct):
    """Data of one sensor, with the energy ½ Σ kernel(w² |values - predicted|²) of an estimate.

    A sensor of your own is a frozen dataclass that derives from this class. It has the fields
    `values`, `shown`, `fps`, `start_time` and `ground_known`, and those that `predict` needs; it
    says `typical_noise` and writes `predict`. All other methods have a default, which a sensor
    may override. Tensors have a leading axis of clips, or none for one clip.
    """

    unit: ClassVar[Unit] = "metres"
    """The unit of its residuals."""
    vectors: ClassVar[Literal["points", "directions", "numbers"]] = "points"
    """What `values` are in space, and so what another frame makes of them: points are turned and
    moved, directions are turned, numbers stay as they are."""
    typical_noise: ClassVar[tuple[float, float]]
    """Standard deviation of a residual's coordinate where nobody gives one: in `unit`, and what
    that is at the body in metres."""
    timed: ClassVar[tuple[str, ...]] = ("values", "shown")
    """Names of the fields that have an axis of frames, the first one after that of clips; where
    there are no data, they are zero, and `shown` is then false."""
    sees: ClassVar[Literal["points", "image", "surface"] | None] = None
    """By which first guesses and checks the data are taken: as those of named points in space, of
    their images, or of points anywhere on the surface; None for others, as those of a sensor of
    your own."""

    values: Float[Tensor, "*batch frames points dims"]
    """What was measured, in `unit`, in the frame of the recording; zero where not shown."""
    shown: Bool[Tensor, "*batch frames points"]
    """Whether a point was measured in a frame."""
    fps: float
    """Frames per second of the data."""
    start_time: float
    """Time of the first frame, seconds of the clock that all sensors of a clip share."""
    ground_known: bool
    """Whether z = 0 of the recording's frame is the ground."""
    level: bool | None = None
    """Whether the z axis of the recording's frame points up even where its ground is not known;
    None where the sensor says nothing of it. See `frame_is_level`."""
    kernel: Callable[..., Tensor] = staticmethod(squared)
    """Robust kernel of squared residuals; see `recon.core.residuals`."""
    ground_seen: bool = False
    """Whether z = 0 of the recording was laid on a plane that the sensor sees."""

    def predict(self, body: PosedBody) -> Float[Tensor, "*batch time points dims"]:
        """Return the values that the sensor would measure of a posed body, in the world."""
        raise NotImplementedError(
            f"{type(self).__name__}: define predict(body): what the sensor would measure of a "
            "posed body, axes (clips, time, points, dims)"
        )

    def predicted(self, estimate: Estimate) -> Float[Tensor, "*batch time points dims"]:
        """Return the predicted values of an estimate, with its scene's offsets, in the world."""
        return self.predict(estimate.body)

    def expected(
        self, estimate: Estimate
    ) -> tuple[Float[Tensor, "*batch seen points dims"], slice]:
        """Return predicted values in the recording's frame, and the frames of data they match."""
        values = self.predicted(estimate)
        if self.vectors == "points":
            values = estimate.scene.to_recording(values)
        elif self.vectors == "directions":
            values = estimate.scene.to_recording_directions(values)
        return self.at_own_times(values, estimate.motion)

    def at_own_times(
        self, values: Float[Tensor, "*batch time points dims"], motion: Motion
    ) -> tuple[Float[Tensor, "*batch seen points dims"], slice]:
        """Interpolate a motion's values to the frames of data that it covers; return both."""
        return at_observation_times(
            values, motion, fps=self.fps, start_time=self.start_time, moments=self.moments
        )

    def check(self) -> None:
        """Refuse a plug-in's sensor whose fields are missing or have shapes that do not match.

        Raises:
            ObservationError: naming the missing fields, or the shapes.
        """
        me: Any = self
        name, fields = type(self).__name__, {field.name for field in dataclasses.fields(me)}
        if missing := {"fps", "start_time", "ground_known", *self.timed} - fields:
            raise ObservationError(
                f"{name}: expected a dataclass with the fields {', '.join(sorted(missing))}, "
                "which windows of long recordings change; write them as fields with annotations"
            )
        for field in ("values", "shown"):
            tensor = getattr(self, field)
            if not isinstance(tensor, Tensor) or tensor.ndim < 2 + (field == "values"):
                got = f" of {tuple(tensor.shape)}" if hasattr(tensor, "shape") else ""
                dims = ", dims" if field == "values" else ""
                raise ObservationError(
                    f"{name}.{field}: expected a tensor of torch with axes (frames, points{dims}) "
                    f"and any axes of clips before them, got {type(tensor).__name__}{got}"
                )
        if self.shown.shape != self.values.shape[:-1] or self.shown.dtype != torch.bool:
            raise ObservationError(
                f"{name}.shown: expected booleans of {tuple(self.values.shape[:-1])}, values "
                f"without their last axis, got {self.shown.dtype} of {tuple(self.shown.shape)}"
            )
        if self.vectors != "numbers" and self.values.shape[-1] != 3:
            raise ObservationError(
                f"{name}.values: expected three coordinates, got {self.values.shape[-1]}; write "
                'vectors = "numbers" where they are no vectors in space'
            )
        if not bool(self.values.isfinite().all()):
            raise ObservationError(
                f"{name}.values: expected finite numbers, got nan or inf; store zero where "
                "nothing was measured, and False in shown"
            )

    def residuals(self, estimate: Estimate) -> Residuals:
        """Return measured minus predicted values of every frame and point, in `unit`."""
        expected, seen = self.expected(estimate)
        measured = self.values[..., seen, :, :]
        if expected.shape[-3:] != measured.shape[-3:]:
            raise ObservationError(
                f"{type(self).__name__}.predict: expected axes (..., frames, points, dims) of "
                f"{tuple(measured.shape[-3:])}, those of values, got {tuple(expected.shape[-3:])}"
            )
        return padded(
            measured - expected, self.weights[..., seen, :], seen, self.moments, self.unit
        )

    def __call__(self, estimate: Estimate) -> Float[Tensor, "*batch"]:
        """Return ½ Σ kernel(w² |measured - predicted|²) in `unit`², scaled to 30 frames/s."""
        found = self.residuals(estimate)
        return self.energy_of(found.values, found.weights)

    def energy_of(self, away: Tensor, weights: Tensor) -> Float[Tensor, "*batch"]:
        """Return ½ Σ kernel(w² |away|²) over all frames, in `unit`², scaled to 30 frames/s."""
        size = weights.square() * away.square().sum(-1)
        return 0.5 * self.kernel(size).sum((-2, -1)) * (REFERENCE_FPS / self.fps)

    @property
    def weights(self) -> Tensor:
        """Weight of every point's residual, (clips, frames, points); zero where not shown."""
        return self.shown

    @property
    def kind(self) -> str:
        """The sensor's name in reports."""
        return type(self).__name__.lower()

    @property
    def clips(self) -> tuple[int, ...]:
        """Sizes of the leading axes of the data: (clips,), or () for one clip without the axis."""
        return tuple(self.shown.shape[:-2])

    @property
    def moments(self) -> int:
        """Number of frames of the data."""
        return self.shown.shape[-2]

    @property
    def duration(self) -> float:
        """Time from the first frame to the last one, seconds."""
        return (self.moments - 1) / self.fps

    @property
    def named(self) -> TrackedPoints | None:
        """The sensor itself if it measures named points in space, else None."""
        return self._self_if_seeing("points")

    @property
    def view(self) -> Keypoints2D | None:
        """The sensor itself if it measures named points in a camera's image, else None."""
        return self._self_if_seeing("image")

    @property
    def cloud(self) -> PointCloud | None:
        """The sensor itself if it measures points anywhere on the body's surface, else None."""
        return self._self_if_seeing("surface")

    def _self_if_seeing(self, what: str) -> Any:
        return self if self.sees == what else None

    @property
    def places(self) -> Float[Tensor, "*batch frames points 3"] | None:
        """Measured points in the recording's frame, metres; None for other measurements."""
        return self.values if self.sees in ("points", "surface") else None

    @property
    def unposed(self) -> bool:
        """Whether the sensor is a fixed camera of unknown pose, which is stored as the identity.

        No real camera has this pose: it would lie on the ground and look straight up.
        """
        if self._camera is None:
            return False
        poses = self._camera.T_camera_world
        return bool((poses == torch.eye(4).to(poses)).all())

    @property
    def _camera(self) -> Camera | None:
        return getattr(self, "camera", None)

    def point_names(self, body: BodyModel) -> tuple[str, ...]:
        """Return the names of the points, for reports; empty for unordered points."""
        del body
        return ()

    def joints_located(self, body: BodyModel) -> Bool[Tensor, "*batch frames 22"] | None:
        """Return a mask of the joints that the data of each frame locate.

        The default, None, means unknown.
        """
        del body

    def shown_joints(self, estimate: Estimate) -> Bool[np.ndarray, "frames 22"]:
        """Return a mask of the joints that each frame of the first clip's data locates."""
        return np.zeros((self.moments, estimate.body.joints.shape[-2]), dtype=bool)

    def noise(self, guess: Motion, body: BodyModel, given: float | None = None) -> Noise:
        """Return the standard deviation of the data: as given, in `unit`, or the typical one."""
        del guess, body
        own, metres = self.typical_noise
        return Noise(own, metres) if given is None else Noise(given, given * metres / own)

    def start(self, body: BodyModel) -> Motion:
        """Return a first guess of the motion: a person who stands at the origin all the time."""
        return standing_motion(
            body, self.clips, self.moments, fps=self.fps, start_time=self.start_time
        )

    def with_constants_of(self: R, scene: Scene) -> R:
        """Return the sensor with the scene's offsets and lens inserted as known constants."""
        del scene
        return self

    def window(self: R, start: float, stop: float) -> R:
        """Return the data from `start` to `stop` (seconds, both included) at unchanged times."""
        clock = {"fps": self.fps, "start_time": self.start_time, "start": start, "stop": stop}
        numbers = moment_numbers(**clock)
        first: dict[str, Any] = {"start_time": self.start_time + numbers.start / self.fps}
        return self.derived(**first, **self.fields_at(numbers))

    def coarse(self: R, body: BodyModel, step: int = 2) -> R:
        """Return the data of every `step`-th frame, or of all frames if most are empty."""
        del body
        if 2 * int(self.shown.any(-1).sum()) < self.shown[..., 0].numel():
            return self
        fewer: dict[str, Any] = {"fps": self.fps / step}
        return self.derived(**fewer, **self.fields_at(range(0, self.moments, step)))

    def with_at_most_points(self: R, most: int) -> R:
        """Return the data with at most `most` points per frame, if its points are unordered."""
        del most
        return self

    def on_faster_clock(self: R, times: int) -> R:
        """Return the data at `times` times the frame rate, with empty frames in between.

        Data of a camera that moves keep their clock.
        """
        if self._camera is not None and self._camera.T_camera_world.shape[-3] > 1:
            return self
        axis = len(self.clips)
        faster: dict[str, Any] = {"fps": self.fps * times}
        return self.derived(
            **faster,
            **self.map_frames(lambda tensor: with_empty_frames_between(tensor, axis, times)),
        )

    def transformed(self: R, T_new_old: Float[np.ndarray, "4 4"]) -> R:
        """Return the data, with a camera if any, in another frame of coordinates (metres)."""
        if self.sees is None and type(self).predict is Sensor.predict:  # `predict` is not defined
            raise ObservationError(
                f"{type(self).__name__} cannot be transformed to another coordinate frame: write "
                "a method transformed(T_new_old), or fit it with a ground that is known"
            )
        camera = None if self._camera is None else self._camera.moved(T_new_old)
        if self.vectors == "numbers":
            return self.derived(camera=camera)
        T = torch.from_numpy(T_new_old).to(self.values)
        points = self.vectors == "points"
        values = so3.transform(T, self.values) if points else self.values @ T[:3, :3].mT
        name = self.timed[0]
        return self.derived(**{name: values.where(self.shown[..., None], 0.0)}, camera=camera)

    def robust_beyond(self: R, distance: float) -> R:
        """Return a sensor of named points with a robust kernel beyond `distance` metres."""
        del distance
        return self

    def fields_at(self, numbers: range) -> dict[str, Any]:
        """Return all fields with an axis of frames, at frames `numbers`; zero outside the data."""
        axis = len(self.clips)
        number = torch.tensor(numbers, dtype=torch.long)
        exists = (number >= 0) & (number < self.moments)

        def at_numbers(tensor: Tensor) -> Tensor:
            there = number.clamp(0, self.moments - 1).to(tensor.device)
            shape = (-1, *(1,) * (tensor.ndim - axis - 1))
            return tensor.index_select(axis, there) * exists.to(tensor.device).reshape(shape)

        camera = {} if self._camera is None else {"camera": self._camera.at(numbers)}
        return self.map_frames(at_numbers) | camera

    def map_frames(self, function: Callable[[Tensor], Tensor]) -> dict[str, Any]:
        """Apply a function to every field that has an axis of frames; return these fields."""
        found: dict[str, Any] = {}
        for name in self.timed:
            value = getattr(self, name)
            if isinstance(value, TensorStruct):
                found[name] = value.map(function)
            elif value is not None:
                found[name] = function(value)
        return found


def standing_motion(
    body: BodyModel, clips: Sequence[int], moments: int, *, fps: float, start_time: float
) -> Motion:
    """Return a motion of the average body standing still in its rest pose over the origin.

    Its soles are at z = 0, and it faces the negative y axis of the world.
    """
    rest = body.joint_template
    turn = so3.exp(rest.new_tensor(UPRIGHT))
    placed = (body.template - rest[0]) @ turn.T
    place = rest.new_zeros(3)
    place[2] = -placed[:, 2].min()
    rotations = torch.eye(3).to(rest).repeat(*clips, moments, len(rest), 1, 1)
    rotations[..., 0, :, :] = turn
    return Motion.create(
        (place - rest[0]).expand(*clips, moments, 3).clone(), rotations,
        rest.new_zeros(*clips, body.shape_size), fps, start_time=start_time,
    )  # fmt: skip


def views_of(sensors: Sequence[Sensor]) -> list[Keypoints2D]:
    """Return those of the sensors that measure named points in images."""
    return [view for one in sensors if (view := one.view)]


def frame_is_level(sensors: Sequence[Sensor]) -> bool:
    """Return whether the z axis of the frame that the sensors share points up.

    It does if some sensors know that and none of the others denies it.
    """
    said = [one.level for one in sensors if one.level is not None]
    return bool(said) and all(said)


def unposed_camera(sensors: Sequence[Sensor]) -> Float[np.ndarray, "4 4"] | None:
    """Return the first pose (T_recording_camera) of the first camera of unknown ground."""
    for one in sorted(sensors, key=lambda one: one.view is None):
        camera = getattr(one, "camera", None)
        if camera is not None and not one.ground_known:
            return camera.T_world_camera[0, 0].double().cpu().numpy()
    return None

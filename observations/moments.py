"""Single frames of sensors that a stream accepts: named points and calibrated views."""

from typing import Any

import torch
from jaxtyping import Bool
from torch import Tensor

from observations.keypoints2d import Keypoints2D
from observations.points import TrackedPoints
from recon.core.arrays import Numbers, float_tensor
from recon.core.errors import ObservationError

Tracker = TrackedPoints | Keypoints2D
"""A sensor whose points have names: in space, or in the image of a calibrated camera."""


def checked_for_stream(given: Any) -> Tracker:
    """Check that a stream can use a sensor; remove its clip axis and make it single precision.

    Raises:
        ObservationError: when it has no named points, its camera moves or has no pose, or the
            ground is not known.
    """
    if not isinstance(given, TrackedPoints | Keypoints2D):
        raise ObservationError(
            "a stream takes recon.Joints3D, Markers3D, Keypoints3D and Keypoints2D, got "
            f"{type(given).__name__}; fit other sensors with recon.fit"
        )
    if given.clips not in ((), (1,)):
        raise ObservationError(f"expected one clip of one person, got leading axes {given.clips}")
    one = given[0] if given.clips else given
    if isinstance(one, Keypoints2D):
        if one.unposed:
            raise ObservationError(
                "a stream needs cameras whose pose is known: give Camera.T_camera_world; fit a "
                "camera of unknown pose with recon.fit, which finds the ground"
            )
        if one.camera.T_camera_world.shape[-3] > 1:
            raise ObservationError("a stream needs cameras that stand still, got one that moves")
    elif one.std is not None:
        raise ObservationError(
            "a stream weights all points equally: leave out std, and give recon.Stream the noise"
        )
    if not one.ground_known:
        raise ObservationError(
            "a stream needs a known ground: make z = 0 the floor, and give ground_known=True"
        )
    return one.to(dtype=torch.float32, device="cpu")


def frame_from_array(sensor: Tracker, array: Numbers) -> Tracker:
    """Make one new frame of a sensor from an array of points, with all checks of a sensor.

    Args:
        sensor: that the points are of.
        array: (points, 3), metres, or u, v and confidence; NaN where nothing was seen.

    Raises:
        ObservationError: when there are other points.
    """
    values = float_tensor(array, "push").to(torch.float32).cpu()
    count = len(sensor.point_ids)
    if values.shape != (count, 3):
        raise ObservationError(
            f"the points changed: expected an array of shape ({count}, 3), got "
            f"{tuple(values.shape)}; write NaN for points that are not seen"
        )
    seen = values.isfinite().all(-1)
    values = values.where(seen[:, None], 0.0)[None]
    if isinstance(sensor, Keypoints2D):
        return sensor.replace(pixels=values[..., :2], confidence=values[..., 2])
    return sensor.replace(positions=values, visible=seen[None])


def frames_between(sensor: Tracker, start: int, stop: int) -> Tracker:
    """Return the frames `start` to `stop` - 1 of a sensor; `start_time` does not change."""
    return sensor.derived(**sensor.map_frames(lambda tensor: tensor[start:stop]))


def points_coincide(moment: Tracker) -> bool:
    """Whether most visible points coincide, as when a tracker has lost the person."""
    places = moment.pixels if isinstance(moment, Keypoints2D) else moment.positions
    shown = places[moment.shown]
    return 2 * len(shown.unique(dim=0)) < len(shown)


def append_frames(before: Tracker, after: Tracker) -> Tracker:
    """Append the frames of `after` to those of `before`, both of one sensor."""
    later = iter(after.map_frames(lambda tensor: tensor).values())
    return before.derived(**before.map_frames(lambda tensor: torch.cat((tensor, next(later)))))


def replace_frame(sensor: Tracker, row: int, moment: Tracker) -> Tracker:
    """Replace frame `row` of a sensor by a one-frame sensor; append it if `row` is the end."""
    later = frames_between(sensor, row + 1, sensor.moments)
    return append_frames(
        append_frames(frames_between(sensor, 0, row), frames_between(moment, 0, 1)), later
    )


def with_points_hidden(
    sensor: Tracker, bad: Bool[Tensor, "moments points"] | None = None
) -> Tracker:
    """Return the sensor with points in `bad` marked as not seen; None hides all points."""
    bad = torch.ones_like(sensor.shown) if bad is None else bad
    kept = sensor.map_frames(
        lambda x: x.masked_fill(bad if x.ndim == bad.ndim else bad[..., None], 0)
    )
    return sensor.derived(**kept)

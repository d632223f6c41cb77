"""Checks of an observation's arrays when it is constructed; fits do not repeat them.

Arrays become tensors, what is not visible becomes zero, and what cannot be an observation is
refused by name. Nothing here runs while a fit minimises: records that the library derives from
checked ones (`TensorStruct.map`, indexing, `derived`) are not checked again.
"""

from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from recon.core.arrays import (
    bool_tensor,
    finite_number,
    float_tensor,
    index_of_first_true,
    index_tuple,
    positive_number,
    require_shape,
)
from recon.core.errors import ObservationError, UnitsError
from recon.core.limits import FRAME_RATE, POINT_DEVIATION, POSITION, TIME

if TYPE_CHECKING:
    from recon.core.camera import Camera
else:  # at run time Any replaces Camera, whose module need not be imported
    from typing import Any as Camera

FARTHEST = 5.0
"""Metres that the points of one moment lie from their middle, the median over points and moments.
A person's lie half a metre from it; in centimetres they would lie 50 from it."""
_MOMENTS, _POINTS = 64, 256
"""How many of them are enough to tell a unit."""


def checked_positions(
    kind: str, name: str, positions: Any, mask_name: str, mask: Any
) -> tuple[Float[Tensor, "*batch moments points 3"], Bool[Tensor, "*batch moments points"]]:
    """Check a sensor's positions and mask; return them as tensors, zero where not visible.

    Args:
        kind: the observation's class, for messages.
        name: of the positions.
        positions: (..., moments, points, 3).
        mask_name: of the mask.
        mask: (..., moments, points), true where a point was seen.

    Raises:
        ValueError: for other shapes, NaN or infinity where visible, and what are no metres.
    """
    hidden = masked_points(positions)
    positions = float_tensor(positions, f"{kind}.{name}")
    require_shape(positions, f"{kind}.{name}", ("moments", "points", 3))
    visible = bool_tensor(mask, f"{kind}.{mask_name}").to(positions.device)
    check_mask_shape(kind, name, positions, mask_name, visible)
    visible = visible & ~hidden
    positions = hidden_as_zero(kind, name, positions, mask_name, visible)
    POSITION.check(positions.detach().cpu(), kind, name)
    refuse_other_units(kind, name, positions.detach(), visible)
    return positions, visible


def checked_std(
    kind: str, std: Any, visible: Bool[Tensor, "*batch moments points"], like: Tensor
) -> tuple[Float[Tensor, "*batch moments points"] | None, float | None]:
    """Check standard deviations of points; return them and their root mean square.

    Args:
        kind: the observation's class, for messages.
        std: of every coordinate, metres; of a shape that broadcasts to (moments, points). None
            where nobody knows it.
        visible: which points were seen; the mean is over these.
        like: a tensor of the wanted precision and device.

    Raises:
        ValueError: for other shapes, and for what is no standard deviation where visible.
    """
    if std is None:
        return None, None
    values = float_tensor(std, f"{kind}.std").to(like)
    try:
        values = values.broadcast_to(visible.shape)
    except RuntimeError:
        raise ObservationError(
            f"{kind}.std: expected a shape that broadcasts to {tuple(visible.shape)}, one number "
            "for all, (points), (moments, 1) or (moments, points); got "
            f"{tuple(values.shape)}"
        ) from None
    if not bool(visible.any()):
        return None, None
    POINT_DEVIATION.check(values.detach().cpu(), kind, "std", seen=visible.cpu())
    present = values[visible].detach().double()
    # dividing by the largest first makes the root mean square of equal numbers exact
    mean = present.max() * (present / present.max()).square().mean().sqrt()
    return values.where(visible, 0.0), float(mean)


def masked_points(values: Any) -> Tensor:
    """Mask of points that a `numpy.ma` masked array masks; a single False for other arrays."""
    if not isinstance(values, np.ma.MaskedArray):
        return torch.tensor(False)
    return torch.from_numpy(np.ma.getmaskarray(values).any(-1))


def checked_clock(kind: str, fps: Any, start_time: Any) -> tuple[float, float]:
    """Check the frame rate (Hz) and the time of the first frame (seconds); return both.

    Raises:
        ValueError: when they are no numbers or out of range.
    """
    fps, start_time = (
        positive_number(fps, f"{kind}.fps"),
        finite_number(start_time, f"{kind}.start_time"),
    )
    FRAME_RATE.check(fps, kind, "fps")
    TIME.check(start_time, kind, "start_time")
    return fps, start_time


def checked_indices(kind: str, name: str, places: Any, points: int) -> tuple[int, ...]:
    """Check that there is one joint or vertex index per point; return the indices.

    Raises:
        ValueError: when these are no whole numbers, or not as many as there are points.
    """
    places = index_tuple(places, f"{kind}.{name}")
    if len(places) != points:
        raise ObservationError(
            f"{kind}.{name}: expected one entry for each of the {points} points, got {len(places)}"
        )
    return places


def camera_of_view(kind: str, camera: Camera, values: Tensor) -> Camera:
    """Check a view's camera; give it the keypoints' leading axes if it has none.

    Raises:
        ValueError: when it has a distorting lens, or belongs to another number of clips.
    """
    if camera.distortion is not None:
        raise ObservationError(
            f"{kind}.camera: expected a camera without distortion, got coefficients; undistort "
            "the pixels (cv2.undistortPoints, P=camera_matrix), and leave the coefficients out"
        )
    leading = values.ndim - 2
    lengthened = camera.map(
        lambda t: t.reshape((1,) * max(leading - t.ndim + 2, 0) + tuple(t.shape))
    )
    for name, tensor in lengthened.tensors().items():
        clips = tensor.shape[: leading - 1]
        fits = tensor.ndim == leading + 2 and all(
            have in (1, want) for have, want in zip(clips, values.shape, strict=False)
        )
        if not fits:
            raise ObservationError(
                f"{kind}.camera.{name}: expected leading axes (clips, 1) or (clips, moments) of "
                f"{tuple(values.shape[:-2])}, got the shape {tuple(tensor.shape)}"
            )
    return lengthened


def check_mask_shape(kind: str, name: str, values: Tensor, mask_name: str, mask: Tensor) -> None:
    """Refuse a mask whose axes differ from those of the points, and arrays without any point."""
    if mask.shape != values.shape[:-1]:
        raise ObservationError(
            f"{kind}.{mask_name}: expected the shape {tuple(values.shape[:-1])}, that of {name} "
            f"without its last axis; got {tuple(mask.shape)}"
        )
    if values.numel() == 0:
        raise ObservationError(
            f"{kind}.{name}: expected at least one clip, moment and point, got the shape "
            f"{tuple(values.shape)}"
        )


def hidden_as_zero(
    kind: str, name: str, values: Tensor, mask_name: str, visible: Tensor
) -> Tensor:
    """Return values set to zero where not visible; refuse NaN and infinity elsewhere."""
    bad = visible & ~values.isfinite().all(-1)
    if bool(bad.any()):
        raise ObservationError(
            f"{kind}.{name}: expected finite numbers where {mask_name} says that a point was "
            f"seen, got NaN or infinity in {int(bad.sum())} places, the first at "
            f"{name}{index_of_first_true(bad)}; mark missing points in {mask_name}"
        )
    return values if bool(visible.all()) else values.where(visible[..., None], 0.0)


def refuse_other_units(kind: str, name: str, positions: Tensor, visible: Tensor) -> None:
    """Refuse positions that lie farther apart than a person's size in metres allows."""
    moments = slice(None, None, max(1, positions.shape[-3] // _MOMENTS))
    points = slice(None, None, max(1, positions.shape[-2] // _POINTS))
    some, seen = positions[..., moments, points, :], visible[..., moments, points]
    some = some.where(seen[..., None], torch.nan)
    middle = some.nanmedian(-2, keepdim=True).values
    away = (some - middle).norm(dim=-1).flatten(-2).nanmedian(-1).values
    if bool((away > FARTHEST).any()):
        far = float(away[away > FARTHEST].max())
        raise UnitsError(
            f"{kind}.{name}: expected metres, but the points of one moment lie {far:.3g} from "
            "their median, and those of a person about half a metre; divide millimetres by 1000, "
            "centimetres by 100"
        )

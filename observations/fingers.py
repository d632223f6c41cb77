"""Separates a sensor's points of the hands from its points of the body, and checks them."""

from collections.abc import Sequence
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from recon.core.arrays import bool_tensor, float_tensor
from recon.core.errors import ObservationError
from recon.core.fingers import FINGER_POINTS, HANDS
from recon.core.layouts import keypoint_names

_OPENXR = 26
_FROM_OPENXR = (1, *range(2, 6), *range(7, 11), *range(12, 16), *range(17, 21), *range(22, 26))
"""Wrist, and four joints of each finger, thumb first, among the joints of a hand of OpenXR, which
begin with the palm and give every other finger a metacarpal (XrHandJointEXT)."""


def body_points_only(names: Sequence[str]) -> bool:
    """Whether none of the keypoint names is a point of a hand (`FINGER_POINTS`)."""
    return not set(FINGER_POINTS) & set(names)


def split_off_fingers(
    points: Any, positions: Any, visible: Any, std: Any
) -> tuple[Any, Any, Any, Any, Float[Tensor, "*batch moments 42 4"]]:
    """Split a sensor's points into body points and hand points with their visibility.

    Args:
        points: a layout with the ending `+hands`, or names.
        positions: (..., moments, points, 3), metres.
        visible: (..., moments, points).
        std: of the points, or None.
    """
    layout = points.removesuffix(HANDS) if isinstance(points, str) else None
    names = tuple(points) if layout is None else (*keypoint_names(layout), *FINGER_POINTS)
    positions, visible = (
        float_tensor(positions, "Keypoints3D.positions"),
        bool_tensor(visible, "Keypoints3D.visible"),
    )
    if positions.shape[-2] != len(names) or visible.shape != positions.shape[:-1]:
        raise ObservationError(
            f"Keypoints3D: expected {len(names)} points, one per name; got positions "
            f"{tuple(positions.shape)} and visible {tuple(visible.shape)}"
        )
    body = [k for k, name in enumerate(names) if name not in FINGER_POINTS]
    if isinstance(std, Tensor) or hasattr(std, "shape"):
        std = float_tensor(std, "Keypoints3D.std")
        std = std[..., body] if std.shape[-1] == len(names) else std
    out = positions.new_zeros(*visible.shape[:-1], len(FINGER_POINTS), 4)
    for k, name in enumerate(names):
        if name in FINGER_POINTS:
            place = FINGER_POINTS.index(name)
            out[..., place, :3] = positions[..., k, :].nan_to_num()
            out[..., place, 3] = visible[..., k]
    kept = layout or tuple(names[k] for k in body)
    return kept, positions[..., body, :], visible[..., body], std, out


def checked_fingers(fingers: Any, like: Any, numbers: int) -> Float[Tensor, "*batch moments 42 n"]:
    """Check points of hands, whose last number is a confidence; those of confidence 0 become zero.

    Args:
        fingers: (..., moments, 42, numbers), NaN where not seen; or 52 points, 26 of each hand in
            the order of OpenXR (XR_EXT_hand_tracking), the palm and metacarpals of which are
            left out.
        like: values of the body's points, with the same axes of moments.
        numbers: coordinates and the confidence.

    Raises:
        ObservationError: for other shapes, or infinite numbers where the confidence is above 0.
    """
    found = float_tensor(fingers, "fingers")
    if found.ndim >= 2 and found.shape[-2] == 2 * _OPENXR:
        found = found[..., [*_FROM_OPENXR, *(_OPENXR + k for k in _FROM_OPENXR)], :]
    wanted = (*tuple(like.shape[:-2]), len(FINGER_POINTS), numbers)
    if found.shape != wanted:
        raise ObservationError(
            f"fingers: expected shape {wanted}: {len(FINGER_POINTS)} points (or OpenXR's "
            f"{2 * _OPENXR}), the left hand's first, each coordinates and a confidence; got "
            f"{tuple(found.shape)}"
        )
    found = torch.where(found[..., -1:] > 0, found, 0.0)
    if not bool(found.isfinite().all()):
        raise ObservationError(
            "fingers: expected finite coordinates where the confidence is above 0, got NaN or inf"
        )
    return found

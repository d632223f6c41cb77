"""Converts and checks arrays and numbers that users pass to the library."""

from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from recon.core.errors import ReconError
from recon.core.limits import FRAME_RATE

Numbers = Tensor | np.ndarray | Sequence[Any]
"""Arrays that users give: a tensor, an array of numpy, or nested lists."""


@lru_cache(maxsize=64)
def cached_constant(
    numbers: tuple[int, ...] | tuple[float, ...] | tuple[tuple[float, ...], ...],
    device: torch.device,
    dtype: torch.dtype = torch.long,
) -> Tensor:
    """Return a tensor of constants that is cached per device; callers must not change it.

    Creating it anew in every evaluation of an objective would make a GPU wait for the host.
    """
    with torch.inference_mode(False):  # autograd refuses inference tensors
        return torch.tensor(numbers, device=device, dtype=dtype)


def float_tensor(values: Any, name: str) -> Tensor:
    """Convert an array, list or tensor of real numbers to a detached floating-point tensor.

    Arrays and lists become single precision, and NaN where an array of `numpy.ma` is masked.
    Tensors keep their device and, where it is single or double, their precision; derivatives do
    not go through them.

    Raises:
        ValueError: when these are no real numbers.
    """
    if isinstance(values, Tensor):
        if values.layout != torch.strided or values.is_meta:
            kind = "meta" if values.is_meta else values.layout
            raise ReconError(f"{name}: expected a dense tensor with values, got one of {kind}")
        values = values.detach().clone() if values.is_inference() else values.detach()
        if values.dtype in (torch.float32, torch.float64):
            return values
        if values.is_complex():
            raise ReconError(f"{name}: expected real numbers, got {values.dtype}")
        return values.float()
    if isinstance(values, np.ma.MaskedArray):
        values = np.ma.filled(values.astype(float), np.nan)
    array = _as_array(values, name)
    if array.dtype.kind not in "fiub":
        raise ReconError(f"{name}: expected an array of numbers, got {_type_text(values, array)}")
    with np.errstate(over="ignore"):  # too large numbers become infinite, and are refused later
        return torch.from_numpy(np.array(array, np.float32, order="C"))


def geometries_given(given: Any) -> tuple[Any, ...]:
    """Return an argument as a tuple of Open3D geometries, one per frame; () if it is no geometry.

    They are recognised by their attributes. A depth image is a pair (image, lens).
    """
    pair = isinstance(given, tuple) and hasattr(given[-1] if given else None, "intrinsic_matrix")
    several = tuple(given) if isinstance(given, list | tuple) and not pair else (given,)
    return several if all(map(is_geometry, several)) else ()


def is_geometry(given: Any) -> bool:
    """Whether an object is an Open3D cloud or mesh, or a pair of depth image and lens."""
    if isinstance(given, tuple) and len(given) == 2 and hasattr(given[1], "intrinsic_matrix"):
        return hasattr(given[0], "depth")
    if hasattr(given, "motion") or hasattr(given, "fps"):  # recon's results are no geometries
        return False
    return any(hasattr(given, name) for name in ("points", "vertices", "point", "vertex", "depth"))


def bool_tensor(values: Any, name: str) -> Tensor:
    """Convert a mask (booleans, or numbers 0 and 1) to a boolean tensor.

    Raises:
        ValueError: when there are other values.
    """
    if isinstance(values, Tensor) and values.dtype == torch.bool:
        return values
    if not isinstance(values, Tensor):
        array = _as_array(values, name)
        if array.dtype.kind not in "fiub":
            raise ReconError(f"{name}: expected true and false, got {_type_text(values, array)}")
        values = torch.from_numpy(np.array(array, order="C"))
    if not bool(((values == 0) | (values == 1)).all()):
        raise ReconError(
            f"{name}: expected true and false or 1 and 0, got other numbers; compare "
            "confidences with a threshold"
        )
    return values.bool()


def index_tuple(values: Any, name: str) -> tuple[int, ...]:
    """Convert a one-dimensional array of non-negative integers to a tuple.

    Raises:
        ValueError: when these are something else.
    """
    array = (
        values.detach().cpu().numpy() if isinstance(values, Tensor) else _as_array(values, name)
    )
    if array.ndim != 1 or (array.size > 0 and (array.dtype.kind not in "iu" or array.min() < 0)):
        raise ReconError(
            f"{name}: expected a row of whole numbers from 0 on, got {_type_text(values, array)}"
        )
    return tuple(int(number) for number in array)


def usable_device(name: str) -> torch.device:
    """Return the torch device of this name after a test that it works.

    Raises:
        ReconError: when there is no such device, or torch cannot use it.
    """
    try:
        return torch.empty(0, device=name).device
    except (RuntimeError, AssertionError, TypeError) as error:
        reason = str(error).strip().partition("\n")[0]
        raise ReconError(f"device: {name!r} cannot be used here ({reason}); use 'cpu'") from error


def positive_number(value: Any, name: str) -> float:
    """Return a value as a float; refuse one that is not finite and above zero.

    Raises:
        ValueError: when it is something else.
    """
    number = finite_number(value, name)
    if not number > 0:
        raise ReconError(f"{name}: expected a number above 0, got {number:g}")
    return number


def usable_frame_rate(value: Any, name: str) -> float:
    """Return a value as a float; refuse an implausible frame rate in Hz (ValueError)."""
    FRAME_RATE.check(rate := positive_number(value, name), name)
    return rate


def finite_number(value: Any, name: str) -> float:
    """Return a value as a float; refuse NaN, infinity and what is no number.

    Raises:
        ValueError: when it is something else.
    """
    try:
        if isinstance(value, bool | np.bool_ | bytes):
            raise TypeError
        number = float(value)
    except (TypeError, ValueError):
        raise ReconError(f"{name}: expected one number, got {value!r:.60}") from None
    if not np.isfinite(number):
        raise ReconError(f"{name}: expected a finite number, got {number:g}")
    return number


def require_shape(tensor: Tensor, name: str, shape: Sequence[str | int]) -> None:
    """Refuse a tensor whose last axes differ from `shape`, where words stand for any length.

    Raises:
        ValueError: with the shape that was expected and the one that came.
    """
    last = tensor.shape[max(tensor.ndim - len(shape), 0) :]
    fits = len(last) == len(shape) and all(
        isinstance(want, str) or got == want for got, want in zip(last, shape, strict=True)
    )
    if not fits:
        wanted = ", ".join(map(str, shape))
        raise ReconError(f"{name}: expected the shape (..., {wanted}), got {tuple(tensor.shape)}")


def finite_median(values: Float[np.ndarray, "*shape samples"]) -> Float[np.ndarray, "*shape"]:
    """Median of the finite values of every row; NaN for a row without finite values."""
    ordered, count = np.sort(values, -1), np.isfinite(values).sum(-1)  # np.sort puts NaN last
    middle = np.stack(((count - 1) // 2, count // 2), -1).clip(min=0)
    return np.take_along_axis(ordered, middle, -1).mean(-1)


def runs_of_true(flags: Bool[np.ndarray, " frames"]) -> list[tuple[int, int]]:
    """Index range [start, stop) of every run of true values."""
    edges = np.flatnonzero(np.diff(np.concatenate(([0], flags.astype(np.int8), [0]))))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))


def index_of_first_true(mask: Tensor) -> list[int]:
    """Index, one number per axis, of the first true element; the mask must have one."""
    return mask.nonzero()[0].tolist()


def _as_array(values: Any, name: str) -> np.ndarray:
    try:
        return np.asarray(values)
    except ValueError:
        raise ReconError(f"{name}: expected an array, got rows of different lengths") from None


def _type_text(values: Any, array: np.ndarray) -> str:
    return f"{type(values).__name__} of shape {array.shape} and type {array.dtype}"

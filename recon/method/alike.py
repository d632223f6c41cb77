"""Whether two values compute the same: priors that were loaded twice, functions made twice."""

import enum
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from functools import partial
from pathlib import PurePath
from types import BuiltinFunctionType, CodeType, FunctionType, MethodType
from typing import Any

import numpy as np
import torch
from torch import Tensor

_PLAIN = (
    str, bytes, int, float, complex, bool, type(None), enum.Enum, PurePath, frozenset, set, range,
    slice, CodeType, torch.dtype, torch.device, torch.Size,
)  # fmt: skip
"""Types whose own equality says it all."""


def alike(a: Any, b: Any) -> bool:
    """Whether two values hold the same code and the same data.

    Records and other objects are compared field by field, functions by their code and by what
    they refer to outside. What is cached in a record does not count. Whatever cannot be compared
    is alike only to itself.
    """
    return _alike(a, b, frozenset())


def _alike(a: Any, b: Any, above: frozenset[tuple[int, int]]) -> bool:
    """`above` has the pairs that are being compared, which objects may refer back to."""
    pair = id(a), id(b)
    if a is b or pair in above:
        return True
    if type(a) is not type(b):
        return False
    above |= {pair}
    if isinstance(a, Tensor):
        return _same_tensor(a, b)
    if isinstance(a, np.ndarray):
        return a.dtype == b.dtype and np.array_equal(a, b)
    if isinstance(a, _PLAIN):
        return bool(a == b)
    if isinstance(a, Mapping):
        return list(a) == list(b) and all(_alike(a[key], b[key], above) for key in a)
    if isinstance(a, list | tuple):
        pairs = zip(a, b, strict=len(a) == len(b))
        return len(a) == len(b) and all(_alike(x, y, above) for x, y in pairs)
    return _alike(_parts(a), _parts(b), above) if _has_parts(a) else False


def _has_parts(value: Any) -> bool:
    if isinstance(value, type | BuiltinFunctionType):
        return False
    return isinstance(value, partial) or is_dataclass(value) or hasattr(value, "__dict__")


def _parts(value: Any) -> Any:
    """What makes up a function, a record or another object."""
    if isinstance(value, partial):
        return value.func, value.args, value.keywords
    if isinstance(value, MethodType):
        return value.__func__, value.__self__
    if isinstance(value, FunctionType):
        cells = [cell.cell_contents for cell in value.__closure__ or ()]
        return value.__code__, value.__defaults__, value.__kwdefaults__, cells
    if is_dataclass(value):
        return [getattr(value, field.name) for field in fields(value)]
    return vars(value)


def _same_tensor(a: Tensor, b: Tensor) -> bool:
    if a.shape != b.shape or a.dtype != b.dtype or a.device != b.device:
        return False
    return (a.data_ptr() == b.data_ptr() and a.stride() == b.stride()) or torch.equal(a, b)

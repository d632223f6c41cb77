"""Immutable records of tensors, which hold nearly all data of the library."""

import dataclasses
from collections.abc import Callable
from typing import Any, TypeVar, cast

import torch
from torch import Tensor

_S = TypeVar("_S")


class TensorStruct:
    """Mixin for frozen dataclasses whose fields are tensors, nested structs or plain settings.

    Plain settings (numbers, strings, None) are carried along unchanged.
    """

    def map(self: _S, function: Callable[[Tensor], Tensor]) -> _S:
        """The record with `function` applied to every tensor in it."""
        record = cast(Any, self)
        changed = {
            field.name: _mapped(getattr(record, field.name), function)
            for field in dataclasses.fields(record)
        }
        return record.derived(**changed)

    def to(
        self: _S,
        *,
        device: torch.device | str | None = None,
        dtype: torch.dtype | None = None,
    ) -> _S:
        """The record on another device, its floating point tensors in another precision."""
        return cast(Any, self).map(
            lambda x: x.to(device=device, dtype=dtype if x.is_floating_point() else None)
        )

    def detach(self: _S) -> _S:
        """The record with its tensors detached from the autograd graph."""
        return cast(Any, self).map(Tensor.detach)

    def __getitem__(self: _S, index: Any) -> _S:
        """The record with every tensor indexed along its leading batch axis."""
        return cast(Any, self).map(lambda tensor: tensor[index])

    def replace(self: _S, **fields: Any) -> _S:
        """Return a copy with some fields replaced; the constructor checks the new values."""
        return dataclasses.replace(cast(Any, self), **fields)

    def derived(self: _S, **fields: Any) -> _S:
        """Return a copy with some fields replaced, without the constructor's checks.

        It is faster than `replace`, as records are derived in every evaluation.
        """
        record = object.__new__(type(self))
        for field in dataclasses.fields(cast(Any, self)):
            value = fields[field.name] if field.name in fields else getattr(self, field.name)
            object.__setattr__(record, field.name, value)
        return record

    def _set_fields(self, **fields: Any) -> None:
        """Replace fields by their checked values; only for use in constructors."""
        for name, value in fields.items():
            object.__setattr__(self, name, value)

    def tensors(self) -> dict[str, Tensor]:
        """Every tensor by its dotted path, in the order of declaration."""
        found: dict[str, Tensor] = {}
        for field in dataclasses.fields(cast(Any, self)):
            value = getattr(self, field.name)
            if isinstance(value, Tensor):
                found[field.name] = value
            elif isinstance(value, TensorStruct):
                found |= {f"{field.name}.{name}": t for name, t in value.tensors().items()}
        return found


def _mapped(value: Any, function: Callable[[Tensor], Tensor]) -> Any:
    """A field's value with `function` applied to the tensors in it."""
    if isinstance(value, Tensor):
        return function(value)
    if isinstance(value, TensorStruct):
        return value.map(function)
    return value


S = TypeVar("S", bound=TensorStruct)
"""Any record of tensors."""


def concatenate(records: list[S], dim: int = 0) -> S:
    """Concatenate records of one structure along one axis; other fields come from the first."""
    paths = records[0].tensors()
    joined = iter([torch.cat([r.tensors()[path] for r in records], dim) for path in paths])
    return records[0].map(lambda _: next(joined))


def stack(records: list[S]) -> S:
    """Stack records of one structure along a new batch axis; other fields come from the first."""
    return concatenate([record[None] for record in records])

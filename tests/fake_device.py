"""A device that exists in tests only: tensors say `meta`, and their numbers lie behind them.

A processor's tensor with axes and a tensor of the device in one operation are refused, as a GPU
refuses them. What makes the host wait is counted by the line that asks for it.
"""

import traceback
from collections import Counter
from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor
from torch.overrides import TorchFunctionMode
from torch.utils._python_dispatch import TorchDispatchMode

FAKE = torch.device("meta")
WAITS = {"_local_scalar_dense", "nonzero", "equal", "is_nonzero", "masked_select"}
"""Operations whose result the host waits for; indexing by booleans and copies are two more."""
_HANDS_OVER = {"copy_", "index", "index_put", "index_put_", "_index_put_impl_"}
"""Operations that take tensors of the processor beside those of the device: they copy them."""


class FakeTensor(Tensor):
    """A tensor of the device, with its numbers in `held`, a tensor of the processor."""

    held: Tensor

    @staticmethod
    def __new__(cls, held: Tensor) -> "FakeTensor":
        made = Tensor._make_wrapper_subclass(  # pyright: ignore[reportAttributeAccessIssue]
            cls, held.shape, strides=held.stride(), dtype=held.dtype, device=FAKE,
            storage_offset=held.storage_offset(), requires_grad=False,
        )  # fmt: skip
        made.held = held
        return made

    def __repr__(self, **_: Any) -> str:
        return f"FakeTensor({self.held})"

    @classmethod
    def __torch_dispatch__(cls, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        return _run(func, args, kwargs or {}, Counter())


class FakeDevice(TorchDispatchMode):
    """Makes `device="meta"` the fake device; `waits` counts what the host waited for."""

    def __init__(self) -> None:
        super().__init__()
        self.waits: Counter[str] = Counter()
        self._numbers = _Numbers()

    def __enter__(self) -> "FakeDevice":
        super().__enter__()
        self._numbers.__enter__()
        return self

    def __exit__(self, *error: Any) -> None:
        self._numbers.__exit__(*error)
        super().__exit__(*error)

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        return _run(func, args, kwargs or {}, self.waits)


class _Numbers(TorchFunctionMode):
    """Makes tensors of Python's numbers on the processor and takes them to the device."""

    def __torch_function__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        kwargs = dict(kwargs or {})
        if func is Tensor.new_tensor:
            kwargs = {"device": args[0].device, "dtype": args[0].dtype} | kwargs
            func, args = torch.tensor, args[1:]
        if func in (torch.tensor, torch.as_tensor) and kwargs.get("device") is not None:
            device = kwargs.pop("device")
            return func(*args, **kwargs).to(device)
        if func is Tensor.tolist:
            return args[0].cpu().tolist()
        if func in (torch.matmul, Tensor.matmul, Tensor.__matmul__) and args[0].ndim == 1:
            row = args[0][None] @ args[1]  # torch would change a shape in place
            return row.squeeze(-2) if args[1].ndim > 1 else row[0]
        if func in (Tensor.__getitem__, Tensor.__setitem__) and isinstance(args[0], FakeTensor):
            places = args[1] if isinstance(args[1], tuple) else (args[1],)
            own = tuple(
                torch.tensor(k).to(FAKE) if isinstance(k, list | tuple) else k for k in places
            )
            args = (args[0], own, *args[2:])
        return func(*args, **kwargs)


def _run(func: Any, args: Any, kwargs: dict[str, Any], waits: Counter[str]) -> Any:
    name = func._schema.name.removeprefix("aten::")
    flat = [*_tensors(args), *_tensors(tuple(kwargs.values()))]
    fake = [one for one in flat if isinstance(one, FakeTensor)]
    asked = kwargs.get("device")
    target = None if asked is None else torch.device(asked)
    goes = bool(fake) if target is None else target.type == FAKE.type
    if not fake and not goes:
        return func(*args, **kwargs)
    foreign = [one for one in flat if not isinstance(one, FakeTensor) and one.ndim > 0]
    hands_over = name in _HANDS_OVER or target is not None
    if fake and foreign and not hands_over:
        raise RuntimeError(f"{name}: tensors of two devices at {_line()}")
    masks = [one for one in args[1] if one is not None] if name in ("index", "index_put_") else []
    by_mask = name == "index" and any(one.dtype == torch.bool for one in masks)
    copied = bool(foreign) if goes else target is not None or name == "copy_"
    if (fake or goes) and (name in WAITS or by_mask or copied):
        waits[f"{name} at {_line()}"] += 1
    kwargs = {
        k: torch.device("cpu") if k == "device" and v is not None else v for k, v in kwargs.items()
    }
    if name == "copy_" and _bare(args[0]).data_ptr() == _bare(args[1]).data_ptr():
        return args[0]  # a product into a place in memory is copied onto itself
    out = func(*_changed(args, _bare), **{k: _changed(v, _bare) for k, v in kwargs.items()})
    if name.endswith("_") and fake and isinstance(args[0], FakeTensor):
        return args[0]
    return _changed(out, _wrapped) if goes else out


def _tensors(given: Any) -> list[Tensor]:
    """The tensors in a tuple, also in lists in it."""
    if isinstance(given, Tensor):
        return [given]
    return [t for one in given for t in _tensors(one)] if isinstance(given, tuple | list) else []


def _changed(given: Any, change: Callable[[Tensor], Tensor]) -> Any:
    """The same with every tensor changed."""
    if isinstance(given, Tensor):
        return change(given)
    if isinstance(given, tuple | list):
        return type(given)([_changed(one, change) for one in given])
    return given


def _bare(one: Tensor) -> Tensor:
    return one.held if isinstance(one, FakeTensor) else one


def _wrapped(one: Tensor) -> Tensor:
    return one if isinstance(one, FakeTensor) else FakeTensor(one)


def _line() -> str:
    """The innermost line of ours."""
    calls = traceback.walk_stack(None)
    ours = (
        (call.f_code.co_filename, line)
        for call, line in calls
        if call.f_code.co_filename != __file__
    )
    name, line = next(one for one in ours if "site-packages" not in one[0])
    return f"{name}:{line}"

"""The inner loop of a fit neither waits for its device nor hands it numbers from the host."""

import traceback
from collections import Counter
from typing import Any

import pytest
import torch
from torch.utils._python_dispatch import TorchDispatchMode

import recon
from recon.solver import lbfgs
from tests.filmed import bundled, cameras, view, walk

WAITS = {"_local_scalar_dense", "nonzero", "equal", "is_nonzero", "masked_select"}
"""Operations whose result the host waits for; `index` by booleans is one more."""
FROM_HOST = {"lift_fresh"}
"""What `torch.tensor`, `new_tensor` and lists as indices do with their numbers."""


class Watching(TorchDispatchMode):
    """Counts the operations that touch the host, by the line of ours that asks for them."""

    def __init__(self, found: Counter[str]) -> None:
        super().__init__()
        self.found = found

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        name = func._schema.name.removeprefix("aten::")
        masks = [one for one in args[1] if one is not None] if name == "index" else []
        by_mask = any(one.dtype == torch.bool for one in masks)
        if name in WAITS | FROM_HOST or by_mask:
            ours = [
                line for line in traceback.extract_stack() if "site-packages" not in line.filename
            ]
            self.found[f"{name} at {ours[-2].filename}:{ours[-2].lineno}"] += 1
        return func(*args, **(kwargs or {}))


@pytest.fixture
def touched(monkeypatch: pytest.MonkeyPatch) -> Counter[str]:
    """What evaluations of L-BFGS ask of the host, each line's first time left out."""
    found: Counter[str] = Counter()
    evaluate = lbfgs._evaluate
    begun: list[int] = []

    def watched(*args: Any) -> Any:
        begun.append(1)
        with Watching(found):
            return evaluate(*args)

    monkeypatch.setattr(lbfgs, "_evaluate", watched)
    yield found
    assert len(begun) > 5


@pytest.mark.numerics
@pytest.mark.parametrize("kind", ["joints", "views"])
def test_evaluations_leave_the_host_alone(touched: Counter[str], kind: str) -> None:
    """Lists as indices, new tensors of constants and a check of lengths made a GPU wait."""
    motion = walk(12)
    if kind == "joints":
        recon.fit(recon.simulate(motion, "joints3d", noise=0.02), "humor", checks=())
    else:
        recon.fit([view(motion, one) for one in cameras(motion, 3)], "humor", checks=())
    # a constant is made once for each device
    assert {line: count for line, count in touched.items() if count > 2} == {}


def test_a_constant_is_made_once() -> None:
    from recon.core.arrays import constant

    with torch.inference_mode():
        first = constant((1.0, 2.0), torch.device("cpu"), torch.float32)
    assert first is constant((1.0, 2.0), torch.device("cpu"), torch.float32)
    assert first.tolist() == [1.0, 2.0]
    x = torch.ones(2, requires_grad=True)
    (x * first).sum().backward()  # not possible with tensors of the inference mode
    assert x.grad is not None
    assert bundled().template.device == first.device

"""Fits on another device give the processor's result; their loops leave the host alone."""

from collections import Counter
from collections.abc import Iterator
from typing import Any

import pytest
import torch

import recon
from recon.method.newton import StageProblem
from recon.solver import lbfgs
from tests.fake_device import FAKE, FakeDevice, FakeTensor
from tests.filmed import bundled, seen_of, walk


@pytest.fixture
def device(monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[FakeDevice, Counter[str]]]:
    """A device, and what evaluations and Hessians ask of the host, by line."""
    fake, found = FakeDevice(), Counter[str]()
    begun: list[int] = []

    def watched(function: Any) -> Any:
        def run(*args: Any) -> Any:
            begun.append(1)
            before = Counter(fake.waits)
            result = function(*args)
            found.update(fake.waits - before)
            return result

        return run

    monkeypatch.setattr(lbfgs, "_evaluate", watched(lbfgs._evaluate))
    monkeypatch.setattr(StageProblem, "model", watched(StageProblem.model))
    yield fake, found
    assert len(begun) > 10


@pytest.mark.numerics
@pytest.mark.parametrize(
    ("kind", "prior"),
    [
        ("joints3d", "humor"),
        ("landmarks", "pose"),
        ("views", "humor"),
        pytest.param("hidden", "humor", marks=pytest.mark.slow),
        pytest.param("depth", "pose", marks=pytest.mark.slow),
    ],
)
def test_a_fit_on_another_device(
    device: tuple[FakeDevice, Counter[str]], kind: str, prior: Any
) -> None:
    """Checks before and after fits took the device's tensors for the processor's, and failed.

    `index_add` with indices of the processor was refused by GPUs; lists made them wait.
    """
    seen = seen_of(walk(12), kind)
    expected = recon.fit(seen, prior)
    fake, found = device
    with fake:
        result = recon.fit(seen, prior, device="meta")
    away = (result.joints - expected.joints).norm(dim=-1)
    # hidden legs may end elsewhere where two motions are about as likely
    assert float(away.mean()) < 0.05 if kind == "hidden" else float(away.max()) < 5e-4
    assert [one.code for one in result.warnings] == [one.code for one in expected.warnings]
    stages = [[one["name"] for one in of.report()["stages"]] for of in (result, expected)]
    assert stages[0] == stages[1]
    tensors = {**result.motion.tensors(), "joint_std": result.joint_std}
    assert [name for name, one in tensors.items() if isinstance(one, FakeTensor)] == []
    if kind not in ("hidden", "depth"):  # constants are copied to the device once
        assert {line: count for line, count in found.items() if count > 4} == {}


def test_the_fake_device_counts_and_refuses() -> None:
    with FakeDevice() as fake:
        x = torch.arange(6.0, device=FAKE).reshape(2, 3).requires_grad_()
        (slope,) = torch.autograd.grad((x * x).sum(), x)
        assert slope.device == FAKE
        assert fake.waits.total() == 0
        assert slope.tolist() == [[0, 2, 4], [6, 8, 10]]
        assert fake.waits.total() == 1
        with pytest.raises(RuntimeError, match="two devices"):
            _ = slope + torch.ones(2, 3)
        assert float(x.detach()[torch.tensor([True, False])].sum()) == 3
        assert fake.waits.total() > 2


def test_a_constant_is_made_once() -> None:
    from recon.core.arrays import cached_constant

    with torch.inference_mode():
        first = cached_constant((1.0, 2.0), torch.device("cpu"), torch.float32)
    assert first is cached_constant((1.0, 2.0), torch.device("cpu"), torch.float32)
    assert first.tolist() == [1.0, 2.0]
    x = torch.ones(2, requires_grad=True)
    (x * first).sum().backward()  # not possible with tensors of the inference mode
    assert x.grad is not None
    assert bundled().template.device == first.device

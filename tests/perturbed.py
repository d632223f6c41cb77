"""Inputs moved by a few units in the last place: what another processor's rounding may do.

`pytest -m numerics --ulps 4` gives every test that it runs a body, bundled weights and arrays read
from files whose numbers are off by up to four units in the last place. A test that passes only
without it hangs on the rounding of the machine it was written on.
"""

from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import torch

from recon.body.model import BodyModel

_SEED = 0
_BUNDLED = Path(__file__).parents[1] / "priors"


def moved(values: np.ndarray, ulps: int, random: np.random.Generator) -> np.ndarray:
    """Every number x as x (1 + k eps), k whole and at most `ulps`; zero stays zero.

    Single numbers, such as a frame rate, are settings and stay as they are.
    """
    if values.dtype.kind != "f" or values.ndim == 0:
        return values
    steps = random.integers(-ulps, ulps + 1, values.shape)
    return (values * (1 + steps * np.finfo(values.dtype).eps)).astype(values.dtype)


def moved_tensor(values: torch.Tensor, ulps: int, random: np.random.Generator) -> torch.Tensor:
    """Tensors as `moved`, in their own shape."""
    found = np.ascontiguousarray(moved(values.numpy(), ulps, random))
    return torch.from_numpy(found).reshape(values.shape)  # numpy gives a number an axis


def install(ulps: int) -> None:
    """From now on bodies, weights and arrays of files are moved; called before tests load."""
    from priors import checkpoints
    from recon.formats import opening as files

    load_body = BodyModel.load

    @cache
    def body(path: str | Path | None = None) -> BodyModel:
        random = np.random.default_rng(_SEED)
        return load_body(path).map(lambda tensor: moved_tensor(tensor, ulps, random))

    def with_tensors(load: Callable[..., checkpoints.Checkpoint]) -> Callable[..., Any]:
        def loaded(*given: Any) -> checkpoints.Checkpoint:
            random, found = np.random.default_rng(_SEED), load(*given)
            if not found.path.is_relative_to(_BUNDLED):  # a test asks for its own ones back
                return found
            tensors = {k: moved_tensor(t, ulps, random) for k, t in found.tensors.items()}
            return checkpoints.Checkpoint(found.path, tensors, found.settings)

        return loaded

    def with_arrays(load: Callable[..., dict[str, np.ndarray]]) -> Callable[..., Any]:
        def loaded(*given: Any, **options: Any) -> dict[str, np.ndarray]:
            random = np.random.default_rng(_SEED)
            return {k: moved(v, ulps, random) for k, v in load(*given, **options).items()}

        return loaded

    BodyModel.load = staticmethod(body)  # pyright: ignore[reportAttributeAccessIssue]
    checkpoints.load_checkpoint = with_tensors(checkpoints.load_checkpoint)
    files.load_arrays = with_arrays(files.load_arrays)

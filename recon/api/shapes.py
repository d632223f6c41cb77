"""Bodies of people as callers give them: coefficients, words, measures, somebody's motion."""

from collections.abc import Mapping
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor

from recon.api.given import MotionLike, motion_given
from recon.api.results.motion import MotionResult
from recon.body.identities import identity
from recon.body.model import BodyModel
from recon.core.arrays import Numbers, float_tensor
from recon.core.errors import ReconError
from recon.core.limits import SHAPE
from recon.core.motion import Motion
from recon.formats.motions import MotionFile

ShapeLike = Numbers | MotionLike
"""Shape coefficients, what `recon.body.identities.identity` takes ("height=1.80,weight=75",
"tall", "-1,0.5"), or a motion of somebody: a record, a result, a file."""


def shape_given(given: ShapeLike, body: BodyModel) -> Float[Tensor, " shape"]:
    """Shape coefficients of the body, those that are missing at the end zero.

    Raises:
        FileNotFoundError: when there is no such motion file.
        ReconError: when this is nothing that is understood, or no body has it.
    """
    if isinstance(given, str):
        return identity(given, body)
    if isinstance(given, Motion | MotionResult | MotionFile | Mapping | Path):
        return motion_given(given, body, "shape").motion.shape
    found = float_tensor(given, "shape").detach().to(body.template)
    if found.ndim != 1 or not 0 < len(found) <= body.shape_size:
        raise ReconError(
            f"shape: expected 1 to {body.shape_size} coefficients, those of the body "
            f"{body.name!r}, got the shape {tuple(found.shape)}"
        )
    SHAPE.check(found.cpu(), "shape", "coefficients")
    return torch.nn.functional.pad(found, (0, body.shape_size - len(found)))


def shape_name(given: ShapeLike) -> str:
    """How a shape was given, for messages."""
    return str(given) if isinstance(given, str | Path) else "shape"

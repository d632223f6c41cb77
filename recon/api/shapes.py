"""Bodies of people as callers give them: coefficients, words, measures, somebody's motion."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor

from recon.api.given import MotionLike, motion_given
from recon.api.results.motion import MotionResult
from recon.body.identities import identity
from recon.body.model import BodyModel
from recon.core.arrays import Numbers, finite, float_tensor, positive
from recon.core.errors import ReconError
from recon.core.limits import SHAPE
from recon.core.motion import Motion
from recon.formats.motions import MotionFile
from recon.method.shape_prior import ShapePrior

ShapeLike = Numbers | MotionLike
"""Shape coefficients, what `recon.body.identities.identity` takes ("height=1.80,weight=75",
"tall", "-1,0.5"), or a motion of somebody: a record, a result, a file."""


@dataclass(frozen=True)
class Shape:
    """What is known of a person's shape without being certain: a prior that the data may correct.

    Something must be given. `recon.fit(..., shape=1.75)` is short for `Shape(height=1.75)`.
    """

    height: float | None = None
    """Metres from the soles to the crown, without shoes."""
    height_std: float = 0.01
    """Standard deviation of the height, metres; people measure themselves to about a centimetre,
    and are one or two centimetres shorter in the evening."""
    like: ShapeLike | None = None
    """Coefficients, words, or a motion of somebody with about this shape, of another day, say."""
    like_std: float = 0.3
    """Standard deviation of every coefficient about those; people differ by 1."""

    def prior(self, body: BodyModel) -> ShapePrior:
        """The density over the shapes of a body.

        Raises:
            ReconError: when nothing is given, a number is none that it can be, or no body has it.
        """
        if self.height is None and self.like is None:
            raise ReconError("shape: expected a height, or a shape that it is like, got neither")
        height_std = positive(self.height_std, "shape.height_std")
        if self.like is None:
            tall = identity(f"height={finite(self.height, 'shape.height')}", body)
            return ShapePrior(tall, self.height, height_std, None)
        mean = shape_given(self.like, body)
        return ShapePrior(mean, self.height, height_std, positive(self.like_std, "shape.like_std"))


def shape_known(
    given: "ShapeLike | Shape | float | None", body: BodyModel
) -> tuple[Float[Tensor, " shape"] | None, ShapePrior | None]:
    """What a fit holds, or what it heeds beside the data; one of them at most.

    Raises:
        FileNotFoundError: when there is no such motion file.
        ReconError: when this is nothing that is understood, or no body has it.
    """
    if given is None:
        return None, None
    if isinstance(given, float | int):
        given = Shape(height=float(given))
    if isinstance(given, Shape):
        return None, given.prior(body)
    return shape_given(given, body), None


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

"""Converts a caller's argument (object, path or arrays) to a motion, body, shape or prior."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from recon.api.results import MotionResult
from recon.body.model import BodyModel
from recon.core.arrays import Numbers, finite_number, float_tensor, positive_number
from recon.core.errors import ReconError, WeightsError
from recon.core.limits import SHAPE
from recon.core.motion import Motion, MotionFile
from recon.core.plugins import PRIORS, registered_places
from recon.fitting.methods import Method, checked_method, prior_class, prior_trait
from recon.method.priors import PriorLike, is_prior

if TYPE_CHECKING:
    from recon.method.shape_prior import ShapePrior
else:  # at run time Any replaces ShapePrior, whose module most fits need not import
    from typing import Any as ShapePrior

MotionLike = Motion | MotionResult | MotionFile | Mapping[str, Any] | Path | str
"""A motion of one clip, what a function of `recon` returned, a motion file or its path, or the
arrays of such a file by name (`trans`, `poses`, `betas`, `mocap_framerate`)."""
BodyLike = BodyModel | Path | str | None
"""A body, the path of a SMPL-family file, or None for the bundled body."""


@dataclass(frozen=True)
class GivenMotion:
    """A motion of one clip, its body, and the other content of its file."""

    file: MotionFile
    name: str
    """Its path, or what the argument is called."""

    @property
    def motion(self) -> Motion:
        """The motion, without a leading axis."""
        return self.file.motion


def paths_given(given: Any) -> tuple[Path, ...]:
    """Return the paths in an `observations` argument; empty if it holds objects in memory."""
    if isinstance(given, Path | str):
        return (Path(given),)
    several = given if isinstance(given, list | tuple | set | frozenset) else ()
    every = all(isinstance(one, Path | str) for one in several)
    return tuple(Path(one) for one in several) if every else ()


def body_given(given: BodyLike) -> BodyModel:
    """Return the body model for an argument: a model, the path of one, or None (bundled).

    Raises:
        FileNotFoundError: when there is no such file.
        ReconError: when it holds no body.
    """
    if given is None or isinstance(given, BodyModel | Path | str):
        return given if isinstance(given, BodyModel) else BodyModel.load(given)
    raise ReconError(f"body: expected a file or a BodyModel, got {type(given).__name__}")


def motion_given(
    given: Any, body: BodyModel, name: str = "motion", remedy: str = ""
) -> GivenMotion:
    """Return an argument as a motion of this body with all shape coefficients; read files.

    Args:
        given: a `MotionLike`; a leading axis of length one is taken off, padding cut off.
        body: whose motion it must be.
        name: of the argument, for messages about what is no file.
        remedy: what to do about a motion of another body, for messages; "" says to give its body.

    Raises:
        FileNotFoundError: when there is no such file.
        ReconError: when it is no motion of one clip, is damaged, or was made with another body.
    """
    from recon.body.motion_files import WITH_BODY, checked_for_body  # rarely needed

    remedy = remedy or WITH_BODY
    if isinstance(given, Path | str):
        from recon.formats.motions import load_motion  # imported only when files are given

        path = Path(given)
        file = load_motion(path, body.template.dtype)
        return GivenMotion(checked_for_body(file, path, body, remedy), str(given))
    if isinstance(given, Mapping):
        from recon.formats.motions import motion_from

        arrays = {key: np.asarray(value) for key, value in given.items()}
        file = motion_from(arrays, Path(name), body.template.dtype)
    elif isinstance(given, MotionResult):
        file = given.file
    elif isinstance(given, MotionFile):
        file = given
    elif isinstance(given, Motion):
        file = MotionFile(_one_clip(given, name))
    else:
        raise ReconError(
            f"{name}: expected a recon.Motion, a result, the path of a motion file (.npz) or its "
            f"arrays by name, got {type(given).__name__}"
        )
    known = checked_for_body(file, name, body, remedy)
    motion = known.motion.detach().to(device=body.template.device, dtype=body.template.dtype)
    return GivenMotion(replace(known, motion=motion), name)


def _one_clip(motion: Motion, name: str) -> Motion:
    """Remove batch axis and padding of a single clip; refuse batches, gaps and NaN."""
    batch = tuple(motion.translation.shape[:-2])
    if batch not in ((), (1,)):
        raise ReconError(
            f"{name}: expected one clip, got leading axes {batch}; take its clips one by one, "
            "motion[k]"
        )
    motion = motion[0] if batch else motion
    frames = int(motion.valid.sum())
    if frames == 0 or not bool(motion.valid[:frames].all()):
        raise ReconError(f"{name}: expected a clip whose missing frames are all at its end")
    motion = motion.window(0, frames)
    for key, tensor in motion.tensors().items():
        if not bool(torch.isfinite(tensor).all()):
            raise ReconError(f"{name}: {key} holds NaN or infinity; fill its gaps first")
    return motion


ShapeLike = Numbers | MotionLike
"""Shape coefficients, what `recon.body.identities.identity` takes ("height=1.80,weight=75",
"tall", "-1,0.5"), or a motion of somebody: a record, a result, a file."""


@dataclass(frozen=True)
class Shape:
    """Uncertain knowledge of a person's shape: a prior that the data may correct.

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
        """The prior density of the shape coefficients of a body.

        Raises:
            ReconError: when nothing is given, a number is impossible, or no body has this shape.
        """
        if self.height is None and self.like is None:
            raise ReconError(
                "Shape: expected height, or a similar shape as `like`, or both; got neither"
            )
        from recon.body.identities import identity
        from recon.method.shape_prior import ShapePrior

        height_std = positive_number(self.height_std, "shape.height_std")
        if self.like is None:
            tall = identity(f"height={finite_number(self.height, 'shape.height')}", body)
            return ShapePrior(tall, self.height, height_std, None)
        mean = shape_given(self.like, body)
        return ShapePrior(
            mean, self.height, height_std, positive_number(self.like_std, "shape.like_std")
        )


def fixed_shape_or_prior(
    given: "ShapeLike | Shape | float | None", body: BodyModel
) -> tuple[Float[Tensor, " shape"] | None, ShapePrior | None]:
    """Return a `shape` argument as fixed shape coefficients, or as a prior over them.

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
    """Return a `shape` argument as shape coefficients; missing trailing ones are zero.

    Raises:
        FileNotFoundError: when there is no such motion file.
        ReconError: when this is nothing that is understood, or no body has it.
    """
    if isinstance(given, str):
        from recon.body.identities import identity

        return identity(given, body)
    if isinstance(given, Motion | MotionResult | MotionFile | Mapping | Path):
        return motion_given(given, body, "shape").motion.shape
    found = float_tensor(given, "shape").detach().to(body.template)
    if found.ndim != 1 or not 0 < len(found) <= body.shape_size:
        raise ReconError(
            f"shape: expected 1 to {body.shape_size} coefficients, those of the body "
            f"{body.name!r}, got an array of shape {tuple(found.shape)}"
        )
    SHAPE.check(found.cpu(), "shape", "coefficients")
    return torch.nn.functional.pad(found, (0, body.shape_size - len(found)))


def shape_name(given: ShapeLike) -> str:
    """Return a text for messages that says how the caller gave the shape."""
    return str(given) if isinstance(given, str | Path) else "shape"


def checked_prior(given: Any, weights: str, method: Method | None = None) -> str | PriorLike:
    """Check a `prior` argument: a name, a "package.module:Class" that exists, or an object.

    Args:
        given: a registered name (ours are humor, pose, anchor and recording), a place
            "package.module:Class", or an object: a loaded prior, or anything with `stages(data)`.
        weights: of a prior that is given by its name or place.
        method: the way to fit it, one of its `methods`; None is the usual one.

    Raises:
        WeightsError: when it is none of these, or weights are given for an object.
        ReconError: when the prior has no such method.
    """
    if isinstance(given, str):
        prior_class(given)
        checked_method(given, method)
        return given
    names = ", ".join(registered_places(PRIORS))
    if weights != "open":
        raise WeightsError(
            f"weights: {weights!r} is for a prior that is given by its name ({names}), but a "
            "loaded prior was given; load it with these weights, and leave weights out"
        )
    if isinstance(given, type) or not (is_prior(given) or prior_trait(given, "completes")):
        raise WeightsError(
            f"prior: expected {names}, 'package.module:Class', or a loaded recon.method.Prior, "
            f"got {given!r:.80}"
        )
    checked_method(given, method)
    return given

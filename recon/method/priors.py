"""The base class of priors: the variables of a motion, their density and the stages of a fit."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace
from importlib import import_module
from inspect import signature
from typing import TYPE_CHECKING, Any, ClassVar, Generic

import torch
from jaxtyping import Float
from torch import Tensor

from recon.body.model import BodyModel
from recon.core.errors import WeightsError
from recon.core.motion import Motion
from recon.core.struct import S, TensorStruct
from recon.method.protocols import Decoded, Estimate
from recon.method.stages import Stage, Stages
from recon.method.terms import Term, joint_acceleration, shape
from recon.solver.lbfgs import LBFGS

if TYPE_CHECKING:
    from recon.method.quadratic import ClipModel

USUAL_NOISE = 0.04
"""Metres by which coordinates are taken to be off where nobody says."""
MODEL_NOISE = 0.008
"""Metres by which a body differs from its model: even perfect points need so much noise."""
SHAPE_WEIGHT = 5e-6
"""Weight of |betas|² per frame beside data in metres²; it matters little."""
SMOOTHNESS = 9400.0
"""Inverse variance of a joint coordinate's second differences at 30 Hz, 1 / metres²."""


@dataclass(frozen=True)
class Density:
    """A Gaussian density of motions, as a sum of squared residuals of unit variance.

    -log p = ½ Σ share (|z|² + acceleration |second difference of a joint|²) + ½ shape |betas|²,
    sums over frames at 30 Hz.
    """

    by_rotations: Callable[[Motion], Float[Tensor, "*batch time coordinates 63"]]
    """Derivatives of the coordinates z of a pose, which have unit variance, by the rotation steps
    of all joints but the root, R_j Exp(w_j), radians."""
    acceleration: float
    """Inverse variance of a joint coordinate's second differences at 30 Hz, 1 / metres²."""
    shape: float
    """Inverse variance of a shape coefficient, for every frame."""
    share: Callable[[Motion], Float[Tensor, "*batch time"]] = lambda motion: torch.ones_like(
        motion.translation[..., 0]
    )
    """Factor between 0 and 1 of a frame's terms: how much of them is believed."""


class Prior(ABC, Generic[S]):
    """Base class of priors: variables of a motion, their density and the stages of a fit.

    A prior must define `encode` and `decode`. All other methods have a default.
    """

    knows_gravity: ClassVar[bool] = True
    """Whether it judges heights above the ground and which way is up. An unknown ground is then
    moved by its stages, and without any ground (`recon.fit(..., ground=None)`) it is refused."""
    level: ClassVar[bool] = False
    """Whether its motions are in the world, z up, and in no recording's frame. Where the ground is
    unknown, motions are brought to the world before `encode`, and its variables, which need a
    method `carried(T, body)`, back to the frame of the recording."""
    methods: ClassVar[tuple[str, ...]] = ()
    """Names of the ways in which it can be fitted, the usual one first; empty if there is one."""
    reach: ClassVar[int] = 0
    """How many frames apart two frames may be that one of its terms couples, at least 2. It then
    has `from_steps`, `turns` and `add_curvature` for second-order minimisers: its variables are
    linear in steps of frames, near the motion they begin at. 0 if it has none of these."""

    @classmethod
    def load(cls, weights: str, body: BodyModel, /) -> "Prior[S]":
        """Load the prior with its weights, when it is given by name or import path.

        Args:
            weights: `open`, or what the user wrote: a file, for example.
            body: whose motion is to be found.

        Raises:
            WeightsError: when there are no such weights; the default loads none.
        """
        del body
        if weights != "open":
            raise WeightsError(
                f"weights: {cls.__name__} takes none, as it has no method load(weights, body); "
                f"got {weights!r}"
            )
        return cls()

    @abstractmethod
    def encode(self, motion: Motion) -> S:
        """Return variables that decode to the motion nearest to the given one, (clips, ...)."""

    @abstractmethod
    def decode(self, variables: S) -> Decoded:
        """Return the motion of the variables, and the parts of their -log p."""

    def stages(
        self,
        data: tuple[Term, ...],
        noise: float = USUAL_NOISE,
        body: BodyModel | None = None,
        method: str | None = None,
    ) -> tuple[Stage[Any], ...]:
        """Return the stages (minimisations) of a fit with this prior, in their order.

        The default has two: place and heading from the data alone, then everything under -log p
        as well (the sum of the energies, nats), with small accelerations and common shapes. It
        is for variables called `translation`, `root`, `pose`, `shape`, as in `FreeMotion`.

        Args:
            data: terms of the observations. They stand in the unit of ½ |residual|² in metres² of
                the least noisy one, so that a negative log-probability is weighted by noise².
            noise: metres by which coordinates of the data are off. A prior whose weights the
                caller chose keeps these.
            body: whose motion it is; None is the one that the prior knows.
            method: one of `methods`; None is the default.
        """
        del body, method
        variance = max(noise, MODEL_NOISE) ** 2
        likely = (
            Term("prior", all_energies, variance),
            Term("shape", shape, SHAPE_WEIGHT),
            Term("acceleration", joint_acceleration, SMOOTHNESS * variance),
        )
        place = frozenset({"translation", "root"})
        return (
            Stage("root", self, data, place, LBFGS(30, tolerance_decrease=1e-4)),
            Stage("all", self, (*data, *likely), place | {"pose", "shape"}, LBFGS(120)),
        )

    def belief(self, noise: float) -> Density | None:
        """Return a Gaussian density that approximates this prior, for data of a noise in metres.

        Standard deviations of a fit follow from it. The default, None, gives none.
        """
        del noise
        return None

    def live(self, noise: float) -> Any:
        """Return energies of steps between frames for a stream, at a noise of `noise` metres.

        The default, None, has none; see `recon.live.objective.StepEnergies`.
        """
        del noise
        return None

    def from_steps(self, variables: S, steps: Float[Tensor, "clips time 69"]) -> S:
        """Return the variables after a step of every frame; steps of zero change nothing."""
        raise NotImplementedError(
            f"{type(self).__name__} has a reach above 0, so it must define from_steps"
        )

    def turns(self, variables: S, clip: int) -> Float[Tensor, "time 63 63"]:
        """Return derivatives of the joints' rotation steps w by the last 63 numbers of a step."""
        raise NotImplementedError(
            f"{type(self).__name__} has a reach above 0, so it must define turns"
        )

    def add_curvature(self, term: Term, clip: "ClipModel") -> bool:
        """Add the Gauss-Newton Hessian of the prior's own term; return False for other terms."""
        del term, clip
        return False


def all_energies(estimate: Estimate) -> Float[Tensor, "*batch"]:
    """Return -log p of an estimate, nats: the sum of all energies that its prior decoded."""
    none = torch.zeros_like(estimate.motion.shape[..., 0])
    return sum(estimate.decoded.energies.values(), none)


PriorLike = Any
"""A `Prior`, or an object as version 0.2 had them, with `method(noise, body)` that gives an object
with `stages(data)`, or with `stages(data)` itself."""


@dataclass(frozen=True)
class Traits:
    """The traits that priors of version 0.2 have; they are now class variables of `Prior`."""

    knows_gravity: bool = True
    completes: bool = False


def trait(kind: object, name: str) -> bool:
    """Return a trait such as `knows_gravity` of a prior or its class, also of version 0.2."""
    former: Traits = getattr(kind, "traits", Traits())
    return getattr(kind, name, getattr(former, name))


def as_prior(given: PriorLike) -> Prior[Any]:
    """Return the given prior, wrapped as a `Prior` if it was written for version 0.2."""
    if not isinstance(given, Prior):
        return _FormerPrior(given)
    try:
        signature(given.stages).bind((), USUAL_NOISE, None, None)
    except TypeError:  # e.g. classes derived from the protocol `Prior` of version 0.2
        return _FormerPrior(given)
    return given


def is_prior(given: object) -> bool:
    """Return whether an object is a prior of this version or of version 0.2."""
    return not isinstance(given, type) and any(hasattr(given, n) for n in ("stages", "method"))


def stages_of(given: PriorLike | Stages) -> Stages:
    """Return the function from data to stages: a prior's `stages`, or the given function."""
    return as_prior(given).stages if is_prior(given) else given


_FORWARDED = ("encode", "decode", "level", "methods", "reach", "from_steps", "turns",
              "add_curvature", "belief", "live")  # fmt: skip


class _FormerPrior(Prior[TensorStruct]):
    """Wraps a prior written for version 0.2 and forwards the methods that it has."""

    def __init__(self, given: Any) -> None:
        forwarded = {name: getattr(given, name) for name in _FORWARDED if hasattr(given, name)}
        vars(self).update(forwarded, knows_gravity=trait(given, "knows_gravity"), _given=given)

    def encode(self, motion: Motion) -> Any:
        raise NotImplementedError("this prior only has stages(data); add encode and decode")

    def decode(self, variables: Any) -> Decoded:
        raise NotImplementedError("this prior only has stages(data); add encode and decode")

    def stages(
        self,
        data: tuple[Term, ...],
        noise: float = USUAL_NOISE,
        body: BodyModel | None = None,
        method: str | None = None,
    ) -> tuple[Stage[Any], ...]:
        given: Any = vars(self)["_given"]
        if hasattr(given, "method"):
            given = given.method(noise, body, *(() if method is None else (method,)))
        made = given.stages(data)
        # consecutive stages of the same prior go on with the same variables
        priors = {id(stage.prior): stage.prior for stage in made}
        own = {key: as_prior(prior) for key, prior in priors.items()}
        return tuple(replace(stage, prior=own[id(stage.prior)]) for stage in made)


def __getattr__(name: str) -> Any:
    """Import `CyclePrior` on demand, as plug-ins of version 0.2 import it from here."""
    if name == "CyclePrior":
        return import_module("recon.method.cycle_prior").CyclePrior
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")

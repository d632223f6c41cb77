"""Methods of a fit from its options: the prior, with weights for the noise of the data."""

from dataclasses import dataclass, replace
from typing import Any

from jaxtyping import Float
from torch import Tensor

from recon.body.model import BodyModel
from recon.core.errors import ReconError, WeightsError
from recon.method.plugins import PRIORS, imported, registered
from recon.method.priors import CyclePrior, ManyMethods, NoisyPrior, Traits, methods_of, traits_of
from recon.method.reconstruction import Method
from recon.method.shape_prior import ShapePrior
from recon.method.stages import Stage
from recon.method.terms import Term

PriorObject = Method | NoisyPrior | CyclePrior
"""A prior that is loaded already, or a method of the caller's own."""


def class_of(prior: str) -> Any:
    """The class of a prior, by its registered name or its place "package.module:Class".

    Raises:
        WeightsError: when there is no such prior.
    """
    known = registered(PRIORS)
    if prior not in known and ":" not in prior:
        raise WeightsError(
            f"prior: expected {', '.join(known)} or 'package.module:Class', got {prior!r}"
        )
    try:
        return imported(known.get(prior, prior), "prior")
    except ReconError as error:
        raise WeightsError(str(error)) from error


def loaded(prior: str | PriorObject, weights: str, body: BodyModel) -> PriorObject:
    """The prior with its weights, those of an object being its own.

    A class is loaded by `load(weights, body)`; without such a method it is made without arguments.

    Raises:
        FileNotFoundError: when there are no such weights.
        WeightsError: when there is no such prior, or it takes no weights.
    """
    if not isinstance(prior, str):
        return prior
    kind = class_of(prior)
    if hasattr(kind, "load"):
        found = kind.load(weights, body)
    elif weights == "open":
        found = kind()
    else:
        raise WeightsError(f"weights: {prior!r} has none: it has no method load(weights, body)")
    if not isinstance(found, PriorObject):
        raise WeightsError(
            f"prior: {prior!r} needs a method stages(data) or method(noise, body), got a "
            f"{type(found).__name__}"
        )
    return found


def traits(prior: str | PriorObject) -> Traits:
    """What is known of a prior without its weights."""
    return traits_of(class_of(prior) if isinstance(prior, str) else prior)


def checked_method(prior: str | PriorObject, name: str | None) -> str | None:
    """The name of a way to fit a prior, one of its `methods`, or None for the usual one.

    Raises:
        ReconError: when the prior has no such method.
    """
    if name is None:
        return None
    known = methods_of(class_of(prior) if isinstance(prior, str) else prior)
    if name in known:
        return name
    whose = repr(prior) if isinstance(prior, str) else f"a {type(prior).__name__}"
    if len(known) == 0:
        raise ReconError(f"method: {whose} is fitted in one way only, got {name!r}; leave it out")
    raise ReconError(f"method: {whose} is fitted by {' or '.join(known)}, got {name!r}")


@dataclass(frozen=True)
class FitOptions:
    """The prior of a fit, the noise of the data, and what else the fit should heed."""

    prior: str | PriorObject = "humor"
    """A registered name, the place of a class, a loaded prior, or a method with `stages`."""
    weights: str = "open"
    """Weights of a prior that is given by its name: `open`, `nc` or a file."""
    method: str | None = None
    """One of the prior's `methods`, the ways in which it can be fitted; None is the usual one."""
    noise: tuple[float | None, ...] = ()
    """Standard deviation of each observation's coordinates in its own unit (metres, or pixels of
    keypoints); None, and an empty tuple, estimate it from the data."""
    physics: float = 0.0
    """Multiplier of the physics energies; 0 leaves them out."""
    ground_given: bool = False
    """Whether the caller gave the plane that lies at z = 0 of the recording."""
    grounded: bool = True
    """Whether there is a ground at all; there is none in water, on ropes and on stairs."""
    repair: bool = True
    """Whether faults of the data are repaired before the fit."""
    shape: Float[Tensor, " shape"] | None = None
    """Shape coefficients that are held; None estimates them."""
    shape_prior: ShapePrior | None = None
    """What is known of the shape, where it is not held."""
    terms: tuple[Term, ...] = ()
    """Further energies, added in every stage that moves poses."""

    def __post_init__(self) -> None:
        """Refuse to judge heights above a ground that is not there.

        Raises:
            ReconError: when the prior or physics need a ground and there is none.
        """
        if self.grounded:
            return
        if self.knows_gravity:
            name = self.prior if isinstance(self.prior, str) else type(self.prior).__name__
            raise ReconError(
                f"without a ground, nothing can be said about heights above it, which the prior "
                f"{name!r} judges; fit with the prior 'pose', or with one of your own whose "
                "traits are Traits(knows_gravity=False)"
            )
        if self.physics != 0:
            raise ReconError(
                f"physics is of a body on the ground, and there is none: expected physics=0, got "
                f"{self.physics:g}"
            )

    @property
    def completes(self) -> bool:
        """Whether the prior knows whole gait cycles, for which beginnings are searched."""
        return traits(self.prior).completes

    @property
    def knows_gravity(self) -> bool:
        """Whether the prior judges heights above the ground and which way is up."""
        return traits(self.prior).knows_gravity

    def noise_of(self, row: int) -> float | None:
        """The standard deviation given for an observation, by its number."""
        return self.noise[row] if self.noise else None


def method_of(options: FitOptions, noise: float, body: BodyModel) -> Method:
    """The method for observations whose coordinates are off by about `noise` metres.

    Raises:
        FileNotFoundError: when there are no such weights.
        ValueError: when the file of the weights holds none, the prior has a way of its own, or
            physics is to weigh less than nothing, or the prior has no such method.
    """
    method = _of_prior(options, noise, body)
    if options.physics == 0:
        return method
    # most fits have none
    from recon.physics.energies import physics_terms

    return WithPhysics(method, physics_terms(noise, options.physics))


def _of_prior(options: FitOptions, noise: float, body: BodyModel) -> Method:
    """A loaded method is fitted as it is; whatever was named is made for the noise."""
    if options.completes:
        raise ReconError(
            "this prior is of one whole cycle, for which beginnings are searched: call "
            "recon.fitting.cycles.complete, or `recon complete`"
        )
    given, name = options.prior, checked_method(options.prior, options.method)
    if not isinstance(given, str) and isinstance(given, Method):
        return given
    prior = loaded(given, options.weights, body)
    if name is not None and isinstance(prior, ManyMethods):
        return prior.method(noise, body, name)
    if isinstance(prior, NoisyPrior):
        return prior.method(noise, body)
    assert isinstance(prior, Method)
    return prior


_PLACE = frozenset({"translation", "root"})


@dataclass(frozen=True)
class WithoutRoot:
    """A method without its leading stages that only place the rest body.

    One image tells the distance of a body by the size of its bones. Placing a rest body there
    would trade its stretched limbs against distance. And a prior that knows of no ground has its
    minimum at another distance than the ground tells (8 cm too low a body, in a test): its stages
    are minimised by first order, which keeps the distance that they begin with.
    """

    method: Method

    def stages(self, data: tuple[Term, ...]) -> tuple[Stage[Any], ...]:
        """The stages from the first on that moves more than place and heading."""
        stages = self.method.stages(data)
        first = next((k for k, stage in enumerate(stages) if not stage.free <= _PLACE), 0)
        return tuple(
            stage if traits_of(stage.prior).knows_gravity else replace(stage, second_order=None)
            for stage in stages[first:]
        )


@dataclass(frozen=True)
class WithSizeHeld:
    """A method that takes the shape from its first stage that finds one.

    One view does not tell whether somebody is large and far or small and near, but for the feet
    that stand on a ground that is known. A prior over steps does not either, yet it finds the
    short steps of small people likelier: what it judges would shrink them by a fifth (CMU 02_01),
    and bend their poses to fit. Whoever turns cartwheels before a camera of known pose became a
    child that floated a metre in front of it.
    """

    method: Method

    def stages(self, data: tuple[Term, ...]) -> tuple[Stage[Any], ...]:
        """Its stages; those after the first that moves the shape do not."""
        stages = self.method.stages(data)
        first = next((k for k, stage in enumerate(stages) if "shape" in stage.free), 0)
        held = (replace(stage, free=stage.free - {"shape"}) for stage in stages[first + 1 :])
        return *stages[: first + 1], *held


@dataclass(frozen=True)
class WithScene:
    """A method that finds something of the scene as well, once there is a first motion."""

    method: Method
    moved: frozenset[str]
    """Paths such as `scene.ground.tilt`; see `recon.core.scene`."""
    terms: tuple[Term, ...]
    """What holds it."""

    def stages(self, data: tuple[Term, ...]) -> tuple[Stage[Any], ...]:
        """Its stages; the first that moves poses leaves the scene alone if others follow."""
        stages = self.method.stages(data)
        posing = [k for k, stage in enumerate(stages) if not stage.free <= _PLACE]
        return tuple(
            replace(stage, terms=(*stage.terms, *self.terms), free=stage.free | self.moved)
            if k in (posing[1:] or posing)
            else stage
            for k, stage in enumerate(stages)
        )


@dataclass(frozen=True)
class WithPhysics:
    """A method and a stage more, in which the body stands on the ground z = 0 as well.

    The stage is the method's last one again, with all that it moves and minimises, and these
    terms, which take the place of those of the same name. It comes last and is short because an
    iteration takes about twice as long with a part of the skin to compute, and because feet that
    stand wrongly in a first guess would be held there.
    """

    method: Method
    terms: tuple[Term, ...]
    iterations: int = 40

    def stages(self, data: tuple[Term, ...]) -> tuple[Stage[Any], ...]:
        """Its stages and one more."""
        stages = self.method.stages(data)
        last = stages[-1]
        # the Hessian of these terms is not known: scaled by that of the others, it ends too early
        minimiser = replace(last.minimiser, max_iterations=self.iterations, scale=0.0)
        last = replace(last, second_order=None, proposals=None)
        own = {term.name for term in self.terms}
        terms = (*(term for term in last.terms if term.name not in own), *self.terms)
        return (*stages, replace(last, name="physics", terms=terms, minimiser=minimiser))

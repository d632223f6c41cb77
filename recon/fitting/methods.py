"""Methods of a fit from its options: the prior, with weights for the noise of the data."""

from dataclasses import dataclass, replace
from typing import Any

from recon.body.model import BodyModel
from recon.core.errors import ReconError
from recon.fitting.options import FitOptions
from recon.fitting.priors import checked_method, loaded
from recon.method.priors import ManyMethods, NoisyPrior, traits_of
from recon.method.reconstruction import Method
from recon.method.stages import Stage
from recon.method.terms import Term
from recon.physics import energies as physics


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
    return WithPhysics(method, physics_terms(noise, options.physics))


def _of_prior(options: FitOptions, noise: float, body: BodyModel) -> Method:
    """A loaded method is fitted as it is; whatever was named is made for the noise."""
    if options.completes:
        raise ReconError(
            "this prior is of one whole cycle, for which beginnings are searched: call "
            "recon.fitting.cycles.completion.complete, or `recon complete`"
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


_PHYSICS = (
    ("penetration", physics.penetration, 0.002),
    ("slide", physics.slide, 0.003),
    ("floating", physics.floating, 0.006),
    ("dynamic stability", physics.dynamic_stability, 0.2),
)
"""Standard deviations, metres: of depth, of the step of a sole per 1/30 s, of height, and of the
distance from the centre of pressure to the zero moment point. Chosen on validation windows."""


def physics_terms(noise: float, strength: float = 1.0) -> tuple[Term, ...]:
    """What holds a body to the ground z = 0, beside an observation of weight one.

    Each weighs noise² / deviation², as a negative log-probability does beside ½ |error|².

    Args:
        noise: of the observation's coordinates, metres; at least 8 mm is taken.
        strength: multiplier of all of them.

    Raises:
        ValueError: when the strength is not a number above 0.
    """
    if not 0 < strength < float("inf"):
        raise ReconError(
            "physics multiplies the weights of contact with the ground: expected a number of at "
            f"least 0 (0 leaves them out, 1 is as chosen on validation), got {strength:g}"
        )
    variance = strength * max(noise, 0.008) ** 2
    return tuple(Term(name, energy, variance / s**2) for name, energy, s in _PHYSICS)


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

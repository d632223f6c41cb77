"""Rewrites the stages of a prior for the unknowns of a clip."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from recon.body.model import BodyModel
from recon.core.errors import ReconError
from recon.fitting.methods import FitOptions, checked_method, loaded_prior
from recon.method.free import FreeMotion
from recon.method.stages import Stage, Stages
from recon.method.terms import Term, joint_acceleration, relative_acceleration

_PLACEMENT = frozenset({"translation", "root"})
_SHAPE = frozenset({"shape"})
PHYSICS_ITERATIONS = 40


def prior_stages(options: FitOptions, noise: float, body: BodyModel) -> Stages:
    """Return a function that gives the prior's stages for data with a noise of `noise` metres.

    Raises:
        FileNotFoundError: when there are no such weights.
        ValueError: when the file of the weights holds none, the prior has a way of its own, or
            physics is to weigh less than nothing, or the prior has no such method.
    """
    if options.completes:
        raise ReconError(
            "this prior is of one whole gait cycle, whose fit tries many first guesses: call "
            "recon.fitting.cycles.complete, or `recon complete`"
        )
    method = checked_method(options.prior, options.method)
    prior = loaded_prior(options.prior, options.weights, body)
    physics: tuple[Term, ...] = ()
    if options.physics != 0:
        # imported only when a fit has energies of physics
        from recon.physics.energies import physics_terms

        physics = physics_terms(noise, options.physics)

    def stages_for(data: tuple[Term, ...]) -> tuple[Stage[Any], ...]:
        stages = prior.stages(data, noise, body, method)
        return with_physics(stages, physics) if physics else stages

    return stages_for


def from_first_prior_stage(stages: Sequence[Stage[Any]]) -> tuple[Stage[Any], ...]:
    """Return the stages from the first one that has a prior; earlier ones only place the motion.

    Where motions are proposed for hidden limbs, stages start there.
    """
    proposing = (k for k, one in enumerate(stages) if one.proposals is not None)
    of_prior = (k for k, one in enumerate(stages) if not isinstance(one.prior, FreeMotion))
    return tuple(stages[next(proposing, next(of_prior, 0)) :])


def from_first_pose_stage(stages: Sequence[Stage[Any]]) -> tuple[Stage[Any], ...]:
    """Return the stages from the first one that optimises more than translation and root."""
    first = next((k for k, stage in enumerate(stages) if not stage.free <= _PLACEMENT), 0)
    return tuple(stages[first:])


def for_one_view(stages: Sequence[Stage[Any]]) -> tuple[Stage[Any], ...]:
    """Return the stages for one view, where the size of bones in the image gives the distance.

    Placing a rest body first would trade its stretched limbs against distance. A prior that knows
    no ground has its minimum at another distance than the ground shows (the body 8 cm too low, in
    a test): its stages are minimised by first order, which keeps the distance at the start.
    """
    return tuple(
        stage if stage.prior.knows_gravity else replace(stage, second_order=None)
        for stage in from_first_pose_stage(stages)
    )


def until_first_shape_stage(stages: Sequence[Stage[Any]]) -> tuple[Stage[Any], ...]:
    """Return the stages up to the first that optimises the shape; only the first if none does."""
    moving = (k for k, stage in enumerate(stages) if "shape" in stage.free)
    return tuple(stages[: next(moving, 0) + 1])


def with_shape_found_once(stages: Sequence[Stage[Any]]) -> tuple[Stage[Any], ...]:
    """Return stages that optimise the shape only in the first that frees it, then hold it.

    One view does not show whether a person is large and far or small and near, except by feet that
    stand on a known ground. A prior over steps does not either, but it finds the short steps of
    small people likelier: it would shrink them by a fifth (CMU 02_01), and bend their poses to
    fit. A person who turned cartwheels before a camera of known pose became a child that floated a
    metre in front of it.
    """
    first = until_first_shape_stage(stages)
    return (*first, *(replace(one, free=one.free - _SHAPE) for one in stages[len(first) :]))


def with_relative_accelerations(stages: Sequence[Stage[Any]]) -> tuple[Stage[Any], ...]:
    """Return the stages with accelerations relative to body size wherever the shape is free.

    In one view, a person half as large and half as far away looks the same and accelerates half
    as much in metres: smoothness would shrink walkers by a third.
    """

    def relative(term: Term) -> Term:
        smooth = term.energy == joint_acceleration
        return replace(term, energy=relative_acceleration) if smooth else term

    return tuple(
        replace(stage, terms=tuple(map(relative, stage.terms))) if "shape" in stage.free else stage
        for stage in stages
    )


def with_shape_held(stages: Sequence[Stage[Any]]) -> tuple[Stage[Any], ...]:
    """Return the stages with the shape held, without those that optimise nothing else."""
    held = (replace(stage, free=stage.free - _SHAPE) for stage in stages)
    return tuple(stage for stage in held if stage.free)


def with_shape_terms(
    stages: Sequence[Stage[Any]], terms: tuple[Term, ...]
) -> tuple[Stage[Any], ...]:
    """Return the stages with further terms wherever the shape is optimised."""
    return tuple(
        replace(one, terms=(*one.terms, *terms)) if "shape" in one.free else one for one in stages
    )


def with_scene(
    stages: Sequence[Stage[Any]], unknowns: frozenset[str], terms: tuple[Term, ...]
) -> tuple[Stage[Any], ...]:
    """Return the stages with unknowns of the scene, optimised once there is a first motion.

    Args:
        stages: stages of a prior; the first that moves poses holds the scene if others follow.
        unknowns: names of unknowns such as `scene.ground.tilt`; see `recon.core.scene`.
        terms: energies of these unknowns.
    """
    posing = [k for k, stage in enumerate(stages) if not stage.free <= _PLACEMENT]
    return tuple(
        replace(stage, terms=(*stage.terms, *terms), free=stage.free | unknowns)
        if k in (posing[1:] or posing)
        else stage
        for k, stage in enumerate(stages)
    )


def with_physics(
    stages: Sequence[Stage[Any]], terms: tuple[Term, ...], iterations: int = PHYSICS_ITERATIONS
) -> tuple[Stage[Any], ...]:
    """Append a last stage with the physics of a body on the ground z = 0.

    It is a copy of the last stage with these terms, which replace those of the same name. It comes
    last and is short because an iteration takes about twice as long with a part of the skin to
    compute, and because feet that stand wrongly in a first guess would be held there.
    """
    # physics terms have no Hessian; L-BFGS scaled by the other terms' Hessian stops too early
    last = replace(stages[-1], name="physics", second_order=None, proposals=None)
    minimiser = replace(last.minimiser, max_iterations=iterations, scale=0.0)
    own = {term.name for term in terms}
    kept = (term for term in last.terms if term.name not in own)
    return (*stages, replace(last, terms=(*kept, *terms), minimiser=minimiser))

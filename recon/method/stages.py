"""Stages: a fit is a tuple of minimisations, each with its terms and variables."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Generic

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from recon.body.model import BodyModel
from recon.core.motion import Motion
from recon.core.struct import S
from recon.method.protocols import Estimate
from recon.method.terms import Term
from recon.solver.lbfgs import LBFGS, Progress, Solution

if TYPE_CHECKING:
    from recon.method.priors import Prior


Proposals = Callable[[Estimate, int], tuple[Motion | None, str]]
"""Finds motions to begin a stage from: called with what energies see of one row and its clip's
number; gives motions of the clip in the world, or None to begin from the row, and what reports say
of it, if anything."""


SecondOrder = Callable[
    ["Stage[Any]", BodyModel, Any, Callable[[Progress], bool | None] | None],
    tuple[Any, Solution] | None,
]
"""Minimises a stage from its unknowns by a Hessian: called with the stage, the body, the unknowns
and what is told of progress; None where no Hessian of the stage is known."""


@dataclass(frozen=True)
class Stage(Generic[S]):
    """One minimisation: a prior's variables, the terms of the objective, and the minimiser."""

    name: str
    prior: "Prior[S]"
    terms: tuple[Term, ...]
    free: frozenset[str]
    """Names of the optimised tensors, the prior's (`pose`) or the scene's (`scene.offsets`)."""
    minimiser: LBFGS = LBFGS()
    portion: Callable[[S], S] | None = None
    """The part of the variables that is decoded and compared, such as the first frames or every
    other moment; None decodes them all."""
    rounds: int = 3
    """Number of minimisations with correspondences found anew before each (iterated closest
    points), a third of the iterations each; only where an energy has a method `matched(estimate)`,
    which gives the energy over the correspondences of an estimate. Minimised while it looks for
    the nearest, it would jump where these change, and line searches end there."""
    proposals: Proposals | None = None
    """Finds hypotheses, which are minimised in place of what the stage is handed; None finds
    none."""
    kept: int | None = None
    """Number of hypotheses of every clip that remain after the stage; None keeps them all."""
    ranking: tuple[Term, ...] = ()
    """The objective by which hypotheses are compared; none takes the stage's own."""
    second_order: SecondOrder | None = None
    """How the stage is minimised where the Hessian of its objective is known; `minimiser` has the
    limits and tolerances, and is taken where it is not known."""

    def __post_init__(self) -> None:
        """Refuse a stage without terms, or with two terms of one name.

        Raises:
            ValueError: when there is no term, or two have one name.
        """
        names = [term.name for term in self.terms]
        if len(names) == 0 or len(set(names)) < len(names):
            raise ValueError(f"stage {self.name!r} needs terms of different names, got {names}")

    @property
    def matches(self) -> bool:
        """Whether any energy uses correspondences, which each round of the stage finds anew."""
        return any(hasattr(term.energy, "matched") for term in self.terms)

    def matched(self, estimate: Estimate) -> "Stage[S]":
        """Return the stage with correspondences fixed to those of an estimate."""

        def with_fixed_correspondences(term: Term) -> Term:
            matched = getattr(term.energy, "matched", None)
            return term if matched is None else replace(term, energy=matched(estimate))

        return replace(self, terms=tuple(with_fixed_correspondences(term) for term in self.terms))

    def values(self, estimate: Estimate) -> Float[Tensor, "rows terms"]:
        """Return the weighted energy of every term, for every row of an estimate."""
        return torch.stack([term.weight * term.energy(estimate) for term in self.terms], -1)

    def rows(self, clip: Int[Tensor, " rows"]) -> "Stage[S]":
        """Return the stage with its data rows selected, or repeated, by index of the clip."""
        return replace(self, terms=tuple(term.rows(clip) for term in self.terms))


Stages = Callable[[tuple[Term, ...]], tuple[Stage[Any], ...]]
"""Gives the stages by which data are fitted: what a prior has as its method `stages`."""


@dataclass(frozen=True)
class ComparedHypotheses:
    """The hypotheses that a stage compared at its end, and which of them were kept."""

    clip: Int[Tensor, " rows"]
    """The clip of every hypothesis."""
    value: Float[Tensor, " rows"]
    """The objective by which they were compared; NaN where a fit met NaN or infinity."""
    kept: Bool[Tensor, " rows"]
    motion: Motion
    """What the stage had found from each, in the frame of the recording; axes (rows, time)."""


@dataclass(frozen=True)
class StageReport:
    """The solver's result and time of one stage, with a row for each clip of the batch."""

    stage: Stage[Any]
    solution: Solution
    seconds: float
    compared: ComparedHypotheses | None = None
    """The hypotheses among which the stage chose; None where it left none out."""
    remarks: tuple[str, ...] = ()  # remarks on the motions proposed by a network

    def rows(self, index: Int[Tensor, " rows"]) -> "StageReport":
        """Return the report of the clips `index`; `compared` keeps all its rows."""
        return replace(self, solution=self.solution.rows(index))


Watch = Callable[[str, Progress], bool | None]
"""Told the stage's name and how far its minimisation has come; True ends that stage."""

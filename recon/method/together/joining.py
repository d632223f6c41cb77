"""Problems of several clips as one batch, whose solution is taken apart again.

A fit of one clip knows its noise, and with it the weights of its energies; they stay its own
when it is joined with others. Clips that are shorter than the longest get frames that do not
exist (`Motion.valid`), which change nothing.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, Protocol, cast, runtime_checkable

import torch
from jaxtyping import Float
from torch import Tensor

from recon.core.motion import Motion
from recon.core.struct import TensorStruct, concatenate
from recon.method.newton.model import ClipModel
from recon.method.protocols import Decoded, Energy, Estimate
from recon.method.reconstruction import Reconstruction
from recon.method.running import run_stages
from recon.method.stages import Matched, Stage
from recon.method.terms import Term
from recon.method.together.alike import alike
from recon.method.together.member import Member

_COMPARED = tuple(one.name for one in fields(Stage) if one.name not in ("prior", "terms"))
"""What stages have besides their prior and terms."""


@runtime_checkable
class Shared(Protocol):
    """A prior that can be joined with others of its class that differ in how they encode only."""

    def decodes_like(self, other: Any) -> bool:
        """Whether both decode the same variables to the same motions and energies."""
        ...


def solve_joined(members: Sequence[Member]) -> list[Reconstruction | None]:
    """Solutions of problems that stand beside each other (`Member.beside`).

    None for those whose stages differ from the first one's by more than weights.
    """
    lengths = [max(row) for row in zip(*(one.lengths for one in members), strict=True)]
    problems = [one.stretched(lengths) for one in members]
    stages = [problem.stages() for problem in problems]
    kept = [k for k in range(len(members)) if k == 0 or _one_course(stages[0], stages[k])]
    counts = [members[k].rows for k in kept]
    estimate, reports = run_stages(
        _joined([stages[k] for k in kept], counts),
        problems[0].body,
        concatenate([problems[k].start for k in kept]),
        concatenate([problems[k].scene for k in kept]),
    )
    every = torch.arange(sum(counts), device=estimate.motion.translation.device)
    found: list[Reconstruction | None] = [None] * len(members)
    for k, rows in zip(kept, every.split(counts), strict=True):
        found[k] = members[k].solution(estimate, reports, rows)
    return found


def _one_course(a: Sequence[Stage[Any]], b: Sequence[Stage[Any]]) -> bool:
    """Whether stages are the same but for weights, data, and how their priors encode."""
    return len(a) == len(b) and all(map(_one_stage, a, b))


def _one_stage(a: Stage[Any], b: Stage[Any]) -> bool:
    return (
        a.reweighting is None  # it would find one set of weights for all clips
        and all(alike(getattr(a, name), getattr(b, name)) for name in _COMPARED)
        and [term.name for term in a.terms] == [term.name for term in b.terms]
        and all(_one_energy(x.energy, y.energy) for x, y in zip(a.terms, b.terms, strict=True))
        and _one_decoder(a.prior, b.prior)
    )


def _one_decoder(a: Any, b: Any) -> bool:
    if type(a) is not type(b):
        return False
    return a.decodes_like(b) if isinstance(a, Shared) else alike(a, b)


def _one_energy(a: Energy, b: Energy) -> bool:
    """Whether energies are one function, or records whose tensors can stand in one batch."""
    if not isinstance(a, TensorStruct) or not isinstance(b, TensorStruct):
        return alike(a, b)
    if type(a) is not type(b):
        return False
    x, y = a.tensors(), b.tensors()
    return (
        list(x) == list(y)
        and all(x[path].shape[1:] == y[path].shape[1:] for path in x)
        and alike(_settings(a), _settings(b))
    )


def _settings(record: TensorStruct) -> list[Any]:
    """What a record has besides tensors; clocks to a microsecond (`Member.beside`)."""
    found: list[Any] = []
    for field in fields(cast(Any, record)):
        value = getattr(record, field.name)
        if isinstance(value, TensorStruct):
            found.append(_settings(value))
        elif not isinstance(value, Tensor) and field.name != "start_time":
            found.append(value)
    return found


def _joined(courses: Sequence[tuple[Stage[Any], ...]], counts: Sequence[int]) -> list[Stage[Any]]:
    """The stages of all problems as those of one batch."""
    priors: dict[tuple[int, ...], _Joint] = {}
    stages: list[Stage[Any]] = []
    for same in zip(*courses, strict=True):
        own = tuple(stage.prior for stage in same)
        # stages of one prior go on from its variables, so they need one object
        prior = priors.setdefault(tuple(map(id, own)), _Joint(own, tuple(counts)))
        terms = zip(*(stage.terms for stage in same), strict=True)
        joined = tuple(_joined_term(several, counts) for several in terms)
        stages.append(replace(same[0], prior=prior, terms=joined))
    return stages


def _joined_term(terms: Sequence[Term], counts: Sequence[int]) -> Term:
    first = terms[0]
    energy = first.energy
    if isinstance(energy, TensorStruct):
        records: list[Any] = [term.energy for term in terms]
        energy = cast(Energy, concatenate(records))
    weights = [term.weight for term in terms]
    if len(set(weights)) == 1:
        return Term(first.name, energy, first.weight)
    each = torch.tensor(weights).repeat_interleave(torch.tensor(counts))
    kind = _WeightedMatches if isinstance(energy, Matched) else _Weighted
    return Term(first.name, kind(each, energy), 1.0)


@dataclass(frozen=True)
class _Weighted(TensorStruct):
    """An energy that every clip weighs in its own way."""

    weights: Float[Tensor, " clips"]
    energy: Any

    def __call__(self, estimate: Estimate) -> Float[Tensor, " clips"]:
        found = self.energy(estimate)
        return self.weights.to(found) * found

    def of_clip(self, clip: int) -> tuple[float, Energy]:
        """The weight of a clip, and the energy that is weighed."""
        return float(self.weights[clip]), self.energy


@dataclass(frozen=True)
class _WeightedMatches(_Weighted):
    """A weighted energy over correspondences, which are found anew between minimisations."""

    def matched(self, estimate: Estimate) -> Energy:
        """The energy over the correspondences of this estimate, weighted likewise."""
        return _Weighted(self.weights, self.energy.matched(estimate))


@dataclass(frozen=True, eq=False)
class _Joint:
    """Priors of several problems that decode alike; each encodes its own clips."""

    priors: tuple[Any, ...]
    counts: tuple[int, ...]

    @property
    def level(self) -> bool:
        """Whether their motions are in the world (`recon.method.unknowns.Level`)."""
        return getattr(self.priors[0], "level", False)

    def encode(self, motion: Motion) -> Any:
        """Variables of every problem's motions by its own prior.

        Of some of the clips, as a solver begins anew with those that are not done, they are the
        first prior's: units of variables differ, and what they decode to does not.
        """
        if len(motion.translation) != sum(self.counts):
            return self.priors[0].encode(motion)
        rows = torch.arange(sum(self.counts), device=motion.translation.device)
        parts = zip(self.priors, rows.split(self.counts), strict=True)
        return concatenate([prior.encode(motion[own]) for prior, own in parts])

    def decode(self, variables: Any) -> Decoded:
        """What any of them decodes."""
        return self.priors[0].decode(variables)

    @property
    def reach(self) -> int:
        """Frames up to so far apart couple; see `recon.method.newton.model.Framewise`."""
        return self.priors[0].reach

    def from_steps(self, variables: Any, steps: Float[Tensor, "clips time 69"]) -> Any:
        """Variables after steps of frames; what they mean is how they are decoded."""
        return self.priors[0].from_steps(variables, steps)

    def turns(self, variables: Any, clip: int) -> Float[Tensor, "time 63 63"]:
        """Derivatives of the joints' rotations by steps of the pose."""
        return self.priors[0].turns(variables, clip)

    def add_curvature(self, term: Term, clip: ClipModel) -> bool:
        """Add the Hessian of a term of the prior."""
        return self.priors[0].add_curvature(term, clip)

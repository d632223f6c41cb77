"""Fits under the anchor-frame prior: place, then the code, then the body, then details."""

from dataclasses import dataclass, replace

from priors.anchor.prior import AnchorFrames, AnchorVariables
from recon.method.stages import Stage
from recon.method.terms import Term, prior_energy
from recon.solver.lbfgs import LBFGS

_PLACING = frozenset({"turn", "place"})
_CYCLE = _PLACING | {"latent", "begin"}
_BODY = _CYCLE | {"shape"}
_DETAILS = _BODY | {"bend", "shift"}


@dataclass(frozen=True)
class AnchorFit:
    """The method for observations whose coordinates are off by about `noise` metres.

    Everything is a negative log-probability times noise², so that observations weigh one: codes,
    shapes and details are normal with unit variance (spec of the variables), the ends of cycle
    and recording are `ends` seconds apart.
    """

    prior: AnchorFrames
    noise: float
    """Metres."""
    ends: float = 0.02
    """Seconds."""
    detailed: bool = True
    """Whether data are dense enough to tell what codes cannot express; adds a last stage."""

    def __post_init__(self) -> None:
        """Refuse what has no meaning."""
        for name in ("noise", "ends"):
            if not getattr(self, name) > 0:
                raise ValueError(f"{name} must be above 0, got {getattr(self, name)}")

    @property
    def terms(self) -> tuple[Term, ...]:
        """Densities of codes and shapes, and of the ends and the height of the cycle."""
        variance = self.noise**2
        return (
            Term("latent", prior_energy("latent"), variance),
            Term("shape", prior_energy("shape"), variance),
            Term("ends", prior_energy("ends"), variance / self.ends**2),
            Term("sink", prior_energy("sink"), variance),
        )

    def search(self, data: tuple[Term, ...]) -> tuple[Stage, ...]:
        """A quick fit that tells good beginnings from bad ones."""
        return (
            self._stage("place", data, _PLACING, LBFGS(12)),
            self._stage("rough", data, _CYCLE, LBFGS(30)),
        )

    def stages(self, data: tuple[Term, ...]) -> tuple[Stage, ...]:
        """All stages, which begin from a cycle that is roughly right."""
        return (*self.coded(data), *self.details(data))

    def coded(self, data: tuple[Term, ...]) -> tuple[Stage, ...]:
        """The code, then the body as well."""
        return (
            self._stage("cycle", data, _CYCLE, LBFGS(30, tolerance_decrease=1e-4)),
            self._stage("body", data, _BODY, LBFGS(60, tolerance_decrease=1e-5)),
        )

    def details(self, data: tuple[Term, ...]) -> tuple[Stage, ...]:
        """The last stage, where data are dense: details that codes cannot express."""
        if not self.detailed:
            return ()
        held = Term("details", prior_energy("details"), self.noise**2)
        minimiser = LBFGS(60, tolerance_decrease=1e-5)
        stage = self._stage("details", data, _DETAILS, minimiser)
        return (replace(stage, terms=(*stage.terms, held)),)

    def _stage(
        self, name: str, data: tuple[Term, ...], free: frozenset[str], minimiser: LBFGS
    ) -> Stage[AnchorVariables]:
        return Stage(name, self.prior, (*data, *self.terms), free, minimiser)

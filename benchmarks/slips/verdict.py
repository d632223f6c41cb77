"""What became of one recording: whether it was repaired or warned of, and for which cause."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from benchmarks.slips.kinds import Slip
from recon.diagnosis.findings import Finding

AS_GOOD = 1.2
"""A fit is repaired when its error is at most so many times that of the clean clip."""
CONSEQUENCES = frozenset({"unseen", "gap"})
"""Codes that say where data is missing: they follow from repairs and name no cause."""


@dataclass(frozen=True)
class Verdict:
    """What became of one slipped clip."""

    clip: str
    clean: float
    """Error of the clip without the slip, in the slip's measure, over the samples of `error`."""
    unrepaired: float | None
    """Error of a fit to the slipped data as they are; None where it was not made."""
    error: float
    """Error of the examined fit, where it does not declare joints to be inferred."""
    repairs: tuple[str, ...]
    """Codes."""
    warnings: tuple[str, ...]
    """Codes."""
    named: bool
    """Whether one of the codes is a right name of the cause."""
    first: bool
    """Whether the first code that names a cause is a right one."""

    @classmethod
    def of(cls, row: dict[str, Any]) -> "Verdict":
        """The verdict that a result file holds as a record."""
        codes = {key: tuple(row[key]) for key in ("repairs", "warnings")}
        return cls(**{**row, **codes})

    @property
    def as_good(self) -> bool:
        """Whether the fit is as good as the clean clip's."""
        return self.error <= AS_GOOD * self.clean

    @property
    def caught(self) -> bool:
        """Whether the user gets a right result or is told that it may be wrong."""
        return self.as_good or len(self.warnings) > 0

    @property
    def judged(self) -> bool:
        """Whether there is a cause to name: a slip that does no harm need not be found."""
        return not (self.as_good and len(self.repairs) + len(self.warnings) == 0)


def verdict_of(
    slip: Slip,
    clip: str,
    *,
    clean: float,
    unrepaired: float | None,
    error: float,
    repairs: Sequence[Finding],
    warnings: Sequence[Finding],
) -> Verdict:
    """Judge the findings of one clip by the slip's right names."""
    causes = [f.code for f in (*repairs, *warnings) if f.code not in CONSEQUENCES]
    return Verdict(
        clip=clip,
        clean=clean,
        unrepaired=unrepaired,
        error=error,
        repairs=tuple(f.code for f in repairs),
        warnings=tuple(f.code for f in warnings),
        named=any(code in slip.codes for code in causes),
        first=len(causes) > 0 and causes[0] in slip.codes,
    )

"""Ending a fit early: because the caller says so, or because its time is used up."""

from collections.abc import Callable
from time import monotonic

from recon.method.stages import Watch
from recon.solver.lbfgs import Progress


class Stopper:
    """Watches a fit and stops all that is left of it once it was asked to.

    A fit is several minimisations in turn, and some of them are needed to make a motion at all.
    After the first stop each of them ends at its first step, so that the estimate so far passes
    through the rest within moments.
    """

    def __init__(
        self,
        callback: Watch | None,
        max_seconds: float | None,
        clock: Callable[[], float] = monotonic,
    ) -> None:
        self._callback, self._clock, self._seconds = callback, clock, max_seconds
        self._deadline = None if max_seconds is None else clock() + max_seconds
        self.reason: str | None = None
        """The reason why the fit was stopped; None while it was not."""

    def __call__(self, stage: str, progress: Progress) -> bool:
        """Whether to stop; the callback is asked until it says so."""
        if self.reason is None:
            self.reason = self._why(stage, progress)
        return self.reason is not None

    def _why(self, stage: str, progress: Progress) -> str | None:
        """A reason to stop now."""
        if self._callback is not None and self._callback(stage, progress) is True:
            return "the callback"
        if self._deadline is not None and self._clock() > self._deadline:
            return f"max_seconds = {self._seconds:g}"
        return None

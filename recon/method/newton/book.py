"""What is known of all clips of a stage while some of them are still being minimised."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from recon.method.stages import Stage
from recon.method.unknowns import Layout, Unknowns
from recon.solver.solution import Progress, Solution, Termination


@dataclass
class Book:
    """Unknowns, numbers and ends of all clips; `active` ones are still being worked on."""

    unknowns: Unknowns[Any]
    active: Int[Tensor, " active"]
    iterations: Int[Tensor, " clips"]
    evaluations: Int[Tensor, " clips"]
    termination: list[Termination]
    traces: list[Float[Tensor, "_ terms"]]
    """Term values of every clip at its iterates."""

    @classmethod
    def open(cls, unknowns: Unknowns[Any]) -> "Book":
        """All clips, with nothing done yet."""
        count = len(next(iter(unknowns.tensors().values())))
        none = torch.zeros(count, dtype=torch.int64)
        limit = [Termination.ITERATION_LIMIT] * count
        every = torch.arange(count)
        return cls(unknowns.detach(), every, none, none.clone(), limit, [])

    def of(self, stage: Stage[Any]) -> Stage[Any]:
        """The stage with the data of the clips that are active."""
        return stage.rows(self.active)

    def begin(self, terms: Float[Tensor, "active terms"]) -> None:
        """Enter the terms at the start of all clips; later calls change nothing."""
        if not self.traces:
            self.traces = [row[None] for row in terms.double().cpu()]

    def enter(
        self,
        moved: Unknowns[Any],
        traces: Sequence[Float[Tensor, "_ terms"]],
        evaluations: Sequence[int],
        ends: Sequence[Termination | None],
    ) -> None:
        """Enter where the active clips have been led; those that have an end are active no more.

        Args:
            moved: unknowns of the active clips.
            traces: term values of each at its new iterates.
            evaluations: by which it got there.
            ends: why it ended; None where it goes on.
        """
        new = iter(moved.tensors().values())

        def put(old: Tensor) -> Tensor:
            whole = old.clone()
            whole[self.active] = next(new).detach().to(old)
            return whole

        self.unknowns = self.unknowns.map(put)
        for k, clip in enumerate(self.active.tolist()):
            self.iterations[clip] += len(traces[k])
            self.evaluations[clip] += evaluations[k]
            self.traces[clip] = torch.cat((self.traces[clip], traces[k].double().cpu()))
            self.termination[clip] = ends[k] or Termination.ITERATION_LIMIT
        self.active = self.active[_mask([end is None for end in ends])]

    def stop(self) -> None:
        """End all clips where they are, because the caller wants it."""
        for clip in self.active.tolist():
            self.termination[clip] = Termination.STOPPED
        self.active = self.active[:0]

    def progress(self) -> Progress:
        """What a callback is told."""
        value = torch.stack([trace[-1].sum() for trace in self.traces])
        return Progress(
            int(self.evaluations.max()),
            self.active.numpy().copy(),
            self.iterations.numpy().copy(),
            value.numpy(),
        )

    def solution(self, stage: Stage[Any]) -> Solution:
        """The result, once no clip is active."""
        longest = max(len(trace) for trace in self.traces)
        padded = [t[torch.arange(longest).clamp(max=len(t) - 1)] for t in self.traces]
        trace = torch.stack(padded)
        return Solution(
            x=Layout.of(self.unknowns, stage.free).flatten(self.unknowns),
            value=trace[:, -1].sum(-1),
            iterations=self.iterations,
            evaluations=self.evaluations,
            termination=tuple(self.termination),
            trace=trace,
        )


def _mask(rows: Sequence[bool]) -> Bool[Tensor, " active"]:
    return torch.tensor(rows, dtype=torch.bool)

"""Speed of HuMoR's last stage: one objective and its gradient, ours and a naive roll-out's.

    python -m benchmarks.rollout --threads 1 2 --json rollout.json

Both compute the same numbers (`benchmarks.naive_humor` says how the other does it). Ratios are
taken within one run, the variants in turn; quote those. Weights and latents are drawn: times do
not depend on what they say. About two minutes on two idle cores; where other work shares them, a
second thread waits for the first and its rows say little.
"""

import argparse
import os
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
import torch
from rich.console import Console
from rich.table import Table
from torch import Tensor

import recon
from benchmarks.naive_humor import NaiveHumor
from benchmarks.results import write
from priors.humor.networks import HumorNetworks
from priors.humor.prior import Humor, HumorVariables
from priors.humor.shooting import Shooting
from recon.benchmark.protocols import noisy_joints
from recon.core import rotations as so3
from recon.core.scene import Scene
from recon.core.struct import stack
from recon.formats.motions import load_motion
from recon.method.protocols import Estimate
from recon.method.terms import Term

WIDTHS, CLIPS, FRAMES = (1024, 512), (1, 16), 60
LENGTHS = (30, 60, 120, 240)
SEED = 0
_SMALL_STEPS = 0.1
"""Factor of the decoder's last layer as drawn, so that bodies stay where bodies are."""


def main() -> None:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--threads", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    torch.manual_seed(SEED)
    humors = {width: drawn(width) for width in WIDTHS}
    rows = [
        compare(humors[width], clips, threads)
        for width in WIDTHS
        for clips in CLIPS
        for threads in arguments.threads
    ]
    times = {width: growth(humor) for width, humor in humors.items()}
    show(rows, times)
    if arguments.json is not None:
        write(
            arguments.json,
            SEED,
            rows=[{**asdict(row), "ratio": row.ratio} for row in rows],
            frames=times,
        )


@dataclass(frozen=True)
class Row:
    """Medians of one run, milliseconds."""

    width: int
    clips: int
    threads: int
    naive: float
    ours: float

    @property
    def ratio(self) -> float:
        """The factor by which ours is faster."""
        return self.naive / self.ours


@dataclass(frozen=True)
class Problem:
    """Clips in the last stage of their fit."""

    humor: Humor
    variables: HumorVariables
    terms: tuple[Term, ...]
    free: frozenset[str]

    @classmethod
    def create(cls, humor: Humor, clips: int, frames: int) -> "Problem":
        """First states of the bundled motion, drawn latents, noisy joints of what they make."""
        demo = Path(recon.__file__).parent / "assets" / "demo.npz"
        motion = load_motion(demo).motion.to(dtype=humor.body.template.dtype).resample(30.0)
        motion = motion.replace(rotations=so3.nearest(motion.rotations))
        start = humor.encode(stack([motion.window(k, k + 2) for k in range(clips)]))
        variables = start.replace(
            latents=torch.randn(clips, frames - 1, 48).to(start.latents),
            valid=torch.ones(clips, frames, dtype=torch.bool),
        )
        seen = noisy_joints(humor.decode(variables).motion, humor.body, SEED)
        stage = Shooting(humor).stages((Term("data", seen, 1.0),))[-1]
        return cls(humor, variables, stage.terms, stage.free)

    def ours(self) -> tuple[Tensor, dict[str, Tensor]]:
        """Objective and gradient as the library computes them."""
        variables, leaves = self._leaves()
        decoded = self.humor.decode(variables)
        posed = self.humor.body.pose(decoded.motion)
        value = self._objective(Estimate(decoded, posed, self._scene()))
        gradients = torch.autograd.grad(value, list(leaves.values()))
        return value.detach(), dict(zip(leaves, gradients, strict=True))

    def naive(self, naive: NaiveHumor) -> tuple[Tensor, dict[str, Tensor]]:
        """The same, computed naively; gradients of the weights are formed and never read."""
        variables, leaves = self._leaves()
        value = self._objective(naive.estimate(variables, self._scene()))
        value.backward()
        return value.detach(), {
            k: leaf.grad for k, leaf in leaves.items() if leaf.grad is not None
        }

    def _leaves(self) -> tuple[HumorVariables, dict[str, Tensor]]:
        tensors = self.variables.tensors()
        moved = {k: tensors[k].detach().clone().requires_grad_() for k in sorted(self.free)}
        return self.variables.replace(**moved), moved

    def _scene(self) -> Scene:
        return Scene.create(len(self.variables.shape), like=self.variables.shape)

    def _objective(self, estimate: Estimate) -> Tensor:
        return torch.stack([t.weight * t.energy(estimate) for t in self.terms]).sum()


def drawn(width: int) -> Humor:
    """Networks of a width with drawn weights."""
    networks = HumorNetworks(width).requires_grad_(False)
    for parameter in networks.decoder.net[-1].parameters():
        parameter.mul_(_SMALL_STEPS)
    return replace(Humor.load(), networks=networks)


def compare(humor: Humor, clips: int, threads: int) -> Row:
    """Times of both roll-outs, run in turn."""
    problem, naive = Problem.create(humor, clips, FRAMES), NaiveHumor.of(humor)
    calls: dict[str, Callable[[], object]] = {
        "naive": lambda: problem.naive(naive),
        "ours": problem.ours,
    }
    torch.set_num_threads(threads)
    seconds = in_turn(calls, rounds=7 if clips == 1 else 3)
    torch.set_num_threads(1)
    naive_ms, ours_ms = 1e3 * seconds["naive"], 1e3 * seconds["ours"]
    return Row(humor.networks.width, clips, threads, naive_ms, ours_ms)


def growth(humor: Humor) -> dict[int, float]:
    """Milliseconds of ours by the number of frames; one clip, one thread, the lengths in turn."""
    calls: dict[str, Callable[[], object]] = {
        str(frames): Problem.create(humor, 1, frames).ours for frames in LENGTHS
    }
    return {int(frames): 1e3 * s for frames, s in in_turn(calls, rounds=15).items()}


def in_turn(calls: dict[str, Callable[[], object]], rounds: int) -> dict[str, float]:
    """Median seconds of each; of two calls in a turn the second counts, which finds its memory."""
    times: dict[str, list[float]] = {name: [] for name in calls}
    for _ in range(rounds):
        for name, call in calls.items():
            call()
            began = time.perf_counter()
            call()
            times[name].append(time.perf_counter() - began)
    return {name: float(np.median(values)) for name, values in times.items()}


def show(rows: list[Row], times: dict[int, dict[int, float]]) -> None:
    """Two tables."""
    title = f"objective and gradient, {FRAMES} frames, {os.cpu_count()} cores"
    table = Table("width", "clips", "threads", "naive, ms", "ours, ms", "faster by", title=title)
    for r in rows:
        numbers = (str(n) for n in (r.width, r.clips, r.threads))
        table.add_row(*numbers, f"{r.naive:.0f}", f"{r.ours:.1f}", f"{r.ratio:.1f}")
    Console().print(table)
    table = Table("width", *(f"{n} frames" for n in LENGTHS), title="ours, ms per frame")
    for width, by_frames in times.items():
        table.add_row(str(width), *(f"{by_frames[n] / n:.3f}" for n in LENGTHS))
    Console().print(table)


if __name__ == "__main__":
    main()

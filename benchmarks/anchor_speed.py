"""How long a completion takes: by the command, alone in a running process, and in a batch.

    python -m benchmarks.anchor_speed CORPUS --weights nc
        --json benchmarks/results/anchor_speed.json

Validation cycles, scanned as in benchmarks/scans.py; processor seconds of one thread, restarts
included, which other work on the machine does not move much; wall-clock seconds beside them. The
batch repeats the cycles until it is full. The command (`recon complete`, landmarks alone) pays
for the start of a process, the weights and the first use of everything besides.
"""

import subprocess
import sys
from collections.abc import Callable
from dataclasses import astuple, dataclass
from functools import partial
from pathlib import Path
from resource import RUSAGE_CHILDREN, getrusage
from tempfile import TemporaryDirectory
from time import perf_counter, process_time

import torch

from benchmarks.anchor import asked, parser
from benchmarks.complete import COLUMNS, observe, together
from benchmarks.cycles import chosen, found_cycles
from benchmarks.results import corpus_source, show, write
from benchmarks.scans import ScannedCycle, scanned_cycle
from observations.kinds import InSpace
from recon.body.model import BodyModel
from recon.fitting.cycles import complete
from recon.fitting.methods import FitOptions
from recon.formats.observations import save_observation

_SINGLE = 4
_COMMANDS = 2
_CASES = ("p=0", "p=50+lm", "f=5+lm")


@dataclass(frozen=True)
class Spent:
    """Seconds of the processor and of the wall clock."""

    processor: float
    wall: float

    def each(self, count: int) -> "Spent":
        """A part of it."""
        return Spent(*(value / count for value in astuple(self)))


def main() -> None:
    """Measure, print and write."""
    own = parser(__doc__)
    own.add_argument("--columns", nargs="*", choices=COLUMNS, default=_CASES)
    own.add_argument("--batch", type=int, default=32)
    arguments = own.parse_args()
    ask = asked(arguments)
    torch.set_num_threads(1)
    body = BodyModel.load()
    settings = FitOptions(prior="anchor", weights=ask.weights)
    cycles = chosen(list(found_cycles(ask.corpus, ask.splits, "validation")), 2)[:_SINGLE]
    scanned = [scanned_cycle(c.clip, c.subject, c.motion, body) for c in cycles]
    table: dict[str, dict[str, float]] = {}
    command = by_command(scanned[:_COMMANDS], ask.weights).each(_COMMANDS)
    table["p=0, command"] = {"processor_s": command.processor, "wall_s": command.wall}
    show("p=0, command", table["p=0, command"])
    for name in arguments.columns:
        seen = [observe(one, COLUMNS[name], body) for one in scanned]
        complete(seen[0], settings, body)  # warms caches
        single = spent(partial(_in_turn, seen, settings, body)).each(len(seen))
        batch = together([seen[k % len(seen)] for k in range(arguments.batch)])
        each = spent(partial(complete, batch, settings, body)).each(arguments.batch)
        row = {
            "single_s": single.processor, "single_wall_s": single.wall,
            "batch_s": each.processor, "batch_wall_s": each.wall,
            "throughput": single.processor / each.processor,
        }  # fmt: skip
        if name == "p=0":
            row["throughput_commands"] = command.processor / each.processor
        table[name] = row
        show(name, row)
        if ask.json is not None:
            write(ask.json, 0, corpus_source(ask.corpus),
                  weights=ask.weights, batch=arguments.batch, seconds=table)  # fmt: skip


def _in_turn(seen: list[list[InSpace]], settings: FitOptions, body: BodyModel) -> None:
    for one in seen:
        complete(one, settings, body)


def spent(work: Callable[[], object]) -> Spent:
    """What some work of this process takes."""
    began = process_time(), perf_counter()
    work()
    return Spent(process_time() - began[0], perf_counter() - began[1])


def by_command(scanned: list[ScannedCycle], weights: str) -> Spent:
    """What completing the landmarks of each takes, a process after the other."""
    with TemporaryDirectory() as folder:
        paths = [Path(folder) / f"{k}.npz" for k in range(len(scanned))]
        for path, one in zip(paths, scanned, strict=True):
            save_observation(path, one.landmarks)
        began = getrusage(RUSAGE_CHILDREN), perf_counter()
        for path in paths:
            subprocess.run(
                [sys.executable, "-m", "recon", "complete", str(path), "--prior", "anchor",
                 "--weights", weights, "--out", str(path.with_suffix(".motion.npz"))],
                check=True, capture_output=True,
            )  # fmt: skip
        ended = getrusage(RUSAGE_CHILDREN), perf_counter()
    used = [use.ru_utime + use.ru_stime for use, _ in (began, ended)]
    return Spent(used[1] - used[0], ended[1] - began[1])


if __name__ == "__main__":
    main()

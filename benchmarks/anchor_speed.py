"""How long a completion takes, alone and in a batch.

    python -m benchmarks.anchor_speed CORPUS --weights open
        --json benchmarks/results/anchor_speed.json

Validation cycles, scanned as in benchmarks/scans.py; wall-clock seconds of one process of one
thread, restarts included. The batch repeats the cycles until it is full.
"""

from pathlib import Path
from time import perf_counter

import torch

from benchmarks.anchor import asked, parser
from benchmarks.complete import COLUMNS, observe, together
from benchmarks.cycles import chosen, found_cycles
from benchmarks.results import show, write
from benchmarks.scans import scanned_cycle
from recon.body import BodyModel
from recon.completion import complete
from recon.settings import FitSettings

BATCH = 32
_SINGLE = 4
_CASES = ("p=0", "p=50+lm", "p=1000+lm", "f=5+lm")


def main() -> None:
    """Measure, print and write."""
    ask = asked(parser(__doc__).parse_args())
    torch.set_num_threads(1)
    body = BodyModel.load()
    settings = FitSettings(prior="anchor", weights=ask.weights)
    cycles = chosen(list(found_cycles(Path(ask.corpus), ask.splits, "validation")), 2)
    scanned = [scanned_cycle(c.clip, c.subject, c.motion, body) for c in cycles]
    table: dict[str, dict[str, float]] = {}
    for name in _CASES:
        seen = [observe(one, COLUMNS[name], body) for one in scanned]
        complete(seen[0], settings, body)  # warms caches
        began = perf_counter()
        for one in seen[:_SINGLE]:
            complete(one, settings, body)
        single = (perf_counter() - began) / _SINGLE
        batch = together([seen[k % _SINGLE] for k in range(BATCH)])
        began = perf_counter()
        complete(batch, settings, body)
        each = (perf_counter() - began) / BATCH
        table[name] = {"single_s": single, "batch_s": each, "throughput": single / each}
        show(name, table[name])
    if ask.json is not None:
        command = "python -m benchmarks.anchor_speed CORPUS"
        write(ask.json, command, 0, weights=ask.weights, seconds=table)


if __name__ == "__main__":
    main()

"""What made-up motions in HuMoR's training are worth to strangers: one training per variation.

    python -m benchmarks.strangers.variety CORPUS FOLDS --only 60 14 --json variety.json

Every variation of `VARIANTS` is trained like a fold of `benchmarks.strangers`, in a folder of its
own name within FOLDS, and fits the same windows by collocation; the pose density learns from the
recordings alone, so that the pose prior is fitted once, with the first variation. What is kept is
used again as there. With `--continued 500` every variation, `base` too, goes on from the weights
of `base` by so many steps: all have seen the recordings equally long, in a fifth of the time.
"""

import argparse
import json
from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import torch
from rich.console import Console
from rich.table import Table

from benchmarks.results import ROOT, commit, corpus_source, dumps, write
from benchmarks.strangers.choice import FRAMES, RUN_FRAMES, chosen
from benchmarks.strangers.fits import HUMOR, POSE, RUNS, SEED, WHOLE, fits
from benchmarks.strangers.folds import Fold, corpus_folds
from benchmarks.strangers.training import Schedule, trained
from benchmarks.tables.variety import HEADINGS, lines
from recon.benchmark.dataset import Splits, clip_files
from recon.body.model import BodyModel
from recon.formats.opening import replacing
from training.humor.variation import VARIED, Variation

BASE = "base"
ALL = replace(VARIED, speed=Variation.speed, shape=Variation.shape)
_ALONE = ("halves", "raises", "sidesteps", "bends", "flights", "arms", "kinds", "people")
VARIANTS: Mapping[str, Variation] = {
    BASE: Variation(),
    "all": ALL,
    **{name: replace(Variation(), **{name: getattr(ALL, name)}) for name in _ALONE},
}
"""Settings by name: all of them, and each alone."""


def main() -> None:
    """Train, fit, print and write, variation by variation."""
    arguments = _arguments()
    torch.set_num_threads(1)
    corpus, body = arguments.corpus, BodyModel.load()
    splits = Splits.load()
    files = clip_files(corpus)
    read = [files[c] for c, part in splits.parts(list(files)).items()
            if part in ("train", "validation") and splits.is_open(c)]  # fmt: skip
    found: dict[str, dict[str, Any]] = {}
    for fold in corpus_folds(corpus, splits, body, arguments.only):
        for name in arguments.variants:
            row = measured(
                fold, name, corpus, arguments.folds, arguments.windows, body, arguments.continued
            )
            found.setdefault(name, {})[fold.name] = row
            table = Table(*HEADINGS)
            for line in lines(found):
                table.add_row(*line)
            Console(width=200).print(table)
            if arguments.json is not None:
                write(arguments.json, SEED, corpus_source(corpus, read),
                      continued=arguments.continued,
                      settings={key: asdict(VARIANTS[key]) for key in found},
                      variants=found)  # fmt: skip


def measured(
    fold: Fold,
    name: str,
    corpus: Path,
    folder: Path,
    count: int,
    body: BodyModel,
    continued: int = 0,
) -> dict[str, Any]:
    """Rows of a fold under one variation; protocols that this commit has fitted are kept."""
    schedule = Schedule()
    if continued > 0:
        start = folder / BASE / fold.name / "humor.safetensors"
        if not start.is_file():
            trained(fold, corpus, folder / BASE, schedule, VARIANTS[BASE])
        schedule, folder = Schedule(steps=continued, start=start), folder / f"continued{continued}"
    priors = trained(fold, corpus, folder / name, schedule, VARIANTS[name])
    identity = {"commit": commit(ROOT), "windows": count, "weights": priors.checksums}
    kept = folder / name / fold.name / "variety.json"
    parts = _earlier(kept, identity)
    methods = (POSE, HUMOR) if name == BASE else (HUMOR,)
    for frames, protocols, kind in ((FRAMES, WHOLE, None), (RUN_FRAMES, RUNS, "run")):
        windows = chosen(fold, corpus, body, frames, count, kind)
        if windows is None:
            continue
        for protocol in protocols:
            part = f"{frames} {protocol}"
            if part in parts:
                continue
            rows = fits(windows, (protocol,), priors, body, methods)
            parts[part] = [asdict(row) for row in rows]
            with replacing(kept) as beside:
                beside.write_text(dumps({"identity": identity, "parts": parts}), encoding="utf-8")
    rows = [row for part in parts.values() for row in part]
    return json.loads(json.dumps({"drift": priors.drift, "rows": rows}))


def _earlier(kept: Path, identity: dict[str, Any]) -> dict[str, Any]:
    """What was fitted already, by protocol; nothing where it was of other code or weights."""
    own = identity["commit"]
    if not kept.is_file() or own is None or own.endswith("+"):
        return {}
    earlier = json.loads(kept.read_text(encoding="utf-8"))
    return earlier["parts"] if earlier["identity"] == identity else {}


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("corpus", type=Path, help="folder of all converted motions")
    parser.add_argument("folds", type=Path, help="folder of the variations' weights and fits")
    parser.add_argument("--only", nargs="+", default=None, help="names of folds, in this order")
    parser.add_argument("--variants", nargs="+", choices=VARIANTS, default=list(VARIANTS))
    parser.add_argument("--continued", type=int, default=0,
                        help="steps from the weights of base; 0 begins from scratch")  # fmt: skip
    parser.add_argument("--windows", type=int, default=8, help="fitted of every fold")
    parser.add_argument("--json", type=Path, default=None)
    return parser.parse_args()


if __name__ == "__main__":
    main()

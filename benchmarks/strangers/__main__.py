"""The number to choose by: priors on people whom neither they nor their pose density ever saw.

    python -m benchmarks.strangers CORPUS FOLDS --json strangers.json
    python -m benchmarks.strangers CORPUS FOLDS --only 35 60 --steps 1500 --json strangers.json

Leave-one-person-out over all people outside test. In every fold HuMoR and the pose density learn
from everybody else, by a short schedule and from scratch; then at least eight windows of the
person are fitted by collocation and under the pose prior alone, both with the fold's weights.
Test people are in no fold and in no training. Clips of unknown people are held out in no fold; the
ones that move like a fold's people (`benchmarks.likeness`) are not learned from either.

FOLDS is a folder where weights, checkpoints and fits are kept. A fold that is trained is not
trained again, a training that was interrupted goes on, and a fold that this commit has fitted is
not fitted again.
"""

import argparse
import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import torch
from rich.console import Console
from rich.table import Table

from benchmarks.results import ROOT, commit, corpus_source, dumps, write
from benchmarks.strangers.choice import FRAMES, RUN_FRAMES, chosen
from benchmarks.strangers.fits import RUNS, SEED, WHOLE, fits
from benchmarks.strangers.folds import Fold, corpus_folds
from benchmarks.strangers.training import Schedule, trained
from benchmarks.tables.strangers import HEADINGS, lines
from recon.benchmark.dataset import SPLITS, Splits, clip_files
from recon.body.model import BodyModel
from recon.formats.opening import replacing


def main() -> None:
    """Train, fit, print and write, fold by fold."""
    arguments = _arguments()
    torch.set_num_threads(1)
    schedule = Schedule(arguments.steps, arguments.batch, arguments.width)
    corpus, body, found = arguments.corpus, BodyModel.load(), {}
    splits = Splits.load(arguments.splits)
    files = clip_files(corpus)
    read = [files[c] for c, part in splits.parts(list(files)).items()
            if part in ("train", "validation") and splits.is_open(c)]  # fmt: skip
    for fold in corpus_folds(corpus, splits, body, arguments.only):
        found[fold.name] = measured(
            fold, corpus, arguments.folds, schedule, arguments.windows, body
        )
        table = Table(*HEADINGS)
        for line in lines(found):
            table.add_row(*line)
        Console(width=200).print(table)
        if arguments.json is not None:
            write(arguments.json, SEED, corpus_source(corpus, read),
                  schedule=asdict(schedule), folds=found)  # fmt: skip


def measured(
    fold: Fold, corpus: Path, folder: Path, schedule: Schedule, count: int, body: BodyModel
) -> dict[str, Any]:
    """The entry of a fold in a result file: as this commit found it earlier, or measured now."""
    priors = trained(fold, corpus, folder, schedule)
    own = commit(ROOT)
    identity = {"commit": own, "windows": count, "weights": priors.checksums}
    kept = folder / fold.name / "fits.json"
    if kept.is_file() and own is not None and not own.endswith("+"):
        earlier = json.loads(kept.read_text(encoding="utf-8"))
        if earlier["identity"] == identity:
            return earlier["found"]
    rows = []
    for frames, protocols, kind in ((FRAMES, WHOLE, None), (RUN_FRAMES, RUNS, "run")):
        windows = chosen(fold, corpus, body, frames, count, kind)
        if windows is not None:
            rows += [asdict(row) for row in fits(windows, protocols, priors, body)]
    found = {
        "people": list(fold.people),
        "excluded": list(fold.splits.excluded),
        "drift": priors.drift,
        "rows": rows,
    }
    # as JSON gives it back, so that what is shown now is what is shown later
    found = json.loads(json.dumps(found))
    with replacing(kept) as beside:
        beside.write_text(dumps({"identity": identity, "found": found}), encoding="utf-8")
    return found


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("corpus", type=Path, help="folder of all converted motions")
    parser.add_argument("folds", type=Path, help="folder of the folds' weights and fits")
    parser.add_argument("--only", nargs="+", default=None, help="names of folds, in this order")
    parser.add_argument("--steps", type=int, default=Schedule.steps, help="of HuMoR's training")
    parser.add_argument("--batch", type=int, default=Schedule.windows, help="windows per step")
    parser.add_argument("--width", type=int, default=Schedule.width, help="of HuMoR's networks")
    parser.add_argument("--windows", type=int, default=8, help="fitted of every fold")
    parser.add_argument("--splits", type=Path, default=SPLITS)
    parser.add_argument("--json", type=Path, default=None)
    return parser.parse_args()


if __name__ == "__main__":
    main()

"""Measures priors on people whom neither they nor their pose density ever saw.

    python -m benchmarks.strangers CORPUS FOLDS --out FOLDER
    python -m benchmarks.strangers CORPUS FOLDS --only 35 60 --steps 1500

This is the number to choose by: leave-one-person-out over all people outside test. In every fold
HuMoR and the pose density learn from everybody else, by a short schedule and from scratch; then at
least eight windows of the person are fitted by collocation and under the pose prior alone, both
with the fold's weights. Test people are in no fold and in no training. Clips of unknown people are
held out in no fold; those that move like a fold's people (`benchmarks.strangers.folds`) are not
learned from either.

FOLDS is a folder where weights, checkpoints and fits are kept. A trained fold is not trained
again, an interrupted training continues, and a fold that this commit has fitted is not fitted
again.
"""

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import torch

from benchmarks.protocol import ROOT, commit, parser, tell
from benchmarks.strangers.choice import FRAMES, RUN_FRAMES, chosen
from benchmarks.strangers.compare import tables
from benchmarks.strangers.fits import RUNS, SEED, WHOLE, fits
from benchmarks.strangers.folds import Fold, corpus_folds
from benchmarks.strangers.training import Schedule, trained
from recon import BodyModel
from recon.benchmark.dataset import SPLITS, Splits, clip_files
from recon.formats.replacing import write_text


def main() -> None:
    """Train, fit, print and write the table, fold by fold."""
    arguments = parser(__doc__, "corpus", "folds")
    arguments.add_argument("--only", nargs="+", default=None, help="names of folds, in this order")
    arguments.add_argument("--steps", type=int, default=Schedule.steps, help="of HuMoR's training")
    arguments.add_argument("--batch", type=int, default=Schedule.windows, help="windows per step")
    arguments.add_argument("--width", type=int, default=Schedule.width, help="of HuMoR's networks")
    arguments.add_argument("--windows", type=int, default=8, help="fitted of every fold")
    arguments.add_argument("--splits", type=Path, default=SPLITS)
    given = arguments.parse_args()
    torch.set_num_threads(1)
    schedule = Schedule(given.steps, given.batch, given.width)
    corpus, body, found = given.corpus, BodyModel.load(), dict[str, dict[str, Any]]()
    splits = Splits.load(given.splits)
    files = clip_files(corpus)
    read = [files[c] for c, part in splits.parts(list(files)).items()
            if part in ("train", "validation") and splits.has_open_licence(c)]  # fmt: skip
    note = (f"HuMoR of width {schedule.width}, {schedule.steps} steps of {schedule.windows} "
            "windows from scratch.")  # fmt: skip
    for fold in corpus_folds(corpus, splits, body, given.only):
        found[fold.name] = measured(fold, corpus, given.folds, schedule, given.windows, body)
        tell(given.out, SEED, {"CORPUS": (corpus, read)}, tables(found, note))


def measured(
    fold: Fold, corpus: Path, folder: Path, schedule: Schedule, count: int, body: BodyModel
) -> dict[str, Any]:
    """Return a fold's results: those that this commit found earlier, or measured now."""
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
    found = {"people": fold.people, "excluded": fold.splits.excluded, "rows": rows}
    # returned as read back from JSON, so that new and stored results have the same types
    text = json.dumps({"identity": identity, "found": found}, indent=1)
    write_text(kept, text)
    return json.loads(text)["found"]


if __name__ == "__main__":
    main()

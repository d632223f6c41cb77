"""Are slips repaired or warned of, is their cause named, and are good recordings left in peace?

    python -m benchmarks.slips CORPUS --good 300 --observations OBSERVATIONS --json slips.json
    python -m benchmarks.slips CORPUS --part validation --clips 3 --sensor joints3d
    python -m benchmarks.slips CORPUS --part validation --slip mirrored --unrepaired
    python -m benchmarks.slips CORPUS --part validation --clips 0 --good 20 --observations FOLDER

45 slips (`benchmarks.slips.kinds`) at sizes that were fixed on validation people
(`benchmarks.slips.sizes`), each on 20 test windows of two seconds: joints with 2 cm of noise, 43
markers with 1 cm, keypoints with 3 pixels. A slip is caught (`told`) when a warning is given or
the fit is as good as the clean clip's (`good`: within 1.2 times its error, over the joints that
the slip spoils, or over the others where the fit declares those to be inferred rather than seen).
It is `named` when one of the codes that were reported is right, and named `first` when the first
of them is; clips that a slip does no harm to, and about which nothing is said, count in neither.
`as is` is the error of a fit without examination. `--good` fits recordings without a slip
(`benchmarks.slips.good`); what is said about them and is not so is a false alarm. The whole table
is a matter of hours: with --json, a run that was interrupted goes on where it stopped, as long as
the code is the same and committed.
"""

import argparse
import json
from pathlib import Path
from typing import Any

from benchmarks.results import (
    ROOT,
    Sources,
    commit,
    corpus_source,
    recordings_source,
    write,
)
from benchmarks.slips.good import GoodWindows, listed, some_of
from benchmarks.slips.kinds import SLIPS
from benchmarks.slips.recordings import SENSORS, evenly, windows_of
from benchmarks.slips.sizes import chosen_sizes
from benchmarks.slips.table import (
    HEADING,
    Judged,
    false_alarms,
    judged,
    line,
    quiet,
    summary,
    totals,
)
from recon.body.model import BodyModel
from recon.fitting.methods import FitOptions

CLIPS = 20


def main() -> None:
    arguments = parsed()
    body, settings = BodyModel.load(), FitOptions(prior=arguments.prior)
    every = windows_of(arguments.corpus, arguments.part, body)
    clips = evenly(every, arguments.clips)
    sources: Sources = corpus_source(arguments.corpus, every.files)
    head = {
        "part": arguments.part,
        "prior": arguments.prior,
        "windows": [every.names[k] for k in clips],
    }
    tables = head | begun(arguments.json, head)
    if arguments.clips > 0:
        slips = [s for s in SLIPS if s.sensor in arguments.sensor and arguments.slip in s.name]
        done = [Judged.of(s, tables["slips"][s.key]) for s in slips if s.key in tables["slips"]]
        left = [s for s in slips if s.key not in tables["slips"]]
        print("\n".join([HEADING, *(line(found) for found in done)]), flush=True)
        for found in judged(
            every, clips, left, chosen_sizes(), settings, body, unrepaired=arguments.unrepaired
        ):
            done.append(found)
            tables["slips"][found.slip.key] = found.report()
            tables["totals"] = totals(done)
            print(line(found), flush=True)
            if arguments.json is not None:
                write(arguments.json, 0, sources, **tables)
        print(summary(done))
    if arguments.good > 0:
        chosen = some_of(listed(arguments.part), arguments.good)
        real = [window.source for window in chosen if not window.variant]
        sources = {**sources, **recordings_source(arguments.observations, real)}
        known = {row["window"] for row in tables["good"]}
        rest = [window for window in chosen if window.name not in known]
        good = GoodWindows(every, arguments.observations, body)
        for row in quiet(good, rest, settings, body):
            tables["good"].append(row)
            if arguments.json is not None:
                write(arguments.json, 0, sources, **tables)
        print(false_alarms(tables["good"]))


def begun(path: Path | None, head: dict[str, Any]) -> dict[str, Any]:
    """What an interrupted run of the same commit and clips has found; nothing otherwise."""
    nothing: dict[str, Any] = {"slips": {}, "good": []}
    if path is None or not path.is_file():
        return nothing
    earlier = json.loads(path.read_text())
    same = {key: earlier.get(key) for key in head} == head
    here = commit(ROOT)
    clean = here is not None and not here.endswith("+") and earlier["about"]["commit"] == here
    return {key: earlier[key] for key in nothing} if same and clean else nothing


def parsed() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("corpus", type=Path)
    parser.add_argument("--part", choices=("test", "validation"), default="test")
    parser.add_argument("--clips", type=int, default=CLIPS, help="windows of each slip")
    parser.add_argument("--good", type=int, default=0, help="fit so many good windows, too")
    parser.add_argument("--sensor", choices=SENSORS, nargs="+", default=list(SENSORS))
    parser.add_argument("--slip", default="", help="slips whose name contains this")
    parser.add_argument("--prior", choices=("pose", "humor"), default="humor")
    parser.add_argument("--unrepaired", action="store_true", help="fit as they are, too")
    parser.add_argument("--observations", type=Path, help="folder of real recordings, for --good")
    parser.add_argument("--json", type=Path, default=None)
    arguments = parser.parse_args()
    if arguments.good > 0 and arguments.observations is None:
        parser.error("--good needs --observations, the folder of real recordings")
    return arguments


if __name__ == "__main__":
    main()

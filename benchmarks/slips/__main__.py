"""Measures whether mistakes in data are repaired or reported, and good data left in peace.

    python -m benchmarks.slips CORPUS OBSERVATIONS --good 300 --out FOLDER
    python -m benchmarks.slips CORPUS OBSERVATIONS --part validation --clips 3 --sensor joints3d
    python -m benchmarks.slips CORPUS OBSERVATIONS --part validation --clips 0 --good 20

45 slips (`benchmarks.slips.kinds`) at sizes that were fixed on validation people, each on 20 test
windows of two seconds: joints with 2 cm of noise, 43 markers with 1 cm, keypoints with 3 pixels. A
slip is caught when a warning is given or the fit is as good as the clean clip's: within 1.2 times
its error, over the joints that the slip spoils, or over the others where the fit declares those to
be inferred rather than seen. It is named when one of the reported codes is right; clips that a
slip does not harm, and about which nothing is reported, do not count. `--good` fits recordings
without a slip (`benchmarks.slips.good`); a wrong finding about them is a false alarm. The whole
table takes hours.
"""

from collections import Counter
from collections.abc import Mapping, Sequence

import recon
from benchmarks.protocol import Cell, Table, evenly, number, parser, recordings_source, tell
from benchmarks.slips.good import GoodWindow, GoodWindows, alarms, listed, some_of
from benchmarks.slips.judging import Verdict, slipped
from benchmarks.slips.kinds import SLIPS, Slip
from benchmarks.slips.recordings import SENSORS, recording_of
from recon.benchmark.dataset import Splits
from recon.benchmark.table import mean_with_interval
from recon.benchmark.windows import load_windows


def main() -> None:
    """Spoil, fit, judge, print and write the tables."""
    arguments = parser(__doc__, "corpus", "observations")
    arguments.add_argument("--part", choices=("test", "validation"), default="test")
    arguments.add_argument("--clips", type=int, default=20, help="windows of each slip")
    arguments.add_argument("--good", type=int, default=0, help="fit so many good windows, too")
    arguments.add_argument("--sensor", choices=SENSORS, nargs="+", default=list(SENSORS))
    arguments.add_argument("--slip", default="", help="slips whose name contains this")
    arguments.add_argument("--prior", choices=("pose", "humor"), default="pose")
    given = arguments.parse_args()
    body = recon.BodyModel.load()
    windows = load_windows(given.corpus, Splits.load(), given.part, body)
    found: dict[Slip, list[Verdict]] = {}
    for sensor in given.sensor if given.clips > 0 else ():
        recordings = [recording_of(windows, k, sensor, body) for k in evenly(windows, given.clips)]
        own = [slip for slip in SLIPS if slip.sensor == sensor and given.slip in slip.name]
        clean = [recon.fit(r.clean, given.prior, body=body, repair=False)
                 for r in recordings if own]  # fmt: skip
        for slip in own:
            pairs = zip(recordings, clean, strict=True)
            found[slip] = [slipped(slip, r, fit, given.prior) for r, fit in pairs]
            print(_row(slip, found[slip]), flush=True)
    tables = {"slips": of_slips(found)} if found else {}
    chosen = some_of(listed(given.part), given.good)
    good = GoodWindows(windows, given.observations, body)
    said: dict[GoodWindow, set[str]] = {}
    for window in chosen:
        result = recon.fit(good.load(window), given.prior, body=body)
        wrong = alarms(window, (*result.repairs, *result.warnings))
        said[window] = {str(finding.code) for finding in wrong}
        for finding in wrong:
            print(f"{window.name}: {finding.code}: {finding.message}", flush=True)
    tables |= {"false-alarms": of_good(said)} if said else {}
    real = [window.source for window in chosen if not window.variant]
    more = recordings_source(given.observations, real) if real else {}
    sources = {"CORPUS": (given.corpus, windows.files), **more}
    tell(given.out, 0, sources, tables)


def of_slips(found: Mapping[Slip, Sequence[Verdict]]) -> Table:
    """Build a table of slips: errors, and how many clips were as good, caught and named."""
    every = [clip for clips in found.values() for clip in clips]
    rows: list[list[Cell]] = [_row(slip, clips) for slip, clips in found.items()]
    rows.append(["all", None, None, None, *_counts(every)])
    named = [clip for clip in every if clip.judged]
    note = (f"As good or warned: {_share([c.caught for c in every], every)}. "
            f"Cause named: {_share([c.named for c in named], named)}.")  # fmt: skip
    heads = (("size", None), ("clean", 1), ("examined", 1), ("as good", None),
             ("as good or warned", None), ("named", None))  # fmt: skip
    return Table([("sensor: slip", None), *heads], rows, note=note)


def _row(slip: Slip, clips: Sequence[Verdict]) -> list[Cell]:
    """Return mean errors of the clean and of the spoiled clips (cm, or factors), and counts."""
    factor = 1 if slip.measure == "speed" else 100
    means = [sum(own) / len(clips) for own in
             ([c.clean for c in clips], [c.error for c in clips])]  # fmt: skip
    size = f"{slip.size:g} {slip.unit}".strip()
    return [slip.key, size, *(number(mean, factor) for mean in means), *_counts(clips)]


def _counts(clips: Sequence[Verdict]) -> list[Cell]:
    judged = [clip for clip in clips if clip.judged]
    return [
        f"{sum(clip.as_good for clip in clips)}/{len(clips)}",
        f"{sum(clip.caught for clip in clips)}/{len(clips)}",
        f"{sum(clip.named for clip in judged)}/{len(judged)}",
    ]


def _share(flags: Sequence[bool], clips: Sequence[Verdict]) -> str:
    """Return a share in percent with its 95 % interval over clips."""
    names = [clip.clip for clip in clips]
    found = mean_with_interval([float(flag) for flag in flags], names, ["all"] * len(names))
    return f"{100 * found.mean:.1f} % [{100 * found.low:.1f}, {100 * found.high:.1f}]"


def of_good(said: Mapping[GoodWindow, set[str]]) -> Table:
    """Build a table of wrong findings about good windows, by sensor or collection."""
    by_kind: dict[str, list[set[str]]] = {}
    for window, codes in said.items():
        by_kind.setdefault(_kind(window), []).append(codes)
    rows: list[list[Cell]] = []
    for kind, own in sorted(by_kind.items()):
        codes = Counter(code for each in own for code in each)
        told = ", ".join(f"{n} {code}" for code, n in codes.most_common())
        rows.append([kind, len(own), str(sum(map(bool, own))), told or None])
    total = sum(map(bool, said.values()))
    share = f"{total} ({100 * total / len(said):.1f} %)"
    heads = (("fitted", 0), ("false alarms", None), ("codes", None))
    return Table([("windows", None), *heads], [*rows, ["all", len(said), share, None]])


def _kind(window: GoodWindow) -> str:
    """Return the row of a window: simulated ones by sensor, real ones by collection."""
    if window.variant:
        return f"simulated {window.variant.split(':')[0]}"
    return f"real {window.source.split('/')[0]}"


if __name__ == "__main__":
    main()

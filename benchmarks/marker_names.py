"""Measures how well markers of real trials are named after their names are removed.

    python -m benchmarks.marker_names OBSERVATIONS --out FOLDER

Every marker loses about 5 % of its frames in gaps of up to half a second, columns are shuffled
every second, and 5 % ghosts are added, which are tracks of up to half a second within 30 cm of a
marker. F1 is over all points (a marker in a frame): right is a point with its own name; wrong is
one with another name, or a ghost with any; missed is a marker's point without its name. The set's
table has the labels of the trial, one of each place on the body. Time is CPU time over that of
converting the trial with its names. In the trial with its names two markers are exchanged for 0.1
to 1 s, eight times: an exchange is found if most of its points get their names back by naming the
trial like itself; false are other points that lose theirs. `benchmarks/marker_names.toml` lists
the trials.
"""

import json
import tempfile
import tomllib
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np

import recon
from benchmarks.protocol import Cell, Table, number, parser, recordings_source, tell
from recon import BodyModel
from recon.body.marker_labels import match_markers
from recon.ingest.marker_conversion import convert_markers
from recon.mocap.c3d import read_c3d
from recon.mocap.recording import MarkerRecording
from training.sources import read_packed_markers

LIST = Path(__file__).with_suffix(".toml")
GAPS, GHOSTS, LONGEST_S, AROUND_M, EXCHANGES = 0.05, 0.05, 0.5, 0.3, 8
COLUMNS: list[tuple[str, int | None]] = [
    ("person", None), ("trials", 0), ("F1 by a named trial", 3), ("time", 1),
    ("F1 by the set", 3), ("time", 1), ("exchanges found %", 1), ("false %", 2),
]  # fmt: skip


def main() -> None:
    """Shuffle and name the markers of every trial, print and write the table."""
    asked = parser(__doc__, "observations")
    asked.add_argument("--part", choices=("develop", "report"), default="report")
    asked.add_argument("--most", type=int, default=2, help="trials of a person")
    given = asked.parse_args()
    people = tomllib.loads(LIST.read_text(encoding="utf-8"))[given.part]
    rows, read = list[list[Cell]](), list[str]()
    for person, own in people.items():
        trials = own["trials"][: given.most]
        read += [own[key] for key in ("like",) if key in own] + [one["path"] for one in trials]
        found = [measured(given.observations, own, one) for one in trials]
        means = [None if np.isnan(one) else number(one) for one in np.mean(found, 0).tolist()]
        rows.append([person, len(found), *means])
        print(rows[-1], flush=True)
    values = np.array([[np.nan if v is None else v for v in row[2:]] for row in rows], float)
    rows.append(["mean", len(rows), *map(number, np.nanmean(values, 0).tolist())])
    sources = recordings_source(given.observations, sorted(set(read)))
    tell(given.out, None, sources, {"marker-names": Table(COLUMNS, rows)})


def measured(folder: Path, person: Mapping[str, Any], trial: Mapping[str, Any]) -> list[float]:
    """Return F1 and relative time by a named trial (else NaN) and by the set, and exchanges."""
    true = markers_of(folder / trial["path"], trial.get("seconds"))
    unnamed, owner = shuffled(true, np.random.default_rng(0))
    began = process_time()
    convert_markers(true, BodyModel.load())
    whole = process_time() - began
    like = person.get("like")
    found = [np.nan, np.nan]
    if like is not None:
        named = markers_of(folder / like, person.get("before"))
        found = [f1(unnamed, owner, true, like=named)]
        found.append((process_time() - began) / whole - 1)
    with tempfile.TemporaryDirectory() as temporary:
        table = Path(temporary) / "set.json"
        table.write_text(json.dumps(match_markers(true.marker_names)[0]), encoding="utf-8")
        began = process_time()
        found += [f1(unnamed, owner, true, set=table), (process_time() - began) / whole]
    return [*found, *exchanges(true, np.random.default_rng(1))]


def exchanges(true: MarkerRecording, random: np.random.Generator) -> tuple[float, float]:
    """Return percentages of exchanged names put right, and of other names that were lost."""
    frames, count = true.visible.shape
    owner = np.where(true.visible, np.arange(count), -1)
    x = true.positions.copy()
    planted: list[tuple[slice, list[int]]] = []
    for _ in range(EXCHANGES):
        pair = random.choice(count, 2, replace=False).tolist()
        first, longest = int(random.integers(frames)), round(true.fps)
        some = slice(first, first + int(random.integers(round(0.1 * true.fps), longest)))
        x[some, pair], owner[some, pair] = x[some, pair[::-1]], owner[some, pair[::-1]]
        planted.append((some, pair))
    bad = replace(true, positions=x, visible=owner >= 0)
    found = recon.label(bad, like=bad)
    told = np.full(owner.shape, -1)
    for k, name in enumerate(found.recording.marker_names):
        if not name.startswith("*"):
            seen = np.flatnonzero(found.columns[:, k] >= 0)
            told[seen, found.columns[seen, k]] = true.marker_names.index(name)
    right = [
        (told[some, pair] == owner[some, pair])[owner[some, pair] >= 0] for some, pair in planted
    ]
    others = (owner == np.arange(count)) & (owner >= 0)
    mended = [one.mean() >= 0.5 for one in right if len(one)]
    return 100 * float(np.mean(mended)), 100 * float((told != owner)[others].mean())


def markers_of(path: Path, seconds: list[float] | None) -> MarkerRecording:
    """Read markers of known labels, one of each place on the body, in some seconds."""
    read = read_packed_markers(path) if path.name.endswith(".i4.xz") else read_c3d(path)
    names = [read.marker_names[k] for k in np.flatnonzero(read.visible.any(0))]
    places = {place: name for name, place in reversed(match_markers(names)[0].items())}
    part = read.select([name for name in names if name in places.values()])
    if seconds is None:
        return part
    return part.window(*(round(one * part.fps) for one in seconds))


def shuffled(
    true: MarkerRecording, random: np.random.Generator
) -> tuple[MarkerRecording, np.ndarray]:
    """Remove names; also return every point's true owner: a marker's number, -1 for ghosts."""
    frames, count = true.visible.shape
    longest = max(2, round(LONGEST_S * true.fps))
    seen = true.visible.copy()
    for k in range(count):
        while (seen[:, k] != true.visible[:, k]).mean() < GAPS * 0.75:
            first = int(random.integers(frames))
            seen[first : first + int(random.integers(1, longest)), k] = False
    extra = 4 + round(2 * GHOSTS * count)
    x = np.concatenate((true.positions, np.zeros((frames, extra, 3))), 1)
    seen = np.concatenate((seen, np.zeros((frames, extra), bool)), 1)
    while seen[:, count:].sum() < GHOSTS * seen[:, :count].sum():
        first, k = int(random.integers(frames)), count + int(random.integers(extra))
        some = slice(first, first + int(random.integers(1, longest)))
        host = int(random.integers(count))
        away = random.normal(size=3)
        away *= AROUND_M * random.uniform(0.1, 1) / np.linalg.norm(away)
        drift = np.arange(len(x[some]))[:, None] / true.fps * random.normal(0, 0.1, 3)
        x[some, k] = true.positions[some, host] + away + drift
        seen[some, k] = true.visible[some, host]
    owner = np.tile(
        np.where(np.arange(count + extra) < count, np.arange(count + extra), -1), (frames, 1)
    )
    for first in range(0, frames, round(true.fps)):
        some = slice(first, first + round(true.fps))
        order = random.permutation(count + extra)
        x[some], seen[some], owner[some] = (
            x[some][:, order],
            seen[some][:, order],
            owner[some][:, order],
        )
    names = tuple(f"*{k + 1}" for k in range(count + extra))
    made = replace(
        true, marker_names=names, positions=np.where(seen[..., None], x, 0.0), visible=seen
    )
    return made, owner


def f1(unnamed: MarkerRecording, owner: np.ndarray, true: MarkerRecording, **way: Any) -> float:
    """Name the markers, and return F1 over points."""
    found = recon.label(unnamed, **way)
    right = wrong = 0
    for k, name in enumerate(found.recording.marker_names):
        if not name.startswith("*"):
            seen = np.flatnonzero(found.columns[:, k] >= 0)
            who = owner[seen, found.columns[seen, k]]
            own = true.marker_names.index(name) if name in true.marker_names else -2
            right += int((who == own).sum())
            wrong += int((who != own).sum())
    return 2 * right / (right + wrong + int((unnamed.visible & (owner >= 0)).sum()))


if __name__ == "__main__":
    main()

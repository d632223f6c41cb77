"""Roll-out and collocation, HuMoR's two ways to fit, on the same windows in all protocols.

    python -m benchmarks.rollout_fits CORPUS --only 6 --json rollout_fits.json
    python -m benchmarks.rollout_fits CORPUS --part validation --only 2 --protocols "three views"

Windows of 60 frames. Noisy joints: 22 with 4 cm of noise per coordinate; hidden points: 43 of the
skin without noise, those below 0.9 m hidden; in-betweening: joints with 1 cm of noise, nothing
seen for one second; upper body: the same without legs. `one camera` does not know the ground, `one
camera, posed` and `three views` stand in a calibrated room: keypoints with three pixels of noise,
legs hidden for the middle third. `keypoints and depth` are of one sensor of unknown pose, `joints
and depth` of noisy joints and a calibrated sensor. Errors of what cameras filmed are those of
joints about the pelvis, in the true world.

`network's own` is what is left when the true motion itself is encoded and rolled out: the error of
a fit that follows the network alone. CPU s is the time of one processor for one clip, a few clips
at once. `by tolerance` counts windows whose last stage ended by tolerance.
"""

import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import torch
from rich.console import Console
from rich.table import Table

from benchmarks.arguments import over_windows
from benchmarks.humor import evenly
from benchmarks.results import corpus_source, write
from benchmarks.rollout_protocols import PROTOCOLS, SEED
from benchmarks.tables.rollouts import HEADINGS, METHODS, lines
from priors.humor.prior import Humor
from recon.benchmark.dataset import Splits
from recon.benchmark.windows import TrueWindows, load_windows
from recon.body.model import BodyModel
from recon.fitting.methods import FitOptions

AT_ONCE = 4


@dataclass(frozen=True)
class Row:
    """What one method did with one window; metres."""

    protocol: str
    method: str
    window: str
    subject: str
    joints: float
    """Mean error of the 22 joints; about the pelvis where cameras see them."""
    thirds: tuple[float, ...]
    """Means of errors over the first, the middle and the last third of the frames."""
    hidden: float | None
    """Mean error of the points or joints that were not seen, where some were not."""
    seconds: float
    evaluations: int
    """Evaluations of all stages."""
    ended: str
    """How the last stage ended."""


def main() -> None:
    """Fit, print and write."""
    parser = over_windows(__doc__)
    parser.add_argument("--only", type=int, default=None, help="use so many windows in all")
    parser.add_argument("--windows", nargs="+", default=None, help="use these, by name")
    parser.add_argument("--protocols", nargs="+", choices=PROTOCOLS, default=list(PROTOCOLS))
    parser.add_argument("--methods", nargs="+", choices=METHODS[:2], default=METHODS[:2])
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    body, splits = BodyModel.load(), Splits.load(arguments.splits)
    windows = load_windows(arguments.corpus, splits, arguments.part, body, SEED)
    if arguments.windows is not None:
        windows = windows.take([windows.names.index(name) for name in arguments.windows])
    windows = windows.take(evenly(windows, arguments.only))
    known = network_errors(windows, body)
    rows: list[Row] = []
    for protocol in arguments.protocols:
        for row in fits(protocol, windows, arguments.methods, body):
            rows.append(row)
            print(f"{protocol}, {row.method}, {row.window}: {100 * row.joints:.2f} cm, "
                  f"{row.seconds:.1f} CPU s, {row.ended}", flush=True)  # fmt: skip
        show(rows, known)
        if arguments.json is not None:
            save(arguments.json, arguments.corpus, arguments.part, windows, rows, known)


def fits(
    protocol: str, windows: TrueWindows, methods: list[str], body: BodyModel
) -> Iterator[Row]:
    """All methods on all windows, a few at once."""
    for first in range(0, len(windows.names), AT_ONCE):
        some = windows.take(list(range(first, min(first + AT_ONCE, len(windows.names)))))
        for method in methods:
            yield from _fitted(protocol, method, some, body, first)


def _fitted(
    protocol: str, method: str, windows: TrueWindows, body: BodyModel, first: int
) -> Iterator[Row]:
    began = time.process_time()
    fit = PROTOCOLS[protocol](windows, FitOptions(method=method), body, first)
    seconds = (time.process_time() - began) / len(windows.names)
    errors = (fit.joints - fit.truth).norm(dim=-1).mean(-1)
    reports = fit.result.reports
    for k, name in enumerate(windows.names):
        unseen = fit.hidden[k][fit.unseen[k]]
        yield Row(
            protocol, method, name, windows.subjects[k],
            joints=float(errors[k].mean()),
            thirds=tuple(float(part.mean()) for part in errors[k].tensor_split(3)),
            hidden=float(unseen.mean()) if len(unseen) else None,
            seconds=seconds,
            evaluations=sum(int(report.solution.evaluations[k]) for report in reports),
            ended=reports[-1].solution.termination[k].name.lower(),
        )  # fmt: skip


def network_errors(windows: TrueWindows, body: BodyModel) -> dict[str, float]:
    """Mean joint error of the roll-out of every true motion's own latents, metres."""
    humor = Humor.load(body=body)
    with torch.no_grad():
        rolled = humor.decode(humor.encode(windows.truth)).motion
    away = body.pose(rolled).joints - body.pose(windows.truth).joints
    errors = away.norm(dim=-1).mean((1, 2)).tolist()
    return dict(zip(windows.names, errors, strict=True))


def save(
    path: Path,
    corpus: Path,
    part: str,
    windows: TrueWindows,
    rows: list[Row],
    known: dict[str, float],
) -> None:
    """The result file, with the windows that it is about."""
    source = corpus_source(corpus, windows.files)
    write(path, SEED, source, part=part, windows=windows.about,
          rows=[vars(row) for row in rows], network=known)  # fmt: skip


def show(rows: list[Row], known: dict[str, float]) -> None:
    """Means over windows, those of acrobatics apart."""
    table = Table(*HEADINGS)
    for line in lines([vars(row) for row in rows], known):
        table.add_row(*line)
    Console(width=150).print(table)


if __name__ == "__main__":
    main()

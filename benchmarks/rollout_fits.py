"""Roll-out and collocation, HuMoR's two ways to fit, on the same windows in several protocols.

    python -m benchmarks.rollout_fits CORPUS --only 6 --json rollout_fits.json
    python -m benchmarks.rollout_fits CORPUS --part validation --only 6 --protocols "noisy joints"

Windows of 60 frames. Noisy joints: 22 with 4 cm of noise per coordinate; hidden points: 43 of the
skin without noise, those below 0.9 m hidden; one camera: keypoints with three pixels of noise,
of a camera that does not know the ground, legs hidden for the middle third, errors about the
pelvis after the best turn.
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
from torch import Tensor

from benchmarks.arguments import over_windows
from benchmarks.cameras import one_camera
from benchmarks.humor import evenly
from benchmarks.results import corpus_source, write
from benchmarks.tables.rollouts import HEADINGS, METHODS, lines
from benchmarks.windows import Windows, load_windows, noisy_joints, occluded_points
from priors.humor.prior import Humor
from priors.training.dataset import Splits
from recon.body.model import BodyModel
from recon.fitting.clip import fit_clip
from recon.fitting.methods import method_of
from recon.fitting.options import FitOptions
from recon.method.protocols import Observation
from recon.method.reconstruction import Reconstruction, solve
from recon.solver.lbfgs import Termination

SEED = 0
PROTOCOLS = ("noisy joints", "hidden points", "one camera")
AT_ONCE = 4


@dataclass(frozen=True)
class Row:
    """What one method did with one window; metres."""

    protocol: str
    method: str
    window: str
    subject: str
    joints: float
    """Mean error of the 22 joints; about the pelvis where a camera sees them."""
    thirds: tuple[float, ...]
    """The same over the first, the middle and the last third of the frames."""
    hidden: float | None
    """Mean error of the points that were not seen, where points were."""
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
        for row in fits(protocol, windows, body):
            rows.append(row)
            print(f"{protocol}, {row.method}, {row.window}: {100 * row.joints:.2f} cm, "
                  f"{row.seconds:.1f} CPU s, {row.ended}", flush=True)  # fmt: skip
        show(rows, known)
        if arguments.json is not None:
            save(arguments.json, arguments.corpus, arguments.part, windows, rows, known)


def fits(protocol: str, windows: Windows, body: BodyModel) -> Iterator[Row]:
    """Both methods on all windows, a few at once."""
    for first in range(0, len(windows.names), AT_ONCE):
        some = windows.take(list(range(first, min(first + AT_ONCE, len(windows.names)))))
        for method in METHODS:
            yield from _fitted(protocol, method, some, body, first)


def _fitted(
    protocol: str, method: str, windows: Windows, body: BodyModel, first: int
) -> Iterator[Row]:
    truth = body.pose(windows.truth).joints
    began = time.process_time()
    if protocol == "one camera":
        results = [_filmed(windows, k, method, body, first + k) for k in range(len(truth))]
        ended = [_last(result, 0) for result in results]
        made = torch.cat([result.body.joints for result in results])
        hidden: list[float | None] = [None] * len(truth)
    else:
        result, hidden = _seen(protocol, windows, method, body)
        ended = [_last(result, k) for k in range(len(truth))]
        made = result.body.joints
    seconds = (time.process_time() - began) / len(truth)
    for k, name in enumerate(windows.names):
        own, true = made[k].detach(), truth[k]
        if protocol == "one camera":
            own, true = own - own[:, :1], true - true[:, :1]
            own = _aligned(own, true)
        errors = (own - true).norm(dim=-1).mean(-1)
        yield Row(
            protocol, method, name, windows.subjects[k],
            joints=float(errors.mean()),
            thirds=tuple(float(part.mean()) for part in errors.tensor_split(3)),
            hidden=hidden[k],
            seconds=seconds,
            evaluations=ended[k][1],
            ended=ended[k][0].name.lower(),
        )  # fmt: skip


def _seen(
    protocol: str, windows: Windows, method: str, body: BodyModel
) -> tuple[Reconstruction, list[float | None]]:
    """A batch of windows from points in space; and the errors of hidden points."""
    if protocol == "noisy joints":
        seen: list[Observation] = [noisy_joints(windows.truth, body, SEED)]
        result = solve(seen, method_of(FitOptions(method=method), 0.04, body), body)
        return result, [None] * len(windows.names)
    occluded, points = occluded_points(windows.truth, body)
    result = solve([occluded], method_of(FitOptions(method=method), 0.0, body), body)
    away = (occluded.predict(result.estimate).detach() - points).norm(dim=-1)
    masks = ~occluded.visible
    return result, [float(e[m].mean()) if bool(m.any()) else None
                    for e, m in zip(away, masks, strict=True)]  # fmt: skip


def _filmed(windows: Windows, k: int, method: str, body: BodyModel, seed: int) -> Reconstruction:
    """One window from one camera of unknown ground."""
    filmed = one_camera(windows.truth[k], body, seed)
    return fit_clip(filmed.observations, FitOptions(method=method), body).result


def _aligned(points: Tensor, truth: Tensor) -> Tensor:
    """Points about the pelvis after the one turn of the whole clip that brings them nearest."""
    u, _, v = torch.linalg.svd((points.flatten(0, 1).mT @ truth.flatten(0, 1)).double())
    signs = torch.ones(3, dtype=u.dtype)
    signs[2] = torch.linalg.det(u @ v)
    return points @ (u * signs @ v).to(points)


def _last(result: Reconstruction, clip: int) -> tuple[Termination, int]:
    """How the last stage ended for a clip, and the evaluations of all stages."""
    evaluations = sum(int(report.solution.evaluations[clip]) for report in result.reports)
    return result.reports[-1].solution.termination[clip], evaluations


def network_errors(windows: Windows, body: BodyModel) -> dict[str, float]:
    """Mean joint error of the roll-out of every true motion's own latents, metres."""
    humor = Humor.load(body=body)
    with torch.no_grad():
        rolled = humor.decode(humor.encode(windows.truth)).motion
    away = body.pose(rolled).joints - body.pose(windows.truth).joints
    errors = away.norm(dim=-1).mean((1, 2)).tolist()
    return dict(zip(windows.names, errors, strict=True))


def save(
    path: Path, corpus: Path, part: str, windows: Windows, rows: list[Row], known: dict[str, float]
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

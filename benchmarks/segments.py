"""Multiple shooting with HuMoR: segments of 1, 5, 15 and all steps, on the same windows.

    python -m benchmarks.segments CORPUS --only 4 --json segments.json

Validation windows of 60 frames. Noisy joints: 22 with 4 cm of noise per coordinate; hidden points:
43 of the skin without noise, those below 0.9 m hidden. All lengths have the same weights and
the same start, the motion of collocation, which stands beside them and whose time is counted.
`objective` is in squares of the noise that the weights are for. `defect` is ½ eᵀ C⁻¹ e of one join
of two segments, nats. `drift` is how far the roll-out of the first state and all latents, without
the other states, comes away from the fit's own joints. `by tolerance` counts windows whose last
stage ended so.
"""

import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import torch
from jaxtyping import Float
from rich.console import Console
from rich.table import Table
from torch import Tensor

from benchmarks.arguments import over_windows
from benchmarks.converged import Protocol, protocols
from benchmarks.humor import evenly
from benchmarks.results import corpus_source, write
from benchmarks.rollout_protocols import SEED, compared
from benchmarks.tables.segments import HEADINGS, lines
from priors.humor.prior import Humor, HumorVariables
from priors.humor.segments import SegmentedHumor, SegmentedVariables
from priors.humor.shooting import Shooting
from recon.benchmark.dataset import Splits
from recon.benchmark.windows import TrueWindows, load_windows
from recon.body.model import BodyModel
from recon.core.motion import Motion
from recon.core.scene import Scene
from recon.method.reconstruction import Reconstruction, solve
from recon.method.stages import Stage
from recon.method.terms import Term
from recon.method.unknowns import Layout, Unknowns

METHODS: dict[str, int | None] = {
    "collocation": None, "segments of 1": 1, "segments of 5": 5, "segments of 15": 15,
    "roll-out": None,
}  # fmt: skip
"""Steps of a segment, where there are segments."""
PROTOCOLS = ("noisy joints", "hidden points")
_LEAST_NOISE = 0.014
"""Metres; weights are those of at least this noise."""


@dataclass(frozen=True)
class Row:
    """Errors in metres and cost of one way to fit one window."""

    protocol: str
    method: str
    window: str
    subject: str
    joints: float
    thirds: tuple[float, ...]
    """Mean error of joints over the first, the middle and the last third of the frames."""
    hidden: float | None
    seconds: float
    """CPU time for one clip, the start's included."""
    evaluations: int
    """Evaluations of the last stage."""
    ended: str
    objective: float | None = None
    """Value of the objective in squares of the noise; None for collocation, which has another."""
    terms: dict[str, float] = field(default_factory=dict, repr=False)
    """Its parts, likewise."""
    defect: float | None = None
    """Mean over joins, nats; None where nothing joins."""
    drift: float | None = None


@dataclass(frozen=True)
class Part:
    """Some stages of a method."""

    method: Shooting
    which: slice

    def stages(self, data: tuple[Term, ...]) -> tuple[Stage[Any], ...]:
        """The stages that were given."""
        return self.method.stages(data)[self.which]


def main() -> None:
    """Fit, print and write."""
    parser = over_windows(__doc__)
    parser.set_defaults(part="validation")
    parser.add_argument("--only", type=int, default=4, help="use so many windows in all")
    parser.add_argument("--protocols", nargs="+", choices=PROTOCOLS, default=list(PROTOCOLS))
    parser.add_argument("--methods", nargs="+", choices=METHODS, default=list(METHODS))
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    body, humor = BodyModel.load(), Humor.load()
    splits = Splits.load(arguments.splits)
    windows = load_windows(arguments.corpus, splits, arguments.part, body, SEED)
    windows = windows.take(evenly(windows, arguments.only))
    rows: list[Row] = []
    for name in arguments.protocols:
        seen = protocols(windows, body)[name]
        for row in fits(name, seen, windows, arguments.methods, humor, body):
            rows.append(row)
            print(row, flush=True)
        show(rows)
        if arguments.json is not None:
            write(arguments.json, SEED, corpus_source(arguments.corpus, windows.files),
                  part=arguments.part, windows=windows.about,
                  rows=[vars(row) for row in rows])  # fmt: skip


def fits(
    name: str,
    seen: Protocol,
    windows: TrueWindows,
    methods: list[str],
    humor: Humor,
    body: BodyModel,
) -> Iterator[Row]:
    """Collocation, and segments of every length from one start, all windows at once."""
    count, variance = len(windows.names), max(seen.noise, _LEAST_NOISE) ** 2
    began = time.process_time()
    method = Shooting.for_noise(humor, seen.noise)
    begun = solve([seen.observed], Part(method, slice(0, -1)), body)
    start, started = begun.motion.detach(), (time.process_time() - began) / count
    if "collocation" in methods:
        for k in range(count):
            scores = _scored(windows, k, seen, begun, body)
            yield Row(name, "collocation", **scores, seconds=started)
    for segmented in [one for one in methods if one != "collocation"]:
        began, steps = time.process_time(), METHODS[segmented]
        method = Shooting.for_noise(humor, seen.noise, steps)
        result = solve([seen.observed], Part(method, slice(-1, None)), body, start=start)
        seconds = started + (time.process_time() - began) / count
        drift = (unrolled(result, start, humor, body) - result.body.joints).norm(dim=-1)
        [report] = result.reports
        names = [term.name for term in report.stage.terms]
        for k in range(count):
            parts = (report.solution.trace[k, -1] / variance).tolist()
            yield Row(
                name,
                segmented,
                **_scored(windows, k, seen, result, body),
                seconds=seconds,
                objective=sum(parts),
                terms=dict(zip(names, parts, strict=True)),
                defect=_defect(result, k, steps),
                drift=float(drift[k].mean()),
            )


def _scored(
    windows: TrueWindows, k: int, seen: Protocol, result: Reconstruction, body: BodyModel
) -> dict[str, Any]:
    """What every method has of a window."""
    fit, last = compared(windows, seen, result, body), result.reports[-1].solution
    errors = (fit.joints[k] - fit.truth[k]).norm(dim=-1).mean(-1)
    unseen = fit.hidden[k][fit.unseen[k]]
    return {
        "window": windows.names[k],
        "subject": windows.subjects[k],
        "joints": float(errors.mean()),
        "thirds": tuple(float(part.mean()) for part in errors.tensor_split(3)),
        "hidden": float(unseen.mean()) if len(unseen) else None,
        "evaluations": int(last.evaluations[k]),
        "ended": last.termination[k].name.lower(),
    }


def _defect(result: Reconstruction, clip: int, steps: int | None) -> float | None:
    if steps is None:
        return None
    joins = (int(result.motion.valid[clip].sum()) - 2) // steps
    return float(result.estimate.decoded.energies["defect"][clip]) / joins


def unrolled(
    result: Reconstruction, start: Motion, humor: Humor, body: BodyModel
) -> Float[Tensor, "clips time 22 3"]:
    """Joints of the roll-out of a fit's first state and all of its latents, metres."""
    [report] = result.reports
    prior, scene = report.stage.prior, Scene.create(len(start.translation), like=start.translation)
    with torch.no_grad():
        began = Unknowns.of(prior, start, scene, body)
        layout = Layout.of(began, report.stage.free)
        variables = layout.unflatten(began, report.solution.x).variables
        if isinstance(variables, SegmentedVariables):
            assert isinstance(prior, SegmentedHumor)
            variables = first_state(variables, prior)
        return body.pose(humor.decode(variables).motion).joints


def first_state(variables: SegmentedVariables, prior: SegmentedHumor) -> HumorVariables:
    """The first segment's state with the latents of all steps."""
    every = range(0, len(variables.shape) * variables.segments, variables.segments)
    first = variables.apart(prior.length)[list(every)]
    return first.replace(latents=variables.latents, valid=variables.valid)


def show(rows: list[Row]) -> None:
    """Means over windows."""
    table = Table(*HEADINGS)
    for line in lines([vars(row) for row in rows]):
        table.add_row(*line)
    Console(width=150).print(table)


if __name__ == "__main__":
    main()

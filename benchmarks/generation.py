"""Evaluates generated motions as HuMoR's Table 1: prediction errors, diversity, and falls.

    python -m benchmarks.generation CORPUS --out FOLDER
    python -m benchmarks.generation CORPUS --weights open --samples 50 --out FOLDER

`recon.predict` continues from the first frame of every listed window, 50 times for 5 s. The first
2 s are compared with the window; APD is over the whole 5 s of the samples that stay on their feet.
`recon.sample` generates 100 motions of 5 s without a given start.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

import recon
from benchmarks.protocol import (
    Cell,
    Metrics,
    Table,
    cells,
    columns_of,
    listed_windows,
    number,
    over_windows,
    tell_of,
)
from recon.benchmark.answers import Row
from recon.benchmark.dataset import clip_files
from recon.benchmark.windows import FPS, FRAMES, TrueWindows
from recon.body.contacts import rest_heights
from recon.core.motion import Motion
from recon.metrics import errors
from recon.metrics.generation import displacements, pairwise_distance, stays_on_its_feet

SEED, SECONDS, UNCONDITIONED = 0, 5, 100
TEMPERATURES = {"default": None, "`--temperature 1.3`": 1.3}
"""Sampling temperatures; 1.3 had the least ADE + FDE on validation subjects, among 1, 1.2 and
1.4."""
COLUMNS: Metrics = {
    "ade_mean": ("ADE of a sample, mean", 100, 1),
    "ade_of_mean": ("ADE of the samples' mean", 100, 1),
    "ade": ("ADE, best of the samples", 100, 1), "fde": ("FDE of the best", 100, 1),
    "apd": ("APD on their feet", 100, 1), "speed": ("mean speed m/s", 1, 2),
    "stays": ("on their feet from true states %", 100, 0),
}  # fmt: skip


@dataclass(frozen=True)
class Joints:
    """Sampled continuations of a window's first frame, and which of them stay on their feet."""

    places: Float[Tensor, "samples time 22 3"]
    stays: Bool[Tensor, " samples"]


def main() -> None:
    """Predict, sample, print and write the table."""
    arguments = over_windows(__doc__)
    arguments.add_argument("--weights", nargs="+", default=["open"], help="open or files")
    arguments.add_argument("--samples", type=int, default=50)
    given = arguments.parse_args()
    body = recon.BodyModel.load()
    windows = listed_windows(given, body)
    files = clip_files(given.corpus)
    recorded = [recon.load_motion(files[clip]).motion for clip in windows.clips]
    rows: list[list[Cell]] = []
    for weights in given.weights:
        for label, temperature in TEMPERATURES.items():
            how = {"weights": weights, "temperature": temperature, "seed": SEED}
            found = [
                continued(recorded[k], windows, k, body, samples=given.samples, **how)
                for k in range(len(recorded))
            ]
            made = recon.sample(count=UNCONDITIONED, seconds=SECONDS, **how)
            drawn = joints_of([one.motion for one in made], body)
            name = label if weights == "open" else f"{label}, {weights} weights"
            rows.append([name, *_means(found, windows, body), *of_feet(drawn)])
    truth = body.pose(windows.truth).joints
    guess = [Joints(sliding(recorded[k], windows, k, body), torch.ones(1).bool())
             for k in range(len(recorded))]  # fmt: skip
    rows.append(["constant velocity", *_means(guess, windows, body)[:4], *[None] * 5])
    speeds = [{"speed": speed(joints)} for joints in truth]
    rows.append(["truth", *cells(speeds, windows, COLUMNS), None, None])
    columns = [*columns_of("cm", COLUMNS), ("on their feet from the mixture %", 0),
               ("their mean speed m/s", 2)]  # fmt: skip
    tell_of(given, SEED, {"generation": Table(columns, rows)}, windows.files)


def continued(
    recorded: Motion, windows: TrueWindows, number: int, body: recon.BodyModel, **how
) -> Joints:
    """Predict from a window's first frame; from the second one if it is the recording's first."""
    at = max(start(windows, number), 1 / recorded.fps)
    known = recorded.replace(shape=windows.truth.shape[number])
    return joints_of([m.motion for m in recon.predict(known, seconds=SECONDS, at=at, **how)], body)


def start(windows: TrueWindows, number: int) -> float:
    """Return the time (s) in the recording at which a window begins."""
    return round(float(windows.names[number].rsplit("@", 1)[1]) * FPS) / FPS


def joints_of(motions: Sequence[Motion], body: recon.BodyModel) -> Joints:
    """Return the joints of motions of equal length, and which of these stay on their feet."""
    places = torch.stack([body.pose(motion).joints for motion in motions])
    heights = torch.stack([rest_heights(body, motion.shape) for motion in motions])
    return Joints(places, stays_on_its_feet(places, heights, FPS))


def sliding(
    recorded: Motion, windows: TrueWindows, number: int, body: recon.BodyModel
) -> Float[Tensor, "1 time 22 3"]:
    """Return the first posture, moving on with the pelvis' horizontal velocity, as a baseline."""
    frame = max(round(start(windows, number) * recorded.fps), 1)
    pelvis = recorded.translation[frame - 1 : frame + 1]
    velocity = (pelvis[1] - pelvis[0]) * recorded.fps * pelvis.new_tensor([1.0, 1.0, 0.0])
    first = body.pose(windows.truth[number].window(0, 1)).joints[0]
    return (first + velocity * torch.arange(FRAMES)[:, None, None] / FPS)[None]


def _means(found: Sequence[Joints], windows: TrueWindows, body: recon.BodyModel) -> list[Cell]:
    truth = body.pose(windows.truth).joints
    rows = [predicted(one, joints) for one, joints in zip(found, truth, strict=True)]
    return cells(rows, windows, COLUMNS)


def predicted(found: Joints, truth: Float[Tensor, "time 22 3"]) -> Row:
    """Return the metrics of one window in SI units; the given first frame does not count."""
    some = found.places[:, 1:FRAMES].to(truth)
    away = displacements(some, truth[1:])
    average = away.mean(-1)
    return {
        "ade": average.min().item(),
        "fde": away[average.argmin(), -1].item(),
        "ade_mean": average.mean().item(),
        "ade_of_mean": displacements(some.mean(0), truth[1:]).mean().item(),
        "apd": pairwise_distance(found.places[found.stays]),
        "speed": speed(found.places[:, :FRAMES]),
        "stays": found.stays.double().mean().item(),
    }


def speed(joints: Float[Tensor, "*samples time 22 3"]) -> float | None:
    """Return the mean speed of the joints (m/s)."""
    return errors.mean(joints.diff(dim=-3).norm(dim=-1) * FPS)


def of_feet(found: Joints) -> list[Cell]:
    """Return the share (%) of sampled motions that stay on their feet, and their speed (m/s)."""
    return [number(found.stays.double().mean().item(), 100), number(speed(found.places))]


if __name__ == "__main__":
    main()

"""Choose the weights of HuMoR's collocation on the validation windows.

    python -m benchmarks.tune_humor CORPUS

Coordinate descent from the present ones: each weight in turn is halved or doubled while that
lowers the mean error of all joints (4 cm noise) or of all points, seen and hidden (43 points,
those below 0.9 m hidden). What it finds is summed up in `CollocationWeights.for_noise`.
"""

import argparse
import dataclasses
from collections.abc import Callable
from pathlib import Path

from benchmarks.scores import subject_mean
from benchmarks.stage12 import SEED
from priors.humor.collocation import Collocation, CollocationWeights
from priors.humor.prior import Humor
from recon.benchmark.dataset import SPLITS, Splits
from recon.benchmark.protocols import noisy_joints, occluded_points
from recon.benchmark.windows import load_windows
from recon.body.model import BodyModel
from recon.method.reconstruction import solve

Error = Callable[[CollocationWeights], float]

NAMES = ("step", "latents", "contact_velocity", "support")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("corpus", type=Path, help="folder of converted motions")
    parser.add_argument("--splits", type=Path, default=SPLITS)
    parser.add_argument("--weights", default="open", help="open, nc or a file")
    arguments = parser.parse_args()

    body, humor = BodyModel.load(), Humor.load(arguments.weights)
    splits = Splits.load(arguments.splits)
    windows = load_windows(arguments.corpus, splits, "validation", body, SEED)
    joints, noisy = body.pose(windows.truth).joints, noisy_joints(windows.truth, body, SEED)
    occluded, points = occluded_points(windows.truth, body)

    def noisy_error(weights: CollocationWeights) -> float:
        method = dataclasses.replace(Collocation.for_noise(humor, 0.04), weights=weights)
        result = solve([noisy], method, body)
        return subject_mean(windows, (result.body.joints - joints).norm(dim=-1).mean((1, 2)))

    def occluded_error(weights: CollocationWeights) -> float:
        method = dataclasses.replace(Collocation.for_noise(humor, 0.0), weights=weights)
        predicted = occluded.predict(solve([occluded], method, body).estimate)
        return subject_mean(windows, (predicted - points).norm(dim=-1).mean((1, 2)))

    for name, error, noise in (
        ("noisy joints", noisy_error, 0.04),
        ("occluded points", occluded_error, 0.0),
    ):
        print(name, descend(error, CollocationWeights.for_noise(noise)), flush=True)


def scaled(weights: CollocationWeights, name: str, factor: float) -> CollocationWeights:
    """Weights with one of them multiplied; names that begin with "pose" are of `weights.pose`."""
    if name in NAMES:
        return dataclasses.replace(weights, **{name: factor * getattr(weights, name)})
    name = name.removeprefix("pose ")
    pose = dataclasses.replace(weights.pose, **{name: factor * getattr(weights.pose, name)})
    return dataclasses.replace(weights, pose=pose)


def descend(error: Error, start: CollocationWeights) -> CollocationWeights:
    best, least = start, error(start)
    print(f"start: {100 * least:.3f} cm", flush=True)
    for name in (*NAMES, "pose", "pose acceleration"):
        for factor in (0.5, 2.0):
            while True:
                trial = scaled(best, name, factor)
                found = error(trial)
                print(f"{name} x {factor}: {100 * found:.3f} cm", flush=True)
                if found > least * 0.9995:  # not worth the step
                    break
                best, least = trial, found
    return best


if __name__ == "__main__":
    main()

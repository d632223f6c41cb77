"""Choose the weights of stages 1 and 2 on the validation windows.

    python -m benchmarks.tune_pose CORPUS

Coordinate descent: each weight in turn is halved or doubled while that lowers the mean error of
all joints (noisy joints) or of all points, seen and hidden (occluded points). What it finds is
summed up in `PoseWeights.for_noise`.
"""

import argparse
import dataclasses
from collections.abc import Callable
from pathlib import Path

from benchmarks.scores import subject_mean
from benchmarks.stage12 import SEED
from priors.pose.prior import PosePrior, PoseWeights
from recon.benchmark.dataset import SPLITS, Splits
from recon.benchmark.protocols import noisy_joints, occluded_points
from recon.benchmark.windows import load_windows
from recon.body.model import BodyModel
from recon.method.reconstruction import solve

Error = Callable[[PoseWeights], float]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("corpus", type=Path, help="folder of converted motions")
    parser.add_argument("--splits", type=Path, default=SPLITS)
    parser.add_argument("--prior", type=Path, default=None, help="weights; default: bundled")
    arguments = parser.parse_args()

    body, prior = BodyModel.load(), PosePrior.load(arguments.prior)
    windows = load_windows(
        arguments.corpus, Splits.load(arguments.splits), "validation", body, SEED
    )
    joints, noisy = body.pose(windows.truth).joints, noisy_joints(windows.truth, body, SEED)
    occluded, points = occluded_points(windows.truth, body)

    def noisy_error(weights: PoseWeights) -> float:
        result = solve([noisy], prior.replace(weights=weights), body)
        return subject_mean(windows, (result.body.joints - joints).norm(dim=-1).mean((1, 2)))

    def occluded_error(weights: PoseWeights) -> float:
        result = solve([occluded], prior.replace(weights=weights), body)
        errors = (occluded.predict(result.estimate) - points).norm(dim=-1)
        seen = errors.where(occluded.visible, 0.0).sum() / occluded.visible.sum()
        print(f"    visible {100 * seen.item():.3f} cm")
        return subject_mean(windows, errors.mean((1, 2)))

    print("noisy joints:", descend(noisy_error, PoseWeights.for_noise(0.04)))
    print("occluded points:", descend(occluded_error, PoseWeights.for_noise(0.0)))


def descend(error: Error, start: PoseWeights, rounds: int = 2) -> PoseWeights:
    best, least = start, error(start)
    for _ in range(rounds):
        before = best
        for name in ("pose", "shape", "acceleration"):
            for factor in (0.5, 2.0):
                while True:
                    trial = dataclasses.replace(best, **{name: getattr(best, name) * factor})
                    found = error(trial)
                    print(f"{name} {getattr(trial, name):.3g}: {100 * found:.3f} cm")
                    if found > least * 0.9995:  # not worth the step
                        break
                    best, least = trial, found
        if best == before:
            break
    return best


if __name__ == "__main__":
    main()

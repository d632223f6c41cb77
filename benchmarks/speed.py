"""Speed: joints against the mesh, and stages 1-2 of one clip and of sixteen.

    python -m benchmarks.speed --json speed.json

Ratios are taken within one run, the variants in turn; quote those. One thread throughout: a second
one gains little on so small operations, and on a shared machine costs many times what it gains.
"""

import argparse
import os
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch

from benchmarks.results import demo_clip, show, write
from observations import Joints3D
from priors.pose.prior import PosePrior
from recon.body.model import BodyModel
from recon.core import rotations as so3
from recon.core.motion import Motion
from recon.core.struct import stack
from recon.method.reconstruction import solve
from recon.simulation import points as simulate
from recon.simulation.points import Corruption

FRAMES, SEED = 60, 0


def main() -> None:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    body = BodyModel.load()
    motion = demo_clip(FRAMES)
    rows = {**posing(body, motion), **fitting(body, motion)}
    show(f"{FRAMES} frames, {os.cpu_count()} cores", rows)
    if arguments.json is not None:
        write(arguments.json, SEED, rows=rows)


def posing(body: BodyModel, motion: Motion) -> dict[str, float]:
    """Forward and backward pass of 60 frames: joints only, 43 points, the naive full mesh."""
    turns = so3.log(motion.rotations.double()).float()

    def run(value: Callable[[Motion], torch.Tensor]) -> Callable[[], None]:
        def call() -> None:
            leaves = [
                t.clone().requires_grad_() for t in (turns, motion.translation, motion.shape)
            ]
            moved = Motion.create(leaves[1], so3.exp(leaves[0]), leaves[2], motion.fps)
            torch.autograd.grad(value(moved).square().sum(), leaves)

        return call

    some = torch.arange(0, len(body.template), len(body.template) // 43)
    seconds = interleaved(
        {
            "joints": run(lambda m: body.pose(m).joints),
            "43 points": run(lambda m: body.pose(m).points(some)),
            "mesh, one matrix product": run(lambda m: body.pose(m).vertices),
            "mesh, vertex by vertex": run(lambda m: naive_vertices(body, m)),
        }
    )
    rows = {f"{name}, forward + backward, ms": 1e3 * s for name, s in seconds.items()}
    joints = seconds["joints"]
    return rows | {
        "joints are faster than the naive mesh by": seconds["mesh, vertex by vertex"] / joints,
        "joints are faster than our mesh by": seconds["mesh, one matrix product"] / joints,
    }


def naive_vertices(body: BodyModel, motion: Motion) -> torch.Tensor:
    """Skinning as it is usually written: a blended 3 x 4 transform per vertex and frame."""
    posed = body.pose(motion)
    shift = posed.joints - (posed.orientations @ posed.rest[..., None])[..., 0]
    transform = torch.cat((posed.orientations, shift[..., None]), -1).flatten(-2)
    blended = (body.weights @ transform).unflatten(-1, (3, 4))
    unposed = body.rest_vertices(motion.shape)
    return (blended[..., :3] @ unposed[..., None])[..., 0] + blended[..., 3]


def fitting(body: BodyModel, motion: Motion) -> dict[str, float]:
    """Stages 1 and 2: one clip, and sixteen as one batch."""
    clips = stack([simulate.joints3d(motion, body, Corruption(noise=0.04), k) for k in range(16)])
    one = clips[:1]
    prior = PosePrior.load()
    solve([one], prior, body)

    def timed(observation: Joints3D) -> float:
        began = time.perf_counter()
        solve([observation], prior, body)
        return time.perf_counter() - began

    single = float(np.median([timed(one) for _ in range(5)]))
    batch = float(np.median([timed(clips) for _ in range(3)]))
    return {
        "stages 1-2 of one clip, s": single,
        "stages 1-2 of sixteen clips at once, s": batch,
        "clips per minute, sixteen at once": 60 * 16 / batch,
        "at once, a clip is faster by": 16 * single / batch,
    }


def interleaved(calls: dict[str, Callable[[], None]], rounds: int = 15) -> dict[str, float]:
    """Median seconds of each, the variants in turn.

    A turn is five calls of which the last three count: the first ones pay for the memory and the
    caches that another variant left behind.
    """
    times: dict[str, list[float]] = {name: [] for name in calls}
    for _ in range(rounds):
        for name, call in calls.items():
            for turn in range(5):
                began = time.perf_counter()
                call()
                if turn >= 2:
                    times[name].append(time.perf_counter() - began)
    return {name: float(np.median(values)) for name, values in times.items()}


if __name__ == "__main__":
    main()

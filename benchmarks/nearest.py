"""Nearest neighbours: their share of a fit's time, and how far off the nearest vertex is.

    python -m benchmarks.nearest --json nearest.json

The objective is one evaluation with its gradient of the default method's: all steps of 90 frames
under HuMoR, and a simulated depth sensor's points. Pairs are found once for the twenty iterations
of a round. One thread throughout.
"""

import argparse
import time
from pathlib import Path

import numpy as np
import torch

from benchmarks.results import demo_clip, show, write
from observations.depth import PointCloud
from observations.surfels import SURFELS, Surfels, to_discs, to_vertices
from priors.humor.collocation import CollocatedHumor
from priors.humor.prior import Humor
from priors.pose.prior import PosePrior
from recon.body.model import BodyModel
from recon.core.camera import depth_camera
from recon.core.motion import Motion
from recon.core.scene import Scene
from recon.method.protocols import Estimate
from recon.reading.clouds import cloud_of
from recon.simulation.depth import PERFECT, depth_points
from recon.simulation.images import dome
from recon.simulation.points import Corruption

FRAMES, SEED, REPEATS = 90, 0, 5
"""Frames of the bundled demo, the seed, and repetitions."""
ROUND = 20
"""Evaluations between two searches."""


def main() -> None:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    body = BodyModel.load()
    motion = demo_clip(FRAMES)
    rows = {**shares(body, motion), **distances(body, motion)}
    show(f"{FRAMES} frames", rows)
    if arguments.json is not None:
        write(arguments.json, SEED, rows=rows)


def shares(body: BodyModel, motion: Motion) -> dict[str, float]:
    """Milliseconds of an evaluation and of the search in it, for several numbers of points."""
    sensor = dome(motion, body, depth_camera(), 1, height=1.2)[0]
    file = depth_points(motion, body, sensor, Corruption(), SEED)
    rows: dict[str, float] = {}
    for points in (512, 1024, 4096):
        objective, search = timed(cloud_of(file, body, points=points).cloud, body, motion)
        rows[f"{points} points: objective, ms"] = 1e3 * objective
        rows[f"{points} points: search, ms"] = 1e3 * search
        rows[f"{points} points: share of the search"] = search / (search + ROUND * objective)
    return rows


def timed(cloud: PointCloud, body: BodyModel, motion: Motion) -> tuple[float, float]:
    """Median seconds of evaluation and gradient with pairs held, and of finding the pairs."""
    prior = CollocatedHumor(Humor.load(body=body), PosePrior.load())
    variables = prior.encode(motion.map(lambda tensor: tensor[None])).detach()
    leaves = [t.requires_grad_() for t in variables.tensors().values() if t.is_floating_point()]
    scene = Scene.create(1, like=motion.translation)
    objective: list[float] = []
    search: list[float] = []
    for _ in range(REPEATS):
        with torch.no_grad():
            decoded = prior.decode(variables)
            begin = time.perf_counter()
            held = cloud.matched(Estimate(decoded, body.pose(decoded.motion), scene))
            search.append(time.perf_counter() - begin)
        begin = time.perf_counter()
        decoded = prior.decode(variables)
        value = held(Estimate(decoded, body.pose(decoded.motion), scene))
        value = value + sum(decoded.energies.values(), torch.zeros(()))
        torch.autograd.grad(value.sum(), leaves, allow_unused=True)
        objective.append(time.perf_counter() - begin)
    return float(np.median(objective)), float(np.median(search))


def distances(body: BodyModel, motion: Motion) -> dict[str, float]:
    """Median distance, mm, of points that lie exactly on the surface; it should be zero."""
    few = motion.window(0, 5)
    sensor = dome(few, body, depth_camera(), 1, height=1.2)[0]
    file = depth_points(few, body, sensor, Corruption(), SEED, sensor=PERFECT)
    cloud = cloud_of(file, body, points=4096).cloud
    rows: dict[str, float] = {}
    for count, distance in ((7000, to_vertices), (SURFELS, to_vertices), (SURFELS, to_discs)):
        case = cloud.replace(surfels=Surfels.of(body, count), distance=distance)
        squared, present = case.squared_distances(Estimate.of_clip(few, body))
        name = f"{distance.__name__}, {len(case.surfels.vertices)} vertices: median, mm"
        rows[name] = 1e3 * float(squared[present].sqrt().median())
    return rows


if __name__ == "__main__":
    main()

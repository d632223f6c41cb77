"""Fits of depth whose points have labels, beside fits of the same clouds without any.

    python -m benchmarks.labelled CORPUS --only 6 --json labelled.json

Windows of 90 frames before a depth sensor of known pose (512 x 424 pixels, 512 points of the body
a frame are fitted), nothing below 0.9 m seen in the middle third; the pose prior. Labels are those
of the simulation, spoiled: a fifth of the points, in coherent patches, is given to another part or
to the other side; the places of the rest are 4 cm off, half of it shared by the points of a
region; in a tenth of the moments, in runs of two to eleven, left and right are exchanged, and in a
twentieth the body is turned about. `first` is the mean error of the first guess about the pelvis,
`turned` the share of the windows whose root is more than 60 degrees off in a fifth of the frames.
CPU s are of the first guess and of the whole fit.
"""

import json
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from rich.console import Console
from torch import Tensor

from benchmarks.arguments import over_windows
from benchmarks.cameras import FRAMES, PIXELS_KEPT, SEED, corruption
from benchmarks.humor import evenly
from benchmarks.results import corpus_source, write
from benchmarks.scores import Columns, Row, Rows, by_subject, tables
from benchmarks.windows import Windows, load_windows
from observations.depth import PointCloud
from observations.files.clouds import cloud_of
from priors.labels.record import PointLabels
from priors.labels.regions import MIRRORED_REGIONS, REGIONS, Regions
from priors.training.dataset import Splits
from recon.body.model import BodyModel
from recon.core import rotations as so3
from recon.core.camera import depth_camera
from recon.core.motion import Motion
from recon.fitting.clip import fit_clip
from recon.fitting.options import FitOptions
from recon.metrics.evaluation import evaluate
from recon.simulation.depth import Surface, depth_points
from recon.simulation.images import dome

WRONG, OFF, EXCHANGED, TURNED = 0.2, 0.04, 0.1, 0.05
_ON_BODY = 0.08
"""Metres from the body within which a point is one of it."""
_SIDES, _ABOUT = torch.tensor([-1.0, 1.0, 1.0]), torch.tensor([-1.0, 1.0, -1.0])

METHODS = {"labels": True, "none": False}
"""Rows, and whether points have labels."""

COLUMNS: Columns = {
    "first": ("first", 100), "root_visible": ("visible", 100), "root_hidden": ("hidden", 100),
    "root_all": ("all", 100), "vertices": ("vertices", 100), "turned": ("turned %", 100),
    "first_seconds": ("first CPU s", 1), "seconds": ("CPU s", 1),
}  # fmt: skip


def main() -> None:
    parser = over_windows(__doc__)
    parser.add_argument("--only", type=int, default=None, help="use so many windows in all")
    about = "rows of others that the JSON has of the same windows are kept"
    parser.add_argument("--methods", nargs="+", choices=METHODS, default=list(METHODS), help=about)
    arguments = parser.parse_args()
    body, splits = BodyModel.load(), Splits.load(arguments.splits)
    windows = load_windows(arguments.corpus, splits, arguments.part, body, SEED, FRAMES)
    if arguments.only is not None:
        windows = windows.take(evenly(windows, arguments.only))
    found: dict[str, dict[str, Rows]] = {"depth": kept(arguments.json, windows)}
    for name in arguments.methods:
        found["depth"][name] = rows_of(windows, body, labelled=METHODS[name])
        for shown in tables(f"depth, {arguments.part}", COLUMNS, found["depth"]):
            Console(width=180).print(shown)
        if arguments.json is not None:
            which = {"part": arguments.part, **windows.about}
            write(arguments.json, SEED, corpus_source(arguments.corpus, windows.files), **which,
                  tables=found)  # fmt: skip


def kept(json_file: Path | None, windows: Windows) -> dict[str, Rows]:
    """Rows that the result file has of these windows."""
    if json_file is None or not json_file.is_file():
        return {}
    known = json.loads(json_file.read_text(encoding="utf-8"))
    return known["tables"]["depth"] if known["names"] == list(windows.names) else {}


def rows_of(windows: Windows, body: BodyModel, *, labelled: bool) -> Rows:
    """Film every window, fit and compare."""
    rows: list[Row] = []
    for k in range(len(windows.names)):
        truth = windows.truth[k]
        cloud, visible = filmed(truth, body, k)
        if labelled:
            labels = spoiled(body, cloud, vertices_of(cloud, truth, body), k)
            cloud = cloud.replace(labels=labels)
        began = time.process_time()
        first = cloud.start(body)[0]
        between = time.process_time()
        fit = fit_clip((cloud,), FitOptions(prior="pose"), body)
        ended = time.process_time()
        motion = fit.result.motion.detach()[0]
        world = evaluate(motion, truth, body, truth_visible=visible)
        begun = evaluate(first, truth, body)
        away = so3.geodesic(motion.rotations[:, 0], truth.rotations[:, 0])
        turned = float((away > np.radians(60)).float().mean() >= 0.2)
        rows.append({
            "first": begun["root_joints_all"], "turned": turned, "seconds": ended - between,
            "first_seconds": between - began, "vertices": world["vertices"],
            "root_visible": world["root_joints_visible"],
            "root_hidden": world["root_joints_hidden"], "root_all": world["root_joints_all"],
        })  # fmt: skip
    return by_subject(windows, rows)


def filmed(truth: Motion, body: BodyModel, seed: int) -> tuple[PointCloud, Tensor]:
    """What a sensor of known pose sees of the body, and which joints are in sight."""
    camera = dome(truth, body, depth_camera(), 1, first=2.4 * seed)[0]
    file = depth_points(
        truth, body, camera, corruption(truth, 0.0), seed,
        points=PIXELS_KEPT, surfaces=(Surface.BODY, Surface.GROUND),
    )  # fmt: skip
    assert file.truth_visible is not None
    visible = torch.from_numpy(file.truth_visible)
    return cloud_of(replace(file, truth_visible=None), body, seed=seed).cloud, visible


def vertices_of(cloud: PointCloud, truth: Motion, body: BodyModel) -> Tensor:
    """The vertex nearest to every point; -1 for points that are not on the body."""
    from scipy.spatial import KDTree

    found = torch.full(cloud.present.shape, -1)
    for moment, vertices in enumerate(body.pose(truth).vertices.numpy()):
        here = cloud.present[0, moment]
        away, index = KDTree(vertices).query(cloud.points[0, moment][here].numpy())
        found[0, moment, here] = torch.from_numpy(np.where(away < _ON_BODY, index, -1))
    return found


def spoiled(body: BodyModel, cloud: PointCloud, vertices: Tensor, seed: int) -> PointLabels:
    """Labels as a network might give them, with errors that neighbouring points share."""
    random = np.random.default_rng(seed)
    truth = PointLabels.known(body, vertices, cloud.present, OFF)
    places, region = truth.places.clone(), truth.region.clamp(min=0)
    mirrored = torch.tensor(MIRRORED_REGIONS)
    signs = readings(random, cloud.moments)
    for moment in range(cloud.moments):
        here = cloud.present[0, moment].nonzero()[:, 0]
        for patch in patches(random, cloud.points[0, moment, here]):
            own = here[patch]
            if random.random() < 0.5:
                places[0, moment, own] *= _SIDES
                region[0, moment, own] = mirrored[region[0, moment, own]]
                continue
            other = int(random.integers(len(REGIONS)))
            of_it = (Regions.of(body).of_vertex == other).nonzero()[:, 0]
            places[0, moment, own] = body.template[of_it[random.integers(len(of_it))]]
            region[0, moment, own] = other
        shared = random.normal(0, OFF / 2**0.5, (len(REGIONS), 3))[region[0, moment, here]]
        alone = random.normal(0, OFF / 2**0.5, (len(here), 3))
        places[0, moment, here] += torch.from_numpy(shared + alone).to(places)
        sign = signs[moment]
        if sign is not None:
            places[0, moment] *= sign
            region[0, moment] = mirrored[region[0, moment]]
    sure = torch.nn.functional.one_hot(region, len(REGIONS)).to(places)
    regions = 0.9 * sure + 0.1 / len(REGIONS)
    return truth.derived(
        places=places.where(cloud.present[..., None], 0.0),
        regions=regions.where(cloud.present[..., None], 0.0),
    )


def readings(random: np.random.Generator, moments: int) -> list[Tensor | None]:
    """Signs by which all places of a moment are wrong, in runs; None where they are right."""
    found: list[Tensor | None] = []
    while len(found) < moments:
        drawn = random.random()
        wrong = _SIDES if drawn < EXCHANGED else _ABOUT if drawn < EXCHANGED + TURNED else None
        found += [wrong] * int(random.integers(2, 12))
    return found[:moments]


def patches(random: np.random.Generator, points: Tensor) -> list[Tensor]:
    """Numbers of the points of patches of 5 to 15 cm, until enough points are in one."""
    free = torch.ones(len(points), dtype=torch.bool)
    found: list[Tensor] = []
    while int((~free).sum()) < int(WRONG * len(points)):
        middle = points[random.integers(len(points))]
        near = (points - middle).norm(dim=-1) < 0.05 + 0.1 * random.random()
        found.append((near & free).nonzero()[:, 0])
        free &= ~near
    return found


if __name__ == "__main__":
    main()

"""Measures fits of rendered films of two people who cross before a still camera.

Two people of random shapes walk past each other in a random room, at different distances from a
camera that shows less than their paths. `recon.fit_people` gets the film of both, and for
comparison a film of each alone, rendered likewise. Errors are about the pelvis in the camera's
frame, over the frames in a person's own result in which their pelvis is in the image.
"""

import argparse
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

import recon
from benchmarks.films.real import about_pelvis, exchanged_sides
from benchmarks.films.rendered import FPS, FRAMES, SEED, Shot, drawn_person
from benchmarks.films.rendering import Actor, Set
from benchmarks.protocol import Cell, Metrics, Table, columns_of, number, tell_of
from recon import BodyModel, Camera, Motion
from recon.benchmark.dataset import Splits
from recon.benchmark.windows import TrueWindows, load_windows
from recon.core import rotations as so3
from recon.core.camera import pose_looking_at
from recon.formats.cameras import guessed_camera
from recon.people.together import fit_people, load_people

SIZE = (720, 540)
LEAST_WALK, APART = 2.0, (0.5, 1.2)
"""Least distance (m) between the ends of a walk, and range of the distance (m) of two paths."""
COLUMNS: Metrics = {
    "followed": ("followed %", 100, 0), "error": ("about pelvis cm", 100, 1),
    "alone": ("alone cm", 100, 1), "ratio": ("ratio", 1, 2),
    "sides": ("sides exchanged %", 100, 1), "people": ("people found", 1, 0),
}  # fmt: skip


def add_arguments(arguments: argparse.ArgumentParser) -> None:
    """Add the options of `crossing` to its command line."""
    arguments.add_argument("--part", choices=("test", "validation"), default="test")
    arguments.add_argument("--pairs", type=int, default=5)
    arguments.add_argument("--films", type=Path, required=True, help="folder that keeps films")


def measure(given: argparse.Namespace) -> None:
    """Render, fit, compare, print and write the table."""
    body, rows = BodyModel.load(), list[list[Cell]]()
    windows = load_windows(given.corpus, Splits.load(), given.part, body, SEED, FRAMES)
    for scene in scenes(windows, given.pairs, body):
        for name, row in judged(scene, given.films, body):
            rows.append([name, *(number(row.get(k), f) for k, (_, f, _) in COLUMNS.items())])
            told = {k: round(v * COLUMNS[k][1], 2) for k, v in row.items()}
            print(f"{name}: {told}", flush=True)
    tables = {"films-crossing": Table(columns_of("person", COLUMNS), rows)}
    tell_of(given, SEED, tables, windows.files)


@dataclass(frozen=True)
class Crossing:
    """Films of two people together and of each alone, with the truth."""

    both: Shot
    alone: tuple[Shot, Shot]


def scenes(windows: TrueWindows, pairs: int, body: BodyModel) -> Iterator[Crossing]:
    """Yield pairs of people who walk; each person walks in one pair."""
    steps = windows.truth.translation[:, -1, :2] - windows.truth.translation[:, 0, :2]
    order = np.random.default_rng(SEED).permutation(len(windows.names))
    walks = [int(row) for row in order if steps[row].norm() > LEAST_WALK]
    for number_ in range(min(pairs, len(walks) // 2)):
        rng = np.random.default_rng([SEED, number_, 5])
        apart, people = rng.uniform(*APART), list[tuple[Actor, Motion]]()
        for k, row in enumerate(walks[2 * number_ : 2 * number_ + 2]):
            motion = drawn_person(windows.truth[row], 2 * number_ + k, body)
            people.append(
                (Actor.drawn(body, 2 * number_ + k), walked(motion, body, k == 1, k * apart))
            )
        camera = before(rng)
        scene = Set.drawn(number_, float(camera.T_world_camera[0, :2, 3].abs().max()) + 0.5)
        (one, other), name = people, f"crossing-{number_:02}"
        both = Shot(name, "", *one, camera, scene, (other,), SIZE)
        alone = (
            replace(both, name=f"{name}-a", others=()),
            replace(both, name=f"{name}-b", actor=other[0], truth=other[1], others=()),
        )
        yield Crossing(both, alone)


def walked(motion: Motion, body: BodyModel, back: bool, depth: float) -> Motion:
    """Turn and move a walk to lie along x (or against it), `depth` metres behind the origin."""
    pelvis = body.pose(motion).joints[:, 0]
    step = pelvis[-1, :2] - pelvis[0, :2]
    angle = np.pi * back - float(torch.atan2(step[1], step[0]))
    turn = so3.rigid(so3.exp(torch.tensor([0.0, 0.0, angle])), torch.zeros(3))
    turned = motion.carried(turn, body.rest_joints(motion.shape)[..., 0, :])
    pelvis = body.pose(turned).joints[:, 0]
    middle = (pelvis[0] + pelvis[-1]) / 2
    return turned.replace(
        translation=turned.translation - middle.new_tensor([middle[0], middle[1] - depth, 0.0])
    )


def before(rng: np.random.Generator) -> Camera:
    """Return a still camera at a random place that looks across the paths."""
    matrix = torch.from_numpy(guessed_camera(SIZE).camera_matrix).float()
    matrix[[0, 1], [0, 1]] *= rng.uniform(0.85, 1.15)
    place = torch.tensor([rng.uniform(-0.6, 0.6), -rng.uniform(3.0, 3.8), rng.uniform(1.1, 1.7)])
    pose = pose_looking_at(place.float(), torch.tensor([0.0, 0.3, 0.9]))
    return Camera.create(matrix, SIZE, T_camera_world=pose.expand(FRAMES, 4, 4))


def judged(
    scene: Crossing, films: Path, body: BodyModel
) -> Iterator[tuple[str, dict[str, float]]]:
    """Fit the films of one pair, and yield a row of metrics for each person."""
    found = [seen(one) for one in fitted(scene.both.film(films), body)]
    for letter, shot in zip("ab", scene.alone, strict=True):
        true = in_camera(body.pose(shot.truth).joints, shot.camera)
        inside = shown(body.pose(shot.truth).joints[:, 0], shot.camera)
        own = min(found, key=lambda one: nearness(one, true), default=None)
        row = {"people": float(len(found)), "followed": 0.0}
        if own is not None:
            kept = own[0] & inside
            row |= {"followed": float(kept.sum() / inside.sum()), "error": error(own, true, kept),
                    "sides": exchanged_sides(own[1][kept], true[kept])}  # fmt: skip
            alone = [seen(one) for one in fitted(shot.film(films), body)]
            single = min(alone, key=lambda one: nearness(one, true))
            row["alone"] = error(single, true, single[0] & kept)
            row["ratio"] = row["error"] / row["alone"]
        yield f"{scene.both.name}: {letter}", row


def fitted(film: Path, body: BodyModel) -> list[recon.Result]:
    """Fit all people in a film."""
    return list(fit_people(load_people([film], body=body), body=body))


Seen = tuple[Tensor, Tensor]
"""Frames in which a person was found (time), and the person's joints in the camera's frame."""


def seen(result: recon.Result) -> Seen:
    """Return the result of a fit on the film's frames, in the camera's frame."""
    first, count = round(result.motion.start_time * FPS), result.motion.frames
    kept, joints = torch.zeros(FRAMES, dtype=torch.bool), torch.zeros(FRAMES, 22, 3).double()
    last = min(first + count, FRAMES)
    kept[first:last] = True
    T = result.T_world_camera
    here = result.joints.double()[: last - first]
    joints[first:last] = here if T is None else so3.transform(so3.inverse_rigid(T.double()), here)
    return kept, joints


def in_camera(joints: Tensor, camera: Camera) -> Tensor:
    """Transform joints to the frame of a still camera."""
    return so3.transform(camera.T_camera_world[0].double(), joints.double())


def shown(points: Tensor, camera: Camera) -> Tensor:
    """Return a mask of the points, one per frame, that are in the image."""
    pixels = camera.project(points[:, None]).pixels[:, 0]
    return ((pixels > 0) & (pixels < torch.tensor(SIZE))).all(-1)


def nearness(one: Seen, true: Tensor) -> float:
    """Return the mean angle (rad), seen from the camera, between two paths of a pelvis."""
    ways = [torch.nn.functional.normalize(j[one[0], 0], dim=-1) for j in (one[1], true)]
    return float((ways[0] - ways[1]).norm(dim=-1).mean())


def error(one: Seen, true: Tensor, kept: Tensor) -> float:
    """Return the mean distance of joints about the pelvis (m)."""
    return float(about_pelvis(one[1][kept], true[kept]).mean())

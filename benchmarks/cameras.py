"""Compares HuMoR with the pose prior on keypoints of one or more simulated cameras.

    python -m benchmarks.cameras CORPUS --out FOLDER
    python -m benchmarks.cameras CORPUS --part validation --only 8 --cases "one camera"

Windows have 90 frames. Cameras film in 1920 x 1080 with three pixels of noise, from directions
that change from window to window; nothing below 0.9 m is seen for the middle third, or in the
whole clip where only half a body is seen. `one camera` does not know where the ground is; the
others stand in a calibrated room, and `one camera of known pose` is compared with the moving one.
Errors about the pelvis need no world; the others are taken in the true world by way of the true
camera. CPU s is the time of one processor for one clip.
"""

import math
import time
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

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
    over_windows,
    tell_of,
)
from recon import BodyModel, Camera, Keypoints2D, Motion
from recon.benchmark.answers import Row
from recon.benchmark.windows import TrueWindows
from recon.core.camera import full_hd_camera
from recon.metrics.evaluation import evaluate, ground_errors
from recon.reading.images import keypoints_of
from recon.simulation.images import camera_ring, keypoints2d, orbiting_camera
from recon.simulation.points import Corruption

SEED, FRAMES = 0, 90
PIXELS = 3.0
HIDDEN = 0.9
"""Height (m) below which nothing is seen for a third of the clip."""
_ORBIT_RAD = 1.0
"""Angle (rad) by which the moving camera is carried around the body."""

COLUMNS: Metrics = {
    "root_visible": ("visible cm", 100, 1), "root_hidden": ("hidden cm", 100, 1),
    "joints_all": ("world cm", 100, 1),
    "normal": ("normal °", 1, 1), "height": ("height cm", 100, 1), "seconds": ("CPU s", 1, 1),
}  # fmt: skip
"""Errors of joints about the pelvis, visible and hidden, and in the world; errors of a ground that
was found."""
CASES: dict[str, tuple[int, bool, bool]] = {
    "one camera, ground not known": (1, False, False),
    "one camera of known pose": (1, True, False),
    "moving camera of known poses": (1, True, False),
    "three views": (3, True, False),
    "legs never seen, one posed camera": (1, True, True),
    "legs never seen, three views": (3, True, True),
}
"""Number of cameras, whether their poses are known, and whether the legs are never seen."""
_MOVING = "moving camera of known poses"
POSE, HUMOR = "stages 1-2", "collocation"


def main() -> None:
    """Simulate, fit, print and write the table."""
    arguments = over_windows(__doc__)
    arguments.add_argument("--cases", nargs="+", choices=CASES, default=list(CASES))
    given = arguments.parse_args()
    body = BodyModel.load()
    windows = listed_windows(given, body, FRAMES)
    methods: dict[str, dict[str, Any]] = {POSE: {"prior": "pose"}, HUMOR: {}}
    found: dict[str, dict[str, list[Row]]] = {}
    for case in given.cases:
        found[case] = {
            name: [measured(windows, k, case, how, body) for k in range(len(windows.names))]
            for name, how in methods.items()
        }
        tell_of(given, SEED, shown(found, windows), windows.files)


def shown(found: Mapping[str, Mapping[str, list[Row]]], windows: TrueWindows) -> dict[str, Table]:
    """Build a table with a row for every case and method."""
    rows: list[list[Cell]] = []
    for case, methods in found.items():
        rows.extend([f"{case}: {m}", *cells(v, windows, COLUMNS)] for m, v in methods.items())
    return {"cameras": Table(columns_of("case", COLUMNS), rows)}


def measured(
    windows: TrueWindows, number: int, case: str, how: Mapping[str, Any], body: BodyModel
) -> Row:
    """Simulate one window's cameras, fit, and return errors and CPU time."""
    count, posed, half = CASES[case]
    truth = windows.truth[number]
    cameras = list(camera_ring(truth, body, full_hd_camera(), count, first=2.4 * number))
    if case == _MOVING:
        middle = body.pose(truth).joints.flatten(0, 1).mean(0)
        cameras = [orbiting_camera(cameras[0], middle, truth.frames, _ORBIT_RAD)]
    hidden = corruption(truth, PIXELS, whole=half)
    views, visible = filmed(cameras, truth, body, hidden, number, posed=posed)
    began = time.process_time()
    result = recon.fit(views, body=body, **how)
    seconds = time.process_time() - began
    there, ground = in_true_world(result, cameras[0].T_world_camera, body)
    world = evaluate(there, truth, body, truth_visible=visible)
    return {
        "root_visible": world["root_joints_visible"],
        "root_hidden": world["root_joints_hidden"],
        "joints_all": world["joints_all"],
        **ground,
        "seconds": seconds,
    }


def in_true_world(
    result: recon.Result, T_world_camera: Float[Tensor, "*time 4 4"], body: BodyModel
) -> tuple[Motion, Row]:
    """Transform a fit to the true world by way of a found camera; also return ground errors.

    The angle between the normals is in degrees, the difference of the camera's heights in metres;
    both are None where the camera knew its pose.
    """
    if result.T_world_camera is None:
        return result.motion, {"normal": None, "height": None}
    T = T_world_camera @ torch.linalg.inv(result.T_world_camera).to(T_world_camera)
    errors = ground_errors(result.T_world_camera, T_world_camera)
    there = result.motion.carried(T, body.rest_joints(result.motion.shape)[0])
    return there, {"normal": math.degrees(errors["ground_normal"]),
                   "height": errors["ground_height"]}  # fmt: skip


def corruption(truth: Motion, noise: float, *, whole: bool = False) -> Corruption:
    """Return settings that hide the legs in the middle third, or in the whole clip."""
    if whole:
        return Corruption(noise=noise, hide_below=HIDDEN)
    third = truth.frames / truth.fps / 3
    during = (truth.start_time + third, truth.start_time + 2 * third)
    return Corruption(noise=noise, hide_below=HIDDEN, during=during)


def filmed(
    cameras: list[Camera], truth: Motion, body: BodyModel, hidden: Corruption, seed: int,
    *, posed: bool,
) -> tuple[tuple[Keypoints2D, ...], Bool[Tensor, "time 22"]]:  # fmt: skip
    """Return 2D keypoints of all cameras, and a mask of the joints that any of them sees."""
    files = [
        keypoints2d(truth, body, camera, hidden, 100 * seed + k)
        for k, camera in enumerate(cameras)
    ]
    visible = [torch.from_numpy(f.truth_visible) for f in files if f.truth_visible is not None]
    if not posed:
        files = [replace(f, camera=replace(f.camera, T_camera_world=None)) for f in files]
    return tuple(keypoints_of(f, body) for f in files), torch.stack(visible).any(0)


if __name__ == "__main__":
    main()

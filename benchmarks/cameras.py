"""Cameras and depth sensors: HuMoR against stages 1-2 on what they see of the listed windows.

    python -m benchmarks.cameras CORPUS --json cameras.json
    python -m benchmarks.cameras CORPUS --part validation --only 8 --cases "one camera"

Windows of 90 frames. Cameras film in 1920 x 1080 with three pixels of noise, from directions that
change from window to window; nothing below 0.9 m is seen for the middle third, or from the first
frame to the last where half a body is seen. `one camera` does not know where the ground is; the
others stand in a calibrated room, and `one camera, posed` is what the moving one compares with.
Depth is a sensor of 512 x 424 pixels of unknown pose, with noise, holes and flying pixels, that
sees body and ground; the same third is hidden. Of the points above the ground that is found in
them, 512 a frame are fitted. Errors about the pelvis need no world; the others are taken in the
true world by way of the true camera. CPU s is the time of one processor for one clip.
"""

import math
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from jaxtyping import Float
from rich.console import Console
from torch import Tensor

from benchmarks.arguments import over_windows
from benchmarks.humor import evenly
from benchmarks.results import corpus_source, write
from benchmarks.scores import Columns, Row, Rows, by_subject, tables
from recon.benchmark.dataset import Splits
from recon.benchmark.windows import TrueWindows, load_windows
from recon.body.model import BodyModel
from recon.core.camera import Camera, depth_camera, full_hd_camera
from recon.core.motion import Motion
from recon.core.struct import concatenate
from recon.fitting.clip import fit_clip
from recon.fitting.methods import FitOptions
from recon.method.protocols import Sensor as Seen
from recon.metrics.evaluation import evaluate, ground_errors
from recon.reading.clouds import cloud_of
from recon.reading.images import keypoints_of
from recon.simulation.depth import Surface, depth_points, without_pose
from recon.simulation.images import dome, keypoints2d, orbiting
from recon.simulation.points import Corruption

SEED = 0
FRAMES = 90
PIXELS = 3.0
HIDDEN = 0.9
"""Metres; nothing below is seen for a third of the clip."""
PIXELS_KEPT = 60_000
"""Pixels of a depth image, ground included; some thousand of them see the body."""
_AT_ONCE = 8
_ORBIT = 1.0
"""Radians that the moving camera is carried around the body by."""

COLUMNS: Columns = {
    "root_visible": ("visible", 100), "root_hidden": ("hidden", 100), "root_all": ("all", 100),
    "joints_all": ("global", 100), "vertices": ("vertices", 100), "pa_joints": ("PA", 100),
    "accel": ("accel", 1), "accel_error": ("accel error", 1),
    "penetration_freq": ("pen. %", 100), "feet": ("contacts %", 100),
    "normal": ("normal °", 1), "height": ("height cm", 100), "seconds": ("CPU s", 1),
}  # fmt: skip
"""Joints about the pelvis (visible, hidden, all); then in the world. Penetration and contacts are
those of the ground that was found."""

METHODS: dict[str, FitOptions] = {
    "stages 1-2": FitOptions(prior="pose"),
    "HuMoR": FitOptions(),
}


@dataclass(frozen=True)
class Filmed:
    """What was seen of a batch of windows."""

    observations: tuple[Seen, ...]
    visible: Float[Tensor, "clips time 22"]
    T_world_camera: Float[Tensor, "clips 4 4"] | None
    """The true pose of a camera that does not know it; None where it does."""
    T_recording_camera: Float[Tensor, "clips 4 4"] | None
    """What the observations take it to be."""


def main() -> None:
    parser = over_windows(__doc__)
    parser.add_argument("--only", type=int, default=None, help="use so many windows in all")
    parser.add_argument("--cases", nargs="+", choices=CASES, default=list(CASES))
    parser.add_argument("--nc", type=Path, default=None, help="weights of more data, a row more")
    parser.add_argument("--ablations", type=Path, default=None, help="folder of their weights")
    arguments = parser.parse_args()

    body, splits = BodyModel.load(), Splits.load(arguments.splits)
    windows = load_windows(arguments.corpus, splits, arguments.part, body, SEED, FRAMES)
    if arguments.only is not None:
        windows = windows.take(evenly(windows, arguments.only))
    methods = dict(METHODS)
    if arguments.nc is not None:
        methods["HuMoR, nc"] = FitOptions(weights=str(arguments.nc))
    console = Console(width=None if sys.stdout.isatty() else 180)
    found: dict[str, dict[str, Rows]] = {}
    for case in arguments.cases:
        own = dict(methods)
        if arguments.ablations is not None and case == "one camera":
            files = sorted(arguments.ablations.glob("*.safetensors"))
            own |= {f"HuMoR, {file.stem}": FitOptions(weights=str(file)) for file in files}
        found[case] = {
            name: rows_of(windows, CASES[case], settings, body) for name, settings in own.items()
        }
        for shown in tables(f"{case}, {arguments.part}", COLUMNS, found[case]):
            console.print(shown)
        if arguments.json is not None:
            about = {"part": arguments.part, **windows.about}
            write(arguments.json, SEED, corpus_source(arguments.corpus, windows.files), **about,
                  tables=found)  # fmt: skip


def rows_of(
    windows: TrueWindows,
    film: Callable[[Motion, BodyModel, int], Filmed],
    settings: FitOptions,
    body: BodyModel,
) -> Rows:
    """Film every window, fit and compare."""
    rows: list[Row] = []
    for start in range(0, len(windows.names), _AT_ONCE):
        some = windows.take(list(range(start, min(start + _AT_ONCE, len(windows.names)))))
        filmed = [film(some.truth[k], body, start + k) for k in range(len(some.names))]
        batch = batch_of(filmed)
        began = time.process_time()
        fitted = fit_clip(batch.observations, settings, body)
        seconds = (time.process_time() - began) / len(filmed)
        motion, contacts = fitted.result.motion.detach(), fitted.result.contacts.detach()
        T = to_true_world(batch, fitted.T_world_recording)
        for k in range(len(filmed)):
            row = _compared(motion[k], some, k, T[k], batch.visible[k].bool(), contacts[k], body)
            rows.append({**row, **_ground_errors(batch, fitted.T_world_recording, k),
                         "seconds": seconds})  # fmt: skip
    return by_subject(windows, rows)


def _compared(
    motion: Motion,
    windows: TrueWindows,
    k: int,
    T: Float[Tensor, "4 4"],
    visible: Tensor,
    contacts: Tensor,
    body: BodyModel,
) -> Row:
    """One window's columns: errors in the true world, penetration and contacts in its own."""
    there = motion.carried(T, body.rest_joints(motion.shape)[0])
    truth, touching = windows.truth[k], windows.contacts[k]
    world = evaluate(there, truth, body, truth_contacts=touching, truth_visible=visible)
    own = evaluate(motion, truth, body, contacts=contacts, truth_contacts=touching)
    return {
        "root_visible": world["root_joints_visible"],
        "root_hidden": world["root_joints_hidden"],
        "root_all": world["root_joints_all"],
        **{key: world[key] for key in ("joints_all", "vertices", "pa_joints", "accel")},
        "accel_error": world["accel_error"],
        "penetration_freq": own["penetration_freq"],
        "feet": own["contact_balanced"],
    }


def to_true_world(
    filmed: Filmed, T_world_recording: Float[Tensor, "clips 4 4"]
) -> Float[Tensor, "clips 4 4"]:
    """Maps the world that was found to the true one, by way of the camera."""
    if filmed.T_world_camera is None or filmed.T_recording_camera is None:
        return torch.linalg.inv(T_world_recording)
    found = T_world_recording @ filmed.T_recording_camera
    return filmed.T_world_camera @ torch.linalg.inv(found)


def _ground_errors(filmed: Filmed, T_world_recording: Tensor, k: int) -> Row:
    """Angle between the normals, degrees, and difference of the camera's heights, metres."""
    if filmed.T_world_camera is None or filmed.T_recording_camera is None:
        return {"normal": None, "height": None}
    found = T_world_recording[k] @ filmed.T_recording_camera[k]
    errors = ground_errors(found, filmed.T_world_camera[k])
    return {"normal": math.degrees(errors["ground_normal"]), "height": errors["ground_height"]}


def batch_of(filmed: list[Filmed]) -> Filmed:
    """One batch of several; clouds padded to one length."""

    def joined(pose: Callable[[Filmed], Tensor | None]) -> Tensor | None:
        poses = [pose(one) for one in filmed]
        known = [T for T in poses if T is not None]
        return torch.cat(known) if len(known) == len(poses) else None

    parts = zip(*(one.observations for one in filmed), strict=True)
    return Filmed(
        observations=tuple(concatenate(list(part)) for part in parts),
        visible=torch.cat([one.visible for one in filmed]),
        T_world_camera=joined(lambda one: one.T_world_camera),
        T_recording_camera=joined(lambda one: one.T_recording_camera),
    )


def corruption(truth: Motion, noise: float, *, whole: bool = False) -> Corruption:
    """Legs hidden for the middle third, or for the whole clip."""
    if whole:
        return Corruption(noise=noise, hide_below=HIDDEN)
    third = truth.frames / truth.fps / 3
    during = (truth.start_time + third, truth.start_time + 2 * third)
    return Corruption(noise=noise, hide_below=HIDDEN, during=during)


def _around(truth: Motion, body: BodyModel, lens: Camera, count: int, seed: int) -> list[Camera]:
    """Cameras around the body, the first in a direction of its own for every window."""
    return list(dome(truth, body, lens, count, first=2.4 * seed))


def images(
    cameras: list[Camera], truth: Motion, body: BodyModel, seed: int, *, posed: bool,
    half: bool = False,
) -> Filmed:  # fmt: skip
    """Keypoints of fixed or moving cameras, which may never see the legs."""
    files = [
        keypoints2d(truth, body, camera, corruption(truth, PIXELS, whole=half), 100 * seed + k)
        for k, camera in enumerate(cameras)
    ]
    visible = torch.stack([torch.from_numpy(f.truth_visible) for f in files]).any(0)  # type: ignore[arg-type]
    if posed:
        views = tuple(keypoints_of(file, body) for file in files)
        return Filmed(views, visible[None], None, None)
    lost = [replace(file, camera=replace(file.camera, T_camera_world=None)) for file in files]
    views = tuple(keypoints_of(file, body) for file in lost)
    T = cameras[0].T_world_camera[None]
    return Filmed(views, visible[None], T, views[0].camera.T_world_camera[:, 0])


def one_camera(truth: Motion, body: BodyModel, seed: int) -> Filmed:
    return images(_around(truth, body, full_hd_camera(), 1, seed), truth, body, seed, posed=False)


def one_camera_posed(truth: Motion, body: BodyModel, seed: int) -> Filmed:
    return images(_around(truth, body, full_hd_camera(), 1, seed), truth, body, seed, posed=True)


def moving_camera(truth: Motion, body: BodyModel, seed: int) -> Filmed:
    camera = _around(truth, body, full_hd_camera(), 1, seed)[0]
    middle = body.pose(truth).joints.flatten(0, 1).mean(0)
    return images([orbiting(camera, middle, truth.frames, _ORBIT)], truth, body, seed, posed=True)


def three_views(truth: Motion, body: BodyModel, seed: int) -> Filmed:
    return images(_around(truth, body, full_hd_camera(), 3, seed), truth, body, seed, posed=True)


def half_body(truth: Motion, body: BodyModel, seed: int) -> Filmed:
    cameras = _around(truth, body, full_hd_camera(), 1, seed)
    return images(cameras, truth, body, seed, posed=True, half=True)


def half_body_three_views(truth: Motion, body: BodyModel, seed: int) -> Filmed:
    cameras = _around(truth, body, full_hd_camera(), 3, seed)
    return images(cameras, truth, body, seed, posed=True, half=True)


def depth(truth: Motion, body: BodyModel, seed: int) -> Filmed:
    camera = _around(truth, body, depth_camera(), 1, seed)[0]
    file = depth_points(
        truth, body, camera, corruption(truth, 0.0), seed,
        points=PIXELS_KEPT, surfaces=(Surface.BODY, Surface.GROUND),
    )  # fmt: skip
    loaded = cloud_of(without_pose(file), body, seed=seed)
    visible = torch.from_numpy(file.truth_visible)[None]  # type: ignore[arg-type]
    T = torch.from_numpy(loaded.T_recording_file).float()[None]
    return Filmed((loaded.cloud,), visible, camera.T_world_camera[None], T)


def depth_and_keypoints(truth: Motion, body: BodyModel, seed: int) -> Filmed:
    """The sensor's own image, at its resolution, with noise as wide as in the large one."""
    camera = _around(truth, body, depth_camera(), 1, seed)[0]
    cloud = depth(truth, body, seed)
    assert cloud.T_recording_camera is not None
    size = depth_camera().camera_matrix[0, 0] / full_hd_camera().camera_matrix[0, 0]
    noise = PIXELS * float(size)
    file = keypoints2d(truth, body, camera, corruption(truth, noise), 100 * seed)
    lost = replace(file, camera=replace(file.camera, T_camera_world=None))
    view = keypoints_of(lost, body, cloud.T_recording_camera[0].double().numpy())
    return replace(cloud, observations=(view, *cloud.observations))


def keypoints_of_sensor(truth: Motion, body: BodyModel, seed: int) -> Filmed:
    """Keypoints alone, those of the protocol with depth."""
    both = depth_and_keypoints(truth, body, seed)
    return replace(both, observations=both.observations[:1])


CASES: dict[str, Callable[[Motion, BodyModel, int], Filmed]] = {
    "one camera": one_camera,
    "one camera, posed": one_camera_posed,
    "moving camera": moving_camera,
    "three views": three_views,
    "half a body, one camera, posed": half_body,
    "half a body, three views": half_body_three_views,
    "depth": depth,
    "2D of the sensor": keypoints_of_sensor,
    "2D + depth": depth_and_keypoints,
}

if __name__ == "__main__":
    main()

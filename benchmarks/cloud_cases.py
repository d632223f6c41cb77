"""Observation files of a window as a depth sensor, its camera and a marker system see it."""

import functools
import math
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from jaxtyping import Bool
from torch import Tensor

from benchmarks.cameras import PIXELS, corruption
from recon.body.model import BodyModel
from recon.core.camera import Camera, depth_camera, full_hd_camera
from recon.core.motion import Motion
from recon.core.skeleton import JOINTS
from recon.formats.observations import (
    KeypointsFile,
    ObservationFile,
    PointsFile,
    PositionsFile,
    save_observation,
)
from recon.simulation.depth import Shown, Surface, depth_points, without_pose
from recon.simulation.images import dome, keypoints2d
from recon.simulation.points import Corruption, joints3d

JOINT_NOISE = 0.03
"""Metres, of every coordinate of joints."""
_PIXELS_KEPT = 30_000
"""Pixels of a depth image, ground included; some thousand of them see the body."""


@dataclass(frozen=True)
class Seen:
    """One window before its sensors."""

    truth: Motion
    body: BodyModel
    number: int
    """Number of the window in the list, which seeds everything random and the view."""

    @functools.cached_property
    def shown(self) -> Shown:
        """The body that the sensor sees."""
        return Shown.of(self.truth, self.body)

    @functools.cached_property
    def camera(self) -> Camera:
        """The depth sensor in its true place."""
        return dome(self.truth, self.body, depth_camera(), 1, first=2.4 * self.number)[0]

    @functools.cached_property
    def cloud(self) -> PointsFile:
        """Body and ground before a sensor of known pose; the legs hidden for the middle third."""
        return depth_points(
            self.truth, self.body, self.camera, corruption(self.truth, 0.0), self.number,
            points=_PIXELS_KEPT, surfaces=(Surface.BODY, Surface.GROUND), shown=self.shown,
        )  # fmt: skip

    @functools.cached_property
    def keypoints(self) -> KeypointsFile:
        """Keypoints in the sensor's own image, noise as wide as in a large one; pose unknown."""
        size = depth_camera().camera_matrix[0, 0] / full_hd_camera().camera_matrix[0, 0]
        hidden = corruption(self.truth, PIXELS * float(size))
        file = keypoints2d(self.truth, self.body, self.camera, hidden, 100 * self.number)
        return replace(file, camera=replace(file.camera, T_camera_world=None))

    @functools.cached_property
    def joints(self) -> PositionsFile:
        """Noisy joints, those below the height hidden for the middle third."""
        seen = joints3d(self.truth, self.body, corruption(self.truth, JOINT_NOISE), self.number)
        return PositionsFile(
            "joints3d", seen.positions.numpy(), seen.visible.numpy(), JOINTS, seen.fps
        )

    @functools.cached_property
    def visible_joints(self) -> Bool[Tensor, "time 22"]:
        """True joints that the sensor sees."""
        assert self.cloud.truth_visible is not None
        return torch.from_numpy(self.cloud.truth_visible)


WALKS = (
    ("02_01", 0.2), ("06_01", 0.8), ("12_01", 0.9), ("26_01", 2.2), ("32_01", 0.7), ("35_01", 0.2),
)  # fmt: skip
"""Straight walks of six people who are not tested on: clip, and first second."""
WALK_FRAMES = 75
VIEWS = ((3.0, 90.0), (3.6, 0.0), (6.3, 180.0), (6.5, 60.0))
"""Metres from the sensor to the middle of a way, and degrees between the way and the view back to
the sensor: 0 comes nearer, 180 goes away."""


def view_of(number: int) -> tuple[float, float]:
    """The view of a walk in the list of walks, one person's after the other's.

    The first view changes from person to person, so that some of the walks show all views.
    """
    return VIEWS[(number + number // len(VIEWS)) % len(VIEWS)]


@dataclass(frozen=True)
class SeenWalk(Seen):
    """A straight walk before a sensor of known pose; every other person without the ground."""

    distance: float
    """Metres from the sensor to the middle of the way."""
    angle: float
    """Degrees between the way and the view back to the sensor."""

    @functools.cached_property
    def camera(self) -> Camera:
        """The depth sensor 1.6 m above the ground."""
        pelvis = self.shown.joints[:, 0]
        middle, way = (pelvis[0] + pelvis[-1]) / 2, pelvis[-1] - pelvis[0]
        heading = math.atan2(float(way[1]), float(way[0])) + math.radians(self.angle)
        level = self.distance * middle.new_tensor([math.cos(heading), math.sin(heading)])
        eye = torch.cat((middle[:2] + level, middle.new_tensor([1.6])))
        return depth_camera().placed(eye, middle)

    @functools.cached_property
    def cloud(self) -> PointsFile:
        """Nothing is hidden."""
        ground = (Surface.GROUND,) if self.number // len(VIEWS) % 2 else ()
        return depth_points(
            self.truth, self.body, self.camera, Corruption(), self.number,
            points=_PIXELS_KEPT, surfaces=(Surface.BODY, *ground), shown=self.shown,
        )  # fmt: skip


CASES: dict[str, tuple[str, ...]] = {
    "depth": ("posed",),
    "depth, sensor unknown": ("unposed",),
    "2D": ("keypoints",),
    "2D + depth": ("keypoints", "unposed"),
    "joints": ("joints",),
    "joints + depth": ("joints", "posed"),
}
"""Cases, and the files of each. Sensors of 2D keypoints do not know their pose."""


def write_files(seen: Seen, case: str, folder: Path) -> list[Path]:
    """Write the observation files of a case, without anything that only a simulation knows."""
    names = CASES.get(case, ("posed",))
    paths = [folder / f"{name}.npz" for name in names]
    for name, path in zip(names, paths, strict=True):
        save_observation(path, replace(_file(seen, name), truth_visible=None))
    return paths


def _file(seen: Seen, name: str) -> ObservationFile:
    if name == "keypoints":
        return replace(seen.keypoints, truth_T_world_camera=None)
    if name == "joints":
        return seen.joints
    return without_pose(seen.cloud) if name == "unposed" else seen.cloud

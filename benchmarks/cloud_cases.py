"""Observation files of a window as a depth sensor, its camera and a marker system see it."""

import functools
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from benchmarks.cameras import HIDDEN, PIXELS, corruption
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
from recon.simulation.depth import (
    DepthSensor,
    Shown,
    Surface,
    depth_image,
    depth_points,
    without_pose,
)
from recon.simulation.images import dome, keypoints2d
from recon.simulation.points import joints3d

JOINT_NOISE = 0.03
"""Metres, of every coordinate of joints."""
_PIXELS_KEPT = 30_000
"""Pixels of a depth image, ground included; some thousand of them see the body."""
_EVERY = 5
"""Frames from one whose vertices are looked at to the next."""
_BEHIND = 0.03
"""A vertex counts as seen if it lies at most so many metres behind what its pixel sees."""


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

    @property
    def shown_frames(self) -> range:
        """Frames whose vertices are compared."""
        return range(0, self.truth.frames, _EVERY)

    @functools.cached_property
    def visible_vertices(self) -> Bool[Tensor, "shown vertices"]:
        """Vertices that the sensor sees in those frames."""
        hidden = corruption(self.truth, 0.0).active(self.truth.times)
        vertices = self.shown.vertices
        return torch.stack([
            self._seen(vertices[k]) & ~(hidden[k] & (vertices[k][:, 2] < HIDDEN))
            for k in self.shown_frames
        ])  # fmt: skip

    def _seen(self, vertices: Float[Tensor, "vertices 3"]) -> Bool[Tensor, " vertices"]:
        image = depth_image(vertices, self.shown.faces, self.camera, None)[0]
        image = torch.from_numpy(image)
        projected = self.camera.project(vertices)
        height, width = image.shape
        column = projected.pixels[:, 0].long().clamp(0, width - 1)
        row = projected.pixels[:, 1].long().clamp(0, height - 1)
        near = projected.in_front & (projected.depth <= DepthSensor().farthest)
        return near & (projected.depth < image[row, column] + _BEHIND)


OTHERS = "depth, MakeHuman"
"""The case with people who are not quite our body."""
CASES: dict[str, tuple[str, ...]] = {
    "depth": ("posed",),
    "depth, sensor unknown": ("unposed",),
    OTHERS: ("makehuman",),
    "2D": ("keypoints",),
    "2D + depth": ("keypoints", "unposed"),
    "joints": ("joints",),
    "joints + depth": ("joints", "posed"),
}
"""Cases, and the files of each. Sensors of 2D keypoints do not know their pose."""

ALONE = {
    "2D + depth": ("2D", "depth, sensor unknown"),
    "joints + depth": ("joints", "depth"),
}
"""Mixtures, and the cases of their parts."""


def write_files(seen: Seen, case: str, folder: Path) -> list[Path]:
    """Write the observation files of a case, without anything that only a simulation knows."""
    paths = [folder / f"{name}.npz" for name in CASES[case]]
    for name, path in zip(CASES[case], paths, strict=True):
        if not path.exists():
            save_observation(path, replace(_file(seen, name), truth_visible=None))
    return paths


def _file(seen: Seen, name: str) -> ObservationFile:
    if name == "keypoints":
        return replace(seen.keypoints, truth_T_world_camera=None)
    if name == "joints":
        return seen.joints
    return without_pose(seen.cloud) if name == "unposed" else seen.cloud

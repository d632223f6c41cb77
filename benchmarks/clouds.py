"""Fits depth images, alone and with other sensors, that are read from observation files.

    python -m benchmarks.clouds CORPUS --part test --out FOLDER
    python -m benchmarks.clouds CORPUS --part validation --cases walks --only 6 --prior pose

Every window is simulated and written to observation files, which `recon.load_observation` reads
and `recon.fit` fits. The sensor has 512 x 424 pixels, noise, holes and flying pixels.

`depth` and the cases after it are the listed windows, 90 frames of each, and see body and ground;
nothing below 0.9 m is seen in the middle third. `depth` knows the pose of its sensor; `depth,
sensor unknown`, `2D` and `2D + depth` do not, nor where the ground is; 2D keypoints are in the
sensor's own image, with one pixel of noise; joints have 3 cm. `walks` are 2.5 s of straight walks
of six people, 2 to 8 m from a sensor of known pose: across its view, towards it, away from it and
askew; every other person without the ground.

Errors of joints about the pelvis and of vertices in the world (by the true sensor) are in cm; a
window is lost if the mean error of joints is more than 15 cm. Refused windows are counted and
printed.
"""

import functools
import math
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from jaxtyping import Bool
from torch import Tensor

import recon
from benchmarks.cameras import PIXELS, corruption, in_true_world
from benchmarks.protocol import (
    NINE_TENTHS,
    Cell,
    Metrics,
    Table,
    cells,
    columns_of,
    evenly,
    over_windows,
    tell_of,
)
from recon.benchmark.dataset import Splits
from recon.benchmark.windows import TrueWindows, load_windows
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
from recon.metrics.evaluation import evaluate
from recon.simulation.depth import PixelSurface, WatchedSurface, depth_points, without_pose
from recon.simulation.images import camera_ring, keypoints2d
from recon.simulation.points import Corruption, joints3d

JOINT_NOISE = 0.03
"""Standard deviation (m) of every coordinate of joints."""
_PIXELS_KEPT = 30_000
"""Number of pixels kept of a depth image with the ground; some thousand of them see the body."""


@dataclass(frozen=True)
class Seen:
    """Simulated sensors of one window of a true motion."""

    truth: Motion
    body: BodyModel
    number: int
    """Index of the window in the list, which is the random seed and determines the view."""

    @functools.cached_property
    def shown(self) -> WatchedSurface:
        """The body's surface as the sensor sees it."""
        return WatchedSurface.of(self.truth, self.body)

    @functools.cached_property
    def camera(self) -> Camera:
        """The depth sensor at its true pose."""
        return camera_ring(self.truth, self.body, depth_camera(), 1, first=2.4 * self.number)[0]

    @functools.cached_property
    def cloud(self) -> PointsFile:
        """Points of body and ground from the posed sensor; legs hidden in the middle third."""
        return depth_points(
            self.truth, self.body, self.camera, corruption(self.truth, 0.0), self.number,
            points=_PIXELS_KEPT, surfaces=(PixelSurface.BODY, PixelSurface.GROUND),
            shown=self.shown,
        )  # fmt: skip

    @functools.cached_property
    def keypoints(self) -> KeypointsFile:
        """Keypoints in the depth sensor's image, with noise scaled to its size; pose unknown."""
        size = depth_camera().camera_matrix[0, 0] / full_hd_camera().camera_matrix[0, 0]
        hidden = corruption(self.truth, PIXELS * float(size))
        file = keypoints2d(self.truth, self.body, self.camera, hidden, 100 * self.number)
        return replace(file, camera=replace(file.camera, T_camera_world=None))

    @functools.cached_property
    def joints(self) -> PositionsFile:
        """Noisy joints, those below the height `HIDDEN` hidden in the middle third."""
        seen = joints3d(self.truth, self.body, corruption(self.truth, JOINT_NOISE), self.number)
        return PositionsFile(
            "joints3d", seen.positions.numpy(), seen.visible.numpy(), JOINTS, seen.fps
        )

    @functools.cached_property
    def visible_joints(self) -> Bool[Tensor, "time 22"]:
        """Mask of the true joints that the sensor sees."""
        assert self.cloud.truth_visible is not None
        return torch.from_numpy(self.cloud.truth_visible)


WALKS = (
    ("02_01", 0.2), ("06_01", 0.8), ("12_01", 0.9), ("26_01", 2.2), ("32_01", 0.7), ("35_01", 0.2),
)  # fmt: skip
"""Clip and start time (s) of straight walks of six people who are in no test."""
WALK_FRAMES = 75
VIEWS = ((3.0, 90.0), (3.6, 0.0), (6.3, 180.0), (6.5, 60.0))
"""Distance (m) from the sensor to the middle of a walk's path, and angle (degrees) between the
direction of walking and that back to the sensor: 0 comes nearer, 180 goes away."""


def view_of(number: int) -> tuple[float, float]:
    """Return the view of a walk by its number in the list, which is ordered by person.

    The first view changes from person to person, so that some of the walks show all views.
    """
    return VIEWS[(number + number // len(VIEWS)) % len(VIEWS)]


@dataclass(frozen=True)
class SeenWalk(Seen):
    """Simulated depth sensor of known pose before a straight walk, with or without the ground."""

    distance: float
    """Distance (m) from the sensor to the middle of the path."""
    angle: float
    """Angle (degrees) between the direction of walking and that back to the sensor."""

    @functools.cached_property
    def camera(self) -> Camera:
        """The depth sensor, 1.6 m above the ground."""
        pelvis = self.shown.joints[:, 0]
        middle, way = (pelvis[0] + pelvis[-1]) / 2, pelvis[-1] - pelvis[0]
        heading = math.atan2(float(way[1]), float(way[0])) + math.radians(self.angle)
        level = self.distance * middle.new_tensor([math.cos(heading), math.sin(heading)])
        eye = torch.cat((middle[:2] + level, middle.new_tensor([1.6])))
        return depth_camera().placed(eye, middle)

    @functools.cached_property
    def cloud(self) -> PointsFile:
        """Points of the unhidden body, and of the ground for every other person."""
        ground = (PixelSurface.GROUND,) if self.number // len(VIEWS) % 2 else ()
        return depth_points(
            self.truth, self.body, self.camera, Corruption(), self.number,
            points=_PIXELS_KEPT, surfaces=(PixelSurface.BODY, *ground), shown=self.shown,
        )  # fmt: skip


CASES: dict[str, tuple[str, ...]] = {
    "depth": ("posed",),
    "depth, sensor unknown": ("unposed",),
    "2D": ("keypoints",),
    "2D + depth": ("keypoints", "unposed"),
    "joints": ("joints",),
    "joints + depth": ("joints", "posed"),
}
"""Files of each case. Sensors of 2D keypoints do not know their pose."""


def write_files(seen: Seen, case: str, folder: Path) -> list[Path]:
    """Write the observation files of a case, without the truth that only a simulation knows."""
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


SEED, FRAMES = 0, 90
LOST = 0.15
"""Mean error (m) of joints about the pelvis above which a window is lost."""

COLUMNS: Metrics = {
    "root_visible": ("visible cm", 100, 1), "root_hidden": ("hidden cm", 100, 1),
    "root_all": ("all cm", 100, 1), "vertices": ("vertices cm", 100, 1),
    "normal": ("normal °", 1, 1), "height": ("height cm", 100, 1),
    "covered_visible": ("within std, seen", 1, 2), "covered_hidden": ("hidden", 1, 2),
    "said": ("warned %", 100, 0), "seconds": ("CPU s", 1, 1),
}  # fmt: skip

Row = dict[str, float | None]
"""Metrics of one window in SI units."""


def main() -> None:
    """Simulate, write files, read and fit them, print and write the table."""
    parser = over_windows(__doc__)
    parser.add_argument("--cases", nargs="+", choices=("walks", *CASES), default=["depth"])
    parser.add_argument("--prior", default="humor", help="as in recon.fit")
    given = parser.parse_args()
    body, splits = BodyModel.load(), Splits.load(given.splits)
    rows: list[list[Cell]] = []
    for case in given.cases:
        windows = (
            walks(given.corpus, splits, body)
            if case == "walks"
            else load_windows(given.corpus, splits, given.part, body, SEED, FRAMES)
        )
        chosen = evenly(windows, given.only)
        found: list[Row] = []
        for k in chosen:
            seen = Seen(windows.truth[k], body, k)
            if case == "walks":
                seen = SeenWalk(windows.truth[k], body, k, *view_of(k))
            found.append(fitted(seen, case, given.prior))
            print(case, windows.names[k], found[-1], flush=True)
        rows.append(means(case, windows.take(chosen), found))
    headings = columns_of("case", COLUMNS)
    headings[1:1] = [("windows", 0), ("lost", 0), ("refused", 0)]
    name = "depth-walks" if given.cases == ["walks"] else "depth"
    tell_of(given, SEED, {name: Table(headings, rows)})


def walks(corpus: Path, splits: Splits, body: BodyModel) -> TrueWindows:
    """Load straight walks, each as often as there are views of it."""
    listed = replace(splits, windows={"validation": {WALK_FRAMES: WALKS}})
    found = load_windows(corpus, listed, "validation", body, SEED, WALK_FRAMES)
    every = found.take([k for k in range(len(found.names)) for _ in VIEWS])
    names = [
        "{}, {:g} m, {:g} degrees".format(name, *view_of(k)) for k, name in enumerate(every.names)
    ]
    return replace(every, names=tuple(names))


def fitted(seen: Seen, case: str, prior: str) -> Row:
    """Fit one window's files and return its metrics; empty if the files are refused."""
    with tempfile.TemporaryDirectory() as folder:
        paths = write_files(seen, case, Path(folder))
        began = time.process_time()
        try:
            result = recon.fit(recon.load_observation(paths), prior)
        except recon.ReconError as error:
            print(f"refused: {error}", flush=True)
            return {}
    seconds = time.process_time() - began
    body = seen.body
    motion, ground = in_true_world(result, seen.camera.T_world_camera, body)
    truth = seen.truth.window(0, motion.frames)
    visible = seen.visible_joints[: motion.frames]
    errors = evaluate(motion, truth, body, truth_visible=visible)
    row: Row = {
        "root_visible": errors["root_joints_visible"], "root_hidden": errors["root_joints_hidden"],
        "root_all": errors["root_joints_all"], "vertices": errors["vertices"],
        "said": float(len(result.warnings) > 0), "seconds": seconds, **ground,
    }  # fmt: skip
    row["lost"] = float((errors["root_joints_all"] or 0.0) > LOST)
    if result.T_world_camera is None and result.joint_std is not None:
        away = (body.pose(motion).joints - body.pose(truth).joints).abs()
        within = (away <= NINE_TENTHS * result.joint_std[..., None]).float().mean(-1)
        row["covered_visible"] = float(within[visible].mean())
        row["covered_hidden"] = None if visible.all() else float(within[~visible].mean())
    return row


def means(case: str, windows: TrueWindows, rows: Sequence[Row]) -> list[Cell]:
    """Return a row of the table: numbers of lost and refused windows, and means over subjects."""
    there = [k for k, row in enumerate(rows) if row]
    lost = sum(bool(rows[k]["lost"]) for k in there)
    counts: list[Cell] = [case, len(rows), lost, len(rows) - len(there)]
    return counts + cells([rows[k] for k in there], windows.take(there), COLUMNS)


if __name__ == "__main__":
    main()

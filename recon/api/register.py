"""`recon.register`: finds the poses of several depth cameras from what they filmed."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Float

from recon.api.given import paths_given
from recon.api.observations import ObservationsLike
from recon.api.results import Tables, closing_fields
from recon.body.model import BodyModel
from recon.core.camera import depth_camera
from recon.core.errors import ObservationError
from recon.fitting.settings import DEFAULTS
from recon.formats.calibration import load_cameras
from recon.formats.cameras import CameraArrays
from recon.formats.depth_images import read_depth_images
from recon.formats.observations import PointsFile, load_observation, save_observation
from recon.formats.opening import files_of
from recon.formats.outputs import Output, OutputKind
from recon.formats.scans import cloud_files, read_scans
from recon.formats.writing import writing
from recon.method.sensor import Sensor
from recon.reading.clip import as_format_errors, clip_of_files
from recon.reading.icp import OrientedCloud, refined_poses, rough_poses
from recon.reading.places import view_name

_READ = 20_000
"""Points of a frame that are read; the ground takes most of them."""
_FRAMES, _POINTS = 20, 3000
"""Frames, evenly over the clip, and points of each that the alignment looks at."""
_GROUND = 0.05
"""Metres above the ground below which points are left out: a plane slides along itself."""
_SAME_TIME = 0.1
"""Frames by which what several cameras see at once may differ."""
_SHARED = 0.05
"""Share of a camera's points that another one sees as well, at least."""


@dataclass(frozen=True, repr=False)
class DepthRig:
    """Clouds of several depth cameras in one world, z up; iterates over them as observations."""

    files: Mapping[str, PointsFile]
    """What each camera saw, by its name, with its pose."""
    shared: Mapping[str, float]
    """Share of its points, without the ground, that another camera sees as well."""
    decisions: tuple[str, ...]
    """What was found and decided, one sentence each."""
    tables: ClassVar[Tables] = {}

    def __iter__(self) -> Iterator[Sensor]:
        """One observation after the other, as `recon.fit` takes them."""
        return iter(
            clip_of_files(list(self.files.items()), (), DEFAULTS, BodyModel.load()).observations
        )

    def report(
        self, inputs: Mapping[str, str] | None = None, settings: Mapping[str, Any] | None = None
    ) -> dict[str, Any]:
        """The JSON report saved beside the poses; see `MotionResult.report`."""
        return {
            "T_world_camera": {
                name: np.linalg.inv(_camera_pose(file)).tolist()
                for name, file in self.files.items()
            },
            "shared": dict(self.shared),
            "decisions": list(self.decisions), **closing_fields(inputs, settings),
        }  # fmt: skip

    def save(
        self, out: Path | str, *, overwrite: bool = False, report: Mapping[str, Any] | None = None
    ) -> tuple[Path, ...]:
        """Write OUT/CAMERA.npz, inputs of `recon fit`, and a calibration file for `--camera`.

        Raises:
            FileExistsError: when something is there that recon did not write, unless `overwrite`.
        """
        with writing(
            Output(Path(out), OutputKind.FOLDER),
            report=report or self.report(),
            overwrite=overwrite,
        ) as (staged,):
            for name, file in self.files.items():
                save_observation(staged / f"{name}.npz", file)
        return tuple(Path(out) / f"{name}.npz" for name in self.files)

    def __repr__(self) -> str:
        """A summary: every camera, and how much of its cloud overlaps with other cameras'."""
        return "Rig: " + ", ".join(f"{name} shares {one:.0%}" for name, one in self.shared.items())


def register(
    observations: ObservationsLike,
    *,
    camera: str | Path | None = None,
    frame_rate: float | None = None,
    depth_scale: float = 0.001,
) -> DepthRig:
    """Bring depth cameras that filmed one clip into one world, without a calibration of the rig.

    Each is a folder of depth images (.png), a folder of clouds (.ply, .pcd, ...) or observations
    of points (.npz), in the axes of its camera: x right, y down, z forward. Poses that files state
    may be off by 10 cm and 5 degrees; where some have none, all must see the ground, and the path
    of the person tells how they stand to each other. Then clouds are aligned by what two cameras
    see at once, the person and the room; the ground, where it is seen, becomes z = 0.

    Args:
        observations: one per camera, of one clock.
        camera: calibration of the lenses of depth images: one for all, or one of the name of each
            folder.
        frame_rate: frames per second, where files do not tell.
        depth_scale: metres per unit of depth images.

    Raises:
        ReconError: when there are fewer than two cameras, something else than points, or cameras
            that share too little; says what to do.
        FileNotFoundError: when there is nothing there.
    """
    paths = paths_given(observations)
    names = [view_name(path) for path in paths]
    if len(set(names)) < max(len(names), 2):
        raise ObservationError(
            "expected paths of two or more cameras with different names, got "
            f"{', '.join(names) or 'none'}"
        )
    _refuse_unused(paths, camera, frame_rate, depth_scale)
    with as_format_errors():
        files = [_read_points(path, camera, frame_rate, depth_scale) for path in paths]
    body = BodyModel.load()
    own = [_in_own_frame(file) for file in files]
    clips = [clip_of_files([one], (), DEFAULTS, body) for one in zip(names, own, strict=True)]
    level = np.array([one.observations[0].ground_seen for one in clips])  # pyright: ignore[reportAttributeAccessIssue]
    base = int(level.argmax())
    level &= level[base]
    stands = np.stack([np.asarray(one.T_recording_camera) for one in clips])
    posed = all(file.camera and file.camera.T_camera_world is not None for file in files)
    views = _oriented_clouds(names, own, stands, level, base)
    if posed:
        start = np.stack([np.linalg.inv(_camera_pose(file)) for file in files]) @ np.linalg.inv(
            stands
        )
        start = np.linalg.inv(start[base]) @ start
        start = np.stack(
            [_levelled_pose(T) if flat else T for T, flat in zip(start, level, strict=True)]
        )
    elif level.all():
        start = rough_poses(views, base, names)
    else:
        raise ObservationError(
            f"{names[int(level.argmin())]}: this camera sees no ground, so its pose "
            "relative to the others is unknown; give files with rough poses (T_camera_world)"
        )
    found, shared = refined_poses(views, start, base, level)
    share, name = min(zip(shared.tolist(), names, strict=True))
    if share < _SHARED:
        raise ObservationError(
            f"{name}: another camera sees {share:.0%} of what this one sees, expected at "
            f"least {_SHARED:.0%}: place cameras nearer to each other, or let them see the room"
        )
    placed = {
        name: _in_world(file, pose @ T, bare=given.camera is None)
        for name, file, given, pose, T in zip(names, own, files, found, stands, strict=True)
    }
    ground = (
        f"the ground that {names[base]} sees is z = 0" if level[base]
        else f"no ground is seen: {names[base]} is taken as held level; fit with --ground unknown"
    )  # fmt: skip
    begun = "begun by " + ("stated poses" if posed else "the path of the person")
    return DepthRig(placed, dict(zip(names, shared.tolist(), strict=True)), (begun, ground))


def _refuse_unused(
    paths: Sequence[Path], camera: str | Path | None, frame_rate: float | None, depth_scale: float
) -> None:
    """Refuse options that none of the files needs."""
    images = any(map(_holds_images, paths))
    unused = {
        "camera": camera is not None and not images,
        "depth_scale": depth_scale != DEFAULTS.depth_scale and not images,
        "frame_rate": frame_rate is not None
        and not any(path.is_dir() and not (path / "times.csv").exists() for path in paths),
    }
    if names := [name for name, given in unused.items() if given]:
        raise ObservationError(
            f"{', '.join(names)}: camera and depth_scale are of depth images alone, frame_rate of "
            "folders without times.csv; the files given state these themselves, leave them out"
        )


def _holds_images(path: Path) -> bool:
    """Whether a path is a folder of depth images, and not of clouds with images beside them."""
    return path.is_dir() and bool(files_of(path, (".png",))) and not cloud_files(path)


def _read_points(
    path: Path, camera: str | Path | None, frame_rate: float | None, depth_scale: float
) -> PointsFile:
    """Read one depth camera's point clouds; in its own frame if the file has no pose."""
    if _holds_images(path):
        if camera is None:
            raise ObservationError(f"{path}: depth images need --camera")
        lenses = load_cameras(camera).cameras
        lens = next(iter(lenses.values())) if len(lenses) == 1 else lenses.get(path.name)
        if lens is None:
            raise ObservationError(
                f"{camera}: expected a camera named {path.name}, or a single camera for all "
                f"files, got {', '.join(lenses)}"
            )
        return read_depth_images(path, lens, fps=frame_rate, depth_scale=depth_scale, points=_READ)
    if path.is_dir():
        return read_scans(path, fps=frame_rate, up="z", points=_READ)
    file = load_observation(path)
    if not isinstance(file, PointsFile):
        raise ObservationError(f"{path}: expected points of a depth camera, got another sensor")
    return file


def _in_own_frame(file: PointsFile) -> PointsFile:
    """Transform points from the world to their camera's frame, and drop the camera's pose."""
    T = _camera_pose(file)
    lens = replace(_camera_of(file), T_camera_world=None)
    return replace(file, points=file.points @ T[:3, :3].T + T[:3, 3], camera=lens)


def _camera_of(file: PointsFile) -> CameraArrays:
    """Return the camera in a file of points, or a default depth camera if it has none."""
    usual = depth_camera()
    return file.camera or CameraArrays(usual.camera_matrix.double().numpy(), usual.image_size)


def _camera_pose(file: PointsFile) -> Float[np.ndarray, "4 4"]:
    """Return T_camera_world of a file's fixed camera; the identity if its pose is unknown."""
    known = None if file.camera is None else file.camera.T_camera_world
    if known is not None and len(known) != 1:
        raise ObservationError("expected cameras that stand still, got one that moves")
    return np.eye(4) if known is None else known[0]


def _levelled_pose(T: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "4 4"]:
    """Return the nearest transform that turns about z and shifts horizontally only."""
    angle = np.arctan2(T[1, 0] - T[0, 1], T[0, 0] + T[1, 1])
    out = np.eye(4)
    out[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    out[:2, 3] = T[:2, 3]
    return out


def _oriented_clouds(
    names: Sequence[str],
    files: Sequence[PointsFile],
    poses: np.ndarray,
    sees_ground: np.ndarray,
    base: int,
) -> list[OrientedCloud]:
    """Return clouds of frames that two cameras saw at once, z up, without ground points.

    Raises:
        ObservationError: when a camera saw nothing at the same time as another one.
    """
    generator, first = np.random.default_rng(0), files[base]
    ticks = [
        (one.start_time - first.start_time + one.frame / one.fps) * first.fps for one in files
    ]
    frames = [np.rint(one).astype(np.int64) for one in ticks]
    together_at = [f[np.abs(t - f) < _SAME_TIME] for f, t in zip(frames, ticks, strict=True)]
    seen, counts = np.unique(
        np.concatenate([np.unique(one) for one in together_at]), return_counts=True
    )
    several = seen[counts > 1]
    if alone := [
        name for name, frame in zip(names, together_at, strict=True)
        if not np.isin(frame, several).any()
    ]:  # fmt: skip
        raise ObservationError(
            f"{', '.join(alone)}: saw nothing at the same time as another camera; check start "
            "times and frame rates, which must be of one clock"
        )
    chosen = several[np.unique(np.linspace(0, len(several) - 1, _FRAMES).round().astype(int))]
    views = []
    for file, frame, tick, T, flat in zip(files, frames, ticks, poses, sees_ground, strict=True):
        points = file.points @ T[:3, :3].T + T[:3, 3]
        kept = np.isin(frame, chosen) & (np.abs(tick - frame) < _SAME_TIME)
        kept &= (points[:, 2] > _GROUND) | (not flat)
        order = generator.permutation(np.flatnonzero(kept))
        rows = np.concatenate([order[frame[order] == one][:_POINTS] for one in chosen])
        views.append(OrientedCloud.of(points[rows], frame[rows], T[:3, 3]))
    return views


def _in_world(file: PointsFile, pose: Float[np.ndarray, "4 4"], *, bare: bool) -> PointsFile:
    """Transform a camera's points to the world by its pose; `bare` leaves the camera out."""
    points = file.points @ pose[:3, :3].T + pose[:3, 3]
    lens = None if bare else replace(_camera_of(file), T_camera_world=np.linalg.inv(pose)[None])
    return replace(file, points=points, camera=lens)

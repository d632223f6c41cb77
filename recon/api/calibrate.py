"""`recon.calibrate`: poses and focal lengths of cameras that filmed one person or a board."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Float

from recon.api.fit import fit
from recon.api.given import paths_given
from recon.api.observations import ObservationsLike
from recon.api.results import Tables, closing_fields
from recon.body.model import BodyModel
from recon.core.arrays import finite_number
from recon.core.errors import ObservationError
from recon.core.layouts import keypoint_names
from recon.core.skeleton import joint_index
from recon.fitting.settings import ReadOptions
from recon.formats.calibration import camera_table
from recon.formats.cameras import CameraArrays, ImageSize
from recon.formats.observations import KeypointsFile
from recon.formats.producers import is_film
from recon.formats.writing import writing_file
from recon.method.sensor import Sensor
from recon.reading.clip import as_format_errors
from recon.reading.images import keypoints_of, undistorted_keypoints
from recon.reading.places import files_of_views
from recon.reading.rig import FilmedPerson, Rig, rig_of_person
from recon.reading.stated import rotation_to_level
from recon.reading.views import Views, read_views

_LONGEST_SHIFT = 1.0
"""Seconds by which one film may begin after another."""
_LONGEST_FIT = 10.0
"""Seconds that are fitted to find the ground and the person's size."""
_LIMBS = (("shoulder", "elbow"), ("elbow", "wrist"), ("hip", "knee"), ("knee", "ankle"))
_UNEVEN = 2.0
"""Ratio of a limb's length to that of other limbs, relative to an average body's, that nobody has:
those of people in real films are 0.7 to 1.3."""
_HEIGHTS = (0.5, 2.5)
"""Metres."""


@dataclass(frozen=True, repr=False)
class CameraRig:
    """Calibrated cameras in one world (m, z up, ground z = 0); a single camera has no pose."""

    cameras: Mapping[str, CameraArrays]
    """By the names of their films."""
    late: Mapping[str, float]
    """Frames by which each film begins after the first."""
    error: float
    """Median distance of a keypoint, or mean one of a board's corner, from where all views place
    it, as a share of the focal length."""
    person: float | None
    """Height of the person, metres: as given, or as the fit of an average body says; None where a
    board was filmed."""
    decisions: tuple[str, ...]
    """What was found, and what was assumed."""
    tables: ClassVar[Tables] = {}

    def report(
        self, inputs: Mapping[str, str] | None = None, settings: Mapping[str, Any] | None = None
    ) -> dict[str, Any]:
        """The JSON report saved beside the calibration; see `MotionResult.report`."""
        return {
            "late": dict(self.late), "error": self.error, "person": self.person,
            "decisions": list(self.decisions), **closing_fields(inputs, settings),
        }  # fmt: skip

    def save(
        self, out: Path | str, *, overwrite: bool = False, report: Mapping[str, Any] | None = None
    ) -> tuple[Path, ...]:
        """Write a calibration (.toml, as Pose2Sim's) that `--camera` reads.

        Raises:
            FileExistsError: when something is there that recon did not write, unless `overwrite`.
            ObservationError: when the name does not end in .toml.
        """
        if Path(out).suffix.lower() != ".toml":
            raise ObservationError(f"{out}: expected a path that ends in .toml for a calibration")
        with writing_file(Path(out), report or self.report(), overwrite=overwrite) as staged:
            tables = (camera_table(name, one) for name, one in self.cameras.items())
            staged.write_text("\n".join(tables))
        return (Path(out),)

    def __repr__(self) -> str:
        """A summary: position and focal length of every camera."""
        seen = "a board" if self.person is None else f"a person of {self.person:.2f} m"
        lines = [f"{len(self.cameras)} cameras that saw {seen}"]
        for name, camera in self.cameras.items():
            where = "pose not known"
            if camera.T_camera_world is not None:
                where = f"at {np.linalg.inv(camera.T_camera_world[0])[:3, 3].round(2)} m"
            focal = camera.camera_matrix[0, 0]
            lines.append(f"  {name}: {where}, focal length {focal:.0f} pixels")
        return "\n".join(lines)


def calibrate(
    observations: ObservationsLike,
    *,
    height: float | None = None,
    frame_rate: float | None = None,
    layout: str | None = None,
    person: int | None = None,
    camera: str | Path | None = None,
    image_size: ImageSize | None = None,
    detector: str | None = None,
    detections: str | None = None,
    board: str | None = None,
    square: str | None = None,
) -> CameraRig:
    """Find poses and focal lengths of fixed cameras that all film one person or checkerboard.

    The person should walk about, so that keypoints fill the space where all cameras look. Films
    may begin up to a second apart. Directions and focal lengths come from the keypoints, the unit
    of length from the height of the person, and the ground from where the feet stand.

    A checkerboard (`board` and `square`) tells more exactly, and the distortion of lenses, too.
    Move and tilt it before all cameras, then lay it on the floor for a second, which becomes the
    ground. Films begin at one moment. One film alone tells its lens.

    Args:
        observations: films, or files or folders of 2D keypoints, one per camera.
        height: of the person, metres, with bare feet; None takes an average body, so that all
            lengths may be off by as much as the person differs from it.
        frame_rate: frames per second, where files do not tell.
        layout: which keypoints they are, where files do not tell.
        person: number of the person to follow where films show several.
        camera: calibration of the lenses, whose focal lengths are then kept and whose distortion
            is taken away; default: phones, whose focal lengths are found.
        image_size: width and height, pixels, where files do not tell.
        detector: of people in films, as of `recon.detect`.
        detections: folder in which detections are kept, as of `recon.detect`.
        board: inner corners of a checkerboard along its two sides, 9x6, which is filmed instead of
            a person.
        square: side of its squares: 25mm.

    Raises:
        ReconError: when there are fewer than two views, or they do not tell how the cameras stand;
            says what to do.
        FileNotFoundError: when there is nothing there.
    """
    if height is not None and not _HEIGHTS[0] <= finite_number(height, "height") <= _HEIGHTS[1]:
        raise ObservationError(
            f"height: expected {_HEIGHTS[0]} to {_HEIGHTS[1]} metres, got {height:g}"
        )
    paths, _ = files_of_views(paths_given(observations))
    given = {
        "frame_rate": frame_rate, "layout": layout, "person": person, "camera": camera,
        "image_size": image_size, "detector": detector, "detections": detections,
    }  # fmt: skip
    by_board = board is not None or square is not None
    unused = (
        {**given, "height": height} if by_board
        else {} if any(map(is_film, paths))
        else {"detector": detector, "detections": detections}
    )  # fmt: skip
    if names := [name for name, value in unused.items() if value is not None]:
        raise ObservationError(
            f"a calibration by {'films of a checkerboard' if by_board else '2D keypoints'} does "
            f"not use {', '.join(names)}; leave these out"
        )
    if by_board:
        return _calibrated_by_board(paths, board or "", square)
    if len(paths) < 2:
        raise ObservationError(
            f"expected films or files of 2D keypoints of two or more cameras, got {len(paths)}"
        )
    how = ReadOptions.of(given)
    with as_format_errors():
        views = [read_views([path], how).views_of_person(person) for path in paths]
    files = _padded_keypoints_by_camera(views)
    people = [_filmed_person(name, one) for name, one in files.items()]
    rig = rig_of_person(people, round(_LONGEST_SHIFT * next(iter(files.values())).fps))
    poses, tall = _camera_poses_and_body_height(rig, files, people, BodyModel.load())
    scale = 1.0 if height is None else height / tall
    cameras: dict[str, CameraArrays] = {}
    for view, (name, pose), focal in zip(views, poses.items(), rig.focal, strict=True):
        pose[:3, 3] *= scale
        cameras[name] = _placed_camera(view.files[0].camera, float(focal), pose)
    assumed = (
        f"no height given: the person is fitted as {tall:.2f} m tall; all lengths are wrong by "
        "the same factor as this height; give --height"
        if height is None
        else f"height {height:.2f} m: given; an average body was fitted as {tall:.2f} m"
    )
    return CameraRig(
        cameras,
        dict(zip(files, rig.late.tolist(), strict=True)),
        rig.error,
        tall * scale,
        (
            *(said for view in views for said in view.decisions),
            *(
                f"{name}: begins {late / views[0].files[0].fps:z.2f} s late"
                for name, late in zip(files, rig.late, strict=True)
            ),
            assumed,
        ),
    )


def _calibrated_by_board(paths: Sequence[Path], board: str, square: str | None) -> CameraRig:
    from recon.films.board import Board, cameras_of_board  # imported only when a board was filmed

    known = Board.of(board, square)
    if others := [str(path) for path in paths if not is_film(path)]:
        raise ObservationError(f"board: expected films of a checkerboard, got {', '.join(others)}")
    cameras, error, said = cameras_of_board(paths, known)
    return CameraRig(cameras, dict.fromkeys(cameras, 0.0), error, None, said)


def _padded_keypoints_by_camera(views: Sequence[Views]) -> dict[str, KeypointsFile]:
    """Return 2D keypoints by camera name, padded with unseen frames to span all the films.

    Raises:
        ObservationError: when names, layouts or frame rates are not what they should be.
    """
    camera_names = [name for view in views for name in view.names]
    files = [file for view in views for file in view.files]
    if len(set(camera_names)) < len(camera_names):
        raise ObservationError(
            "cameras are named after their files, so files need different names, got "
            f"{', '.join(camera_names)}; rename one, or name a lens in --camera for each"
        )
    for what in ("layout", "fps"):
        told = {getattr(file, what) for file in files}
        if len(told) > 1:
            raise ObservationError(
                f"expected one {'frame rate' if what == 'fps' else what} for all views, got "
                f"{', '.join(map(str, sorted(told)))}; detect all alike, or give the right one"
            )
    first = min(view.first_frame for view in views)
    stop = max(v.first_frame + len(file.pixels) for v, file in zip(views, files, strict=True))
    found = {}
    for name, view, file in zip(camera_names, views, files, strict=True):
        around = (view.first_frame - first, stop - view.first_frame - len(file.pixels))
        pixels = np.pad(undistorted_keypoints(file), (around, (0, 0), (0, 0)))
        confidence = np.pad(file.confidence, (around, (0, 0)))
        lens = replace(file.camera, T_camera_world=None, distortion=None)
        found[name] = replace(file, pixels=pixels, confidence=confidence, camera=lens)
    return found


def _filmed_person(camera_name: str, file: KeypointsFile) -> FilmedPerson:
    matrix, path = file.camera.camera_matrix, file.camera.path
    up = None if path is None or not path.level else path.T_world_camera[0, 2, :3]
    return FilmedPerson(
        camera_name, file.pixels, file.confidence, float(matrix[[0, 1], [0, 1]].mean()),
        file.camera.focal_std, matrix[:2, 2], up,
    )  # fmt: skip


def _rotation_to_z_up_and_scale(
    rig: Rig, people: Sequence[FilmedPerson], layout: str, body: BodyModel
) -> tuple[Float[np.ndarray, "3 3"], float]:
    """Return the rotation from the first camera's frame to z up, and metres per unit of the rig.

    Up is the mean of the cameras' own estimates, else the direction from ankles to shoulders. The
    unit makes the person's limbs about as long as those of an average body.
    """
    points = {name: rig.points[:, k] for k, name in enumerate(keypoint_names(layout))}
    rest = body.rest_joints(body.template.new_zeros(1)).double().numpy()
    pairs = [(f"{side}_{a}", f"{side}_{b}") for side in ("left", "right") for a, b in _LIMBS]
    seen = [(a, b) for a, b in pairs if np.isfinite(points[a] - points[b]).any()]
    ratios = [
        np.linalg.norm(rest[joint_index(a)] - rest[joint_index(b)])
        / np.nanmedian(np.linalg.norm(points[a] - points[b], axis=-1))
        for a, b in seen
    ]
    told = zip(rig.T_camera_world, people, strict=True)
    ups = [T[:3, :3].T @ one.up for T, one in told if one.up is not None]
    rise = [points[f"{s}_shoulder"] - points[f"{s}_ankle"] for s in ("left", "right")]
    if not ups and np.isfinite(rise).any():
        ups = [np.nanmean(rise, axis=(0, 1))]
    if not ups or not seen:
        raise ObservationError(
            "no two cameras see limbs of the person, and shoulder and ankle of one side, which "
            "tell size and vertical; film the person from head to foot"
        )
    unit, up = float(np.median(ratios)), np.mean(ups, axis=0)
    if max(ratios) > _UNEVEN * unit or min(ratios) < unit / _UNEVEN:
        raise ObservationError(
            f"limbs of the person come out {unit / max(ratios):.1f} to {unit / min(ratios):.1f} "
            f"times as long as a body's, expected {1 / _UNEVEN:g} to {_UNEVEN:g}; do all views "
            "show one person (--person counts in each view by itself) at the same time?"
        )
    return rotation_to_level(up / np.linalg.norm(up)), unit


def _camera_poses_and_body_height(
    rig: Rig, files: Mapping[str, KeypointsFile], people: Sequence[FilmedPerson], body: BodyModel
) -> tuple[dict[str, Float[np.ndarray, "4 4"]], float]:
    """Return T_camera_world of every camera, by a fit that finds the ground, and body height (m).

    Args:
        rig: the cameras in the frame of the first.
        files: what each camera saw, without distortion.
        people: the tracks of 2D keypoints, per camera, from which the rig was found.
        body: that is fitted.
    """
    first = next(iter(files.values()))
    turn, unit = _rotation_to_z_up_and_scale(rig, people, first.layout, body)
    level = all(one.up is not None for one in people)
    poses: dict[str, Float[np.ndarray, "4 4"]] = {}
    seen: list[Sensor] = []
    own = zip(files.items(), rig.T_camera_world, rig.focal, rig.late, strict=True)
    for (name, file), T, focal, late in own:
        pose = np.vstack((np.hstack((T[:3, :3] @ turn.T, unit * T[:3, 3:])), (0, 0, 0, 1)))
        camera = _placed_camera(file.camera, focal, pose)
        shifted = replace(file, camera=camera, start_time=-late / first.fps)
        seen.append(keypoints_of(shifted, body).derived(ground_known=False, level=level))
        poses[name] = pose
    found = fit(
        seen, "pose", body=body, ground="unknown", between=_span_seen_best(files, first.fps)
    )
    assert found.T_world_camera is not None
    moved = found.T_world_camera.double().numpy() @ next(iter(poses.values()))
    return (
        {name: pose @ np.linalg.inv(moved) for name, pose in poses.items()},
        float(body.height(found.motion.shape)),
    )


def _placed_camera(
    camera: CameraArrays, focal: float, pose: Float[np.ndarray, "4 4"]
) -> CameraArrays:
    """Return a camera with the given focal length (pixels) and pose (T_camera_world)."""
    matrix = camera.camera_matrix.copy()
    matrix[[0, 1], [0, 1]] = focal
    return CameraArrays(matrix, camera.image_size, camera.distortion, pose[None])


def _span_seen_best(files: Mapping[str, KeypointsFile], fps: float) -> tuple[float, float] | None:
    """Return the span (s) in which all cameras see most keypoints; None for a short film."""
    seen = np.stack([one.confidence.mean(-1) for one in files.values()]).min(0)
    length = round(_LONGEST_FIT * fps)
    if len(seen) <= length:
        return None
    first = int(np.convolve(seen, np.ones(length), mode="valid").argmax())
    return first / fps, (first + length) / fps

"""Everything that was recorded of one clip, from files of any kind, in one frame."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from observations.files.clouds import cloud_of
from observations.files.images import camera_above, keypoints_of
from observations.files.keypoints3d import settled
from observations.files.points import positions_of
from observations.people.places import load_silhouettes, masked
from observations.people.views import load_views, read_views
from recon.body.model import BodyModel
from recon.core.errors import FormatError, ObservationError
from recon.fitting.readers import PlaceMarkers, read_by, readers
from recon.fitting.settings import DEFAULTS, FitSettings
from recon.formats.calibration import load_cameras
from recon.formats.depth_images import read_depth_images
from recon.formats.detections.tables import holds_detections
from recon.formats.keypoints3d.labels import are_keypoints
from recon.formats.keypoints3d.reader import (
    RECORDINGS,
    from_recording,
    holds_points_3d,
    marker_recording,
    markers_of_study,
    read_points_3d,
)
from recon.formats.mocap.recording import MarkerRecording
from recon.formats.observations import (
    KeypointsFile,
    ObservationFile,
    PointsFile,
    PositionsFile,
    load_observation,
)
from recon.formats.projects import Project, project_at
from recon.formats.scans import read_scans
from recon.method.protocols import Sensor
from recon.people.everyone import everyone

_CLOUDS, _IMAGES, _DETECTIONS = {".ply", ".pcd"}, {".png"}, {".json", ".csv"}


@dataclass(frozen=True)
class Clip:
    """One clip's observations, and what was assumed in reading them."""

    observations: tuple[Sensor, ...]
    """All in the frame of the recording."""
    names: tuple[str, ...]
    notes: tuple[str, ...]
    T_recording_camera: Float[np.ndarray, "4 4"] | None
    """Pose of the one camera whose pose is not known, if there is one; metres."""
    ground_given: bool = False
    """Whether the caller gave the plane that lies at z = 0 of the recording."""


def load_clip(
    paths: Sequence[Path],
    settings: FitSettings,
    body: BodyModel,
    place_markers: PlaceMarkers | None = None,
) -> Clip:
    """Read files and folders of one clip.

    Whatever the class `settings.reader` or one that is registered as `recon.observations` reads;
    observation files (.npz) of any kind; folders or files of 2D detections, one per view, with
    `--camera`; 3D keypoints of other programs, by file or session folder; markers (.c3d, .trc)
    where `place_markers` says how; a folder of scans (.ply, .pcd); a folder of 16-bit depth images
    (.png) with `--camera`. Sensors without a pose are taken to be one and the same camera.

    Raises:
        FileNotFoundError: when something is not there.
        ValueError: when something cannot be read, or options are missing; says what to do.
    """
    if len(paths) == 0:
        raise ObservationError("nothing to fit: expected at least one observation file, got none")
    own = readers(settings.reader)
    for path in paths:
        if not path.exists():
            raise FileNotFoundError(f"no observation at {path}")
    paths, settings, projects = _of_projects(paths, settings)
    files: list[tuple[str, ObservationFile | Sensor]] = []
    notes = [decision for one in projects for decision in one.decisions]
    detections: list[Path] = []
    stretch: tuple[float, float] | None = None
    for path in paths:
        if path.is_dir() and next(path.iterdir(), None) is None:
            raise ObservationError(
                f"{path}: the folder is empty; expected scans (.ply, .pcd), depth images (.png) "
                "or 2D detections (.json, .csv) in it"
            )
        if (seen := read_by(own, path, body)) is not None:
            files.append((str(path), seen))
        elif (recording := _recording(path, settings)) and _on_skin(recording, settings):
            if place_markers is None:
                raise FormatError(
                    f"{path}: its points are markers on the skin ("
                    f"{', '.join(recording.marker_names[:6])}, ...), no keypoints"
                )
            placed = place_markers(recording, body, settings.mapping, settings.robust)
            notes += [f"{path}: {decision}" for decision in placed.decisions]
            files.append((str(path), placed.markers))
        elif (file := _points_3d(path, settings, body, recording)) is not None:
            notes += [f"{path}: {decision}" for decision in file.decisions]
            found = positions_of(file, path, body, up="z", robust=settings.robust)
            files.append((str(path), found))
        elif holds_detections(path):
            detections.append(path)
        elif path.suffix.lower() == ".npz":
            files.append((str(path), load_observation(path, unit=settings.unit)))
        elif kinds := _inside(path) & (_CLOUDS | _IMAGES):
            files.append((str(path), _read_folder(path, kinds, settings)))
        elif path.is_dir() or path.suffix.lower() in _DETECTIONS:
            detections.append(path)
        else:
            raise FormatError(
                f"{path}: expected an observation (.npz), 2D keypoints (.json, .csv or folders of "
                "them), 3D keypoints (.npy, .npz, .csv, .json, .trc, .c3d or a session folder), "
                "markers (.c3d, .trc) or a folder of scans or depth images; `recon convert` takes "
                "skeletons of motion capture"
            )
    if detections:
        if settings.person == "all":
            raise ObservationError(
                "one clip is of one person; `recon fit --person all`, in Python recon.load_people "
                "and recon.fit_people, fit everybody"
            )
        views = load_views(
            detections, settings.camera, fps=settings.frame_rate, layout=settings.layout,
            person=settings.person, camera_unit=settings.camera_unit, camera_up=settings.camera_up,
            image_size=settings.image_size, track=settings.camera_track,
        )  # fmt: skip
        notes += views.decisions
        shown = views.files
        if settings.masks is not None:
            if len(shown) != 1:
                raise ObservationError(
                    f"--masks are of one view, got {len(shown)} views; write the masked keypoints "
                    "of each view to an observation file first"
                )
            mask = load_silhouettes(settings.masks)
            shown = (masked(shown[0], mask, first_frame=views.first_frame),)
        files += zip(views.names, shown, strict=True)
        if len(projects) == 1 and projects[0].frames is not None:
            first, end = (k - views.first_frame for k in projects[0].frames)
            stretch = (first / shown[0].fps, (end - 1) / shown[0].fps)
    clip = _together(files, notes, settings, body)
    return clip if stretch is None else window(clip, *stretch)


@dataclass(frozen=True)
class PersonClip:
    """One of several people in detections."""

    number: int
    """Their number as `person` takes it."""
    clip: Clip
    """What was seen of them, from when they were first seen to when they were last seen."""


def load_people(
    paths: Sequence[Path], settings: FitSettings, body: BodyModel
) -> tuple[tuple[PersonClip, ...], tuple[str, ...]]:
    """Everybody in 2D detections, who are left out, and what else was decided.

    Raises:
        FileNotFoundError: when something is not there.
        ValueError: when it is something else than detections, cannot be read, or options are
            missing; says what to do.
    """
    for path in paths:
        if not path.exists():
            raise FileNotFoundError(f"no observation at {path}")
    paths, settings, projects = _of_projects(paths, settings)
    for path in paths:
        if path.is_file() and path.suffix.lower() not in _DETECTIONS:
            raise FormatError(
                f"{path}: several people are told apart in files of 2D detections (.json, .csv, "
                "or folders of them); give nothing else with --person all"
            )
    if settings.masks is not None:
        raise ObservationError("--masks are of one person; leave them out with --person all")
    seen = read_views(
        paths, settings.camera, fps=settings.frame_rate, layout=settings.layout,
        camera_unit=settings.camera_unit, camera_up=settings.camera_up,
        image_size=settings.image_size, track=settings.camera_track,
    )  # fmt: skip
    found = everyone(seen)
    people: list[PersonClip] = []
    for one in found.people:
        files = list(zip(one.views.names, one.views.files, strict=True))
        clip = _together(files, [one.note], settings, body)
        times = np.concatenate([seen_times(view) for view in clip.observations])
        people.append(PersonClip(one.number, window(clip, times.min(), times.max())))
    notes = [decision for one in projects for decision in one.decisions]
    return tuple(people), (*notes, *seen.decisions, *found.decisions)


def _of_projects(
    paths: Sequence[Path], settings: FitSettings
) -> tuple[list[Path], FitSettings, list[Project]]:
    """Files of projects instead of their folders, and what their own settings say.

    What the caller says counts more. A camera that he gives makes a project a folder of
    detections.
    """
    found: list[Path] = []
    projects: list[Project] = []
    for path in paths:
        project = project_at(path) if settings.camera is None else None
        if project is None:
            found.append(path)
            continue
        projects.append(project)
        seen = project.detections if project.calibration is not None else None
        if seen is None and project.points is None:
            seen = project.detections
        found.append(seen or project.points or path)
    if len(projects) == 1:
        (one,) = projects
        settings = replace(
            settings, camera=one.calibration, frame_rate=settings.frame_rate or one.fps
        )
    elif projects:
        raise ObservationError(
            f"expected one project at a time, got {', '.join(str(p.folder) for p in projects)}"
        )
    return found, settings, projects


def _points_3d(
    path: Path, settings: FitSettings, body: BodyModel, recording: MarkerRecording | None
) -> PositionsFile | None:
    """The 3D keypoints of a file or folder, z up; None where it holds something else."""
    if recording is not None:
        if (markers := markers_of_study(recording)) is not None:
            return markers
        raw, unit, up = from_recording(recording), None, None
    elif holds_points_3d(path, images=settings.camera is not None):
        person = None if settings.person == "all" else settings.person
        raw, unit, up = read_points_3d(path, person=person), settings.unit, settings.up
    else:
        return None
    return settled(raw, body, fps=settings.frame_rate, unit=unit, up=up, layout=settings.layout)


def _recording(path: Path, settings: FitSettings) -> MarkerRecording | None:
    """The labelled points of a .c3d or .trc file; None for other files."""
    if path.suffix.lower() not in RECORDINGS or not path.is_file():
        return None
    return marker_recording(path, settings.unit, settings.up)


def _on_skin(recording: MarkerRecording, settings: FitSettings) -> bool:
    """Whether the points are markers on the skin, as those are that the caller maps."""
    if settings.mapping is not None:
        return True
    return not are_keypoints(recording.marker_names) and markers_of_study(recording) is None


def clip_from(files: Sequence[tuple[str, ObservationFile]], body: BodyModel) -> Clip:
    """One clip of what observation files hold, each with a name for messages.

    Raises:
        ValueError: as `load_clip` does.
    """
    return _together(files, [], DEFAULTS, body)


def window(clip: Clip, start: float, stop: float) -> Clip:
    """What was seen from one time to another, both included, seconds of the recording's clock.

    Before the first and after the last moment of all observations there is nothing to fit.

    Raises:
        ValueError: when the times do not rise or nothing was seen between them.
    """
    if not start < stop:
        raise ObservationError(f"--between takes two rising times in seconds, got {start} {stop}")
    ends = [one.start_time + (one.shown.shape[-2] - 1) / one.fps for one in clip.observations]
    first = max(start, min(one.start_time for one in clip.observations))
    last = max(first, min(stop, max(ends)))
    cut = tuple(observation.window(first, last) for observation in clip.observations)
    if not any(len(seen_times(one)) > 0 for one in cut):
        every = np.concatenate([seen_times(one) for one in clip.observations])
        raise ObservationError(
            f"{', '.join(clip.names)}: nothing was seen between {start:g} and {stop:g} s; "
            f"--between counts on the recording's clock, which shows something from "
            f"{every.min():.2f} to {every.max():.2f} s"
        )
    return replace(clip, observations=cut)


def seen_times(observation: Sensor) -> Float[np.ndarray, " moments"]:
    """Times at which one clip's observation shows anything, seconds."""
    moments = observation.shown[0].any(-1).nonzero()[:, 0].cpu().numpy()
    return observation.start_time + moments / observation.fps


def _together(
    files: Sequence[tuple[str, ObservationFile | Sensor]],
    notes: list[str],
    settings: FitSettings,
    body: BodyModel,
) -> Clip:
    """All as observations; depth without a pose first, as it may see the ground."""
    posed = [_has_pose(file) for _, file in files]
    views_without = [
        name for (name, file), pose in zip(files, posed, strict=True)
        if not pose and isinstance(file, KeypointsFile)
    ]  # fmt: skip
    if len(views_without) > 1:
        raise ObservationError(
            f"the cameras of {', '.join(views_without)} have no pose (T_camera_world), so nobody "
            "knows how they stand to each other; give a calibration, or fit one view alone"
        )
    plane = None if isinstance(settings.ground, str) else settings.ground
    T = None if plane is None else camera_above(plane)
    found: dict[int, Sensor] = {}
    for k, (name, file) in enumerate(files):
        if isinstance(file, PointsFile):
            notes += [f"{name}: {decision}" for decision in file.decisions]
            loaded = cloud_of(file, body, seed=settings.seed, T_recording_camera=T)
            found[k] = loaded.cloud
            seen = "" if loaded.ground.ground is None else "ground: "
            notes.append(f"{name}: {seen}{loaded.ground.reason}")
            notes += [f"{name}: {decision}" for decision in loaded.decisions]
            if not posed[k]:
                T = loaded.T_recording_file if T is None else T
    for k, (name, file) in enumerate(files):
        if isinstance(file, KeypointsFile):
            view = keypoints_of(file, body, None if posed[k] else T)
            found[k] = view
            if not posed[k] and T is None:
                T = view.camera.T_world_camera[0, 0].double().cpu().numpy()
        elif isinstance(file, PositionsFile):
            found[k] = positions_of(
                file, name, body, unit=settings.unit, up=settings.up, robust=settings.robust
            )
        elif not isinstance(file, PointsFile):
            found[k] = file
    observations = tuple(found[k] for k in range(len(files)))
    names = tuple(name for name, _ in files)
    return Clip(observations, names, tuple(notes), T, plane is not None)


def _has_pose(file: ObservationFile | Sensor) -> bool:
    if not isinstance(file, PointsFile | KeypointsFile):
        return True
    return file.camera is None or file.camera.T_camera_world is not None


def _read_folder(path: Path, kinds: set[str], settings: FitSettings) -> PointsFile:
    """A folder of scans or of depth images."""
    if kinds & _CLOUDS:
        up = "z" if settings.up is None else settings.up
        return read_scans(
            path, fps=settings.frame_rate, unit=settings.unit, up=up, seed=settings.seed
        )
    if settings.camera is None or settings.frame_rate is None:
        raise ObservationError(
            f"{path}: depth images need the sensor's calibration (--camera) and --frame-rate"
        )
    cameras = load_cameras(
        settings.camera,
        unit=settings.camera_unit,
        up=settings.camera_up,
        image_size=settings.image_size,
    ).cameras
    if len(cameras) != 1:
        raise ObservationError(
            f"{settings.camera}: expected the one sensor of {path}, got {', '.join(cameras)}"
        )
    return read_depth_images(
        path,
        next(iter(cameras.values())),
        fps=settings.frame_rate,
        depth_scale=settings.depth_scale,
        masks=settings.masks,
    )


def _inside(path: Path) -> set[str]:
    """Endings of the files in a folder."""
    if not path.is_dir():
        return set()
    return {one.suffix.lower() for one in path.iterdir() if one.is_file()}

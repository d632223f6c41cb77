"""Reads all files of one clip into observations with one frame of coordinates."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from recon.body.model import BodyModel
from recon.core.errors import FormatError, ObservationError, ReconError
from recon.detections.tables import holds_detections
from recon.fitting.ground import camera_above
from recon.fitting.records import Clip, clip_between
from recon.fitting.settings import FitSettings
from recon.formats.observations import (
    KeypointsFile,
    ObservationFile,
    PointsFile,
    PositionsFile,
    load_observation,
)
from recon.formats.opening import files_of
from recon.formats.producers import BODIES, is_film, producer_of, refuse_unsupported
from recon.formats.projects import Project, project_at
from recon.formats.scans import cloud_files, read_scans
from recon.keypoints3d.labels import are_keypoints
from recon.keypoints3d.reader import (
    holds_labelled_points,
    holds_points_3d,
    marker_recording,
    opencap_markers,
    points_of_recording,
    read_points_3d,
)
from recon.method.sensor import Sensor
from recon.reading.keypoints3d import points_in_metres
from recon.reading.points import positions_in_metres, positions_of
from recon.reading.readers import Reader, read_by, readers

_IMAGES, DETECTIONS = {".png"}, {".json", ".csv"}
Content = ObservationFile | Sensor
"""What a file holds: arrays, or an observation that needs no more."""


def load_clip(paths: Sequence[Path], settings: FitSettings, body: BodyModel) -> Clip:
    """Read files and folders of one clip as observations.

    Accepted are files of the class `settings.reader` or of a class registered as
    `recon.observations`; observation files (.npz); folders or files of 2D detections, one per
    view, with `--camera`; 3D keypoints of other programs, by file or session folder; markers
    (.c3d, .trc); a folder of scans (.ply, .pcd, .obj); a folder of depth images (.png) with
    `--camera`. Sensors without a pose are taken to be the same camera.

    Raises:
        FileNotFoundError: when something is not there.
        FormatError: when something cannot be read, or options are missing; says what to do.
    """
    if len(paths) == 0:
        raise ObservationError("nothing to fit: expected at least one observation file, got none")
    with as_format_errors():
        own = readers(settings.reader)
        paths, settings, projects = files_of_projects(paths, settings)
        files: list[tuple[str, Content]] = []
        notes = [decision for one in projects for decision in one.decisions]
        detections: list[Path] = []
        for path in paths:
            found = _read_path(path, settings, body, own)
            if found is None:
                detections.append(path)
            else:
                files.append((str(path), found[0]))
                notes += [f"{path}: {decision}" for decision in found[1]]
        if not detections:
            return _clip_without_needless_ground(files, notes, settings, body)
        if settings.person == "all":
            raise ObservationError(
                "expected one person in a clip, got all; run `recon fit --person all`, in Python "
                "recon.people.together.load_people and recon.fit_people, to fit everybody"
            )
        from recon.reading.views import read_views  # imported only for images

        views = read_views(detections, settings, settings.between).views_of_person(settings.person)
        shown = views.files
        if settings.masks is not None:
            if len(shown) != 1:
                raise ObservationError(
                    f"--masks works with one view, got {len(shown)}; fit one view with its masks, "
                    "or leave --masks out"
                )
            # imported only for masks
            from recon.reading.places import inside_silhouettes, load_silhouettes

            mask = load_silhouettes(settings.masks)
            shown = (inside_silhouettes(shown[0], mask, first_frame=views.first_frame),)
        others = len(files)
        files += zip(views.names, shown, strict=True)
        clip = _clip_without_needless_ground(files, [*notes, *views.decisions], settings, body)
        clip = _with_views_at_their_frames(clip, others, views.first_frame)
        span = views.shot
        if len(projects) == 1 and projects[0].frames is not None:
            span = (projects[0].frames[0], projects[0].frames[1] - 1)
        if span is None:
            return clip
        start = clip.observations[others].start_time
        first, last = (start + (frame - views.first_frame) / shown[0].fps for frame in span)
        return clip_between(clip, first, last)


def _read_path(
    path: Path, settings: FitSettings, body: BodyModel, plugin_readers: Sequence[Reader]
) -> tuple[Content, Sequence[str]] | None:
    """Return the data of a file or folder, with notes on reading; None for 2D detections."""
    if path.is_dir() and next(path.iterdir(), None) is None:
        raise ObservationError(
            f"{path}: the folder is empty; expected scans (.ply, .pcd, .obj), depth images (.png) "
            "or 2D detections (.json, .csv) in it"
        )
    if (seen := read_by(plugin_readers, path, body)) is not None:
        return seen, ()
    if is_film(path):
        return None
    refuse_unsupported(path, "fit")
    if path.is_file() and holds_labelled_points(path):
        return _labelled_points(path, settings, body)
    if holds_points_3d(path, images=settings.camera is not None):
        person = None if settings.person == "all" else settings.person
        file = points_in_metres(
            read_points_3d(path, person=person), body, fps=settings.frame_rate,
            unit=settings.unit, up=settings.up, hand=settings.hand, layout=settings.layout,
        )  # fmt: skip
        return _sensor_of_points(file, path, body, settings)
    if holds_detections(path):
        return None
    if (found := producer_of(path)) is not None and found.holds == BODIES:
        raise FormatError(f"{path}: {found.how_to_read()}, and recon.refine in Python")
    if path.suffix.lower() == ".npz":
        return load_observation(path, unit=settings.unit), ()
    if path.is_dir() and (cloud_files(path) or files_of(path, _IMAGES)):
        return _read_folder(path, settings), ()
    if path.is_dir() or path.suffix.lower() in DETECTIONS:
        return None
    raise FormatError(
        f"{path}: expected a film, an observation (.npz), 2D keypoints (.json, .csv, folders of "
        "them), 3D keypoints (.npy, .npz, .csv, .json, .trc, .c3d or a session folder), "
        "markers (.c3d, .trc) or a folder of scans or depth images; `recon convert` takes "
        "skeletons of motion capture"
    )


def _labelled_points(
    path: Path, settings: FitSettings, body: BodyModel
) -> tuple[Sensor, Sequence[str]]:
    """Read the labelled points of a .c3d or .trc file: keypoints, or markers on the skin.

    Labels that the caller maps are markers. Markers that OpenCap computed from keypoints get its
    positions on the body; offsets of other markers from the body are estimated first.
    """
    recording = marker_recording(path, settings.unit, settings.up)
    file = opencap_markers(recording)
    skin = file is None and not are_keypoints(recording.marker_names)
    if skin or settings.mapping is not None:
        from recon.ingest.marker_observation import seen_markers

        return seen_markers(recording, body, settings.mapping, settings.robust, settings.hand)
    if file is None:
        points = points_of_recording(recording)
        file = points_in_metres(
            points, body, fps=settings.frame_rate, hand=settings.hand, layout=settings.layout
        )
    else:
        file = positions_in_metres(file, path, body, up="z", hand=settings.hand)
    return _sensor_of_points(file, path, body, settings)


def _sensor_of_points(
    file: PositionsFile, path: str | Path, body: BodyModel, settings: FitSettings
) -> tuple[Sensor, Sequence[str]]:
    """Make a sensor of points in metres, z up; return it with what was assumed in reading."""
    found = positions_of(file, path, body, up="z", hand="right", robust=settings.robust)
    return found, file.decisions


@contextmanager
def as_format_errors() -> Iterator[None]:
    """Within this context, raise any ValueError of a reader as a `FormatError`."""
    try:
        yield
    except ReconError:
        raise
    except ValueError as error:
        raise FormatError(str(error)) from error


def files_of_projects(
    paths: Sequence[Path], settings: FitSettings
) -> tuple[list[Path], FitSettings, list[Project]]:
    """Replace project folders of other programs by the files in them, and add their settings.

    Settings of the caller come first. If the caller gives a camera, a project is read as a folder
    of detections.

    Raises:
        FileNotFoundError: when something is not there.
        ValueError: when there are several projects, or one is damaged.
    """
    for path in paths:
        if not path.exists():
            raise FileNotFoundError(f"{path}: expected an observation, found nothing")
    if settings.camera is not None:
        return list(paths), settings, []
    projects = {path: one for path in paths if (one := project_at(path)) is not None}
    if len(projects) > 1:
        folders = ", ".join(str(one.folder) for one in projects.values())
        raise ObservationError(f"expected one project at a time, got {folders}")
    found: list[Path] = []
    for path in paths:
        one = projects.get(path)
        if one is None:
            found.append(path)
            continue
        calibrated = one.calibration is not None or one.points is None
        found.append((one.detections if calibrated else None) or one.points or path)
        settings = replace(
            settings, camera=one.calibration, frame_rate=settings.frame_rate or one.fps
        )
    return found, settings, list(projects.values())


def clip_of_files(
    files: Sequence[tuple[str, Content]],
    notes: Sequence[str],
    settings: FitSettings,
    body: BodyModel,
) -> Clip:
    """Make one clip of all files; a depth sensor without pose goes first: it may see the ground.

    Args:
        files: the data that were read, each with a name for messages.
        notes: on how the files were read.
        settings: how to read.
        body: that is to be fitted.

    Raises:
        ValueError: when the files do not fit together, or show no body.
    """
    notes = list(notes)
    posed = [_has_pose(file) for _, file in files]
    views_without = [
        name for (name, file), pose in zip(files, posed, strict=True)
        if not pose and isinstance(file, KeypointsFile)
    ]  # fmt: skip
    if len(views_without) > 1:
        raise ObservationError(
            f"the cameras of {', '.join(views_without)} have no pose (T_camera_world), so their "
            "relative positions are unknown; give a calibration, or fit one view alone"
        )
    plane = None if isinstance(settings.ground, str) else settings.ground
    T = None if plane is None else camera_above(plane)
    found: dict[int, Sensor] = {}
    order = sorted(range(len(files)), key=lambda k: not isinstance(files[k][1], PointsFile))
    for k in order:
        name, file = files[k]
        if isinstance(file, PointsFile):
            from recon.reading.clouds import cloud_of  # imported only for clouds

            loaded = cloud_of(file, body, seed=settings.seed, T_recording_camera=T)
            found[k] = loaded.cloud
            seen = "" if loaded.ground.ground is None else "ground: "
            said = (*file.decisions, f"{seen}{loaded.ground.reason}", *loaded.decisions)
            notes += [f"{name}: {decision}" for decision in said]
            if not posed[k] and T is None:
                T = loaded.T_recording_file
        elif isinstance(file, KeypointsFile):
            from recon.reading.images import keypoints_of  # imported only for images

            view = found[k] = keypoints_of(file, body, None if posed[k] else T)
            if not posed[k] and T is None:
                T = view.camera.T_world_camera[0, 0].double().cpu().numpy()
        elif isinstance(file, PositionsFile):
            points = positions_in_metres(
                file, name, body, unit=settings.unit, up=settings.up, hand=settings.hand
            )
            found[k], said = _sensor_of_points(points, name, body, settings)
            notes += [f"{name}: {decision}" for decision in said]
        else:
            found[k] = file
    observations = tuple(found[k] for k in range(len(files)))
    names = tuple(name for name, _ in files)
    return Clip(observations, names, tuple(notes), T, plane is not None)


def _with_views_at_their_frames(clip: Clip, others: int, first_frame: int) -> Clip:
    """Start views at their first frame's number, beside other observations of that time.

    Views alone begin at time 0, and so do those whose frames are numbered from 1.

    Args:
        clip: observations, those of the views last.
        others: number of observations before those of the views.
        first_frame: number of the first frame of the views.
    """
    before, views = clip.observations[:others], clip.observations[others:]
    start = first_frame / views[0].fps
    if first_frame < 2 or all(start > one.start_time + one.duration for one in before):
        return clip
    note = f"the first frame of the views is number {first_frame}: they begin at {start:.3f} s"
    views = tuple(one.derived(start_time=one.start_time + start) for one in views)
    return replace(clip, observations=(*before, *views), notes=(*clip.notes, note))


def _clip_without_needless_ground(
    files: Sequence[tuple[str, Content]],
    notes: Sequence[str],
    settings: FitSettings,
    body: BodyModel,
) -> Clip:
    """Like `clip_of_files`, but ignore a given ground where all sensors' poses are known."""
    if all(_has_pose(file) for _, file in files):
        settings = replace(settings, ground=None)
    return clip_of_files(files, notes, settings, body)


def _has_pose(file: Content) -> bool:
    if not isinstance(file, PointsFile | KeypointsFile):
        return True
    return file.camera is None or file.camera.T_camera_world is not None


def _read_folder(path: Path, settings: FitSettings) -> PointsFile:
    """Read a folder of scans or of depth images as points of every frame."""
    if cloud_files(path):
        return read_scans(
            path, fps=settings.frame_rate, unit=settings.unit, up=settings.up, seed=settings.seed
        )
    if settings.camera is None:
        raise ObservationError(f"{path}: depth images need the sensor's calibration (--camera)")
    # imported only for depth images
    from recon.formats.calibration import load_cameras
    from recon.formats.depth_images import read_depth_images

    cameras = load_cameras(
        settings.camera,
        unit=settings.camera_unit,
        up=settings.camera_up,
        image_size=settings.image_size,
    ).cameras
    if len(cameras) != 1:
        raise ObservationError(
            f"{settings.camera}: expected one camera, that of {path}, got {', '.join(cameras)}"
        )
    return read_depth_images(
        path,
        next(iter(cameras.values())),
        fps=settings.frame_rate,
        depth_scale=settings.depth_scale,
        masks=settings.masks,
    )

"""`recon.read`: reads files as observations of one clip, or as a motion."""

import logging
from pathlib import Path
from typing import Any, Literal

from recon.body.model import BodyModel
from recon.core.arrays import geometries_given
from recon.core.coordinates import notes_on_missing_path
from recon.core.motion import MotionFile
from recon.fitting.settings import FitSettings
from recon.formats.motions import holds_motion, load_motion
from recon.method.sensor import Sensor
from recon.reading.clip import load_clip

_LOG = logging.getLogger("recon")


def read(path: Any, **options: Any) -> Sensor | list[Sensor] | MotionFile:
    """Read files as one observation, a list of observations of one clip, or a motion.

    Args:
        path: a motion file (.npz), or a file or folder of observations, or several of one clip;
            or, with `frame_rate`, geometries of Open3D, one per frame, as `recon.fit` takes them.
        **options: of `load_observation`; none for a motion.

    Raises:
        FileNotFoundError: when there is no such file.
        FormatError: when something cannot be read, or arguments are missing; says what to do.
    """
    if not options and isinstance(path, Path | str) and holds_motion(path):
        file = load_motion(path)
        motion = file.motion
        if said := notes_on_missing_path(motion.translation.numpy(), motion.rotations.numpy()):
            _LOG.warning("%s: %s", path, said)
        return file
    return load_observation(path, **options)


def load_observation(
    path: Any,
    *,
    body: BodyModel | None = None,
    unit: str | None = None,
    up: Literal["x", "y", "z", "x-down", "y-down", "z-down"] | None = None,
    hand: Literal["left", "right"] | None = None,
    frame_rate: float | None = None,
    layout: str | None = None,
    person: int | None = None,
    masks: Path | str | None = None,
    camera: Path | str | None = None,
    camera_unit: Literal["m", "mm"] | None = None,
    camera_up: Literal["x", "y", "z", "x-down", "y-down", "z-down"] | None = None,
    image_size: tuple[int, int] | None = None,
    camera_track: Path | str | None = None,
    ground: tuple[float, float, float, float] | None = None,
    depth_scale: float = 0.001,
    reader: str | None = None,
    seed: int = 0,
    mapping: Path | str | None = None,
    fingers: bool = False,
) -> Sensor | list[Sensor]:
    """Read observations as `recon fit` does: one, or a list where there are several.

    Observation files (.npz); folders or files of 2D detections, one per view, with `camera`;
    folders of scans (.ply, .pcd, .obj); folders of depth images (.png) with `camera`; markers of
    laboratories (.c3d, .trc); files of sensors that other packages registered. All have a leading
    axis of length one. What was assumed in reading is logged (logger `recon`).

    Args:
        path: file or folder, or several of one clip, or geometries of Open3D.
        body: whose points markers and keypoints are; None is the bundled body.
        unit: of positions and scans, where the file is wrong about it.
        up: axis that points up, or down, where the file is wrong about it.
        hand: handedness of the coordinates; None tells it from the body, where points have names.
        frame_rate: frames per second of detections and images, where files do not tell.
        layout: which keypoints detections are, where files do not tell: openpose25, coco17, ...
        person: number of the person to follow where detections show several.
        masks: silhouettes of the person; keypoints outside are taken as occluded.
        camera: calibration of the cameras that detections and depth images come from.
        camera_unit: unit of the calibration, where it does not tell.
        camera_up: axis of the calibration's world that points up, or down.
        image_size: width and height, pixels, where no calibration tells.
        camera_track: how the one camera was carried, as COLMAP, TUM, DROID-SLAM or ARKit write it.
        ground: plane n·x = d below a camera without pose, (nx, ny, nz, d) in its frame, metres.
        depth_scale: metres per unit of depth images.
        reader: class that reads files of a sensor of your own, "package.module:Class"; not needed
            where it is registered as the entry point `recon.observations`.
        seed: of the draw of points from clouds.
        mapping: JSON or TOML file that says where markers (.c3d, .trc) sit, label = landmark, for
            labels that are not known or mean another place; of markers without names, the table
            of their set, or a recording of the same person and set that has names.
        fingers: whether fingers are looked for in films, too.

    Raises:
        FileNotFoundError: when there is no such file.
        FormatError: when something cannot be read, or arguments are missing; says what to do.
    """
    settings = FitSettings(
        unit=unit, up=up, hand=hand, frame_rate=frame_rate, layout=layout, person=person,
        masks=None if masks is None else Path(masks),
        camera=None if camera is None else Path(camera), camera_unit=camera_unit,
        camera_up=camera_up, image_size=image_size,
        camera_track=None if camera_track is None else Path(camera_track), ground=ground,
        depth_scale=depth_scale, reader=reader, seed=seed,
        mapping=None if mapping is None else Path(mapping), fingers=fingers,
    )  # fmt: skip
    model = BodyModel.load() if body is None else body
    if geometries := geometries_given(path):
        from recon.reading.geometries import load_geometries

        clip = load_geometries(geometries, settings, model)
    else:
        paths = [path] if isinstance(path, Path | str) else path
        clip = load_clip([Path(one) for one in paths], settings, model)
    for note in clip.notes:
        _LOG.info("%s", note)
    return clip.observations[0] if len(clip.observations) == 1 else list(clip.observations)

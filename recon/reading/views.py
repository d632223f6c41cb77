"""Reads files of 2D keypoints and a calibration: one person, one file per view."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from recon.core.errors import ObservationError
from recon.core.limits import FRAME_RATE
from recon.detections.reader import read_keypoints
from recon.detections.records import Detections
from recon.fitting.settings import ReadOptions
from recon.formats.calibration import Calibration, load_cameras
from recon.formats.cameras import (
    CameraArrays,
    CameraPath,
    checked_camera,
    guessed_camera,
    guessed_image_size,
)
from recon.formats.observations import KeypointsFile
from recon.formats.tracks import CameraTrack, read_track
from recon.reading.places import files_of_views, match_cameras, view_name
from recon.reading.same_person import person_across_views
from recon.reading.stated import (
    background_camera,
    camera_of_images,
    cut_to_longest_shot,
    frame_range,
    note_of_steps,
    rate_of_views,
    read_sized_detections,
)
from recon.reading.tracks import Track, TrackedView, chosen_track, tracks_of_people

_OUTSIDE = 0.5
"""Share of the keypoints outside the image from which something is wrong."""
_BORDER = 0.5
"""Pixels from the centres of the outermost ones at which keypoints count as clamped."""


@dataclass(frozen=True)
class Views:
    """The 2D keypoints of one person in the views of one or several cameras."""

    files: tuple[KeypointsFile, ...]
    """One per view, all of the same frames; a frame without the person has confidence zero."""
    names: tuple[str, ...]
    """Names of the cameras."""
    first_frame: int
    """Frame number of the first frame."""
    decisions: tuple[str, ...]
    """What was decided about files, cameras and persons, and why."""
    shot: tuple[int, int] | None = None
    """First and last frame of the one shot that was taken of a film with cuts."""


def read_views(
    paths: Sequence[Path], how: ReadOptions, between: tuple[float, float] | None = None
) -> "SeenViews":
    """The 2D keypoints of all people in one or more calibrated views.

    Args:
        paths: files or folders of `recon.detections.reader`, one per view; a folder that
            holds such folders, or a project of Pose2Sim or EasyMocap, stands for all its views.
        how: the options of reading. Without a calibration, the camera of one view is guessed, a
            phone's, from the size of its images.
        between: seconds of a film with cuts in which to look for its longest shot; None for all.

    Raises:
        FileNotFoundError: when a file or folder is not there.
        ValueError: when something is missing, damaged, ambiguous or does not fit together; the
            message says what was expected and which option decides.
    """
    folders, notes = files_of_views(paths)
    check_calibrated(folders, how)
    known = {
        path: one for path in folders if (one := read_sized_detections(path, how)) is not None
    }
    fps = rate_of_views(folders, known) if how.frame_rate is None else how.frame_rate
    if fps is None or not FRAME_RATE.holds(fps):
        raise ObservationError(
            f"files of 2D keypoints do not state the frame rate, and it was given as {fps}; give "
            "frames per second with --frame-rate"
        )
    track = None if how.camera_track is None else read_track(how.camera_track)
    if track is not None and len(folders) > 1:
        raise ObservationError(
            f"{how.camera_track}: this track is of one camera, there are {len(folders)} views; "
            "give one view"
        )
    if how.camera is None:
        calibration = _camera_of_one_view(folders[0], known.get(folders[0]), track, how)
    else:
        calibration = load_cameras(
            how.camera, unit=how.camera_unit, up=how.camera_up, image_size=how.image_size
        )
    names, matching = match_cameras(
        [view_name(path) for path in folders], tuple(calibration.cameras)
    )
    cameras = [calibration.cameras[name] for name in names]
    found = [
        known.get(path) or read_keypoints(path, layout=how.layout, image_size=camera.image_size)
        for path, camera in zip(folders, cameras, strict=True)
    ]
    sized = [camera_of_images(*one) for one in zip(cameras, found, strict=True)]
    cameras = [camera for camera, _ in sized]
    first, frames = frame_range(found)
    notes = [*notes, *note_of_steps(found)]
    shot = None
    if len(found) == 1:
        found[0], shot, cut = cut_to_longest_shot(found[0], fps, between)
        notes = [*notes, *([cut] if cut else [])]
    cameras = [_camera_at_frames(*one, first, frames) for one in zip(cameras, names, strict=True)]
    carried: tuple[str, ...] = ()
    if track is not None:
        poses, reason = track.poses_at_frames(first, frames, fps)
        carried = (_note_on_track(track, reason),)
        path = CameraPath(poses, track.metric, track.level)
        cameras = [replace(cameras[0], T_camera_world=None, path=path)]
    level: list[str] = []
    if how.ground is None:  # a given ground plane also tells which way is up
        numbers = first + np.arange(frames)
        both = [background_camera(*one, numbers, fps) for one in zip(found, cameras, strict=True)]
        cameras, level = [camera for camera, _ in both], [note for _, note in both if note]
    for one, camera in zip(found, cameras, strict=True):
        _check_pixels(one, camera)
    inside = [
        _without_border_keypoints(one, camera) for one, camera in zip(found, cameras, strict=True)
    ]
    found, left_out = [one for one, _ in inside], [note for _, note in inside if note]
    layouts = [f"{one.name}: {'; '.join(one.decisions)}" for one in found]
    return SeenViews(
        found=tuple(found),
        names=tuple(names),
        cameras=tuple(cameras),
        first_frame=first,
        frames=frames,
        fps=float(fps),
        up_given=how.camera_up is not None,
        shot=shot,
        decisions=(
            *notes,
            *calibration.decisions,
            *carried,
            *level,
            *matching,
            *layouts,
            *(note for _, note in sized if note),
            *left_out,
        ),
    )


def check_calibrated(views: Sequence[Path], how: ReadOptions) -> None:
    """Refuse several views without a calibration.

    Raises:
        ObservationError: says how to get one, and what to do with views that are not of one clip.
    """
    if how.camera is None and how.camera_track is None and len(views) > 1:
        raise ObservationError(
            f"several views ({', '.join(map(str, views))}) need calibrated cameras; give their "
            "file with --camera, which `recon calibrate` finds from one person or a checkerboard. "
            "Films of different moments are fitted one by one, or as a folder by `recon batch`"
        )


def _camera_of_one_view(
    path: Path, known: Detections | None, track: CameraTrack | None, how: ReadOptions
) -> Calibration:
    """The camera that a tracker states, else a typical phone's, for one uncalibrated view.

    Its images are as large as the tracker, the caller or the file says, else as the keypoints
    need.
    """
    stated = None if track is None else track.camera
    size, reason = how.image_size, "given"
    if size is None and known is not None and (stated is None or stated.size is None):
        size, reason = known.image_size, f"of {known.name}"
    if size is None and (stated is None or stated.size is None):
        seen = read_keypoints(path, layout=how.layout)
        size = guessed_image_size(seen.pixels, seen.confidence)
        reason = (
            "guessed as the smallest usual one that holds the keypoints (--image-size gives it)"
        )
    if stated is not None:
        camera = replace(
            checked_camera(stated, size, how.camera_track or path), T_camera_world=None
        )
        said = (f"{how.camera_track}: its intrinsics were taken",)
    else:
        assert size is not None
        millimetres = None if known is None else known.stated_focal
        camera = guessed_camera(size, millimetres)
        lens = (
            "guessed a focal length of {:.0f} pixels, that of a phone's main camera (28 mm for "
            "35 mm film)"
            if millimetres is None
            else f"a focal length of {{:.0f}} pixels, that of the {millimetres:.4g} mm for 35 mm "
            "film which the film states"
        )
        said = (
            f"image size {size[0]} x {size[1]}: {reason}",
            f"no --camera: {lens.format(camera.camera_matrix[0, 0])}"
            + ("" if track is None else ", which the fit keeps, as the camera moves"),
        )
    return Calibration({view_name(path): camera}, "m", said)


def _note_on_track(track: CameraTrack, matched: str) -> str:
    unit = "metres" if track.metric else "of unknown unit, estimated from standing feet"
    up = "its world is level" if track.level else "up is estimated from the person"
    return f"camera track of {track.producer}: {matched}; {unit}; {up}; the ground is unknown"


@dataclass(frozen=True)
class SeenViews:
    """The detections of all people in all views."""

    found: tuple[Detections, ...]
    names: tuple[str, ...]
    """Names of the cameras."""
    cameras: tuple[CameraArrays, ...]
    first_frame: int
    """Frame number of the first frame of any view."""
    frames: int
    """Number of frames from the first to the last of any view."""
    fps: float
    up_given: bool
    """Whether the caller said which axis of the cameras' world points up."""
    decisions: tuple[str, ...]
    """What was decided about files and cameras, and why."""
    shot: tuple[int, int] | None = None
    """First and last frame of the one shot that was taken of a film with cuts."""

    def tracked_views(self) -> tuple[TrackedView, ...]:
        """The tracks of all people in every view.

        Raises:
            ValueError: when a view shows nobody.
        """
        views: list[TrackedView] = []
        for name, one, camera in zip(self.names, self.found, self.cameras, strict=True):
            if not (tracks := tracks_of_people(one)):
                chosen_track(tracks, None, one.name)  # refuses it
            views.append(TrackedView(name, one.layout, camera, tracks, self.first_frame))
        unposed = [one.name for one in views if one.camera.T_camera_world is None]
        if len(views) > 1 and unposed:
            raise ObservationError(
                f"several views need the poses of their cameras; {', '.join(unposed)} has none"
            )
        return tuple(views)

    def views(self, tracks: Sequence[Track | None], who: Sequence[str]) -> Views:
        """One person's observation in every view that shows them.

        Args:
            tracks: of the person, one per view or None.
            who: what was decided about the person.
        """
        kept = [(v, track) for v, track in enumerate(tracks) if track is not None]
        return Views(
            files=tuple(self._observation_of_track(v, track) for v, track in kept),
            names=tuple(self.names[v] for v, _ in kept),
            first_frame=self.first_frame,
            decisions=(*self.decisions, *who),
            shot=self.shot,
        )

    def views_of_person(self, number: int | None) -> Views:
        """One person's observation; several views decide together who it is.

        Args:
            number: in the first view, from 0 by first appearance; None for the one that is seen
                most completely.

        Raises:
            ValueError: when there is no such person, or it is not clear who is meant.
        """
        views = self.tracked_views()
        if len(views) > 1:
            return self.views(*person_across_views(views, number, up_given=self.up_given))
        tracks = next(iter(views)).tracks
        track = chosen_track(tracks, number, self.found[0].name)
        who = "the only one" if len(tracks) == 1 else "given" if number is not None else "most"
        if who == "most" and track.completeness < max(one.completeness for one in tracks):
            who = "moves; a bystander is as complete"
        return self.views([track], (f"{self.names[0]}: {track} ({who} of {len(tracks)} tracks)",))

    def _observation_of_track(self, view: int, track: Track) -> KeypointsFile:
        shape = (self.frames, track.confidence.shape[1])
        pixels, confidence = np.zeros((*shape, 2)), np.zeros(shape)
        pixels[track.frame - self.first_frame] = track.pixels
        confidence[track.frame - self.first_frame] = track.confidence
        layout, camera, fingers = self.found[view].layout, self.cameras[view], None
        if track.hands is not None:
            fingers = np.zeros((self.frames, *track.hands.shape[1:]))
            fingers[track.frame - self.first_frame] = track.hands
        return KeypointsFile(pixels, confidence, layout, self.fps, camera, fingers=fingers)


def _camera_at_frames(camera: CameraArrays, name: str, first: int, frames: int) -> CameraArrays:
    """A moving camera with the poses of these frames alone.

    Raises:
        ValueError: when its poses count neither from frame 0 nor from the first frame.
    """
    pose = camera.T_camera_world
    if pose is None or len(pose) in (1, frames):
        return camera
    if len(pose) < first + frames:
        raise ObservationError(
            f"camera {name}: expected 1 pose, {frames} poses from frame {first} on, or all from "
            f"frame 0 on, got {len(pose)}"
        )
    return replace(camera, T_camera_world=pose[first : first + frames])


def _without_border_keypoints(found: Detections, camera: CameraArrays) -> tuple[Detections, str]:
    """The detections without keypoints at the image border or beyond, and a note about these.

    Detectors guess what the image does not show, and many clamp the guess to the border.
    """
    most = np.array(camera.image_size) - 1 - _BORDER
    inside = ((found.pixels > _BORDER) & (found.pixels < most)).all(-1)
    seen = found.confidence > 0
    if (hands := found.hands) is not None:
        within = ((hands[..., :2] > _BORDER) & (hands[..., :2] < most)).all(-1, keepdims=True)
        found = replace(found, hands=np.where(within, hands, 0.0))
    count = int((seen & ~inside).sum())
    if count == 0:
        return found, ""
    confidence = np.where(inside, found.confidence, 0.0)
    pixels = np.where((confidence > 0)[..., None], found.pixels, 0.0)
    note = (
        f"{found.name}: {count} keypoints ({count / seen.sum():.1%}) at the image border or "
        "beyond are taken as not seen"
    )
    return replace(found, pixels=pixels, confidence=confidence), note


def _check_pixels(found: Detections, camera: CameraArrays) -> None:
    """Refuse keypoints in fractions of the image, or of images of another size.

    Raises:
        ValueError: for fractions of an image, a swapped width and height, or another resolution.
    """
    places = found.pixels[found.confidence > 0]
    width, height = camera.image_size
    if len(places) == 0:
        return
    if np.abs(places).max() <= 2.0:
        raise ObservationError(
            f"{found.name}: expected pixels, but all coordinates lie near [0, 1]; write them in "
            "pixels (OpenPose: --keypoint_scale 0)"
        )
    outside = 1 - ((places >= 0) & (places <= (width, height))).all(-1).mean()
    swapped = 1 - ((places >= 0) & (places <= (height, width))).all(-1).mean()
    if outside <= _OUTSIDE:
        return
    reason = (
        "width and height seem to be swapped in the calibration"
        if swapped < 1 - _OUTSIDE
        else "the keypoints seem to be of another camera or resolution"
    )
    raise ObservationError(
        f"{found.name}: {outside:.0%} of the keypoints lie outside the image of {width} x "
        f"{height} pixels; {reason}"
    )

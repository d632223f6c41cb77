"""The options of reading and fitting, each described once; imports nothing heavy."""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from difflib import get_close_matches
from pathlib import Path
from typing import Any, Literal, TypeVar

Options = TypeVar("Options", bound="ReadOptions")
_FILES = ("masks", "camera", "camera_track", "mapping")


@dataclass(frozen=True)
class ReadOptions:
    """Options for reading the files of one clip, for facts that the files do not contain."""

    unit: str | None = None
    """Unit of positions and scans, where the file is wrong about it: m, cm, mm, inch, ft, cmu, or
    metres per unit (0.3048)."""
    up: Literal["x", "y", "z", "x-down", "y-down", "z-down"] | None = None
    """Axis that points up, or down, where the file is wrong about it."""
    hand: Literal["left", "right"] | None = None
    """Handedness of the coordinates; default: found from the body, if points have names."""
    frame_rate: float | None = None
    """Frames per second of detections, 3D keypoints, scans or estimates, where files do not state
    it; of a film that is played slower or faster, the rate of the camera."""
    layout: str | None = None
    """Layout of the 2D or 3D keypoints, where files do not state it, openpose25, coco17, ..."""
    person: int | Literal["all"] | None = None
    """Person to follow where detections or an estimate show several: the number in the message
    that lists them, or `all`, each in a file of the folder OUT."""
    detector: str | None = None
    """Detector of people in films: other landmarks of BlazePose (pose_landmark_heavy.tflite), or a
    class of your own, package.module:Class. Default: BlazePose with its landmarks `full`."""
    fingers: bool = False
    """Whether to find fingers in films, too, which takes half as much time again."""
    detections: str | None = None
    """Folder in which detections in films are kept, to go on from them; default: beside OUT."""
    masks: Path | None = None
    """Silhouettes of the person (folder of images, one per frame, or .npz): keypoints outside
    are taken as occluded."""
    mapping: Path | None = None
    """File (.json, .toml; label = landmark) that says where markers of a .c3d or .trc file sit,
    for labels that are unknown or mean another place; for markers without names, the table of
    their set, or a recording of the same person and set that has names."""
    camera: Path | None = None
    """Calibration of the cameras that detections and depth images come from; default, for
    detections of one view: a phone's, whose focal length the fit corrects."""
    camera_unit: Literal["m", "mm"] | None = None
    """Unit of the calibration, where the file does not state it."""
    camera_up: Literal["x", "y", "z", "x-down", "y-down", "z-down"] | None = None
    """Axis of the calibration's world that points up, or down; default: z."""
    camera_track: Path | None = None
    """Poses of a carried camera, from a tracker: a folder of COLMAP with `images.txt`, a text of
    TUM's, an array of DROID-SLAM or DPVO (.npy, .npz), or ARKit's .json."""
    image_size: tuple[int, int] | None = None
    """Width and height of the images, pixels, where no calibration states them."""
    ground: tuple[float, float, float, float] | Literal["none", "known", "unknown"] | None = None
    """Ground seen by a camera without pose: the plane n·x = d in its frame (x right, y down, z
    forward), the normal up, metres; 0 -1 0 -1.2 is 1.2 m below a level camera. Or `known` at
    z = 0, `unknown`, to be found, and, with the prior `pose`, `none`, where feet stand on no
    ground: water, ropes, stairs. Default: as the observations say."""
    reader: str | None = None
    """Class that reads files of a sensor of your own, package.module:Class; not needed where it is
    registered as `recon.observations`."""
    depth_scale: float = 0.001
    """Metres per unit of depth images; 0.001 where they hold millimetres."""
    robust: float | None = None
    """Distance in metres beyond which a point counts ever less; default: least squares.
    Keypoints in images and points of scans are always robust."""
    seed: int = 0
    """Seed of all random numbers."""

    @classmethod
    def of(cls: type[Options], given: Mapping[str, Any]) -> Options:
        """Create options from arguments by name; paths may be strings.

        Raises:
            TypeError: when there is no option of a name.
        """
        known = [one.name for one in fields(cls)]
        for name in given:
            if name not in known:
                near = get_close_matches(name, known, n=1)
                hint = f"; did you mean {near[0]}?" if near else ""
                raise TypeError(f"there is no option {name!r} of reading files{hint}")
        files = {name: Path(given[name]) for name in _FILES if isinstance(given.get(name), str)}
        return cls(**{**given, **files})

    def changed_names(self) -> list[str]:
        """Names of the options that differ from their defaults."""
        return [one.name for one in fields(self) if getattr(self, one.name) != one.default]


@dataclass(frozen=True)
class FitSettings(ReadOptions):
    """Options for reading and fitting files, as the command line shows them."""

    prior: str = "humor"
    """Prior of motions: `humor` knows steps from pose to pose and contacts of feet, `pose` single
    poses and smoothness (stages 1-2 of HuMoR), `anchor` one whole cycle of gait, `recording` HuMoR
    over a whole recording (`recon complete`). Or one that another package registered, or a class
    of your own, package.module:Class."""
    weights: str = "open"
    """Weights of the prior: `open` or a file."""
    method: str | None = None
    """How the prior is fitted, where there are several ways: `humor` by `collocation` (the motion
    itself is moved; default) or `rollout` (a first state and latents are, as published). Or fitted
    not at all: `look`, or package.module:Class, previews points in space by a network."""
    body: Path | None = None
    """A SMPL-family file of your own; default: the bundled body."""
    shape: str | None = None
    """Shape of the person, which is held: height=1.80,weight=75, words, coefficients, or a motion
    file of theirs. Default: found from the data; of an estimate on another body, the average."""
    between: tuple[float, float] | None = None
    """First and last time to fit, seconds of the recording's clock; default: all."""
    noise: float | None = None
    """Standard deviation of every coordinate in space, metres; default: found from the data."""
    noise_pixels: float | None = None
    """Standard deviation of keypoints in images, pixels; default: found from the data."""
    repair: bool = True
    """Whether to repair, before the fit, what is surely wrong with the data: zeros for missing
    points, names exchanged in a stretch, outliers, a floor at another height. All is reported."""
    checks: Literal["all", "none"] = "all"
    """Whether the data are checked before the fit and the result after it; `none` saves a part of
    a second, repairs nothing and warns of nothing."""
    physics: float = 0.0
    """Weight of the physics of a body on flat ground, mostly of its feet: 1 is right where there
    is nothing else to stand, sit or lean on; 0 leaves it out."""
    fps: float | None = None
    """Frame rate of the result; default: that of the first observation."""
    device: Literal["cpu", "cuda"] = "cpu"
    """Device on which the fit is computed."""

    def arguments(self) -> dict[str, Any]:
        """Return the settings as arguments of `recon.fit`."""
        given = dict(vars(self))
        given["noise"] = {"metres": self.noise, "pixels": given.pop("noise_pixels")}
        given["ground"] = {None: "auto", "none": None}.get(self.ground, self.ground)
        given["checks"] = None if self.checks == "all" else ()
        given["robust"] = "auto" if self.robust is None else self.robust
        return given


DEFAULTS = FitSettings()

"""Settings that the command line shows; light to import."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal


@dataclass(frozen=True)
class FitSettings:
    """How to fit files."""

    prior: str = "humor"
    """What is likely: `humor` is every step from pose to pose and where feet touch, `pose` single
    poses and smoothness (stages 1-2 of HuMoR), `anchor` one whole cycle of gait, `recording`
    HuMoR with cycles of gait where little was seen. Or one that another package registered, or
    the class of one of your own, package.module:Class."""
    weights: str = "open"
    """Weights of the prior: `open`, `nc` (not for commercial use; in a source checkout) or a
    file."""
    method: str | None = None
    """How the prior is fitted, where there are several ways: `humor` by `collocation` (the motion
    itself is moved; default) or `rollout` (a first state and latents are, as published)."""
    body: Path | None = None
    """A SMPL-family file of your own; default: the bundled body."""
    between: tuple[float, float] | None = None
    """Seconds of the recording's clock from which to which to fit; default: all."""
    unit: Literal["m", "cm", "mm", "inch", "cmu"] | None = None
    """Unit of positions and scans, where the file is wrong about it."""
    up: Literal["x", "y", "z", "x-down", "y-down", "z-down"] | None = None
    """Axis that points up, or down, where the file is wrong about it."""
    noise: float | None = None
    """Standard deviation of every coordinate in space, metres; default: told from the data."""
    noise_pixels: float | None = None
    """Standard deviation of keypoints in images, pixels; default: told from the data."""
    camera: Path | None = None
    """Calibration of the cameras that detections and depth images come from; default, for
    detections of one view: a phone's, whose focal length the fit corrects."""
    camera_unit: Literal["m", "mm"] | None = None
    """Unit of the calibration, where it does not tell."""
    camera_up: Literal["x", "y", "z"] | None = None
    """Axis of the calibration's world that points up; default: z."""
    camera_track: Path | None = None
    """How the one camera was carried, by a tracker: a folder of COLMAP with `images.txt`, a text
    of TUM's, an array of DROID-SLAM or DPVO (.npy, .npz), or ARKit's .json."""
    image_size: tuple[int, int] | None = None
    """Width and height of the images, pixels, where no calibration tells."""
    ground: tuple[float, float, float, float] | Literal["none"] | None = None
    """Ground seen by a camera without pose: the plane n·x = d in its frame (x right, y down, z
    forward), the normal up, metres; 0 -1 0 -1.2 is 1.2 m below a level camera. Default: found.
    `none`, with --prior pose, where feet stand on no ground: water, ropes, stairs."""
    layout: str | None = None
    """Layout of the keypoints, in images or in space, where files do not tell: openpose25,
    coco17, h36m17, ..."""
    person: int | Literal["all"] | None = None
    """Whom to follow where detections show several people: number as the message lists them, or
    `all`, each in a file of the folder OUT."""
    masks: Path | None = None
    """Silhouettes of the person (folder of images, one per frame, or .npz): keypoints outside
    are taken as occluded."""
    frame_rate: float | None = None
    """Frames per second of detections, 3D keypoints and scans, where files do not tell."""
    mapping: Path | None = None
    """File (.json, .toml; label = landmark) that says where markers of a .c3d or .trc file sit,
    for labels that are not known or mean another place."""
    reader: str | None = None
    """Class that reads files of a sensor of your own, package.module:Class; not needed where it is
    registered as `recon.observations`."""
    depth_scale: float = 0.001
    """Metres per unit of depth images; 0.001 where they hold millimetres."""
    robust: float | None = None
    """Distance in metres beyond which a point counts ever less; default: least squares.
    Keypoints in images and points of scans are always robust."""
    repair: bool = True
    """Put right, before the fit, what is surely wrong with the data: zeros for missing points,
    names exchanged in a stretch, outliers, a floor at another height. The report says what was
    done."""
    physics: float = 0.0
    """How much physics of a body on flat ground counts, its feet above all: 1 as much as it should
    where there is nothing else to stand, sit or lean on; 0 leaves it out."""
    fps: float | None = None
    """Rate of the result; default: that of the first observation."""
    device: Literal["cpu", "cuda"] = "cpu"
    """Device that computes."""
    seed: int = 0
    """Seed of everything random."""


DEFAULTS = FitSettings()


@dataclass(frozen=True)
class RefineSettings:
    """How to refine files of estimated motions."""

    prior: str = "humor"
    """What is likely: `humor`, `pose`, or one that another package registered."""
    weights: str = "open"
    """Weights of the prior: `open`, `nc` (not for commercial use; in a source checkout) or a
    file."""
    body: Path | None = None
    """The SMPL-family file that the estimate is of; its shape coefficients are then taken.
    Default: the bundled body."""
    shape: str | None = None
    """Shape of the person on the bundled body: height=1.80,weight=75, words, coefficients, or a
    motion file of theirs. Default: the average."""
    frame_rate: float | None = None
    """Frames per second of the estimate, where the file does not tell: that of the video."""
    fps: float | None = None
    """Rate of the result; default: the estimate's."""
    up: Literal["x", "y", "z"] | None = None
    """Axis that points up; default: told from how the body stands."""
    person: int | None = None
    """Which of several people, from 1 on; default: the one of most frames."""
    ground: Literal["known", "unknown"] = "unknown"
    """Whether height zero of the estimate's world is the ground."""
    physics: float = 0.0
    """How much physics of a body on flat ground counts; 0 leaves it out."""

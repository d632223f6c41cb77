"""The 45 slips, which are mistakes that people make with data, by kind of sensor, with sizes.

The size of a slip is the smallest tried that doubles the error of a fit without repairs, or adds 5
cm, on validation people (abaa3a0: benchmarks/slips/sizes.py). Tried sizes begin at the smallest
that is a mistake rather than an ordinary difference: shoes lift people by up to 4 cm, detectors
and markers differ by several centimetres in where a point is, adults differ in size by a fifth,
and an exchange of less than 0.2 s is an outlier.

More than one code can be right. Points in space whose sides are exchanged throughout are, up to a
rigid motion, the same as a mirrored recording of the mirrored person, so that either name is
right; and a view that contradicts the others may be named by its own error.
"""

from dataclasses import dataclass
from typing import Literal

from benchmarks.slips import mistakes as m
from benchmarks.slips.recordings import Sensor
from recon.diagnosis.findings import Code

Measure = Literal["world", "pelvis", "path", "posture", "speed"]
"""The error by which a slip is judged.

* world: mean distance of joints from the truth, metres.
* pelvis: the same of joints about the pelvis, where the world is scaled or one camera leaves the
  distance open.
* path: the same about where the pelvis was at first, where one camera is carried along.
* posture: the same after the best rigid alignment of each frame with the truth or its mirror
  image, whichever is nearer, where nothing tells which of the two was recorded.
* speed: the factor by which the mean speed of all joints is wrong.
"""


@dataclass(frozen=True)
class Slip:
    """One mistake that people make with one kind of sensor."""

    name: str
    sensor: Sensor
    spoil: m.Spoil
    size: float
    unit: str
    codes: tuple[Code, ...]
    """Codes of findings that name the cause correctly, the plainest first."""
    measure: Measure = "world"
    joints: tuple[str, ...] = ()
    """Joints that the slip spoils, whose error is measured; empty means all."""

    @property
    def key(self) -> str:
        """Name of the slip in tables."""
        return f"{self.sensor}: {self.name}"


JOINTS: tuple[Slip, ...] = (
    Slip("sides exchanged, whole clip", "joints3d", m.sides, 1.0, "",
         ("sides exchanged", "mirrored"), "posture"),
    Slip("sides exchanged, a stretch", "joints3d", m.sides_for, 0.2, "s",
         ("sides exchanged",)),
    Slip("ankles exchanged", "joints3d", m.exchange("left_ankle", "right_ankle"), 0.2, "s",
         ("points exchanged", "sides exchanged"), joints=("left_ankle", "right_ankle")),
    Slip("wrist and elbow exchanged", "joints3d", m.exchange("left_wrist", "left_elbow"),
         0.2, "s", ("points exchanged",), joints=("left_wrist", "left_elbow")),
    Slip("another person, near", "joints3d", m.somebody_else, 0.3, "m",
         ("identity change",)),
    Slip("another person, far", "joints3d", m.somebody_else, 1.5, "m", ("identity change",)),
    Slip("wrist frozen in the room", "joints3d", m.hold("left_wrist"), 2.0, "s",
         ("constant point",), joints=("left_wrist",)),
    Slip("zeros", "joints3d", m.zeros, 0.01, "of points", ("zeros",)),
    Slip("head away from its place", "joints3d", m.offset("head", 2), 0.1, "m",
         ("offset point",), joints=("head",)),
    Slip("rate x 2", "joints3d", m.rate, 2.0, "x", ("rate",), "speed"),
    Slip("rate x 1/2", "joints3d", m.rate, 0.5, "x", ("rate",), "speed"),
    Slip("frames shuffled", "joints3d", m.shuffle, 8.0, "frames", ("frame order",)),
    Slip("floor too low", "joints3d", m.lift, 0.05, "m", ("floor",)),
    Slip("outliers", "joints3d", m.outliers, 0.05, "of points", ("outliers",)),
    Slip("mirrored", "joints3d", m.mirror, 1.0, "", ("mirrored", "sides exchanged"), "posture"),
)  # fmt: skip

MARKERS: tuple[Slip, ...] = (
    Slip("sides exchanged, a stretch", "markers3d", m.sides_for, 0.2, "s",
         ("sides exchanged",)),
    Slip("two markers exchanged", "markers3d",
         m.exchange("left_knee_lateral", "left_ankle_lateral"), 0.4, "s",
         ("points exchanged",), joints=("left_knee", "left_ankle")),
    Slip("another person", "markers3d", m.somebody_else, 0.3, "m", ("identity change",)),
    Slip("marker holds its last value", "markers3d", m.hold("left_elbow_lateral"), 0.4, "s",
         ("constant point",), joints=("left_elbow",)),
    Slip("zeros", "markers3d", m.zeros, 0.01, "of points", ("zeros",)),
    Slip("marker away from its place", "markers3d", m.offset("right_knee_lateral", 2),
         0.1, "m", ("offset point",), joints=("right_knee",)),
    Slip("rate x 4", "markers3d", m.rate, 4.0, "x", ("rate",), "speed"),
    Slip("frames repeated", "markers3d", m.repeat, 0.35, "of frames", ("repeated frames",)),
    Slip("frames shuffled", "markers3d", m.shuffle, 4.0, "frames", ("frame order",)),
    Slip("floor too high", "markers3d", m.lift, -0.05, "m", ("floor",)),
    Slip("scale", "markers3d", m.scale, 1.3, "x", ("scale",), "pelvis"),
    Slip("outliers", "markers3d", m.outliers, 0.01, "of points", ("outliers",)),
    Slip("mirrored", "markers3d", m.mirror, 1.0, "", ("mirrored", "sides exchanged"),
         "posture"),
)  # fmt: skip

CAMERA: tuple[Slip, ...] = (
    Slip("sides exchanged, a stretch", "camera", m.sides_for, 0.2, "s",
         ("sides exchanged",), "pelvis"),
    Slip("wrist and elbow exchanged", "camera", m.exchange("left_wrist", "left_elbow"), 0.2,
         "s", ("points exchanged",), "pelvis", ("left_wrist", "left_elbow")),
    Slip("another person", "camera", m.somebody_else, 0.3, "m",
         ("identity change",), "pelvis"),
    Slip("wrist holds its last value", "camera", m.hold("left_wrist"), 0.8, "s",
         ("constant point",), "pelvis", ("left_wrist",)),
    Slip("zeros", "camera", m.zeros, 0.1, "of points", ("zeros",), "pelvis"),
    Slip("rate x 2", "camera", m.rate, 2.0, "x", ("rate",), "speed"),
    Slip("outliers", "camera", m.outliers, 0.1, "of points", ("outliers",), "pelvis"),
    Slip("camera moves", "camera", m.carried_camera, 40.0, "degrees",
         ("camera moves",), "path"),
)  # fmt: skip

CAMERAS: tuple[Slip, ...] = (
    Slip("one pose off", "cameras", m.misplaced_view, 1.0, "degrees", ("view at odds",)),
    Slip("another person in one view", "cameras", m.other_person_in_view, 0.5, "m",
         ("view at odds", "identity change")),
    Slip("sides exchanged in one view", "cameras", m.sides_in_view, 0.4, "s",
         ("view at odds", "sides exchanged")),
    Slip("one view mirrored", "cameras", m.mirrored_view, 1.0, "",
         ("view at odds", "mirrored")),
    Slip("one view out of step", "cameras", m.delayed_view, 2.0, "frames",
         ("views out of step",)),
    Slip("one camera moves", "cameras", m.sagging_view, 2.0, "degrees",
         ("camera moves", "view at odds")),
    Slip("all views mirrored", "cameras", m.mirrored_views, 1.0, "", ("mirrored",)),
    Slip("scale of the calibration", "cameras", m.large_calibration, 1.3, "x",
         ("scale",), "pelvis"),
    Slip("another person", "cameras", m.somebody_else, 0.3, "m",
         ("identity change",)),
)  # fmt: skip

SLIPS: tuple[Slip, ...] = JOINTS + MARKERS + CAMERA + CAMERAS
"""All 45 slips."""

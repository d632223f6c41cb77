"""The plausible range of every quantity that a file may hold, with the reason for it.

One record per quantity, and one function that compares numbers with it. Readers refuse what lies
outside: such a number is damage, another unit or another quantity, and a fit would follow it.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from recon.core.errors import ReconError


@dataclass(frozen=True)
class Limit:
    """The plausible range of one quantity, both ends included."""

    quantity: str
    low: float
    high: float
    unit: str
    reason: str
    """The reason why nothing beyond the range is recorded; it ends every refusal."""

    def holds(self, values: Any) -> bool:
        """Whether all numbers lie in the range; NaN does not."""
        numbers = np.asarray(values)
        return bool(((numbers >= self.low) & (numbers <= self.high)).all())

    def check(self, values: Any, source: object, key: str = "", *, seen: Any = None) -> None:
        """Refuse numbers outside the range.

        Args:
            values: one number or an array of any shape.
            source: the file, for the message.
            key: the place in the file: name of the array, line, joint.
            seen: mask of the values that count (or of their leading axes); None for all of them.

        Raises:
            ValueError: naming file, quantity, the first number outside, and where it stands.
        """
        numbers = np.asarray(values)
        # in half precision the limits themselves may overflow
        with np.errstate(invalid="ignore", over="ignore"):
            bad = ~((numbers >= self.low) & (numbers <= self.high))
        if seen is not None:
            mask = np.asarray(seen, dtype=np.bool_)
            bad &= mask.reshape(*mask.shape, *[1] * (bad.ndim - mask.ndim))
        if not bad.any():
            return
        index = tuple(int(axis) for axis in np.unravel_index(int(bad.argmax()), bad.shape))
        place = f" at {key}{list(index) if index else ''}" if key or index else ""
        unit = f" {self.unit}" if self.unit else ""
        value = numbers[index]
        shown = f"{value:.6g}" if isinstance(value, int | float | np.number) else str(value)[:40]
        raise ReconError(
            f"{source}: expected a {self.quantity} of {self.low:.6g} to {self.high:.6g}{unit}, "
            f"got {shown}{place}; {self.reason}"
        )


POSITION = Limit(
    "position", -1e4, 1e4, "m",
    "beyond 10 km single precision rounds to more than a millimetre: check the unit, or subtract "
    "an origin near the person from survey coordinates",
)  # fmt: skip
FRAME_RATE = Limit(
    "frame rate", 1e-3, 1e4, "Hz",
    "time lapse takes a picture every few minutes, the fastest motion capture 10,000 a second",
)  # fmt: skip
FEW_MOMENTS = 6.0
"""Moments per second below which motion is guessed rather than followed: a foot that walks swings
for 0.4 s, and is then seen at most twice while it does."""
CLOCK_RATE = Limit(
    "rate of the clock that numbers frames", 1e-3, 1e9, "Hz",
    "clocks of cameras count nanoseconds at the finest",
)  # fmt: skip
TIME = Limit(
    "time", -1e10, 1e10, "s",
    "seconds since 1970 are about 1.8e9: a larger number is in milliseconds or finer",
)  # fmt: skip
FRAME_NUMBER = Limit(
    "frame number", 0.0, 4e18, "",
    "cameras that number frames by a clock count nanoseconds since 1970, 1.8e18, at most",
)  # fmt: skip
PERSON = Limit(
    "number of a person", -1.0, 1e12, "",
    "trackers count the people they see; -1 says that a person has no number",
)  # fmt: skip
FRAMES = Limit(
    "number of frames", 1.0, 1e7, "",
    "a day at 100 Hz has 8.6 million: cut longer recordings",
)  # fmt: skip
JOINTS = Limit(
    "number of joints or markers", 1.0, 5000.0, "",
    "a skeleton with face and fingers has fewer than 1,000, a room of markers fewer than 5,000",
)  # fmt: skip
SAMPLES = Limit(
    "number of frames times joints", 1.0, 8e6, "",
    "more does not fit into 2 GB while it is read: cut the recording",
)  # fmt: skip
CLOUD = Limit(
    "number of points in a cloud", 0.0, 2e7, "",
    "more does not fit into 2 GB while it is read, and 4,096 of a frame are used: thin it out",
)  # fmt: skip
PADDED_CLOUD = Limit(
    "number of frames times the points fitted in the fullest frame", 0.0, 5e7, "",
    "more does not fit into 2 GB while it is fitted: cut the recording",
)  # fmt: skip
ROTATION = Limit(
    "rotation vector", -100.0, 100.0, "rad",
    "rotations need at most pi; files that add up whole turns reach a few of them",
)  # fmt: skip
ANGLE = Limit(
    "joint angle", -36_000.0, 36_000.0, "degrees",
    "files that add up whole turns reach a few of them, never a hundred",
)  # fmt: skip
ORTHOGONALITY = Limit(
    "deviation of R times its transpose from the identity", 0.0, 1e-2, "",
    "a rotation neither scales nor mirrors; rounding to three digits stays below this",
)  # fmt: skip
SHAPE = Limit(
    "shape coefficient", -50.0, 50.0, "standard deviations",
    "people are within 5; fits of wrong data get to about 20",
)  # fmt: skip
SHAPES = Limit(
    "number of shape coefficients", 0.0, 400.0, "",
    "SMPL-X, the largest model, has 300, and 100 of the facial expression",
)  # fmt: skip
PROBABILITY = Limit(
    "probability", -1e-3, 1.001, "",
    "a probability is from 0 to 1, but for rounding",
)  # fmt: skip
CONFIDENCE = Limit(
    "confidence", 0.0, 1.01, "",
    "0 is not seen and 1 is certain, but for rounding: clip or scale the detector's scores",
)  # fmt: skip
SCORE = Limit(
    "score of a detector", -1e4, 1e4, "",
    "scores that are not normalised get to about 10 and are clipped to 1",
)  # fmt: skip
DEVIATION = Limit(
    "standard deviation", 0.0, 100.0, "m",
    "a value more uncertain than that tells nothing",
)  # fmt: skip
ANGLE_DEVIATION = Limit(
    "standard deviation of an angle", 0.0, 180.0, "degrees",
    "a value more uncertain than that tells nothing",
)  # fmt: skip
POINT_DEVIATION = Limit(
    "standard deviation of a measured point", 1e-6, 100.0, "m",
    "nothing measures people to a micrometre; points uncertain by more than 100 m tell nothing",
)  # fmt: skip
IMAGE_SIZE = Limit(
    "image size", 8.0, 65_535.0, "pixels",
    "the smallest depth sensors have 8 pixels a side, image files 65,535 at most",
)  # fmt: skip
PIXEL = Limit(
    "pixel coordinate", -2e5, 2e5, "pixels",
    "detectors guess keypoints outside the image, but never so far outside",
)  # fmt: skip
FOCAL_LENGTH = Limit(
    "focal length", 4.0, 1e6, "pixels",
    "a lens of 1,200 mm before an 8K sensor has 260,000; check that it is in pixels, not in mm",
)  # fmt: skip
FILM_FOCAL_LENGTH = Limit(
    "focal length for 35 mm film",
    8.0,
    400.0,
    "mm",
    "no lens of a phone or camera that films people is outside",
)
FIELD = Limit(
    "focal length over the image's longer side", 0.1, 200.0, "",
    "0.1 is a view of 157 degrees, wider than any lens but a fisheye, and the longest lenses have "
    "70: the camera matrix and image size are of different images",
)  # fmt: skip
PIXEL_ASPECT = Limit(
    "ratio of the two focal lengths", 0.25, 4.0, "",
    "pixels are square or, with anamorphic lenses and old video, up to twice as wide as high",
)  # fmt: skip
PRINCIPAL_POINT = Limit(
    "principal point over the image's longer side", -50.0, 50.0, "",
    "it is near the middle of the image; of an image cut out of a larger one it may lie outside",
)  # fmt: skip
SKEW = Limit(
    "skew over the focal length", -0.1, 0.1, "",
    "axes of sensors are at right angles to within a thousandth",
)  # fmt: skip
DISTORTION = Limit(
    "distortion coefficient", -1e7, 1e7, "",
    "long lenses have large coefficients, as these multiply small angles, but none so large",
)  # fmt: skip
LENS = Limit(
    "stretch of the image by the lens, halfway to its nearer edge", 0.5, 2.0, "",
    "no lens without fisheye bends its image so: the distortion is of another lens or damaged",
)  # fmt: skip
DEPTH_SCALE = Limit(
    "depth scale", 1e-6, 0.1, "m per unit",
    "16 bits then end within 7 cm, or neighbouring values are more than 10 cm apart",
)  # fmt: skip
PAYLOAD = Limit(
    "size of the unpacked arrays", 0.0, float(1 << 29), "bytes",
    "more does not fit into 2 GB while it is read: cut the recording",
)  # fmt: skip
TEXT = Limit(
    "size of the unpacked text", 0.0, float(1 << 28), "bytes",
    "more does not fit into 2 GB while it is read: cut the recording",
)  # fmt: skip
TABLE = Limit(
    "size of a skeleton's file", 0.0, float(1 << 24), "bytes",
    "a skeleton file describes some joints; motions are in other files",
)  # fmt: skip
JSON = Limit(
    "size of the JSON or CSV files of one camera", 0.0, float(1 << 26), "bytes",
    "lists of numbers take thirty times more memory than their text: cut the recording",
)  # fmt: skip
MASKS = Limit(
    "size of the unpacked masks", 0.0, float(1 << 32), "bytes",
    "more does not fit into 2 GB as one bit per pixel: give a folder of .png files",
)  # fmt: skip
PEOPLE = Limit(
    "number of people in a frame", 0.0, 100.0, "",
    "every person is compared with every other; crop the images of a crowd to the person",
)  # fmt: skip
KEYPOINTS = Limit(
    "number of keypoints of a person", 0.0, 1000.0, "",
    "models of body, face and hands have up to 550",
)  # fmt: skip
BINARY = Limit(
    "size of the file", 0.0, float(1 << 30), "bytes",
    "more does not fit into 2 GB while it is read: cut the recording",
)  # fmt: skip
NUMBERS = Limit(
    "number of numbers in an array", 0.0, 5e7, "",
    "each takes eight bytes while it is read, whatever it took in the file: cut the recording",
)  # fmt: skip
ENTRIES = Limit(
    "number of entries of nested lists and dictionaries", 0.0, 2e6, "",
    "entries that several containers share are counted for each: save plain arrays",
)  # fmt: skip
DEPTH = Limit(
    "depth of nested lists and dictionaries", 0.0, 64.0, "",
    "poses of many people in many frames are nested five deep: save plain arrays",
)  # fmt: skip
CALIBRATION = Limit(
    "size of a calibration's file", 0.0, float(1 << 20), "bytes",
    "a hundred cameras take 60 kB; poses of a camera that moves for long belong in .npz",
)  # fmt: skip
IMAGE = Limit(
    "size of an unpacked image", 1.0, 1.5e8, "bytes",
    "a 16K image has fewer: save masks and depth images in shades of grey",
)  # fmt: skip
MODEL_NUMBERS = Limit(
    "number of numbers in an array of a body model", 0.0, 3e7, "",
    "SMPL-X, the largest model, has 15 million: this is no body model",
)  # fmt: skip
MODEL_LENGTH = Limit(
    "length in a body model", -5.0, 5.0, "m",
    "a body at rest measures two metres, and a shape coefficient moves it by centimetres",
)  # fmt: skip
MODEL_WEIGHT = Limit(
    "weight in a body model", -2.0, 3.0, "",
    "skinning weights are from 0 to 1, weights of joints a little beyond",
)  # fmt: skip
UNIT_LENGTH = Limit(
    "length of a unit vector", 0.99, 1.01, "",
    "rounding to two digits moves the length of a unit vector by less than that",
)  # fmt: skip
NETWORK_WEIGHT = Limit(
    "weight of a network", -6.6e4, 6.6e4, "",
    "half precision, in which weights are stored, ends at 65,504",
)  # fmt: skip

LIMITS: tuple[Limit, ...] = tuple(v for v in list(globals().values()) if isinstance(v, Limit))
"""Every range above."""

_USUAL_TURN = 0.75
"""Share of joints and frames that turn by less than half a turn, whatever a root counts on to."""
_BENT = 0.8
"""Radians, without whole turns, that half of all joints turn by less; half of degrees by 1.6."""
_JOINTS_THAT_TELL = 10
"""Fewest joints by which degrees are told from a root that turns on and on."""


def check_rotation_vectors(values: np.ndarray, source: object, key: str) -> None:
    """Refuse numbers that are no rotation vectors in radians.

    Args:
        values: (frames, ...); NaN is passed over.
        source: the file, for the message.
        key: name of the array, for the message.

    Raises:
        ValueError: when they are quaternions, columns of matrices or degrees, or too large.
    """
    rows = values.reshape(len(values), values[:1].size)
    rows = rows[np.isfinite(rows).all(-1)].astype(np.float64)
    expected = f"{source}: expected rotation vectors (axis times angle in radians) in {key}, got"
    for width, unit, kind in ((4, 4, "quaternions"), (6, 3, "two columns of rotation matrices")):
        if rows.size and rows.shape[1] % width == 0:
            lengths = np.linalg.norm(rows.reshape(-1, unit), axis=-1)
            if UNIT_LENGTH.holds(lengths):
                raise ReconError(
                    f"{expected} {kind}; convert them (scipy.spatial.transform.Rotation) to "
                    "rotation vectors, or to matrices (..., 3, 3)"
                )
    if rows.size and rows.shape[1] % 3 == 0 and rows.shape[1] >= 3 * _JOINTS_THAT_TELL:
        angles = np.linalg.norm(rows.reshape(-1, 3), axis=-1)
        rest = np.abs(angles - 2 * np.pi * np.round(angles / (2 * np.pi)))
        usual = float(np.quantile(angles, _USUAL_TURN))
        if usual > np.pi and np.median(rest) > _BENT:
            raise ReconError(
                f"{expected} numbers that look like degrees: a quarter of the joints turn by more "
                f"than {usual:.1f}, and half a turn is 3.1 radians. Save numpy.deg2rad of them; "
                "Euler angles must become rotation vectors first"
            )
    ROTATION.check(values, source, key, seen=np.isfinite(values))

"""The networks of MediaPipe Hands: where palms are in an image, and 21 points of each hand.

Zhang et al., "MediaPipe Hands: On-device Real-time Hand Tracking" (2020). A detector gives, for a
square image, a box about every palm, the wrist and the knuckle of the middle finger; the square
about the hand, turned so that fingers point up, is cut out for a second network.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from recon.core.errors import ReconError
from recon.films.blazepose import (
    Image,
    Network,
    Region,
    anchors_of_grids,
    bundled_folder,
    detected_boxes,
    mapped,
)

POINTS = 21
"""Of a hand, in the order of `recon.core.fingers.FINGER_POINTS`."""
_DETECTOR_SIDE, _SIDE = 192, 224
"""Pixels of the networks' inputs."""
_ANCHORS = {24: 2, 12: 6}
"""Cells of a side of each of the detector's grids, and boxes per cell."""
_WRIST, _MIDDLE = 0, 2
"""Keypoints of a palm that tell where its fingers are."""
_PALM_GROWTH, _PALM_SHIFT = 2.6, 0.5
"""Side of a hand's region per side of its palm's box, and how far the region lies ahead of the box
towards the fingers, in sides of the box."""
_GROWTH, _SHIFT = 2.0, 0.1
"""The same per side of the box about the points of a palm that were found before."""
_PALM_POINTS = [0, 1, 2, 3, 5, 6, 9, 10, 13, 14, 17, 18]
"""Points that finger tips do not move."""


@dataclass(frozen=True)
class Palm:
    """A palm that the detector found."""

    region: Region
    """Of its hand."""
    wrist: Float[np.ndarray, "2"]
    """Pixels."""
    score: float


@dataclass(frozen=True)
class Hand:
    """Points that the second network finds in a region."""

    pixels: Float[np.ndarray, "21 2"]
    """In the image, guessed also for what it does not show."""
    score: float
    """How likely the region holds a hand."""

    @property
    def region(self) -> Region:
        """Where to look for the hand in the next frame."""
        knuckles = self.pixels[[5, 13]].mean(0) / 2 + self.pixels[9] / 2
        ahead = knuckles - self.pixels[0]
        angle = float(np.arctan2(ahead[0], -ahead[1]))
        axes = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
        turned = self.pixels[_PALM_POINTS] @ axes.T
        low, high = turned.min(0), turned.max(0)
        side = max(float((high - low).max()), 1.0)
        centre = (low + high) / 2 - np.array([0, _SHIFT * float((high - low)[1])])
        return Region(centre @ axes, _GROWTH * side, angle)


class HandNetworks:
    """Both networks, run by LiteRT."""

    def __init__(self) -> None:
        """Load both.

        Raises:
            ReconError: when the extra `film` is not installed, or its models are those of before
                hands were looked for.
        """
        folder = bundled_folder()
        if not (folder / "hand_landmark_full.tflite").is_file():
            raise ReconError(
                "the installed motion-recon-film-models is too old to find hands; "
                "install it anew with: pip install --upgrade 'motion-recon[film]'"
            )
        self._detector = Network(folder / "palm_detection_full.tflite", (2016, 18))
        self._landmarks = Network(folder / "hand_landmark_full.tflite", (63,))
        self._anchors = anchors_of_grids(_ANCHORS)

    def palms(self, image: Image, square: Region) -> list[Palm]:
        """Palms in a square of an image, the surest first."""
        cut = square.cut(image, _DETECTOR_SIDE) / np.float32(255.0)
        to_image, found = square.to_image(_DETECTOR_SIDE), list[Palm]()
        for points, score in detected_boxes(self._detector, cut, self._anchors):
            centre, _, *keypoints = mapped(points * _DETECTOR_SIDE - 0.5, to_image)
            ahead = keypoints[_MIDDLE] - keypoints[_WRIST]
            side = float(points[1].max()) * square.side
            length = max(float(np.linalg.norm(ahead)), 1e-9)
            region = Region(
                centre + _PALM_SHIFT * side * ahead / length,
                _PALM_GROWTH * side,
                float(np.arctan2(ahead[0], -ahead[1])),
            )
            found.append(Palm(region, keypoints[_WRIST], score))
        return found

    def hand(self, image: Image, region: Region) -> Hand:
        """The points of the hand in a region."""
        cut = region.cut(image, _SIDE) / np.float32(255.0)
        raw, (score,) = self._landmarks(cut, (1,))
        places = raw.reshape(POINTS, 3)[:, :2].astype(float)
        pixels = mapped(places - 0.5, region.to_image(_SIDE))
        return Hand(pixels, float(score))

"""Runs the networks of MediaPipe Hands, which find palms in an image and points of each hand.

Zhang et al., "MediaPipe Hands: On-device Real-time Hand Tracking" (2020). A detector gives, for a
square image, a box about every palm, the wrist and the knuckle of the middle finger; the square
about the hand, turned so that fingers point up, is cut out for a second network (21 points).
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from recon.core.errors import ReconError
from recon.films.blazepose import (
    Image,
    Network,
    Region,
    affinely_mapped,
    anchors_of_grids,
    bundled_folder,
    detected_boxes,
)

POINTS = 21
"""Number of points of a hand, in the order of `recon.core.fingers.FINGER_POINTS`."""
_DETECTOR_SIDE, _SIDE = 192, 224
"""Sides (pixels) of both networks' square inputs."""
_ANCHORS = {24: 2, 12: 6}
"""Boxes per cell of each of the detector's grids, by the number of cells along a side."""
_WRIST, _MIDDLE = 0, 2
"""Indices of a palm's keypoints: wrist and knuckle of the middle finger, from palm to fingers."""
_PALM_GROWTH, _PALM_SHIFT = 2.6, 0.5
"""Side of a hand's region per side of its palm's box, and how far the region lies ahead of the box
towards the fingers, in sides of the box."""
_GROWTH, _SHIFT = 2.0, 0.1
"""The same for a hand that is followed, in sides of the box about its `_PALM_POINTS`."""
_PALM_POINTS = [0, 1, 2, 3, 5, 6, 9, 10, 13, 14, 17, 18]
"""Indices of the points of a hand without those that move most when fingers bend."""


@dataclass(frozen=True)
class Palm:
    """A palm that the detector found in an image."""

    region: Region
    """Square around the whole hand."""
    wrist: Float[np.ndarray, "2"]
    """Position in the image, pixels."""
    score: float


@dataclass(frozen=True)
class Hand:
    """The 21 points of a hand that the second network finds in a region."""

    pixels: Float[np.ndarray, "21 2"]
    """Positions in the image; those of points that are not seen are guessed."""
    score: float
    """Probability that the region holds a hand."""

    @property
    def next_region(self) -> Region:
        """Square of the image in which to look for the hand in the next frame."""
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
    """The detector of palms and the network for points of hands, run by LiteRT."""

    def __init__(self) -> None:
        """Load both networks.

        Raises:
            ReconError: when the extra `film` is not installed, or a version of it that is too old
                to have networks for hands.
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

    def palms_in(self, image: Image, square: Region) -> list[Palm]:
        """Return the palms that are found in a square of an image, highest score first."""
        cut = square.cut(image, _DETECTOR_SIDE) / np.float32(255.0)
        to_image, found = square.to_image(_DETECTOR_SIDE), list[Palm]()
        for points, score in detected_boxes(self._detector, cut, self._anchors):
            centre, _, *keypoints = affinely_mapped(points * _DETECTOR_SIDE - 0.5, to_image)
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

    def hand_in(self, image: Image, region: Region) -> Hand:
        """Find the 21 points of the hand in a region of an image."""
        cut = region.cut(image, _SIDE) / np.float32(255.0)
        raw, (score,) = self._landmarks(cut, (1,))
        places = raw.reshape(POINTS, 3)[:, :2].astype(float)
        pixels = affinely_mapped(places - 0.5, region.to_image(_SIDE))
        return Hand(pixels, float(score))

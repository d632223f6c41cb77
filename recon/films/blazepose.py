"""Runs the networks of BlazePose, which find people in an image and 33 landmarks of each.

Bazarevsky et al., "BlazePose: On-device Real-time Body Pose tracking" (2020). A small detector
gives, for a square image, the mid hips of every person and a circle around the body; the square
about this circle, turned so that the trunk is upright, is cut out for a second network.
"""

import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32, UInt8

from recon.core.errors import ReconError

Image = UInt8[np.ndarray, "height width 3"]
LANDMARKS = 33
_POINTS = 39
"""Points from the second network: 33 landmarks, 2 for the next region, and 4 of the hands."""
_NEXT_REGION = slice(33, 35)
_DETECTOR_SIDE, _SIDE, _HEAT = 224, 256, 64
"""Sides (pixels) of both networks' square inputs, and of the heat maps."""
_ANCHORS = {28: 2, 14: 2, 7: 6}
"""Boxes per cell of each of the detector's grids, by the number of cells along a side."""
_LEAST_SCORE = 0.5
_OVERLAP = 0.3
"""Intersection over union above which two detected boxes are taken for one object."""
_GROWTH = 1.25
"""Side of a person's region over the diameter of the circle around the body."""
_REACH = 3
"""Cells of the heat map on each side of a landmark whose centre of mass refines its position."""
_LEAST_HEAT = 0.5
MIRRORED = np.array(
    [0, 4, 5, 6, 1, 2, 3, 8, 7, 10, 9, *(k + 1 if k % 2 else k - 1 for k in range(11, 33))]
)
"""Index of each landmark's counterpart on the other side of the body."""


@dataclass(frozen=True)
class Region:
    """A rotated square in an image, around a person or a hand."""

    centre: Float[np.ndarray, "2"]
    """Position in the image, pixels."""
    side: float
    """Length of a side, pixels."""
    angle: float
    """Clockwise rotation of the square in the image, radians."""

    @classmethod
    def of_points(cls, hips: Float[np.ndarray, "2"], top: Float[np.ndarray, "2"]) -> "Region":
        """Return a person's square, around the circle centred at `hips` and through `top`."""
        up = top - hips
        angle = float(np.arctan2(up[0], -up[1]))
        return cls(hips, 2 * _GROWTH * float(np.linalg.norm(up)), angle)

    def to_image(self, pixels: int) -> Float[np.ndarray, "2 3"]:
        """Return the affine map from the square, resampled to `pixels` a side, to the image."""
        cos, sin = np.cos(self.angle), np.sin(self.angle)
        turn = np.array([[cos, -sin], [sin, cos]]) * self.side / pixels
        return np.column_stack((turn, self.centre - turn @ np.full(2, (pixels - 1) / 2)))

    def cut(self, image: Image, pixels: int) -> UInt8[np.ndarray, "pixels pixels 3"]:
        """Return the square as an upright image of its own; black beyond the original's border."""
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        return np.asarray(
            cv2.warpAffine(image, self.to_image(pixels), (pixels, pixels), flags=flags)
        )


@dataclass(frozen=True)
class Pose:
    """The 33 landmarks of a person that BlazePose's second network finds in a region."""

    pixels: Float[np.ndarray, "33 2"]
    """Positions in the image; those of landmarks that are not seen are guessed."""
    visibility: Float[np.ndarray, " 33"]
    """Probability that a landmark is seen and not covered."""
    presence: Float[np.ndarray, " 33"]
    """Probability that a landmark lies in the region."""
    inside: Bool[np.ndarray, " 33"]
    """Whether a landmark's position is in the region; beyond it, positions are unreliable."""
    score: float
    """Probability that the region holds a person."""
    region: Region
    """Square of the image in which the landmarks were looked for."""
    next_points: Float[np.ndarray, "2 2"]
    """Mid hips and top of the circle around the body, for the region of the next frame."""


class BlazePose:
    """BlazePose's detector of people and its network for their landmarks, run by LiteRT."""

    def __init__(self, landmarks: Path | None = None) -> None:
        """Load both networks.

        Args:
            landmarks: model file (.tflite) of the second network; None is the bundled `full`.

        Raises:
            ReconError: when the extra `film` is not installed, or the file is no such network.
        """
        folder = bundled_folder()
        self._detector = Network(folder / "pose_detection.tflite", (2254, 12))
        self._landmarks = Network(landmarks or folder / "pose_landmark_full.tflite", (195,))
        self._anchors = anchors_of_grids(_ANCHORS)

    def find(self, image: Image, square: Region | None = None) -> list[tuple[Region, float]]:
        """Return a region and score for each person in an image or a square, best first."""
        height, width = image.shape[:2]
        if square is None:
            square = Region(np.array([width - 1, height - 1]) / 2, float(max(width, height)), 0.0)
        cut = square.cut(image, _DETECTOR_SIDE)
        to_image = square.to_image(_DETECTOR_SIDE)
        found: list[tuple[Region, float]] = []
        image_of_network = cut / np.float32(127.5) - np.float32(1.0)
        for points, score in detected_boxes(self._detector, image_of_network, self._anchors):
            hips, rim = affinely_mapped(points[2:4] * _DETECTOR_SIDE - 0.5, to_image)
            found.append((Region.of_points(hips, rim), score))
        return found

    def poses(self, image: Image, region: Region) -> tuple[Pose, Pose]:
        """Find a person's landmarks twice: in a region of the image and in its mirror image.

        Those from the mirror image are mirrored back, with left and right exchanged.
        """
        cut = region.cut(image, _SIDE)
        return self._pose_in_cut(cut, region, mirror=False), self._pose_in_cut(
            cut[:, ::-1], region, mirror=True
        )

    def _pose_in_cut(self, cut: Image, region: Region, *, mirror: bool) -> Pose:
        raw, score, heat = self._landmarks(cut / np.float32(255.0), (1,), (_HEAT, _HEAT, _POINTS))
        rows = raw.reshape(_POINTS, 5).astype(float)
        places = _refined_by_heatmap(rows[:, :2], heat)
        sure = _sigmoid(rows[:, 3:])
        if mirror:
            places = places * (-1, 1) + (_SIDE, 0)
            places[:LANDMARKS], sure = places[MIRRORED], sure[MIRRORED]
        inside: Bool[np.ndarray, " points"] = np.all((places > 0) & (places < _SIDE), axis=-1)
        pixels = affinely_mapped(places - 0.5, region.to_image(_SIDE))
        return Pose(
            pixels=pixels[:LANDMARKS],
            visibility=sure[:LANDMARKS, 0],
            presence=sure[:LANDMARKS, 1],
            inside=inside[:LANDMARKS],
            score=float(score[0]),
            region=region,
            next_points=pixels[_NEXT_REGION],
        )


def bundled_folder() -> Path:
    """Return the folder in which the extra `film` installed its networks.

    Raises:
        ReconError: when the extra `film` is not installed.
    """
    try:
        import ai_edge_litert  # noqa: F401
        import recon_film_models
    except ImportError as error:
        raise ReconError(
            f"films need a detector of people and the package {error.name}, which is not "
            "installed; install both with: pip install 'motion-recon[film]' (in a checkout: "
            "pip install ./film-models '.[film]')"
        ) from error
    return recon_film_models.FOLDER


class Network:
    """A neural network that is read from a TensorFlow Lite file and run by LiteRT."""

    def __init__(self, path: Path, first_shape: tuple[int, ...]) -> None:
        from ai_edge_litert.interpreter import Interpreter

        try:
            with _without_stderr():
                self._run: Any = Interpreter(str(path), num_threads=min(os.cpu_count() or 1, 4))
                self._run.allocate_tensors()
        except (ValueError, RuntimeError) as error:
            raise ReconError(f"{path}: expected a network (.tflite): {error}") from error
        self._input = self._run.get_input_details()[0]["index"]
        outputs = sorted(self._run.get_output_details(), key=lambda one: one["name"], reverse=True)
        self._outputs = {tuple(one["shape"][1:].tolist()): one["index"] for one in outputs}
        self._first = first_shape
        if first_shape not in self._outputs:
            raise ReconError(
                f"{path}: expected a network of BlazePose with an output of shape "
                f"{first_shape}, got the shapes {', '.join(map(str, self._outputs))}"
            )

    def __call__(self, image: np.ndarray, *more: tuple[int, ...]) -> list[np.ndarray]:
        """Run the network on an image; return its main output and one of each shape in `more`.

        Of several outputs of one shape, the first by name is returned.
        """
        self._run.set_tensor(self._input, image[None].astype(np.float32))
        self._run.invoke()
        return [self._run.get_tensor(self._outputs[one])[0] for one in (self._first, *more)]


@contextmanager
def _without_stderr() -> Iterator[None]:
    """Silence stderr in a `with` block, since LiteRT writes to it for every network it loads."""
    kept, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)


def _sigmoid(logits: np.ndarray) -> np.ndarray:
    """Return probabilities for a network's logits."""
    return 1 / (1 + np.exp(-np.clip(logits.astype(float), -80, 80)))


def affinely_mapped(
    points: Float[np.ndarray, "n 2"], affine: Float[np.ndarray, "2 3"]
) -> np.ndarray:
    """Return 2D points transformed by an affine map."""
    return points @ affine[:, :2].T + affine[:, 2]


def anchors_of_grids(boxes: Mapping[int, int]) -> Float[np.ndarray, "anchors 2"]:
    """Return the centres of a detector's anchor boxes, as fractions of the image's side.

    Args:
        boxes: boxes per cell of each grid over the image, by the number of cells along a side.
    """
    grids = [
        np.repeat(np.mgrid[:side, :side].reshape(2, -1)[::-1].T + 0.5, count, axis=0) / side
        for side, count in boxes.items()
    ]
    return np.concatenate(grids)


def detected_boxes(
    detector: Callable[..., list[np.ndarray]],
    image: Float32[np.ndarray, "side side 3"],
    anchors: Float[np.ndarray, "anchors 2"],
) -> Iterator[tuple[Float[np.ndarray, "points 2"], float]]:
    """Yield centre, size and keypoints of each detected box, and its score, highest first.

    All are fractions of the image's side; overlapping boxes are averaged, weighted by scores.
    """
    boxes, logits = detector(image, (len(anchors), 1))
    scores = _sigmoid(logits[:, 0])
    kept = scores > _LEAST_SCORE
    scores, points = scores[kept], boxes[kept].astype(float) / len(image)
    points = points.reshape(len(scores), boxes.shape[1] // 2, 2)
    points[:, [0, *range(2, points.shape[1])]] += anchors[kept][:, None]
    for members in _overlapping_boxes(points[:, 0], points[:, 1], scores):
        mean = np.average(points[members], axis=0, weights=scores[members])
        yield mean, float(scores[members[0]])


def _overlapping_boxes(
    middles: Float[np.ndarray, "n 2"], sizes: Float[np.ndarray, "n 2"], scores: np.ndarray
) -> list[np.ndarray]:
    """Group overlapping boxes; return each group's indices, by descending score.

    A group holds the boxes that overlap the highest-scoring box that is not yet in a group.
    """
    low, high, area = middles - sizes / 2, middles + sizes / 2, sizes.prod(1)
    rest, groups = np.argsort(-scores), list[np.ndarray]()
    while len(rest) > 0:
        best = rest[0]
        common = np.minimum(high[rest], high[best]) - np.maximum(low[rest], low[best])
        shared = np.maximum(common, 0).prod(1)
        same = shared > _OVERLAP * (area[rest] + area[best] - shared)
        same[0] = True
        groups.append(rest[same])
        rest = rest[~same]
    return groups


def _refined_by_heatmap(
    places: Float[np.ndarray, "39 2"], heat: Float[np.ndarray, "64 64 39"]
) -> Float[np.ndarray, "39 2"]:
    """Move each point to the nearby centre of mass of its heat map, if that has a clear peak."""
    cell_size = _SIDE // _HEAT
    cells = np.floor(places / cell_size).astype(int)
    in_map = ((cells >= 0) & (cells < _HEAT)).all(1)
    reach = np.arange(-_REACH, _REACH + 1)
    columns, rows = (np.clip(cells[:, k, None], 0, _HEAT - 1) + reach for k in (0, 1))
    inside = ((rows >= 0) & (rows < _HEAT))[:, :, None] & ((columns >= 0) & (columns < _HEAT))[
        :, None
    ]
    patch = heat[
        np.clip(rows, 0, _HEAT - 1)[:, :, None],
        np.clip(columns, 0, _HEAT - 1)[:, None],
        np.arange(_POINTS)[:, None, None],
    ]
    probability = np.where(inside, _sigmoid(patch), 0.0)
    total = probability.sum((1, 2))
    x = (probability * columns[:, None]).sum((1, 2)) / np.maximum(total, 1e-9)
    y = (probability * rows[:, :, None]).sum((1, 2)) / np.maximum(total, 1e-9)
    clear = in_map & (probability.max((1, 2)) >= _LEAST_HEAT)
    return np.where(clear[:, None], np.stack((x, y), -1) * cell_size, places)

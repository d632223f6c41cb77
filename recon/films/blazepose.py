"""The networks of BlazePose: where people are in an image, and 33 landmarks of each.

Bazarevsky et al., "BlazePose: On-device Real-time Body Pose tracking" (2020). A small detector
gives, for a square image, the middle of the hips of everybody and a circle around the body; the
square about this circle, turned so that the trunk is upright, is cut out for a second network.
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
"""Of the second network: landmarks, then two that give the next region, and four of hands."""
_NEXT = slice(33, 35)
_DETECTOR_SIDE, _SIDE, _HEAT = 224, 256, 64
"""Pixels of the networks' inputs, and of the heat maps."""
_ANCHORS = {28: 2, 14: 2, 7: 6}
"""Cells of a side of each of the detector's grids, and boxes per cell."""
_LEAST_SCORE = 0.5
_OVERLAP = 0.3
"""Intersection over union from which on two boxes show the same."""
_GROWTH = 1.25
"""Side of the region per diameter of the circle around the body."""
_REACH = 3
"""Pixels of the heat map about a landmark whose centre of mass refines it."""
_LEAST_HEAT = 0.5
MIRRORED = np.array(
    [0, 4, 5, 6, 1, 2, 3, 8, 7, 10, 9, *(k + 1 if k % 2 else k - 1 for k in range(11, 33))]
)
"""Which landmark each is in a mirror: left and right exchanged."""


@dataclass(frozen=True)
class Region:
    """A turned square in an image that holds a person."""

    centre: Float[np.ndarray, "2"]
    """Pixels."""
    side: float
    """Pixels."""
    angle: float
    """Radians by which the square's upper edge is turned clockwise from that of the image."""

    @classmethod
    def of_points(cls, hips: Float[np.ndarray, "2"], rim: Float[np.ndarray, "2"]) -> "Region":
        """The square about a person, from the mid hips and a point of the circle around them."""
        way = rim - hips
        angle = float(np.arctan2(way[0], -way[1]))
        return cls(hips, 2 * _GROWTH * float(np.linalg.norm(way)), angle)

    def to_image(self, pixels: int) -> Float[np.ndarray, "2 3"]:
        """The affine map from the square's cut-out of so many pixels to the image."""
        cos, sin = np.cos(self.angle), np.sin(self.angle)
        turn = np.array([[cos, -sin], [sin, cos]]) * self.side / pixels
        return np.column_stack((turn, self.centre - turn @ np.full(2, (pixels - 1) / 2)))

    def cut(self, image: Image, pixels: int) -> UInt8[np.ndarray, "pixels pixels 3"]:
        """The square as an upright image; black beyond the border of the image."""
        how = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        return np.asarray(
            cv2.warpAffine(image, self.to_image(pixels), (pixels, pixels), flags=how)
        )


@dataclass(frozen=True)
class Pose:
    """Landmarks that the second network finds in a region, and their scores."""

    pixels: Float[np.ndarray, "33 2"]
    """In the image, guessed also for what it does not show."""
    visibility: Float[np.ndarray, " 33"]
    """How likely a landmark is seen and not covered."""
    presence: Float[np.ndarray, " 33"]
    """How likely it is in the region."""
    inside: Bool[np.ndarray, " 33"]
    """Whether it is in the region; the network cannot say more than that it lies beyond."""
    score: float
    """How likely the region holds a person."""
    region: Region
    """That was looked at."""
    next_points: Float[np.ndarray, "2 2"]
    """The hips and a point of the circle around the body, for the region of the next frame."""


class BlazePose:
    """The two networks of BlazePose, run by LiteRT."""

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
        """People in an image, or in a square of it, with their scores; the surest first."""
        height, width = image.shape[:2]
        if square is None:
            square = Region(np.array([width - 1, height - 1]) / 2, float(max(width, height)), 0.0)
        cut = square.cut(image, _DETECTOR_SIDE)
        to_image = square.to_image(_DETECTOR_SIDE)
        found: list[tuple[Region, float]] = []
        image_of_network = cut / np.float32(127.5) - np.float32(1.0)
        for points, score in detected_boxes(self._detector, image_of_network, self._anchors):
            hips, rim = mapped(points[2:4] * _DETECTOR_SIDE - 0.5, to_image)
            found.append((Region.of_points(hips, rim), score))
        return found

    def poses(self, image: Image, region: Region) -> tuple[Pose, Pose]:
        """Landmarks of the person in a region, found in the image and in its mirror image.

        A mirror image gives the same person: places are mirrored back, left and right named anew.
        """
        cut = region.cut(image, _SIDE)
        return self._pose(cut, region, mirror=False), self._pose(cut[:, ::-1], region, mirror=True)

    def _pose(self, cut: Image, region: Region, *, mirror: bool) -> Pose:
        raw, score, heat = self._landmarks(cut / np.float32(255.0), (1,), (_HEAT, _HEAT, _POINTS))
        rows = raw.reshape(_POINTS, 5).astype(float)
        places = _refined_by_heatmap(rows[:, :2], heat)
        sure = _sigmoid(rows[:, 3:])
        if mirror:
            places = places * (-1, 1) + (_SIDE, 0)
            places[:LANDMARKS], sure = places[MIRRORED], sure[MIRRORED]
        inside: Bool[np.ndarray, " points"] = np.all((places > 0) & (places < _SIDE), axis=-1)
        pixels = mapped(places - 0.5, region.to_image(_SIDE))
        return Pose(
            pixels=pixels[:LANDMARKS],
            visibility=sure[:LANDMARKS, 0],
            presence=sure[:LANDMARKS, 1],
            inside=inside[:LANDMARKS],
            score=float(score[0]),
            region=region,
            next_points=pixels[_NEXT],
        )


def bundled_folder() -> Path:
    """The folder of the model files.

    Raises:
        ReconError: when the extra `film` is not installed.
    """
    try:
        import ai_edge_litert  # noqa: F401
        import recon_film_models
    except ImportError as error:
        raise ReconError(
            f"films need a detector of people, and {error.name} is not installed; install both "
            "with: pip install 'motion-recon[film]'"
        ) from error
    return recon_film_models.FOLDER


class Network:
    """A network in a file of TensorFlow Lite."""

    def __init__(self, path: Path, first: tuple[int, ...]) -> None:
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
        self._first = first
        if first not in self._outputs:
            raise ReconError(
                f"{path}: expected a network of BlazePose with an output of {first}, got "
                f"{', '.join(map(str, self._outputs))}"
            )

    def __call__(self, image: np.ndarray, *more: tuple[int, ...]) -> list[np.ndarray]:
        """Outputs for an image: that of the shape `first`, then those of the shapes `more`.

        Of several outputs of one shape it is the first by their names.
        """
        self._run.set_tensor(self._input, image[None].astype(np.float32))
        self._run.invoke()
        return [self._run.get_tensor(self._outputs[one])[0] for one in (self._first, *more)]


@contextmanager
def _without_stderr() -> Iterator[None]:
    """Context in which libraries write nothing to stderr, as LiteRT does for every network."""
    kept, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)


def _sigmoid(logits: np.ndarray) -> np.ndarray:
    """Probabilities of a network's scores."""
    return 1 / (1 + np.exp(-np.clip(logits.astype(float), -80, 80)))


def mapped(points: Float[np.ndarray, "n 2"], way: Float[np.ndarray, "2 3"]) -> np.ndarray:
    """Points after an affine map."""
    return points @ way[:, :2].T + way[:, 2]


def anchors_of_grids(boxes: Mapping[int, int]) -> Float[np.ndarray, "anchors 2"]:
    """Centres that a detector's boxes are relative to, as fractions of its image.

    Args:
        boxes: number of boxes in each cell, by the cells of a side of a grid over the image.
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
    """Centre, size and keypoints of everything that a detector finds, surest first; and scores.

    Places and sizes are fractions of the image; boxes that overlap are averaged by their scores.
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
    """Groups of boxes that overlap the most confident box not yet in a group.

    Their indices, by descending confidence.
    """
    low, high, area = middles - sizes / 2, middles + sizes / 2, sizes.prod(1)
    left, groups = np.argsort(-scores), list[np.ndarray]()
    while len(left) > 0:
        best = left[0]
        common = np.minimum(high[left], high[best]) - np.maximum(low[left], low[best])
        shared = np.maximum(common, 0).prod(1)
        same = shared > _OVERLAP * (area[left] + area[best] - shared)
        same[0] = True
        groups.append(left[same])
        left = left[~same]
    return groups


def _refined_by_heatmap(
    places: Float[np.ndarray, "39 2"], heat: Float[np.ndarray, "64 64 39"]
) -> Float[np.ndarray, "39 2"]:
    """Places moved to the centre of mass of the heat about them, where it is hot enough."""
    step = _SIDE // _HEAT
    cells = np.floor(places / step).astype(int)
    own = ((cells >= 0) & (cells < _HEAT)).all(1)
    reach = np.arange(-_REACH, _REACH + 1)
    columns, rows = (np.clip(cells[:, k, None], 0, _HEAT - 1) + reach for k in (0, 1))
    there = ((rows >= 0) & (rows < _HEAT))[:, :, None] & ((columns >= 0) & (columns < _HEAT))[
        :, None
    ]
    patch = heat[
        np.clip(rows, 0, _HEAT - 1)[:, :, None],
        np.clip(columns, 0, _HEAT - 1)[:, None],
        np.arange(_POINTS)[:, None, None],
    ]
    warmth = np.where(there, _sigmoid(patch), 0.0)
    total = warmth.sum((1, 2))
    x = (warmth * columns[:, None]).sum((1, 2)) / np.maximum(total, 1e-9)
    y = (warmth * rows[:, :, None]).sum((1, 2)) / np.maximum(total, 1e-9)
    hot = own & (warmth.max((1, 2)) >= _LEAST_HEAT)
    return np.where(hot[:, None], np.stack((x, y), -1) * step, places)

"""Files of labelled clouds, drawn from a corpus, for training the network of labels."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from scipy.spatial import KDTree

from priors.labels.regions import Regions
from recon.benchmark.dataset import Part
from recon.body.model import BodyModel
from recon.core.motion import Motion
from training.labels.clouds import POINTS, LabelledClouds
from training.labels.people import SPACING, Postures, drawn_shape, turned_over, wardrobe
from training.labels.rooms import Glimpse, all_around, drawn_room, glimpse
from training.run import LOG
from training.settings import TrainingSettings

WINDOW = 3
"""Moments of a window, `SPACING` apart."""
WINDOWS, LEARNED, CHECKED = 500, 24, 2
"""Windows of a file, and files of the training and the validation people."""
_SUITS = 150
"""Different clothes that people wear."""
_LEAST = 60
"""Points of the body that a moment must show, on average of a window."""
_LEFT_OVER = ("nothing", "ball", "box")


@dataclass(frozen=True)
class Source:
    """People and postures from which windows are drawn."""

    postures: Postures
    wardrobe: list[BodyModel]
    body: BodyModel

    @classmethod
    def of(cls, settings: TrainingSettings, part: Part, seed: int) -> "Source":
        """Postures of one part of a corpus.

        Raises:
            FileNotFoundError: when the corpus holds no motion files.
            ValueError: when no clip of it may be learned from.
        """
        body, clips = BodyModel.load(), settings.load_clips(part)
        if len(clips) == 0:
            raise ValueError(f"{settings.corpus}: no {part} clip there ({settings.data})")
        rows = [(clip.subject, clip.motion.rotations) for clip in clips]
        return cls(Postures.of(rows, clips[0].motion.fps), wardrobe(body, _SUITS, seed), body)


def make_training_clouds(settings: TrainingSettings) -> tuple[Path, Path]:
    """Draw labelled clouds of training and of validation people; the two folders with them.

    Files `clouds_0000.npz` and so on that are there already are not made again; the same seed and
    number give the same file.

    Raises:
        FileNotFoundError: when the corpus holds no motion files.
        ValueError: when no clip of it may be learned from.
    """
    folder = settings.out / "clouds"
    parts: tuple[tuple[Part, int], ...] = (("train", LEARNED), ("validation", CHECKED))
    for seed, (part, files) in enumerate(parts, settings.seed):
        (folder / part).mkdir(parents=True, exist_ok=True)
        paths = [folder / part / f"clouds_{number:04d}.npz" for number in range(files)]
        if all(path.is_file() for path in paths):
            continue
        source = Source.of(settings, part, seed)
        for number, path in enumerate(paths):
            if not path.is_file():
                draw_clouds(source, WINDOWS, np.random.default_rng([seed, number])).save(path)
                LOG.info("wrote %s", path)
    return folder / "train", folder / "validation"


def draw_clouds(source: Source, windows: int, random: np.random.Generator) -> LabelledClouds:
    """Windows of drawn people in drawn rooms."""
    shape = (windows, WINDOW, POINTS)
    points, places = (np.zeros((*shape, 3), np.float16) for _ in range(2))
    regions, present = np.full(shape, -1, np.int8), np.zeros(shape, bool)
    eyes, has_eye = np.zeros((windows, 3), np.float32), np.zeros(windows, bool)
    of_vertex = Regions.of(source.body).of_vertex.numpy()
    tree = KDTree(source.body.template.numpy())
    for window in range(windows):
        glimpses, eye = draw_window(source, random)
        while sum(int(each.on_body.sum()) for each in glimpses) < _LEAST * WINDOW:
            glimpses, eye = draw_window(source, random)
        middle = np.median(np.concatenate([each.points for each in glimpses]), 0)
        for moment, each in enumerate(glimpses):
            pick = random.permutation(len(each.points))[:POINTS]
            region = of_vertex[tree.query(each.places[pick])[1]] if len(pick) else pick
            row = (window, moment, slice(0, len(pick)))
            points[row] = (each.points[pick] - middle).clip(-30, 30)
            places[row] = each.places[pick]
            regions[row] = np.where(each.on_body[pick] > 0, region, -1)
            present[row] = True
        if eye is not None:
            eyes[window], has_eye[window] = eye - middle, True
    arrays = (points, present, places, regions, eyes, has_eye, np.ones(windows, bool))
    return LabelledClouds(*map(torch.from_numpy, arrays))


def draw_window(
    source: Source, random: np.random.Generator
) -> tuple[list[Glimpse], Float[np.ndarray, "3"] | None]:
    """The visible points of a person in a window, and the sensor's place (None: all sides)."""
    suit = source.wardrobe[int(random.integers(len(source.wardrobe)))]
    rotations = source.postures.draw(WINDOW, random)
    rotations[:, 0] = turned_over(random).astype(np.float32) @ rotations[:, 0]
    motion = Motion.create(
        torch.zeros(WINDOW, 3),
        torch.from_numpy(np.ascontiguousarray(rotations, np.float32)),
        drawn_shape(source.body, random),
        1 / SPACING,
    )
    vertices = suit.pose(motion).vertices.double().numpy()
    steps = random.normal(0.0, random.choice([0.05, 0.3]), 2) * SPACING
    vertices[..., :2] += np.arange(WINDOW)[:, None, None] * steps
    lift = random.uniform(0, 0.6) if random.random() < 0.15 else 0.0
    vertices[..., 2] += lift - vertices[..., 2].min()
    faces, places = suit.faces.numpy(), source.body.template.double().numpy()
    if random.random() < 0.15:
        return [all_around(row, faces, places, POINTS, random) for row in vertices], None
    room = drawn_room(vertices, random)
    left_over = str(random.choice(_LEFT_OVER, p=[0.5, 0.2, 0.3]))
    return [glimpse(row, faces, places, room, left_over, random) for row in vertices], room.eye

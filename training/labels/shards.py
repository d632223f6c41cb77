"""Simulated people, and files of labelled clouds of them for training."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation
from torch import Tensor

from priors.labels.regions import Regions
from recon.benchmark.dataset import Part
from recon.body.model import BodyModel
from recon.core.motion import Motion
from recon.core.raster import differentiable_normals
from recon.core.skeleton import JOINTS, descendants, joint_index
from recon.simulation.scenery import Clothing, clothed, random_field
from training.labels.clouds import POINTS, LabelledClouds
from training.labels.rooms import LabelledPoints, body_points, drawn_room, simulated_room_points
from training.run import LOG
from training.settings import TrainingSettings

_WIDE, _WIDEST = 1.3, 3.5
"""Standard deviation of every shape coefficient, where people have 1, and the largest."""
_HAIRLINE = 0.04
"""Metres above the head's joint where hair begins at the forehead."""


def clothed_bodies(body: BodyModel, count: int, seed: int) -> list[BodyModel]:
    """Make `count` bodies with random clothes and hair; the first has neither."""
    random = np.random.default_rng(seed)
    worn = [body]
    for _ in range(count - 1):
        number = int(random.integers(2**31))
        loose = 0.004 * math.exp(random.uniform(0.0, math.log(6.0)))
        clothing = Clothing(loose=loose, folds=random.uniform(0.001, 0.005))
        worn.append(with_hair(clothed(body, number, clothing), number))
    return worn


def with_hair(body: BodyModel, seed: int) -> BodyModel:
    """Add hair, up to a few centimetres off top and back of the head, to a body."""
    generator = torch.Generator().manual_seed(seed)
    longest = 0.06 * float(torch.rand((), generator=generator)) ** 2
    joint = body.joint_template[joint_index("head")]
    away = body.template - joint
    grows = (away[:, 1] - 2.5 * away[:, 2].clamp(min=0) > -_HAIRLINE).to(away)
    field = 1 + 0.3 * random_field(body.template, 0.05, generator)
    carried = body.weights[:, joint_index("head")] * grows * field.clamp(min=0)
    normals = differentiable_normals(body.template, body.faces)
    return body.replace(template=body.template + (longest * carried)[:, None] * normals)


def drawn_shape(body: BodyModel, random: np.random.Generator) -> Float[Tensor, " shape"]:
    """Random shape coefficients, more extreme than real ones."""
    drawn = random.normal(0.0, _WIDE, body.shape_size).clip(-_WIDEST, _WIDEST)
    return torch.from_numpy(drawn).to(body.template)


SPACING = 0.3
"""Seconds between the moments of a window."""
_LIMBS = tuple(
    descendants(joint_index(name))
    for name in ("left_shoulder", "right_shoulder", "left_hip", "right_hip", "neck")
)
"""Joints that are exchanged together where postures are put together of several."""


@dataclass(frozen=True)
class Postures:
    """Rotations of recorded people, from which windows are drawn."""

    clips: Sequence[Float[np.ndarray, "_ 22 3 3"]]
    """Rotations of every clip, in the frame of its recording (z up)."""
    chances: Float[np.ndarray, " clips"]
    """Probability with which each clip is drawn."""
    fps: float

    @classmethod
    def of(
        cls, clips: Sequence[tuple[str, Float[torch.Tensor, "_ 22 3 3"]]], fps: float
    ) -> "Postures":
        """Collect the postures of clips, each given with its person's name.

        People are drawn evenly but for the square root of how much is known of them, clips of one
        person by their length.
        """
        subjects: dict[str, int] = {}
        for subject, rotations in clips:
            subjects[subject] = subjects.get(subject, 0) + len(rotations)
        chances = np.array([len(rows) / subjects[subject] ** 0.5 for subject, rows in clips])
        rotations = [rows.numpy().astype(np.float32) for _, rows in clips]
        return cls(rotations, chances / chances.sum(), fps)

    def draw(
        self, moments: int, random: np.random.Generator
    ) -> Float[np.ndarray, "moments 22 3 3"]:
        """A window of somebody's motion: as recorded, combined from several, or random.

        Of ten windows five are as recorded, three have limbs of other recordings, two have bent
        limbs that are drawn at random; half of all are disturbed a little.
        """
        kind = random.random()
        window = self._recorded_window(moments, random)
        if kind >= 0.5:
            for limb in _LIMBS:
                if random.random() < 0.7:
                    window[:, limb] = self._recorded_window(moments, random)[:, limb]
        if kind >= 0.8:
            window[:, 1:] = random_motion(moments, random)[:, 1:]
        if random.random() < 0.5:
            bend = random.normal(0.0, random.choice([0.1, 0.25]), (1, len(JOINTS), 3))
            bend[:, 0] = 0.0
            window = window @ _rotation_matrices(bend)
        return window

    def _recorded_window(self, moments: int, random: np.random.Generator) -> np.ndarray:
        """Moments `SPACING` apart of one clip, played a little faster or slower, or backwards."""
        clip = self.clips[int(random.choice(len(self.clips), p=self.chances))]
        pace = random.uniform(0.7, 1.3) * random.choice([-1, 1]) * SPACING * self.fps
        frames = np.rint(random.integers(len(clip)) + pace * np.arange(moments)).astype(int)
        return clip[np.clip(frames, 0, len(clip) - 1)].copy()


def random_motion(
    moments: int, random: np.random.Generator
) -> Float[np.ndarray, "moments 22 3 3"]:
    """A random slow motion of limbs, roughly within joint limits.

    Elbows and knees bend one way only; hips are mostly flexed, so that many of these sit, squat or
    kick. The root is left as it is.
    """
    turns = np.zeros((len(JOINTS), 3))
    for name in ("spine1", "spine2", "spine3", "neck", "head"):
        turns[joint_index(name)] = random.normal((random.uniform(0, 0.4), 0, 0), 0.2)
    for side, sign in (("left", 1.0), ("right", -1.0)):
        lift = random.uniform(-1.4, 1.4)
        swing = random.uniform(-0.6, 1.6)
        arm = Rotation.from_euler("y", -sign * swing) * Rotation.from_euler("z", sign * lift)
        arm = arm * Rotation.from_euler("x", random.normal(0.0, 0.7))
        turns[joint_index(f"{side}_shoulder")] = arm.as_rotvec()
        turns[joint_index(f"{side}_elbow"), 1] = -sign * random.uniform(0.0, 2.4)
        turns[joint_index(f"{side}_wrist")] = random.normal(0.0, 0.3, 3)
        flexion = random.uniform(-0.4, 2.0)
        leg = Rotation.from_euler("x", -flexion)
        leg = leg * Rotation.from_euler("z", sign * random.uniform(-0.2, 0.8))
        leg = leg * Rotation.from_euler("y", sign * random.normal(0.0, 0.4))
        turns[joint_index(f"{side}_hip")] = leg.as_rotvec()
        turns[joint_index(f"{side}_knee"), 0] = random.uniform(0.0, min(2.4, 1.2 + abs(flexion)))
        turns[joint_index(f"{side}_ankle")] = random.normal(0.0, 0.3, 3)
    drift = random.normal(0.0, random.choice([0.0, 0.2]), (1, len(JOINTS), 3))
    return _rotation_matrices(turns + drift * np.arange(moments)[:, None, None]).astype(np.float32)


def random_orientation(random: np.random.Generator) -> Float[np.ndarray, "3 3"]:
    """A random rotation of a person: upright in any heading, lying on any side, or arbitrary."""
    heading = Rotation.from_euler("z", random.uniform(0, 2 * np.pi))
    kind = random.random()
    if kind < 0.65:
        return heading.as_matrix()
    if kind < 0.82:
        roll = Rotation.from_euler("z", random.uniform(0, 2 * np.pi))
        return (heading * Rotation.from_euler("x", np.pi / 2) * roll).as_matrix()
    return Rotation.from_quat(random.normal(size=4)).as_matrix()


def _rotation_matrices(
    vectors: Float[np.ndarray, "moments 22 3"],
) -> Float[np.ndarray, "moments 22 3 3"]:
    matrices = Rotation.from_rotvec(vectors.reshape(-1, 3)).as_matrix()
    return matrices.reshape(*vectors.shape[:-1], 3, 3).astype(np.float32)


WINDOW = 3
"""Moments of a window, `SPACING` apart."""
WINDOWS, LEARNED, CHECKED = 500, 24, 2
"""Windows of a file, and files of the training and the validation people."""
_SUITS = 150
"""Different clothes that people wear."""
_LEAST = 60
"""Points of the body that a moment must show, on average of a window."""
_BACKGROUNDS = ("nothing", "ball", "box")


@dataclass(frozen=True)
class Source:
    """Bodies and postures of which windows of simulated clouds are drawn."""

    postures: Postures
    bodies: list[BodyModel]
    body: BodyModel

    @classmethod
    def of(cls, settings: TrainingSettings, part: Part, seed: int) -> "Source":
        """Load the postures of one part of a corpus, and dress bodies at random.

        Raises:
            FileNotFoundError: when the corpus holds no motion files.
            ValueError: when no clip of it may be learned from.
        """
        body, clips = BodyModel.load(), settings.load_clips(part)
        if len(clips) == 0:
            raise ValueError(f"{settings.corpus}: holds no {part} clip; convert more recordings")
        rows = [(clip.subject, clip.motion.rotations) for clip in clips]
        return cls(
            Postures.of(rows, clips[0].motion.fps), clothed_bodies(body, _SUITS, seed), body
        )


def make_training_clouds(settings: TrainingSettings) -> tuple[Path, Path]:
    """Draw labelled clouds of training and of validation people; return the folders of both.

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
    """Draw windows of clouds of random people in random rooms, with their labels."""
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
) -> tuple[list[LabelledPoints], Float[np.ndarray, "3"] | None]:
    """Sample points of a person; return also the sensor's place, None if it sees all sides."""
    suit = source.bodies[int(random.integers(len(source.bodies)))]
    rotations = source.postures.draw(WINDOW, random)
    rotations[:, 0] = random_orientation(random).astype(np.float32) @ rotations[:, 0]
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
        return [body_points(row, faces, places, POINTS, random) for row in vertices], None
    room = drawn_room(vertices, random)
    background = str(random.choice(_BACKGROUNDS, p=[0.5, 0.2, 0.3]))
    return [
        simulated_room_points(row, faces, places, room, background, random) for row in vertices
    ], room.eye

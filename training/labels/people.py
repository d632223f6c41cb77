"""Random people: bodies of random shapes with random clothes and hair."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from scipy.spatial.transform import Rotation
from torch import Tensor

from recon.body.model import BodyModel
from recon.core.raster import tensor_normals
from recon.core.skeleton import JOINTS, descendants, joint_index
from recon.simulation.scenery import Clothing, clothed, random_field

_WIDE, _WIDEST = 1.3, 3.5
"""Standard deviation of every shape coefficient, where people have 1, and the largest."""
_HAIRLINE = 0.04
"""Metres above the head's joint where hair begins at the forehead."""


def wardrobe(body: BodyModel, count: int, seed: int) -> list[BodyModel]:
    """The body in different clothes and hair; the first is without both."""
    random = np.random.default_rng(seed)
    worn = [body]
    for _ in range(count - 1):
        number = int(random.integers(2**31))
        loose = 0.004 * math.exp(random.uniform(0.0, math.log(6.0)))
        clothing = Clothing(loose=loose, folds=random.uniform(0.001, 0.005))
        worn.append(with_hair(clothed(body, number, clothing), number))
    return worn


def with_hair(body: BodyModel, seed: int) -> BodyModel:
    """The body with hair of some length, up to a few centimetres off top and back of the head."""
    generator = torch.Generator().manual_seed(seed)
    longest = 0.06 * float(torch.rand((), generator=generator)) ** 2
    joint = body.joint_template[joint_index("head")]
    away = body.template - joint
    grows = (away[:, 1] - 2.5 * away[:, 2].clamp(min=0) > -_HAIRLINE).to(away)
    field = 1 + 0.3 * random_field(body.template, 0.05, generator)
    carried = body.weights[:, joint_index("head")] * grows * field.clamp(min=0)
    normals = tensor_normals(body.template, body.faces)
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
        """Postures of clips, each with its person's name.

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
        window = self._recorded(moments, random)
        if kind >= 0.5:
            for limb in _LIMBS:
                if random.random() < 0.7:
                    window[:, limb] = self._recorded(moments, random)[:, limb]
        if kind >= 0.8:
            window[:, 1:] = random_motion(moments, random)[:, 1:]
        if random.random() < 0.5:
            bend = random.normal(0.0, random.choice([0.1, 0.25]), (1, len(JOINTS), 3))
            bend[:, 0] = 0.0
            window = window @ _rotation_matrices(bend)
        return window

    def _recorded(self, moments: int, random: np.random.Generator) -> np.ndarray:
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


def turned_over(random: np.random.Generator) -> Float[np.ndarray, "3 3"]:
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

"""A person who stands, moves the arms and makes forty hand poses, for tests and measurements."""

from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, Int

from recon.body.hands import ANGLES, HandModel, pose_fingers
from recon.body.model import BodyModel
from recon.core import rotations as so3
from recon.core.fingers import FINGER_POINTS, HAND_JOINTS, ROWS, TIPS, Hands
from recon.core.motion import Motion
from recon.core.skeleton import joint_index

FPS = 30.0


def pose_table() -> dict[str, np.ndarray]:
    """Angles in degrees, by the name of the pose; none was used to make the hand model."""
    header, *rows = (Path(__file__).parent / "poses.csv").read_text().split()
    assert header.split(",")[1:] == list(ANGLES)
    cells = [row.split(",") for row in rows]
    return {name: np.array(numbers, dtype=float) for name, *numbers in cells}


def angle_paths(seed: int, count: int = 40, hold: float = 0.4, move: float = 0.6) -> torch.Tensor:
    """Angles (time, 2, 22), radians, of hands that go from pose to pose, each in its order."""
    rows, generator = np.deg2rad(list(pose_table().values())), np.random.default_rng(seed)
    u = np.linspace(0, 1, round(move * FPS) + 1)[1:, None]
    u = 10 * u**3 - 15 * u**4 + 6 * u**5
    sides = []
    for _ in range(2):
        order = rows[generator.permutation(len(rows))[:count]]
        path = [np.repeat(order[:1], round(hold * FPS), 0)]
        for start, end in pairwise(order):
            path += [start + (end - start) * u, np.repeat(end[None], round(hold * FPS), 0)]
        sides.append(np.concatenate(path))
    return torch.from_numpy(np.stack(sides, 1))


@dataclass(frozen=True)
class Person:
    """A motion with fingers, and the 42 points of its hands."""

    body: BodyModel
    motion: Motion
    angles: torch.Tensor
    points: torch.Tensor


def person(seed: int = 0, count: int = 40) -> Person:
    """Somebody with hands of other lengths than the body's shape says."""
    body = BodyModel.load()
    generator = torch.Generator().manual_seed(seed)
    angles = angle_paths(seed, count)
    time = torch.arange(len(angles)) / FPS
    rotations = torch.eye(3).repeat(len(angles), 22, 1, 1)
    rotations[:, 0] = so3.exp(torch.tensor([torch.pi / 2, 0.0, 0.0]))
    for sign, side in ((1.0, "left"), (-1.0, "right")):
        swing = torch.stack(
            (0.3 * (1.1 * time).sin(), 0 * time, sign * (-0.9 + 0.3 * time.cos())), -1
        )
        rotations[:, joint_index(f"{side}_shoulder")] = so3.exp(swing)
        bend = torch.stack((0 * time, sign * (-0.9 + 0.4 * (0.8 * time).sin()), 0 * time), -1)
        rotations[:, joint_index(f"{side}_elbow")] = so3.exp(bend)
        turn = torch.stack(
            (0.5 * (1.3 * time).sin(), 0.2 * time.cos(), 0.3 * (0.9 * time).sin()), -1
        )
        rotations[:, joint_index(f"{side}_wrist")] = so3.exp(turn)
    shape = torch.zeros(body.shape_size)
    rest = body.rest_joints(shape)
    place = torch.zeros(len(angles), 3)
    place[:, 2] = rest[0, 1] - rest[10, 1] + 0.03
    model = HandModel.of(body, shape)
    sizes = 0.06 * torch.randn(1, generator=generator) + 0.05 * torch.randn(
        20, generator=generator
    )
    lengths = model.lengths * sizes.double().exp()
    hands = hands_of_angles(angles, model, lengths).to(dtype=torch.float32)
    motion = Motion.create(place - rest[0], rotations, shape, FPS).replace(hands=hands)
    return Person(body, motion, angles, hand_points(motion, body))


def hand_points(motion: Motion, body: BodyModel) -> torch.Tensor:
    """The points of FINGER_POINTS (time, 42, 3), world, metres."""
    fingers, _ = pose_fingers(motion, body)
    wrists = body.pose(motion).joints[:, 20:22]
    found = torch.zeros(motion.frames, len(FINGER_POINTS), 3)
    for side in (0, 1):
        found[:, 21 * side] = wrists[:, side]
        found[:, 21 * side + 1 : 21 * side + 21] = fingers[:, ROWS[side]]
    return found


def noisy(points: torch.Tensor, noise: float, missing: float, seed: int = 0) -> torch.Tensor:
    """Points with white noise and a confidence of 0 or 1 as their last number."""
    generator = torch.Generator().manual_seed(seed)
    found = points + noise * torch.randn(points.shape, generator=generator)
    seen = torch.rand(points.shape[:-1], generator=generator) >= missing
    return torch.cat((found, torch.ones_like(found[..., :1])), -1) * seen[..., None]


def hands_of_angles(
    angles: Float[torch.Tensor, "time 2 22"], model: HandModel, lengths: torch.Tensor | None = None
) -> Hands:
    """Finger rotations and bone lengths for joint angles (radians) of left and right hand."""
    eye = torch.eye(3).to(angles).expand(len(angles), 3, 3)
    nowhere = angles.new_zeros(len(angles), 3)
    local = torch.stack([model.posed(angles[:, s], eye, nowhere, s).local for s in (0, 1)], 1)
    rotations = angles.new_zeros(len(angles), len(HAND_JOINTS), 3, 3)
    joints: Int[torch.Tensor, "2 15"] = ROWS.unflatten(1, (5, 4))[:, :, :3].flatten(1)
    rotations[:, joints] = local
    out = model.lengths.new_zeros(len(HAND_JOINTS) + len(TIPS))
    out[ROWS] = model.lengths if lengths is None else lengths
    return Hands(rotations, out)

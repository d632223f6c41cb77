"""Takes each body from MakeHuman's A-pose to the zero pose of the skeleton by inverse skinning.

Every bone gets a rotation R (zero pose -> A-pose) that carries its direction in the zero pose to
its direction in the body at hand, so bone directions are the same for all bodies and the shape
space holds no pose. With x_A = sum_j w_j (R_j x_T + t_j), the zero pose is
x_T = (sum w R)^-1 (x_A - sum w t).
"""

import numpy as np
import torch

from body.layout import JOINTS, PARENTS, SIDES, number

LEAN_DEGREES = {"spine1": 8.0, "spine2": 8.0, "spine3": 8.0, "neck": -4.0}
"""Degrees by which the zero pose leans farther back than MakeHuman's."""
COLLAR_RAISE_DEGREES = 28.0
COLLAR_BACK_DEGREES = 6.0
THIGH_OUT_DEGREES = 5.5
FOOT_OUT_DEGREES = 11.0
UPPER_ARM = (-6.0, -3.0)
"""Azimuth (towards the front) and elevation of a bone in the zero pose, degrees."""
FOREARM = (0.0, 1.0)
HAND = (0.0, -2.0)
SHANK = (-0.034, -1.0, -0.105)
FOREARM_TWIST_SHARE = 0.6
"""Share of the hand's remaining twist that the forearm takes."""


def unpose(
    vertices: np.ndarray, points: np.ndarray, weights: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Compute zero-pose vertices (n, V, 3) and joints (n, 22, 3) of bodies in the A-pose."""
    rotations = bone_rotations(points)
    joints_a = points[:, : len(JOINTS)]
    joints_t = np.zeros_like(joints_a)
    for j, parent in enumerate(PARENTS):
        if parent >= 0:
            bone = joints_a[:, j] - joints_a[:, parent]
            turned = np.einsum("nba,nb->na", rotations[:, parent], bone)
            joints_t[:, j] = joints_t[:, parent] + turned
    shifts = joints_a - np.einsum("njab,njb->nja", rotations, joints_t)
    w = torch.from_numpy(weights).float()
    blended = torch.einsum("vj,njab->nvab", w, torch.from_numpy(rotations).float())
    shift = torch.einsum("vj,nja->nva", w, torch.from_numpy(shifts).float())
    moved = torch.from_numpy(vertices).float() - shift
    return torch.linalg.solve(blended, moved[..., None])[..., 0].numpy(), joints_t


def bone_rotations(points: np.ndarray) -> np.ndarray:
    """Compute (n, 22, 3, 3) rotations from the zero pose to the pose of `points` (n, 28, 3)."""
    count = len(points)
    rotations = np.tile(np.eye(3), (count, len(JOINTS), 1, 1))

    def at(name: str) -> np.ndarray:
        return points[:, number(name)]

    for name, degrees in LEAN_DEGREES.items():
        rotations[:, number(name)] = _about_x(degrees)
    for _, side, sign in SIDES:
        raise_back = _about_z(-sign * COLLAR_RAISE_DEGREES) @ _about_y(-sign * COLLAR_BACK_DEGREES)
        rotations[:, number(f"{side}_collar")] = rotations[:, number("spine3")] @ raise_back
        upper = at(f"{side}_elbow") - at(f"{side}_shoulder")
        fore = at(f"{side}_wrist") - at(f"{side}_elbow")
        hand = at(f"{side}_middle_knuckle") - at(f"{side}_wrist")
        across = at(f"{side}_index_knuckle") - at(f"{side}_pinky_knuckle")
        hinge = sign * np.cross(upper, fore)  # the elbow's axis, downwards in the zero pose
        down, forward, up = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0]])
        arm = _align(_direction(UPPER_ARM, sign), down, upper, hinge)
        wrist = _align(_direction(HAND, sign), forward, hand, across)
        elbow = _align(_direction(FOREARM, sign), down, fore, hinge)
        elbow = _share_twist(elbow, wrist, fore, FOREARM_TWIST_SHARE)
        thigh = at(f"{side}_knee") - at(f"{side}_hip")
        shank = at(f"{side}_ankle") - at(f"{side}_knee")
        sole = _unit((at(f"{side}_foot") - at(f"{side}_ankle")) * [1.0, 0.0, 1.0])
        facing = 0.5 * (sole + forward)
        out = np.deg2rad(THIGH_OUT_DEGREES)
        toes = np.deg2rad(FOOT_OUT_DEGREES)
        hip = _align([sign * np.sin(out), -np.cos(out), 0.0], forward, thigh, facing)
        knee = _align(np.array(SHANK) * [sign, 1.0, 1.0], forward, shank, facing)
        foot = _align([sign * np.sin(toes), 0.0, np.cos(toes)], up, sole, np.tile(up, (count, 1)))
        named = {"shoulder": arm, "elbow": elbow, "wrist": wrist, "hip": hip, "knee": knee}
        for name, rotation in {**named, "ankle": foot, "foot": foot}.items():
            rotations[:, number(f"{side}_{name}")] = rotation
    return rotations


def _share_twist(
    rotation: np.ndarray, end: np.ndarray, axis: np.ndarray, share: float
) -> np.ndarray:
    """Turn `rotation` about the bone by a share of its remaining twist towards `end`."""
    axis = _unit(axis)
    own, goal = (_unit(_reject(turn[..., 2], axis)) for turn in (rotation, end))
    angle = np.arctan2((np.cross(own, goal) * axis).sum(-1), (own * goal).sum(-1))
    cross = np.cross(axis[:, None, :], np.eye(3)).transpose(0, 2, 1)
    a = (share * angle)[:, None, None]
    return (np.eye(3) + np.sin(a) * cross + (1.0 - np.cos(a)) * cross @ cross) @ rotation


def _align(along_t, aside_t, along_a: np.ndarray, aside_a: np.ndarray) -> np.ndarray:
    """Return the rotation of direction `along_t` to `along_a`, and `aside_t` nearest `aside_a`."""
    source = _frame(np.asarray(along_t)[None], np.asarray(aside_t)[None])
    return _frame(along_a, aside_a) @ source.transpose(0, 2, 1)


def _frame(along: np.ndarray, aside: np.ndarray) -> np.ndarray:
    x = _unit(along)
    y = _unit(_reject(aside, x))
    return np.stack([x, y, np.cross(x, y)], -1)


def _reject(vector: np.ndarray, axis: np.ndarray) -> np.ndarray:
    return vector - (vector * axis).sum(-1, keepdims=True) * axis


def _unit(vector: np.ndarray) -> np.ndarray:
    return vector / np.linalg.norm(vector, axis=-1, keepdims=True)


def _direction(azimuth_elevation: tuple[float, float], sign: float) -> np.ndarray:
    azimuth, elevation = np.deg2rad(azimuth_elevation)
    level = np.cos(elevation)
    return np.array([sign * level * np.cos(azimuth), np.sin(elevation), level * np.sin(azimuth)])


def _about_x(degrees: float) -> np.ndarray:
    c, s = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


def _about_y(degrees: float) -> np.ndarray:
    c, s = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])


def _about_z(degrees: float) -> np.ndarray:
    c, s = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])

"""Computes the linear shape space and the sparse joint regressor."""

from dataclasses import dataclass

import numpy as np

from body.layout import FLIP, JOINTS, PARENTS, TRUNK, mirrored
from body.mesh import twins
from body.rig import convex_combination, symmetric_weights

PELVIS = np.array([0.0, -0.235, 0.028])
"""The root joint in the body's frame, as in SMPL: the origin lies a little above the pelvis."""


@dataclass(frozen=True)
class ShapeSpace:
    """Linear shape space: vertices = mean + directions @ shape, shape ~ N(0, 1) over adults."""

    mean: np.ndarray
    directions: np.ndarray
    coordinates: np.ndarray
    """(n, K) shape coefficients of the training bodies."""
    explained: np.ndarray
    """Cumulative share of the variance that the shapes explain."""


def symmetrise(
    vertices: np.ndarray, joints: np.ndarray, twin: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Average each body with its mirror image, pelvis at `PELVIS`; overwrite `vertices`."""
    shift = PELVIS - joints[:, :1]
    joints = joints + shift
    for number in range(len(vertices)):
        body = vertices[number] + shift[number]
        vertices[number] = 0.5 * (body + body[twin] * FLIP)
    return vertices, 0.5 * (joints + joints[:, mirrored(JOINTS)] * FLIP)


def principal_shapes(vertices: np.ndarray, faces: np.ndarray, count: int) -> ShapeSpace:
    """Compute area-weighted principal components (vertices are denser in the face)."""
    mean = vertices.mean(0, dtype=np.float64)
    area = vertex_areas(mean, faces)
    offset = vertices - mean.astype(np.float32)
    weighted = (offset * np.sqrt(area / area.sum())[:, None]).astype(np.float32)
    flat = weighted.reshape(len(offset), -1)
    values, vectors = np.linalg.eigh((flat @ flat.T).astype(np.float64))
    values, vectors = values[::-1].clip(0.0), vectors[:, ::-1]
    coordinates = vectors[:, :count] * np.sqrt(len(offset))
    height = np.ptp(vertices[:, :, 1], axis=1)
    sign = np.where(coordinates.T @ (height - height.mean()) < 0.0, -1.0, 1.0)
    coordinates = coordinates * sign  # taller is positive: eigenvectors have no sign of their own
    scores = (coordinates.T / len(offset)).astype(np.float32)
    directions = (scores @ offset.reshape(len(offset), -1)).reshape(count, -1, 3)
    explained = np.cumsum(values)[:count] / values.sum()
    return ShapeSpace(mean, directions.transpose(1, 2, 0).astype(float), coordinates, explained)


def vertex_areas(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Return a third of the area of the faces at each vertex, m^2."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    third = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 6.0
    areas = np.zeros(len(vertices))
    for k in range(3):
        np.add.at(areas, faces[:, k], third)
    return areas


def joint_regressor(
    bodies: np.ndarray, joints: np.ndarray, template: np.ndarray, weights: np.ndarray
) -> np.ndarray:
    """Fit (22, V) convex, sparse and mirror-symmetric weights of skin that give joints.

    By non-negative least squares over `bodies` (n, V, 3) with `joints` (n, 22, 3), relative to the
    centre of the candidates, so that it does not depend on where a body stands.
    """

    def pool(j: int) -> np.ndarray:
        return _regressor_pool(JOINTS[j], template, joints[:, j].mean(0), weights)

    def amounts(j: int, candidates: np.ndarray) -> np.ndarray:
        ring = bodies[:, candidates]
        centre = ring.mean(1, keepdims=True)
        columns = (ring - centre).transpose(0, 2, 1).reshape(-1, len(candidates))
        target = (joints[:, j] - centre[:, 0]).reshape(-1)
        amount = convex_combination(columns, target, ridge=3e-4 * np.sqrt(len(columns)))
        return np.where(amount < 1e-4, 0.0, amount)

    return symmetric_weights(JOINTS, twins(template), 160, pool, amounts)


def _regressor_pool(
    name: str, template: np.ndarray, joint: np.ndarray, weights: np.ndarray
) -> np.ndarray:
    """Choose the vertices from which a joint may be regressed."""
    distance = np.linalg.norm(template - joint, axis=1)
    if name in TRUNK:
        carriers = [*TRUNK, "left_hip", "right_hip", "left_collar", "right_collar"]
        trunk = weights[:, [JOINTS.index(carrier) for carrier in carriers]].sum(1) > 0.9
        return np.flatnonzero(trunk & (np.abs(template[:, 1] - joint[1]) < 0.05))
    if name == "left_collar":
        carriers = ["spine3", "left_collar", "neck", "left_shoulder"]
        near = weights[:, [JOINTS.index(carrier) for carrier in carriers]].sum(1) > 0.6
        return np.flatnonzero(near & (distance < 0.12))
    j = JOINTS.index(name)
    family = [j, PARENTS[j], *(k for k, parent in enumerate(PARENTS) if parent == j)]
    distance[weights[:, family].sum(1) <= 0.5] = np.inf
    nearest = distance.min()
    return np.flatnonzero(distance < max(2.3 * nearest, nearest + 0.05))

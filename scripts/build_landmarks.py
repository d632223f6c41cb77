"""Finds the named surface points of the bundled body and writes `recon/assets/landmarks.json`.

    python scripts/build_landmarks.py

Left points are found on the mean body in its rest pose (y up, z forward, x to the body's left,
palms down) and mirrored. A point is the vertex nearest to where a ray from inside the body leaves
it: "lateral side of the knee" is the ray from the knee joint outwards. Run it after
`build_body.py`; the result holds for that mesh only.
"""

import argparse
import json
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

ASSETS = Path(__file__).parents[1] / "recon" / "assets"
FLIP = np.array([-1.0, 1.0, 1.0])
OUT, IN = np.array([1.0, 0.0, 0.0]), np.array([-1.0, 0.0, 0.0])  # lateral, medial (left side)
UP, DOWN = np.array([0.0, 1.0, 0.0]), np.array([0.0, -1.0, 0.0])
FRONT, BACK = np.array([0.0, 0.0, 1.0]), np.array([0.0, 0.0, -1.0])


def offset(x: float, y: float, z: float) -> np.ndarray:
    """Return an offset in metres: to the body's left, up, to the front."""
    return np.array([x, y, z])


@dataclass(frozen=True)
class Mesh:
    """The mean body at rest: surface, joints, skinning weights and mirrored vertices."""

    vertices: np.ndarray
    faces: np.ndarray
    joints: dict[str, np.ndarray]
    weights: dict[str, np.ndarray]
    twin: np.ndarray

    def exit(self, origin: np.ndarray, direction: np.ndarray) -> np.ndarray:
        """Return where a ray that starts inside the body first leaves it (Moeller-Trumbore)."""
        direction = direction / np.linalg.norm(direction)
        corner, b, c = (self.vertices[self.faces[:, k]] for k in range(3))
        edge1, edge2 = b - corner, c - corner
        across = np.cross(direction, edge2)
        determinant = (edge1 * across).sum(1)
        safe = np.where(np.abs(determinant) < 1e-12, 1.0, determinant)
        to_origin = origin - corner
        u = (to_origin * across).sum(1) / safe
        turned = np.cross(to_origin, edge1)
        v = turned @ direction / safe
        distance = (edge2 * turned).sum(1) / safe
        leaving = (determinant < -1e-12) & (distance > 0.0)
        hit = leaving & (u >= 0.0) & (v >= 0.0) & (u + v <= 1.0)
        if not hit.any():
            raise ValueError(f"the ray from {origin} along {direction} meets no surface")
        return origin + distance[hit].min() * direction

    def nearest(self, point: np.ndarray, median: bool = False) -> int:
        """Return the vertex nearest to a point, on request only of those in the median plane."""
        distance = np.linalg.norm(self.vertices - point, axis=1)
        if median:
            distance[self.twin != np.arange(len(distance))] = np.inf
        return int(distance.argmin())

    def furthest(self, direction: np.ndarray, among: np.ndarray) -> int:
        """Return the vertex in a mask that is furthest along a direction."""
        reach = np.where(among, self.vertices @ direction, -np.inf)
        return int(reach.argmax())


def load(path: Path) -> Mesh:
    with np.load(path, allow_pickle=False) as data:
        names = [str(name) for name in data["joint_names"]]
        vertices = data["template"].astype(float)
        weights = np.zeros((len(vertices), len(names)))
        np.put_along_axis(weights, data["weight_index"].astype(int), data["weight_value"], 1)
        joints = dict(zip(names, data["joint_template"].astype(float), strict=True))
        faces = data["faces"].astype(int)
    gap = np.linalg.norm(vertices[:, None] * FLIP - vertices[None], axis=2)
    columns = dict(zip(names, weights.T, strict=True))
    return Mesh(vertices, faces, joints, columns, gap.argmin(1))


def trunk_and_head(mesh: Mesh) -> tuple[dict[str, int], dict[str, int]]:
    """Find points of the median plane, and left points of head and trunk."""
    joints = mesh.joints
    head = mesh.weights["head"] > 0.5
    nose = mesh.furthest(FRONT, head & (mesh.twin == np.arange(len(mesh.twin))))
    crown = mesh.furthest(UP, head)
    nose_point, crown_point = mesh.vertices[nose], mesh.vertices[crown]
    middle = np.array([0.0, nose_point[1], joints["head"][2] + 0.01])  # inside the skull
    eyes = nose_point[1] + 0.036  # metres above the tip of the nose
    temples = 0.5 * (nose_point[1] + crown_point[1]) + 0.01
    skull = middle * [1.0, 0.0, 1.0] + offset(0.0, temples, 0.0)

    def trunk(joint: str, other: str, fraction: float) -> np.ndarray:
        return joints[joint] + fraction * (joints[other] - joints[joint])

    def median(origin: np.ndarray, direction: np.ndarray) -> int:
        return mesh.nearest(mesh.exit(origin + offset(1e-4, 0.0, 0.0), direction), median=True)

    def left(origin: np.ndarray, direction: np.ndarray) -> int:
        return mesh.nearest(mesh.exit(origin, direction))

    c7 = trunk("spine3", "neck", 0.95)
    hip = joints["left_hip"]

    def above_hips(height: float, sideways: float = 0.0) -> np.ndarray:
        """Return a point above the hip joints: the frontal iliac spines lie 8 cm above them."""
        return np.array([sideways, hip[1] + height, joints["pelvis"][2]])

    shoulder, collar = joints["left_shoulder"], joints["left_collar"]
    blade = np.array([0.45 * shoulder[0], 0.0, 0.0])  # sideways distance of the shoulder blade
    singles = {
        "nose": nose,
        "head_top": crown,
        "forehead": median(skull, FRONT),
        "back_head": median(skull, BACK),
        "chin": median(middle + offset(0.0, -0.075, 0.0), FRONT),
        "c7": median(c7, BACK),
        "t2": median(trunk("spine3", "neck", 0.62), BACK),
        "t7": median(trunk("spine2", "spine3", 0.9), BACK),
        "t10": median(trunk("spine1", "spine2", 0.75), BACK),
        "l3": median(trunk("pelvis", "spine1", 1.0), BACK),
        "sternal_notch": median(trunk("spine3", "neck", 0.58), FRONT),
        "sternum": median(trunk("spine3", "neck", 0.15), FRONT),
        "xiphoid": median(trunk("spine2", "spine3", 0.35), FRONT),
        "navel": median(above_hips(0.115), FRONT),
        "sacrum": median(above_hips(0.105), BACK),
    }
    sided = {
        "eye": left(np.array([0.028, eyes, middle[2]]), FRONT),
        "ear": left(middle + offset(0.0, 0.025, -0.005), OUT),
        "temple": left(skull + offset(0.0, -0.02, 0.045), OUT),
        "front_head": left(skull, FRONT + 0.55 * OUT),
        "back_head": left(skull, BACK + 0.55 * OUT),
        "clavicle": left(collar * [0.4, 1.0, 1.0], FRONT + 0.35 * UP),
        "chest": left(joints["spine3"] + offset(0.09, 0.0, 0.0), FRONT),
        "upper_chest": left(trunk("spine3", "neck", 0.46) + offset(0.059, 0.0, 0.0), FRONT),
        "acromion": left(shoulder + offset(-0.01, 0.0, 0.0), UP),
        "shoulder_front": left(shoulder, FRONT),
        "shoulder_back": left(shoulder, BACK),
        "scapula_angle": left(trunk("spine2", "spine3", 0.9) + blade, BACK),
        "scapula": left(trunk("spine3", "neck", 0.2) + blade, BACK),
        "scapula_root": left(trunk("spine3", "neck", 0.42) + 0.85 * blade, BACK),
        "acromion_back": left(shoulder + offset(-0.02, 0.0, 0.0), UP + 0.8 * BACK),
        "asis": left(above_hips(0.085, 0.12), FRONT),
        "psis": left(above_hips(0.11, 0.045), BACK),
        "iliac_crest": left(above_hips(0.15), OUT),
        "trochanter": left(hip + offset(0.0, 0.005, 0.0), OUT),
        "pelvis_side": left(above_hips(0.09), OUT),
        "rib": left(trunk("spine1", "spine2", 0.4) + blade, FRONT + 0.9 * OUT),
    }
    return singles, sided


def arm(mesh: Mesh) -> dict[str, int]:
    """Find points of the left arm; at rest the elbow's outer side is up, the thumb in front."""
    shoulder, elbow, wrist = (mesh.joints[f"left_{n}"] for n in ("shoulder", "elbow", "wrist"))
    hand = mesh.weights["left_wrist"] > 0.5
    tip = mesh.vertices[mesh.furthest(OUT, hand)]
    palm = wrist + 0.47 * (tip - wrist)

    def at(origin: np.ndarray, direction: np.ndarray) -> int:
        return mesh.nearest(mesh.exit(origin, direction))

    def along(start: np.ndarray, stop: np.ndarray, fraction: float) -> np.ndarray:
        return start + fraction * (stop - start)

    middle_upper, middle_fore = along(shoulder, elbow, 0.55), along(elbow, wrist, 0.5)
    bones = wrist + offset(0.002, 0.0, 0.0)
    return {
        "deltoid": at(along(shoulder, elbow, 0.3), UP),
        "lower_upper_arm": at(along(shoulder, elbow, 0.78), UP),
        "upper_arm": at(middle_upper, UP),
        "upper_arm_front": at(middle_upper, FRONT),
        "upper_arm_back": at(middle_upper, BACK),
        "upper_arm_medial": at(along(shoulder, elbow, 0.42), DOWN),
        "elbow_lateral": at(elbow, UP),
        "elbow_medial": at(elbow, DOWN),
        "olecranon": at(elbow, BACK),
        "forearm": at(middle_fore, UP),
        "forearm_front": at(middle_fore, FRONT),
        "forearm_back": at(middle_fore, BACK),
        "wrist_radial": at(bones, FRONT),
        "wrist_ulnar": at(bones, BACK),
        "wrist_dorsal": at(bones, UP),
        "hand": at(palm, UP),
        "index_knuckle": at(palm + offset(0.0, 0.0, 0.022), UP),
        "pinky_knuckle": at(palm + offset(-0.012, 0.0, -0.03), UP),
        "fingertip": mesh.nearest(tip),
        "thumb": mesh.furthest(FRONT, hand),
    }


def leg(mesh: Mesh) -> dict[str, int]:
    """Find points of the left leg; the foot has its own axes, as it points a bit outwards."""
    hip, knee, ankle, toes = (mesh.joints[f"left_{n}"] for n in ("hip", "knee", "ankle", "foot"))
    foot = (mesh.weights["left_ankle"] + mesh.weights["left_foot"]) > 0.5
    ahead = (toes - ankle) * [1.0, 0.0, 1.0]
    ahead /= np.linalg.norm(ahead)
    outer = np.cross(UP, ahead)
    sole = mesh.vertices[foot, 1].min()
    height = mesh.vertices[:, 1] - sole
    heel = mesh.furthest(-ahead, foot & (height < 0.04))
    toe_tip = mesh.vertices[mesh.furthest(ahead, foot)]
    length = (toe_tip - mesh.vertices[heel]) @ ahead
    ball = mesh.vertices[heel] + 0.72 * length * ahead
    sideways = (mesh.vertices - ball) @ outer
    width = sideways[foot & (np.abs((mesh.vertices - ball) @ ahead) < 0.015)]
    mid = 0.5 * (width.min() + width.max())
    ball = (ball + mid * outer) * [1.0, 0.0, 1.0] + offset(0.0, sole + 0.018, 0.0)
    halfway = 0.5 * (width.max() - width.min())
    sideways = sideways - mid

    def at(origin: np.ndarray, direction: np.ndarray) -> int:
        return mesh.nearest(mesh.exit(origin, direction))

    def around(name: str, origin: np.ndarray) -> dict[str, int]:
        directions = {"lateral": OUT, "medial": IN, "front": FRONT, "back": BACK}
        directions["front_lateral"] = FRONT + OUT
        return {f"{name}_{side}": at(origin, way) for side, way in directions.items()}

    def along(start: np.ndarray, stop: np.ndarray, fraction: float) -> np.ndarray:
        return start + fraction * (stop - start)

    def inside_foot(fraction: float) -> np.ndarray:
        """Return the point of the foot's middle line at a fraction of the way heel to ball."""
        return along(mesh.vertices[heel], ball, fraction) * [1, 0, 1] + offset(
            0.0, sole + 0.02, 0.0
        )

    return {
        **around("upper_thigh", along(hip, knee, 0.33)),
        **around("thigh", along(hip, knee, 0.55)),
        **around("lower_thigh", along(hip, knee, 0.78)),
        "knee_lateral": at(knee, OUT),
        "knee_medial": at(knee, IN),
        "patella": at(knee, FRONT),
        "tibial_tuberosity": at(along(knee, ankle, 0.12), FRONT),
        "fibula_head": at(along(knee, ankle, 0.09), OUT + 0.3 * BACK),
        **around("upper_shank", along(knee, ankle, 0.27)),
        **around("shank", along(knee, ankle, 0.5)),
        **around("lower_shank", along(knee, ankle, 0.75)),
        "ankle_lateral": at(ankle, outer),
        "ankle_medial": at(ankle, -outer),
        "heel": heel,
        "heel_lateral": at(inside_foot(0.12), outer),
        "heel_below": at(inside_foot(0.12), DOWN),
        "instep": at(inside_foot(0.83) - 0.008 * outer, UP),
        "midfoot_lateral": at(inside_foot(0.75), outer),
        "midfoot_medial": at(inside_foot(0.75), -outer),
        "toe2_base": at(ball + 0.2 * halfway * -outer, UP),
        "toe1_base": at(ball, -outer),
        "toe5_base": at(ball - 0.04 * length * ahead, outer),
        "toe_tip": mesh.nearest(toe_tip),
        "big_toe": mesh.furthest(ahead, foot & (sideways < -0.25 * halfway)),
        "small_toe": mesh.furthest(ahead, foot & (sideways > 0.68 * halfway)),
    }


def landmarks(mesh: Mesh) -> dict[str, int]:
    """Find all points, right ones by mirroring."""
    singles, sided = trunk_and_head(mesh)
    parts: tuple[Callable[[Mesh], dict[str, int]], ...] = (arm, leg)
    for part in parts:
        sided = {**sided, **part(mesh)}
    left = {f"left_{name}": vertex for name, vertex in sided.items()}
    right = {f"right_{name}": int(mesh.twin[vertex]) for name, vertex in sided.items()}
    return {**singles, **left, **right}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--body", type=Path, default=ASSETS / "body.npz")
    parser.add_argument("--out", type=Path, default=ASSETS / "landmarks.json")
    options = parser.parse_args()
    beside = options.out.with_name(options.out.name + ".partial")
    beside.write_text(json.dumps(landmarks(load(options.body)), indent=1) + "\n")
    os.replace(beside, options.out)


if __name__ == "__main__":
    main()

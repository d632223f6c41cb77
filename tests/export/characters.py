"""Made characters of other proportions, units, rest poses and names, and what a viewer shows."""

import json
import struct
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from recon.core.fingers import HAND_JOINTS, HAND_PARENTS
from recon.core.skeleton import JOINTS, PARENTS

CHILD = {"leg": 0.5, "trunk": 0.8, "arm": 0.6, "foot": 0.8, "wide": 1.2, "head": 1.6}
GIANT = {"leg": 1.5, "trunk": 1.15, "arm": 1.35, "foot": 1.6, "wide": 1.1, "head": 0.8}


@dataclass(frozen=True)
class Look:
    """How a character is made."""

    names: Mapping[str, str] = field(default_factory=dict)
    sizes: Mapping[str, float] = field(default_factory=dict)
    unit: float = 1.0
    """Lengths of its file in a metre; the root scales them back."""
    drop: float = 0.0
    """Degrees that arms hang below the T pose."""
    spread: float = 0.0
    """Degrees that legs stand apart."""
    backwards: bool = False
    """Whether it looks to -z, as in VRM 0.x."""
    rolled: bool = True
    """Whether the axes of its bones are turned anyhow."""
    fingers: bool = False
    posed: float = 0.0
    """Radians by which its nodes are turned from the pose its skin was bound in."""


def _lengths(look: Look) -> np.ndarray:
    """Vector to every joint from its parent in the T pose, metres; x to the left, z ahead."""
    s = {"leg": 1.0, "trunk": 1.0, "arm": 1.0, "foot": 1.0, "wide": 1.0, "head": 1.0}
    s |= dict(look.sizes)
    ways = {
        "pelvis": (0, 0, 0), "spine1": (0, 0.12 * s["trunk"], 0),
        "spine2": (0, 0.13 * s["trunk"], 0), "spine3": (0, 0.06 * s["trunk"], 0),
        "neck": (0, 0.21 * s["trunk"], 0), "head": (0, 0.08 * s["head"], 0.01),
        "hip": (0.09 * s["wide"], -0.08, 0), "knee": (0, -0.4 * s["leg"], 0),
        "ankle": (0, -0.4 * s["leg"], 0), "foot": (0.02, -0.06 * s["foot"], 0.13 * s["foot"]),
        "collar": (0.07 * s["wide"], 0.13 * s["trunk"], 0), "shoulder": (0.11 * s["wide"], 0, 0),
        "elbow": (0.27 * s["arm"], 0, 0), "wrist": (0.25 * s["arm"], 0, 0),
    }  # fmt: skip
    across = {"thumb": 0.03, "index": 0.025, "middle": 0.005, "ring": -0.015, "pinky": -0.03}
    found = []
    for name in (*JOINTS, *HAND_JOINTS):
        side, _, part = name.partition("_")
        if name in HAND_JOINTS:
            first = part[-1] == "1"
            z = across[part[:-1]] if first else 0.01 if part[:-1] == "thumb" else 0
            way = np.array([0.09 if first else 0.03, 0, z]) * s["arm"]
        else:
            way = np.array(ways[part or side], float)
        found.append(way * ([-1, 1, 1] if side == "right" else [1, 1, 1]))
    return np.array(found, float)


def make_character(path: Path, look: Look) -> Path:
    """Write a character of boxes as GLB."""
    count = len(JOINTS) + (len(HAND_JOINTS) if look.fingers else 0)
    joints = (*JOINTS, *HAND_JOINTS)[:count]
    parents = (*PARENTS, *HAND_PARENTS)[:count]
    ways, random = _lengths(look)[:count], np.random.default_rng(3)
    turns = [np.eye(3)] * count
    for k, name in enumerate(joints):
        side = -1 if name.startswith("right") else 1
        own = np.eye(3)
        if name.endswith("_shoulder"):
            own = Rotation.from_euler("z", -side * look.drop, degrees=True).as_matrix()
        if name.endswith("_hip"):
            own = Rotation.from_euler("z", side * look.spread, degrees=True).as_matrix()
        if name.endswith("_ankle"):
            own = Rotation.from_euler("z", -side * look.spread, degrees=True).as_matrix()
        turns[k] = own if parents[k] < 0 else turns[parents[k]] @ own
    places = np.zeros((count, 3))
    for k, parent in enumerate(parents):
        if parent >= 0:
            places[k] = places[parent] + turns[parent] @ ways[k]
    boxes = [_box(k, joints, parents, places, turns, look) for k in range(count)]
    places[:, 1] -= (low := min(box[:, 1].min() for box in boxes))
    boxes = [box - [0, low, 0] for box in boxes]
    flip = np.diag([-1.0, 1, -1]) if look.backwards else np.eye(3)
    places, boxes = places @ flip * look.unit, [box @ flip * look.unit for box in boxes]
    axes = [
        Rotation.random(random_state=random).as_matrix() if look.rolled else np.eye(3)
        for _ in range(count)
    ]
    binds = np.tile(np.eye(4), (count, 1, 1))
    for k in range(count):
        binds[k, :3, :3], binds[k, :3, 3] = axes[k].T, -axes[k].T @ places[k]
    nodes = []
    for k, parent in enumerate(parents):
        turn = axes[k] if parent < 0 else axes[parent].T @ axes[k]
        way = places[k] if parent < 0 else axes[parent].T @ (places[k] - places[parent])
        bent = Rotation.from_rotvec(random.normal(size=3) * look.posed)
        node = {
            "name": look.names.get(joints[k], joints[k]), "translation": way.tolist(),
            "rotation": (Rotation.from_matrix(turn) * bent).as_quat().tolist(),
            "extras": {"kept": 1.0},
        }  # fmt: skip
        if children := [c for c, p in enumerate(parents) if p == k]:
            node["children"] = children
        nodes.append(node)
    nodes.append({"name": "body", "mesh": 0, "skin": 0})
    scale = 1 / look.unit
    nodes.append({"name": "Armature", "children": [0], "scale": [scale, scale, scale]})
    vertices = np.concatenate(boxes).astype("<f4")
    own = np.repeat(np.arange(count), [len(box) for box in boxes])
    slots = np.zeros((len(own), 4), "<u2")
    slots[:, 0] = own
    weights = np.tile(np.array([1, 0, 0, 0], "<f4"), (len(own), 1))
    arrays = [vertices, slots, weights, binds.transpose(0, 2, 1).reshape(-1, 16).astype("<f4")]
    types = [("VEC3", 5126), ("VEC4", 5123), ("VEC4", 5126), ("MAT4", 5126)]
    views, accessors, data = [], [], b""
    for k, (array, (kind, component)) in enumerate(zip(arrays, types, strict=True)):
        views.append({"buffer": 0, "byteOffset": len(data), "byteLength": array.nbytes})
        told = {"bufferView": k, "componentType": component, "count": len(array), "type": kind}
        if k == 0:
            told |= {"min": vertices.min(0).tolist(), "max": vertices.max(0).tolist()}
        accessors.append(told)
        data += array.tobytes()
    document = {
        "asset": {"version": "2.0", "generator": "somebody", "copyright": "©"},
        "scene": 0, "scenes": [{"nodes": [count, count + 1]}], "nodes": nodes,
        "meshes": [{"primitives": [
            {"attributes": {"POSITION": 0, "JOINTS_0": 1, "WEIGHTS_0": 2}, "mode": 0}
        ]}],
        "skins": [{"joints": list(range(count)), "inverseBindMatrices": 3}],
        "accessors": accessors, "bufferViews": views, "buffers": [{"byteLength": len(data)}],
        "extras": {"number": 0.1, "text": "ä"},
    }  # fmt: skip
    write_glb_of(path, document, data)
    return path


def _box(k, joints, parents, places, turns, look):
    """Corners of a box about a bone; feet have a flat sole from heel to ball or toes."""
    name = joints[k]
    part = name.partition("_")[2]
    child = next((c for c, p in enumerate(parents) if p == k and c < len(JOINTS)), None)
    thick = 0.05
    if part == "ankle":
        foot = places[child] - places[k]
        heights = np.array([foot[1] - 0.03, 0.02])
        depth = np.array([-0.05, foot[2]])
        corners = np.stack(np.meshgrid([-0.04, 0.04], heights, depth), -1).reshape(-1, 3)
        return places[k] + corners
    if part == "foot":
        reach = 0.08 * dict(look.sizes).get("foot", 1.0)
        corners = np.stack(np.meshgrid([-0.04, 0.04], [-0.03, 0.02], [0, reach]), -1)
        return places[k] + corners.reshape(-1, 3)
    end = places[child] if child is not None else places[k] + turns[k] @ [0, 0.02, 0]
    if name == "head":
        end, thick = places[k] + [0, 0.2 * dict(look.sizes).get("head", 1.0), 0], 0.08
    if name in HAND_JOINTS or part == "wrist":
        thick = 0.01
    corners = np.stack(np.meshgrid(*[[-thick, thick]] * 3), -1).reshape(-1, 3)
    return np.concatenate((places[k] + corners, end + corners))


def write_glb_of(path: Path, document: dict, data: bytes | None) -> None:
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    parts = struct.pack("<II", len(text), 0x4E4F534A) + text
    if data is not None:
        data = data + bytes(-len(data) % 4)
        parts += struct.pack("<II", len(data), 0x004E4942) + data
    path.write_bytes(b"glTF" + struct.pack("<II", 2, 12 + len(parts)) + parts)


def read_glb_of(path: Path) -> tuple[dict, bytes]:
    data = path.read_bytes()
    size = struct.unpack_from("<I", data, 12)[0]
    return json.loads(data[20 : 20 + size]), data[28 + size :]


def array_of(document: dict, data: bytes, accessor: int) -> np.ndarray:
    told = document["accessors"][accessor]
    view = document["bufferViews"][told["bufferView"]]
    width = {"SCALAR": 1, "VEC3": 3, "VEC4": 4, "MAT4": 16}[told["type"]]
    dtype = {5121: "<u1", 5123: "<u2", 5125: "<u4", 5126: "<f4"}[told["componentType"]]
    begin = view.get("byteOffset", 0) + told.get("byteOffset", 0)
    flat = np.frombuffer(data, dtype, told["count"] * width, begin)
    return flat.reshape(-1, width)


@dataclass(frozen=True)
class Played:
    """A file as a viewer shows it at the times of its last animation."""

    names: list[str]
    world: np.ndarray
    """(time, nodes, 4, 4)."""
    local: np.ndarray
    rest: np.ndarray
    """Of nodes to their parents, as the file has them."""
    vertices: np.ndarray
    """(time, vertices, 3)."""
    owners: np.ndarray
    """Node of every vertex."""
    binds: np.ndarray
    """(nodes, 4, 4): in which the skin was bound."""
    fps: float

    def place(self, name: str) -> np.ndarray:
        return self.world[:, self.names.index(name), :3, 3]


def play(path: Path) -> Played:
    """Pose a file by its last animation and its skins, independently of the library."""
    document, data = read_glb_of(path)
    nodes, animation = document["nodes"], document["animations"][-1]
    times = array_of(document, data, animation["samplers"][0]["input"])[:, 0]
    rest = np.stack([_local(node) for node in nodes])
    local = np.tile(rest, (len(times), 1, 1, 1))
    for channel in animation["channels"]:
        sampler = animation["samplers"][channel["sampler"]]
        values = array_of(document, data, sampler["output"]).astype(float)
        node = channel["target"]["node"]
        assert "matrix" not in nodes[node]
        if channel["target"]["path"] == "translation":
            local[:, node, :3, 3] = values
        else:
            size = np.array(nodes[node].get("scale", (1, 1, 1)))
            local[:, node, :3, :3] = Rotation.from_quat(values).as_matrix() * size
    parents = [-1] * len(nodes)
    for k, node in enumerate(nodes):
        for child in node.get("children", ()):
            parents[child] = k
    world: dict[int, np.ndarray] = {}

    def chained(k: int) -> np.ndarray:
        if k not in world:
            world[k] = local[:, k] if parents[k] < 0 else chained(parents[k]) @ local[:, k]
        return world[k]

    every = np.stack([chained(k) for k in range(len(nodes))], 1)
    vertices, owners, bound = [], [], rest.copy()
    for node in nodes:
        if "skin" not in node:
            continue
        skin = document["skins"][node["skin"]]
        binds = array_of(document, data, skin["inverseBindMatrices"]).reshape(-1, 4, 4)
        bound[skin["joints"]] = np.linalg.inv(binds.transpose(0, 2, 1))
        move = every[:, skin["joints"]] @ binds.transpose(0, 2, 1)
        for one in document["meshes"][node["mesh"]]["primitives"]:
            named = one["attributes"]
            points, slots, weights = (
                array_of(document, data, named[key])
                for key in ("POSITION", "JOINTS_0", "WEIGHTS_0")
            )
            points = np.concatenate((points, np.ones((len(points), 1))), 1)
            weights = weights / weights.sum(1, keepdims=True)
            made = sum(
                weights[None, :, k, None]
                * (move[:, slots[:, k]] @ points[None, :, :, None])[..., 0]
                for k in range(4)
            )
            vertices.append(made[..., :3])
            owners.append(
                np.array(skin["joints"])[slots[np.arange(len(slots)), weights.argmax(1)]]
            )
    fps = float(1 / np.diff(times).mean())
    return Played(
        [node.get("name", "") for node in nodes], every, local, rest,
        np.concatenate(vertices, 1), np.concatenate(owners), bound, fps,
    )  # fmt: skip


def _local(node: dict) -> np.ndarray:
    if "matrix" in node:
        return np.array(node["matrix"]).reshape(4, 4).T
    made = np.eye(4)
    turn = Rotation.from_quat(node.get("rotation", (0, 0, 0, 1))).as_matrix()
    made[:3, :3] = turn * np.array(node.get("scale", (1, 1, 1)))
    made[:3, 3] = node.get("translation", (0, 0, 0))
    return made


def slip(points: np.ndarray, fps: float, near: float = 0.03) -> tuple[np.ndarray, np.ndarray]:
    """Speed over the ground of the lowest of some points (time, points, 3), and where it is near.

    Height is the second axis.
    """
    lowest = points[:-1, :, 1].argmin(1)
    rows = np.arange(len(lowest))
    here, later = points[rows, lowest], points[rows + 1, lowest]
    speed = np.linalg.norm((later - here)[:, [0, 2]], axis=1) * fps
    return speed, (here[:, 1] < near) & (later[:, 1] < near)


def twists(played: Played, bones: list[tuple[str, str, str]]) -> dict[str, float]:
    """Largest turn of every bone about itself since its skin was bound, degrees."""
    found = {}
    for above, name, end in bones:
        over, k, child = (played.names.index(one) for one in (above, name, end))
        way = np.linalg.inv(played.binds[k]) @ played.binds[child, :, 3]
        axis = way[:3] / np.linalg.norm(way[:3])
        bound = np.linalg.inv(played.binds[over]) @ played.binds[k]
        since = np.linalg.inv(bound[:3, :3]) @ played.local[:, k, :3, :3]
        q = Rotation.from_matrix(since / np.cbrt(np.linalg.det(since))[:, None, None]).as_quat()
        angle = 2 * np.arctan2(q[:, :3] @ axis, q[:, 3])
        angle = (angle + np.pi) % (2 * np.pi) - np.pi
        found[name] = float(np.degrees(np.abs(angle)).max())
    return found

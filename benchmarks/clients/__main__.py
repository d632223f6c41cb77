"""Compares our exported files, as Blender, three.js, OpenSim and OpenUSD read them, with ours.

    python -m benchmarks.clients --python CLIENTS/bin/python --blender BLENDER/bin/python
        --node CLIENTS/node_modules --out benchmarks/results

`make clients` installs these programs and runs this. Every client runs in a process of its own,
without recon, and returns where it puts the joints, the skin or the segments of the bundled clip,
with made fingers; the errors against our own body are written with the versions of the clients,
and again for the names of every other program. The exit code is 1 if an error is above its limit.
"""

import argparse
import json
import re
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any, get_args

import numpy as np
import torch

from benchmarks.protocol import ROOT, Table, parser, tell
from recon.body.hands import pose_fingers, skin_weights_with_fingers
from recon.body.landmarks import landmark
from recon.body.model import BodyModel
from recon.body.opensim import opensim_axes
from recon.body.segments import posed_axes
from recon.core import rotations as so3
from recon.core.bone_names import BoneNames, joint_names_in
from recon.core.fingers import HAND_JOINTS, HAND_PARENTS, Hands
from recon.core.motion import Motion
from recon.core.skeleton import JOINTS, PARENTS, joint_index
from recon.core.units import to_z_up
from recon.export.motion import export_file
from recon.export.tables import body_places_of_markers, recorded_markers
from recon.formats.motions import load_motion, save_motion

_PARENTS = {
    "femur": ("pelvis", "hip"), "tibia": ("femur", "knee"), "foot": ("tibia", "ankle"),
    "toes": ("foot", "foot"), "humerus": ("thorax", "shoulder"), "forearm": ("humerus", "elbow"),
    "hand": ("forearm", "wrist"),
}  # fmt: skip
"""Parent of every segment, and the joint at which the segment begins."""
_MARKED = {"pelvis": "pelvis", "femur": "femur", "tibia": "tibia", "foot": "calcn"}
"""Segments whose markers inverse kinematics follows, and their names in OpenSim's model."""


def turned_segments(motion: Motion, body: BodyModel) -> dict[str, np.ndarray]:
    """Return the axes of every segment in every frame, in OpenSim's ground frame (y up)."""
    axes = posed_axes(opensim_axes(body, motion.shape), body, motion)
    return {name: to_z_up("y").T @ turn for name, turn in axes.items()}


def segment_sizes(motion: Motion, body: BodyModel) -> dict[str, list[float]]:
    """Return the places (m) where segments begin, in their parents' axes."""
    axes = opensim_axes(body, motion.shape)
    rest = body.rest_joints(motion.shape).numpy()

    def begin(segment: str) -> np.ndarray:
        if segment == "pelvis":
            return spines(motion, body)
        if segment == "thorax":
            return rest[joint_index("spine1")]
        name, end = segment.split("_")
        return rest[joint_index(f"{'right' if end == 'r' else 'left'}_{_PARENTS[name][1]}")]

    found = {"torso": (axes["pelvis"].T @ (begin("thorax") - begin("pelvis"))).tolist()}
    for end in "rl":
        for name, (above, _) in _PARENTS.items():
            parent = above if above in ("pelvis", "thorax") else f"{above}_{end}"
            step = begin(f"{name}_{end}") - begin(parent)
            found[f"{name}_{end}"] = (axes[parent].T @ step).tolist()
    return found


def marker_sizes(motion: Motion, body: BodyModel) -> dict[str, tuple[str, list[float]]]:
    """Return BSM's markers on pelvis and legs: the model's body, and the place in its axes (m)."""
    axes = opensim_axes(body, motion.shape)
    rest = body.rest_joints(motion.shape).numpy()
    segments = {joint_index("pelvis"): "pelvis"} | {
        joint_index(f"{side}_{joint}"): f"{name}_{side[0]}"
        for side in ("right", "left")
        for name, joint in (("femur", "hip"), ("tibia", "knee"), ("foot", "ankle"))
    }
    found = {}
    for label, place in body_places_of_markers("bsm").items():
        vertex = torch.tensor([landmark(place.landmarks[0])])
        shares = body.weights[vertex[0]]
        bone = int(shares.argmax())
        # leave out markers on skin that moves with two bones: no bone alone tells where they are
        if float(shares[bone]) < 0.9 or bone not in segments:
            continue
        name, *end = segments[bone].split("_")
        begin = rest[bone] if end else spines(motion, body)
        point = body.rest_vertices(motion.shape, vertex).numpy()[0]
        place_in_segment = axes[segments[bone]].T @ (point - begin)
        found[label] = ("_".join((_MARKED[name], *end)), place_in_segment.tolist())
    return found


def spines(motion: Motion, body: BodyModel) -> np.ndarray:
    """Return the middle (m) of the anterior superior iliac spines of the unposed body."""
    index = torch.tensor([landmark("left_asis"), landmark("right_asis")])
    return body.rest_vertices(motion.shape, index).numpy().mean(0)


HERE = ROOT / "scripts" / "clients"
MILLIMETRE = 1e-3
LIMITS = {
    "bvh_blender_mm": 0.1, "bvh_three_mm": 0.1, "gltf_blender_mm": 0.1, "gltf_three_mm": 0.1,
    "fbx_blender_mm": 0.1, "usd_mm": 0.1, "usd_skin_mm": 0.1, "opensim_three_axes_deg": 0.01,
    "opensim_trc_mm": 0.01, "gltf_issues": 0, "usd_messages": 0, "opensim_unknown_coordinates": 2,
    "vrm_three_mm": 0.1, "vrm_messages": 0, "metarig_deg": 0.01,
}  # fmt: skip
"""Largest allowed value of each figure that has one; patellae are two coordinates that a skeleton
without muscles does not have."""


def main() -> None:
    """Export the demo, run every client, compare, print and write the table."""
    asks = parser(__doc__)
    asks.add_argument("--python", type=Path, required=True, help="has opensim and usd-core")
    asks.add_argument("--blender", type=Path, required=True, help="has bpy")
    asks.add_argument("--node", type=Path, required=True, help="has three, three-vrm, validator")
    given = asks.parse_args()
    body = BodyModel.load().to(dtype=torch.float64)
    demo = ROOT / "recon" / "assets" / "demo.npz"
    motion = with_fingers(load_motion(demo, torch.float64).motion)
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder)
        save_motion(out / "m.npz", motion)
        named = {n: read_by_all(given, out, motion, body, n) for n in get_args(BoneNames)}
        found = {key: value for one in reversed(named.values()) for key, value in one.items()}
        found |= opensim(given.python, out, motion, body)
    rows = [
        [name, value if isinstance(value, int | float) else str(value), LIMITS.get(name)]
        for name, value in found.items()
    ]
    compared = [name for name in LIMITS if name in named["vrm"]]
    each = [[names, *map(one.get, compared)] for names, one in named.items()]
    tell(given.out, None, {}, {
        "clients": Table([("figure", None), ("value", 6), ("largest allowed", 2)], rows),
        "clients-names": Table([("names", None), *((name, 6) for name in compared)], each),
    })  # fmt: skip
    above = [
        f"{names} {name}"
        for names, one in (named | {"": found}).items()
        for name, limit in LIMITS.items()
        if name in one and not one[name] <= limit
    ]
    if above:
        sys.exit(f"above its limit: {', '.join(above)}")


ALL = (*JOINTS, *HAND_JOINTS)


def with_fingers(motion: Motion) -> Motion:
    """Let every finger joint swing about its own axis, by about half a radian at most."""
    axes = np.random.default_rng(0).normal(scale=0.3, size=(len(HAND_JOINTS), 3))
    phases = np.arange(motion.frames)[:, None] / 10 + np.arange(len(HAND_JOINTS))
    return motion.replace(hands=Hands(so3.exp(torch.from_numpy(np.sin(phases)[..., None] * axes))))


def read_by_all(
    given: argparse.Namespace, out: Path, motion: Motion, body: BodyModel, names: BoneNames
) -> dict[str, Any]:
    """Export the motion with the names of a program, and compare it as every client reads it."""
    bvh, glb, stage = (out / f"{names}.{ending}" for ending in ("bvh", "glb", "usd"))
    export_file(out / "m.npz", bvh=bvh, glb=glb, usd=stage, names=names)
    found = three(given.node, bvh, glb, motion, body, names)
    found |= vrm(given.node, glb, motion, body) if names == "vrm" else {}
    found |= validated(given.node, glb)
    found |= blender(given.blender, bvh, glb, motion, body, names)
    return found | usd(given.python, stage, motion, body, names)


def asked(*command: str | Path) -> dict[str, Any]:
    """Run a client, and return the JSON in the last line that it prints."""
    words = [str(word) for word in command]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        sys.exit(f"{' '.join(words)}\n{done.stdout[-2000:]}{done.stderr[-4000:]}")
    return json.loads(done.stdout.strip().splitlines()[-1])


def joints_of(motion: Motion, body: BodyModel) -> np.ndarray:
    fingers = pose_fingers(motion, body)[0][:, : len(HAND_JOINTS)]
    return torch.cat((body.pose(motion).joints, fingers), 1).numpy()


def skin_errors(found: np.ndarray, motion: Motion, body: BodyModel) -> np.ndarray:
    """Return the distances (mm) of the vertices that no finger moves, in every tenth frame."""
    fixed = skin_weights_with_fingers(motion, body)[0][:, len(JOINTS) :].sum(-1) == 0
    truth = body.pose(motion).vertices[::10].numpy()
    return np.linalg.norm(found - truth, axis=-1)[:, fixed] / MILLIMETRE


def farthest(found: np.ndarray, truth: np.ndarray) -> float:
    """Return the largest distance in millimetres."""
    return float(np.linalg.norm(found - truth, axis=-1).max() / MILLIMETRE)


def three(
    node: Path, bvh: Path, glb: Path, motion: Motion, body: BodyModel, names: BoneNames
) -> dict[str, Any]:
    said = asked(
        "node", HERE / "in_three.mjs", node.resolve(), bvh, glb,
        str(motion.frames), str(motion.fps),
    )  # fmt: skip
    truth, turn = joints_of(motion, body), to_z_up("y")
    in_bvh = np.stack([said["bvh"][name] for name in in_a_bvh(names)], 1) / 100 @ turn.T
    in_gltf = np.stack([said["gltf"][name] for name in joint_names_in(ALL, names)], 1) @ turn.T
    every = skin_errors(np.array(said["skin"]) @ turn.T, motion, body)
    return {
        "three": said["version"],
        "bvh_three_mm": farthest(in_bvh, truth),
        "gltf_three_mm": farthest(in_gltf, truth),
        "gltf_three_skin_median_mm": float(np.median(every)),
        "gltf_three_skin_max_mm": float(every.max()),
        "bvh_three_seconds": said["bvh_seconds"],
        "gltf_three_seconds": said["gltf_seconds"],
    }


def in_a_bvh(names: BoneNames) -> list[str]:
    """Return the names of all joints in a BVH, which has Mixamo's without their prefix."""
    return [name.removeprefix("mixamorig:") for name in joint_names_in(ALL, names)]


def vrm(node: Path, glb: Path, motion: Motion, body: BodyModel) -> dict[str, Any]:
    said = asked(
        "node", HERE / "in_vrm.mjs", node.resolve(), glb, str(motion.frames), str(motion.fps)
    )
    places = np.stack([said["places"][name] for name in joint_names_in(ALL, "vrm")], 1)
    return {
        "vrm": said["version"],
        "vrm_three_mm": farthest(places @ to_z_up("y").T, joints_of(motion, body)),
        "vrm_messages": len(said["messages"]),
    }


def validated(node: Path, glb: Path) -> dict[str, Any]:
    said = asked("node", HERE / "in_validator.mjs", node.resolve(), glb)
    return {
        "gltf_validator": said["version"],
        "gltf_issues": len(said["issues"]),
        "gltf_messages": [one["message"] for one in said["issues"]][:5],
    }


def read_in_blender(
    python: Path, bvh: Path, glb: Path, motion: Motion
) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Return what Blender says, and where it puts the bones of both files and of an FBX."""
    out, fbx = (glb.with_suffix(ending) for ending in (".npz", ".fbx"))
    said = asked(
        python, HERE / "in_blender.py", bvh, glb, out, fbx, str(motion.frames), str(motion.fps)
    )
    with np.load(out) as arrays:
        return said, dict(arrays)


def metarig(python: Path, bvh: Path, motion: Motion, body: BodyModel) -> float:
    """Return by how much arms and fingers of Rigify's metarig point away from ours, degrees.

    Its arms hang at rest, and its bones have rolls of their own.
    """
    glb = bvh.with_name("on_metarig.glb")
    export_file(bvh.with_name("m.npz"), glb=glb, character=bvh.with_name("metarig.glb"))
    arrays = read_in_blender(python, bvh, glb, motion)[1]
    theirs = np.stack([arrays[f"gltf {name}"] for name in joint_names_in(ALL, "rigify")], 1)
    # a hand's shape is the character's, so knuckles are left out
    ends = [k for k in range(joint_index("left_elbow"), len(ALL)) if not ALL[k].endswith("1")]
    both = np.stack((theirs, joints_of(motion, body)))
    ways = both[:, :, ends] - both[:, :, np.array((*PARENTS, *HAND_PARENTS))[ends]]
    a, b = ways / np.linalg.norm(ways, axis=-1, keepdims=True)
    return float(np.rad2deg(2 * np.arcsin(np.linalg.norm(a - b, axis=-1).max() / 2)))


def blender(
    python: Path, bvh: Path, glb: Path, motion: Motion, body: BodyModel, names: BoneNames
) -> dict[str, Any]:
    said, arrays = read_in_blender(python, bvh, glb, motion)
    theirs, of_bvh = joint_names_in(ALL, names), in_a_bvh(names)
    pairs = zip(of_bvh, (*PARENTS, *HAND_PARENTS), strict=False)
    tree = {name: None if p < 0 else of_bvh[p] for name, p in pairs}
    if said["parents"] != tree:
        sys.exit(f"Blender has another hierarchy: {said['parents']}")
    found = {
        kind: np.stack([arrays[f"{kind} {name}"] for name in of_kind], 1)
        for kind, of_kind in (("bvh", of_bvh), ("gltf", theirs), ("fbx", theirs))
    }
    every = skin_errors(arrays["gltf skin"], motion, body)
    truth = joints_of(motion, body)
    return {
        "blender": said["version"],
        "bvh_blender_mm": farthest(found["bvh"], truth),
        "gltf_blender_mm": farthest(found["gltf"], truth),
        "fbx_blender_mm": farthest(found["fbx"], truth),
        "gltf_blender_skin_median_mm": float(np.median(every)),
        "gltf_blender_skin_max_mm": float(every.max()),
        **({"metarig_deg": metarig(python, bvh, motion, body)} if names == "rigify" else {}),
    }


def usd(
    python: Path, path: Path, motion: Motion, body: BodyModel, names: BoneNames
) -> dict[str, Any]:
    out = path.with_suffix(".npz")
    said = asked(python, HERE / "in_usd.py", path, out, str(motion.frames))
    with np.load(out) as arrays:
        joints, skin = arrays["joints"], arrays["skin"]
    rows = [said["names"].index(re.sub(r"\W", "_", one)) for one in joint_names_in(ALL, names)]
    return {
        "usd": said["version"],
        "usd_mm": farthest(joints[:, rows], joints_of(motion, body)),
        "usd_skin_mm": float(skin_errors(skin, motion, body).max()),
        "usd_validators": said["validators"],
        "usd_messages": len(said["messages"]),
        "usd_time_codes": said["time_codes"],
    }


def opensim(python: Path, out: Path, motion: Motion, body: BodyModel) -> dict[str, Any]:
    trc, mot = out / "m.trc", out / "m.mot"
    export_file(out / "m.npz", trc=trc, mot=mot, markers="bsm", unit="m")
    frames = list(range(0, motion.frames, 5))
    sizes = {
        "frames": frames,
        "places": segment_sizes(motion, body),
        "markers": marker_sizes(motion, body),
    }
    (out / "sizes.json").write_text(json.dumps(sizes))
    said = asked(
        python, HERE / "in_opensim.py", mot, trc, out / "sizes.json",
        out / "opensim.npz",
    )  # fmt: skip
    truth = turned_segments(motion, body)
    columns = dict(zip(said["coordinates"], read_mot(mot)[frames].T[1:], strict=True))
    with np.load(out / "opensim.npz") as arrays:
        apart = {
            name: angle_between(arrays[f"body {theirs}"], truth[ours][frames])
            for name, (theirs, ours) in SEGMENTS.items()
        }
        follow = {
            name.removeprefix("ik "): np.abs(arrays[name] - columns[name.removeprefix("ik ")])
            for name in arrays.files
            if name.startswith(("ik hip", "ik knee", "ik ankle", "ik pelvis_t", "ik pelvis_l"))
            and not name.startswith(("ik pelvis_tx", "ik pelvis_ty", "ik pelvis_tz"))
        }
        markers = arrays["markers"]
    heights = recorded_markers(motion, body, "bsm", "m").positions[frames] @ to_z_up("y")
    return {
        "opensim": said["version"],
        "opensim_three_axes_deg": max(
            float(apart[name].max()) for name in ("pelvis", "torso", "femur_r", "femur_l")
        ),
        "opensim_segments_deg": {k: round(float(np.median(v)), 2) for k, v in apart.items()},
        "opensim_ik_deg": {k: round(float(np.median(v)), 2) for k, v in follow.items()},
        "opensim_trc_mm": farthest(markers, heights),
        "opensim_unknown_coordinates": len(said["unknown coordinates"]),
        "opensim_frames": said["frames"],
        "opensim_first_time": said["first_time"],
        "opensim_markers": len(said["markers"]),
    }


SEGMENTS = {
    "pelvis": ("pelvis", "pelvis"),
    "torso": ("torso", "thorax"),
    **{
        f"{theirs}_{end}": (f"{theirs}_{end}", f"{ours}_{end}")
        for end in "rl"
        for theirs, ours in {
            "femur": "femur", "tibia": "tibia", "calcn": "foot", "toes": "toes",
            "humerus": "humerus", "radius": "forearm", "hand": "hand",
        }.items()
    },
}  # fmt: skip
"""Bodies of OpenSim's model, and our names of these segments."""


def read_mot(path: Path) -> np.ndarray:
    lines = path.read_text().splitlines()
    start = lines.index("endheader") + 2
    return np.array([line.split("\t") for line in lines[start:]], dtype=float)


def angle_between(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the angle in degrees between two rotation matrices."""
    sine = np.linalg.norm(a - b, axis=(-2, -1)) * 0.5**1.5
    return np.rad2deg(2 * np.arcsin(np.clip(sine, 0, 1)))


if __name__ == "__main__":
    main()

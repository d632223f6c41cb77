"""Compares our exported files, as Blender, three.js, OpenSim and OpenUSD read them, with ours.

    python -m benchmarks.clients --python CLIENTS/bin/python --blender BLENDER/bin/python
        --node CLIENTS/node_modules --out benchmarks/results

`make clients` installs these programs and runs this. Every client runs in a process of its own,
without recon, and returns where it puts the joints, the skin or the segments of the bundled clip;
the errors against our own body are written with the versions of the clients. The exit code is 1 if
an error is above its limit.
"""

import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import torch

import recon
from benchmarks.protocol import ROOT, Cell, Table, parser, tell
from recon.body.landmarks import landmark
from recon.body.model import BodyModel
from recon.body.opensim import opensim_axes
from recon.body.segments import posed_axes
from recon.core.motion import Motion
from recon.core.skeleton import JOINTS, PARENTS, joint_index
from recon.core.units import to_z_up
from recon.export.motion import export_file
from recon.export.tables import body_places_of_markers, recorded_markers
from recon.formats.motions import load_motion

_PARENTS = {
    "femur": ("pelvis", "hip"), "tibia": ("femur", "knee"), "foot": ("tibia", "ankle"),
    "toes": ("foot", "foot"), "humerus": ("thorax", "shoulder"), "forearm": ("humerus", "elbow"),
    "hand": ("forearm", "wrist"),
}  # fmt: skip
"""Parent of every segment, and the joint at which the segment begins."""
_FIRST_JOINTS = {
    "femur": "hip", "tibia": "knee", "foot": "ankle", "toes": "foot", "humerus": "shoulder",
    "forearm": "elbow", "hand": "wrist",
}  # fmt: skip
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
        return rest[joint_index(f"{'right' if end == 'r' else 'left'}_{_FIRST_JOINTS[name]}")]

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
    segments = {"pelvis": "pelvis"} | {
        f"{side}_{joint}": f"{name}_{side[0]}"
        for side in ("right", "left")
        for name, joint in (("femur", "hip"), ("tibia", "knee"), ("foot", "ankle"))
    }
    found = {}
    for label, place in body_places_of_markers("bsm").items():
        vertex = torch.tensor([landmark(place.landmarks[0])])
        shares = body.weights[vertex[0]]
        bone = int(shares.argmax())
        # leave out markers on skin that moves with two bones: no bone alone tells where they are
        if float(shares[bone]) < 0.9:
            continue
        for joint, segment in segments.items():
            if joint_index(joint) != bone:
                continue
            begin = spines(motion, body) if segment == "pelvis" else rest[bone]
            point = body.rest_vertices(motion.shape, vertex).numpy()[0]
            name = _MARKED[segment.split("_")[0]] + segment.removeprefix(segment.split("_")[0])
            found[label] = (name, (axes[segment].T @ (point - begin)).tolist())
    return found


def spines(motion: Motion, body: BodyModel) -> np.ndarray:
    """Return the middle (m) of the anterior superior iliac spines of the unposed body."""
    index = torch.tensor([landmark("left_asis"), landmark("right_asis")])
    return body.rest_vertices(motion.shape, index).numpy().mean(0)


HERE = ROOT / "scripts" / "clients"
DEMO = Path(recon.__file__).parent / "assets" / "demo.npz"
MILLIMETRE = 1e-3
LIMITS = {
    "bvh_blender_mm": 0.1, "bvh_three_mm": 0.1, "gltf_blender_mm": 0.1, "gltf_three_mm": 0.1,
    "fbx_blender_mm": 0.1, "usd_mm": 0.1, "usd_skin_mm": 0.1, "opensim_three_axes_deg": 0.01,
    "opensim_trc_mm": 0.01, "gltf_issues": 0, "usd_messages": 0, "opensim_unknown_coordinates": 2,
}  # fmt: skip
"""Largest allowed value of each figure that has one; patellae are two coordinates that a skeleton
without muscles does not have."""


def main() -> None:
    """Export the demo, run every client, compare, print and write the table."""
    asks = parser(__doc__)
    asks.add_argument("--python", type=Path, required=True, help="has opensim and usd-core")
    asks.add_argument("--blender", type=Path, required=True, help="has bpy")
    asks.add_argument("--node", type=Path, required=True, help="has three and gltf-validator")
    given = asks.parse_args()
    motion, body = load_motion(DEMO, torch.float64).motion, BodyModel.load()
    body = body.to(dtype=torch.float64)
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder)
        files = {name: out / f"m.{name}" for name in ("bvh", "glb", "usd", "trc", "mot")}
        export_file(
            DEMO, bvh=files["bvh"], glb=files["glb"], usd=files["usd"], trc=files["trc"],
            mot=files["mot"], markers="bsm", unit="m",
        )  # fmt: skip
        found: dict[str, Any] = {}
        found |= three(given.node, files, motion, body)
        found |= validated(given.node, files["glb"])
        found |= blender(given.blender, files, out, motion, body)
        found |= usd(given.python, files["usd"], out, motion, body)
        found |= opensim(given.python, files, out, motion, body)
    rows: list[list[Cell]] = [
        [name, _told(value), LIMITS.get(name)] for name, value in found.items()
    ]
    columns = (("figure", None), ("value", 6), ("largest allowed", 2))
    tell(given.out, None, {}, {"clients": Table(columns, rows)})
    above = [name for name, limit in LIMITS.items() if not found[name] <= limit]
    if above:
        sys.exit(f"above its limit: {', '.join(above)}")


def _told(value: Any) -> Cell:
    """Return a number as it is, and any other value as text."""
    return value if isinstance(value, int | float) else str(value)


def asked(*command: str | Path) -> dict[str, Any]:
    """Run a client, and return the JSON in the last line that it prints."""
    words = [str(word) for word in command]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        sys.exit(f"{' '.join(words)}\n{done.stdout[-2000:]}{done.stderr[-4000:]}")
    return json.loads(done.stdout.strip().splitlines()[-1])


def joints_of(motion: Motion, body: BodyModel) -> np.ndarray:
    return body.pose(motion).joints.numpy()


def farthest(found: np.ndarray, truth: np.ndarray) -> float:
    """Return the largest distance in millimetres."""
    return float(np.linalg.norm(found - truth, axis=-1).max() / MILLIMETRE)


def three(node: Path, files: dict[str, Path], motion: Motion, body: BodyModel) -> dict[str, Any]:
    said = asked(
        "node", HERE / "in_three.mjs", node.resolve(), files["bvh"], files["glb"],
        str(motion.frames), str(motion.fps),
    )  # fmt: skip
    truth, turn = joints_of(motion, body), to_z_up("y")
    in_bvh = np.stack([said["bvh"][name] for name in JOINTS], 1) / 100 @ turn.T
    in_gltf = np.stack([said["gltf"][name] for name in JOINTS], 1) @ turn.T
    skin = np.array(said["skin"]) @ turn.T
    every = np.linalg.norm(skin - body.pose(motion).vertices.numpy()[::10], axis=-1) / MILLIMETRE
    return {
        "three": said["version"],
        "bvh_three_mm": farthest(in_bvh, truth),
        "gltf_three_mm": farthest(in_gltf, truth),
        "gltf_three_skin_median_mm": float(np.median(every)),
        "gltf_three_skin_max_mm": float(every.max()),
        "bvh_three_seconds": said["bvh_seconds"],
        "gltf_three_seconds": said["gltf_seconds"],
    }


def validated(node: Path, glb: Path) -> dict[str, Any]:
    said = asked("node", HERE / "in_validator.mjs", node.resolve(), glb)
    return {
        "gltf_validator": said["version"],
        "gltf_issues": len(said["issues"]["messages"]),
        "gltf_messages": [one["message"] for one in said["issues"]["messages"]][:5],
    }


def blender(
    python: Path, files: dict[str, Path], out: Path, motion: Motion, body: BodyModel
) -> dict[str, Any]:
    said = asked(
        python, HERE / "in_blender.py", files["bvh"], files["glb"], out / "blender.npz",
        out / "m.fbx", str(motion.frames), str(motion.fps),
    )  # fmt: skip
    parents = {JOINTS[k]: None if p < 0 else JOINTS[p] for k, p in enumerate(PARENTS)}
    if said["parents"] != parents:
        sys.exit(f"Blender has another hierarchy: {said['parents']}")
    with np.load(out / "blender.npz") as arrays:
        found = {
            kind: np.stack([arrays[f"{kind} {name}"] for name in JOINTS], 1)
            for kind in ("bvh", "gltf", "fbx")
        }
        skin = arrays["gltf skin"]
    truth = joints_of(motion, body)
    every = np.linalg.norm(skin - body.pose(motion).vertices.numpy()[::10], axis=-1) / MILLIMETRE
    return {
        "blender": said["version"],
        "bvh_blender_mm": farthest(found["bvh"], truth),
        "gltf_blender_mm": farthest(found["gltf"], truth),
        "fbx_blender_mm": farthest(found["fbx"], truth),
        "gltf_blender_skin_median_mm": float(np.median(every)),
        "gltf_blender_skin_max_mm": float(every.max()),
    }


def usd(python: Path, path: Path, out: Path, motion: Motion, body: BodyModel) -> dict[str, Any]:
    said = asked(python, HERE / "in_usd.py", path, out / "usd.npz", str(motion.frames))
    with np.load(out / "usd.npz") as arrays:
        joints, skin = arrays["joints"], arrays["skin"]
    return {
        "usd": said["version"],
        "usd_mm": farthest(joints, joints_of(motion, body)),
        "usd_skin_mm": farthest(skin, body.pose(motion).vertices.numpy()[::10]),
        "usd_validators": said["validators"],
        "usd_messages": len(said["messages"]),
        "usd_time_codes": said["time_codes"],
    }


def opensim(
    python: Path, files: dict[str, Path], out: Path, motion: Motion, body: BodyModel
) -> dict[str, Any]:
    frames = list(range(0, motion.frames, 5))
    sizes = {
        "frames": frames,
        "places": segment_sizes(motion, body),
        "markers": marker_sizes(motion, body),
    }
    (out / "sizes.json").write_text(json.dumps(sizes))
    said = asked(
        python, HERE / "in_opensim.py", files["mot"], files["trc"], out / "sizes.json",
        out / "opensim.npz",
    )  # fmt: skip
    truth = turned_segments(motion, body)
    columns = dict(zip(said["coordinates"], read_mot(files["mot"])[frames].T[1:], strict=True))
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
    own = recorded_markers(motion, body, "bsm", "m")
    heights = own.positions[frames] @ to_z_up("y")
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

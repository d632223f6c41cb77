"""Writes what the frozen cases read: simulated observations of a walk, and foreign files."""

import json
from pathlib import Path
from typing import Any

import numpy as np

import recon
from scripts.frozen.exports import export

DEMO = Path(recon.__file__).parent / "assets" / "demo.npz"
CLIP, CYCLE, SPARSE = (20, 56), (20, 51), (0, 60)
"""Frames of the bundled walk (30 Hz): a clip, one cycle of gait, a recording."""


def make_inputs(folder: Path) -> None:
    """Write what the cases read: simulated observations of the walk, and foreign files."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, (kind, options) in OBSERVATIONS.items():
        options = {"seed": 1, "frames": CLIP} | options
        path = folder / (name if options.get("views", 1) > 1 else f"{name}.npz")
        recon.simulate(DEMO, kind, **options).save(path, overwrite=True)
    twice = ("root_orient", "pose_body")  # these arrays repeat parts of `poses`
    walk = {key: value for key, value in np.load(DEMO).items() if key not in twice}
    random = np.random.default_rng(2)
    np.savez(folder / "slow.npz", **(walk | {"mocap_framerate": 20.0, "mocap_frame_rate": 20.0}))
    recon.simulate(folder / "slow.npz", "joints3d", noise=0.02, seed=1).save(folder / "long.npz")
    jitter = {
        key: walk[key] + random.normal(0, size, walk[key].shape).astype(np.float32)
        for key, size in (("trans", 0.01), ("poses", 0.05))
    }
    kept = ("betas", "gender", "mocap_framerate")  # nothing says of which body model it is
    foreign = {key: walk[key] for key in kept} | {k: v[: CLIP[1]] for k, v in jitter.items()}
    np.savez(folder / "estimate.npz", **foreign)
    np.savez(folder / "jitter.npz", **(walk | jitter))
    cut = {k: v[slice(*CLIP)] if len(walk["trans"]) in v.shape[:1] else v for k, v in walk.items()}
    np.savez(folder / "clip.npz", **cut)
    for markers in ("pig", "halpe26"):
        export(folder / "clip.npz", "--trc", folder / f"{markers}.trc", "--markers", markers)
    export(folder / "clip.npz", "--bvh", folder / "clip.bvh")
    write_c3d(folder / "pig.c3d", folder / "pig.trc")
    write_openpose(folder / "openpose")
    _write_smpl(folder / "SMPLX_NEUTRAL.npz")


OBSERVATIONS: dict[str, tuple[Any, dict[str, Any]]] = {
    "joints": ("joints3d", {"noise": 0.02, "missing_points": 0.1}),
    "hidden": ("joints3d", {"noise": 0.02, "hide_below": 0.9, "during": (0.9, 1.4)}),
    "markers": ("markers3d", {"noise": 0.01, "outliers": 0.05}),
    "landmarks": ("landmarks", {"noise": 0.01}),
    "camera": ("keypoints2d", {"noise": 2.0}),
    "phone": ("keypoints2d", {"noise": 2.0, "unknown_ground": True}),
    "two": ("keypoints2d", {"noise": 2.0, "views": 2}),
    "cloud": ("depth", {"noise": 0.01, "points": 400, "left_over": ("ground",)}),
    "scans": ("scans", {"noise": 0.005, "points": 200}),
    "cycle": ("landmarks", {"noise": 0.01, "frames": CYCLE}),
    "sparse": ("scans", {"noise": 0.005, "points": 60, "frames": SPARSE, "missing_frames": 0.8}),
}
"""Sensor and options of each simulated observation, keyed by the name of its file."""


def write_c3d(path: Path, trc: Path) -> None:
    """Write the markers of a TRC file (millimetres, y up) as C3D with z up."""
    import ezc3d

    lines = trc.read_text().splitlines()
    names = lines[3].split("\t")[2::3]
    names = [name for name in names if name]
    rows = [
        [float(word) for word in line.split("\t") if word] for line in lines[5:] if line.strip()
    ]
    values = np.array(rows)[:, 2:].reshape(len(rows), -1, 3)[..., [0, 2, 1]] * (1.0, -1.0, 1.0)
    file = ezc3d.c3d()
    point = file["parameters"]["POINT"]
    point["RATE"]["value"], point["UNITS"]["value"] = [30.0], ["mm"]
    point["LABELS"]["value"] = names
    ones = np.ones((1, len(names), len(rows)))
    file["data"]["points"] = np.concatenate((values.transpose(2, 1, 0), ones))
    file.write(str(path))


def write_openpose(folder: Path) -> None:
    """Write OpenPose's 2D keypoints of two people before one camera, a file per frame."""
    folder.mkdir(exist_ok=True)
    people = []
    for first, aside in ((20, 0.0), (70, 420.0)):
        seen = recon.simulate(DEMO, "keypoints2d", noise=2.0, frames=(first, first + 36), seed=1)
        seen.save(folder / "seen.npz", overwrite=True)
        with np.load(folder / "seen.npz") as file:
            pixels = file["pixels"] * 0.5 + (240 + aside, 270)
            people.append(np.concatenate((pixels, file["confidence"][..., None]), -1))
    for path in folder.glob("seen.npz*"):
        path.unlink()
    for k, moment in enumerate(zip(*people, strict=True)):
        found = [{"pose_keypoints_2d": one.ravel().round(3).tolist()} for one in moment]
        (folder / f"walk_{k:012d}_keypoints.json").write_text(json.dumps({"people": found}))


def _write_smpl(path: Path) -> None:
    """Write the bundled body, 4 % thinner, in the arrays of a SMPL-X file with 55 joints."""
    body = recon.BodyModel.load()
    thinner = np.array([0.96, 0.96, 1.0])
    template = body.template.numpy() * thinner
    directions = body.shape_directions.numpy() * thinner[:, None]
    joints = body.joint_template.numpy() * thinner
    joint_directions = body.joint_directions.numpy() * thinner[:, None]
    extra = [15] * 3 + [20] * 15 + [21] * 15
    """Parents of jaw, eyes and fingers, which stay at rest."""
    regressor = np.zeros((55, len(template)))
    for row in range(22):
        near = np.linalg.norm(template - joints[row], axis=1).argsort()[:400]
        known = (template[near].T, directions[near].transpose(1, 2, 0).reshape(-1, 400))
        asked = (joints[row], joint_directions[row].reshape(-1), [1.0])
        system = np.concatenate((*known, np.ones((1, 400))))
        regressor[row, near] = np.linalg.lstsq(system, np.concatenate(asked), rcond=None)[0]
    regressor[22:] = regressor[extra]
    weights = np.zeros((len(template), 55))
    weights[:, :22] = body.weights.numpy()
    parents = [2**32 - 1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19]
    padding = np.zeros((len(template), 3, 310 - body.shape_directions.shape[-1]))
    np.savez(
        path,
        v_template=template,
        shapedirs=np.concatenate((directions, padding), axis=2),
        J_regressor=regressor,
        weights=weights,
        kintree_table=np.array([[*parents, *extra], range(55)]),
        f=body.faces.numpy(),
    )

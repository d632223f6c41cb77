"""The frozen cases: fits of every sensor, verbs and exporters, by public names and files alone."""

import json
import math
import tempfile
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import torch

import recon
from scripts.frozen.exports import Arrays, exported, recon_command
from scripts.frozen.inputs import CLIP, DEMO, OBSERVATIONS

Case = Callable[[Path], Arrays]
"""Function that runs a case on a folder of input files and returns arrays."""


def _fit(*names: str, **options: Any) -> Case:
    def case(inputs: Path) -> Arrays:
        return _result(recon.fit([inputs / name for name in names], **options))

    return case


def _result(found: Any) -> Arrays:
    """Return joints, last objective, shape and ground contacts of a fit."""
    energies = found.report()["stages"][-1]["energies"]
    return {
        "joints": found.joints.numpy(),
        "objective": np.array(sum(energies.values())),
        "shape": found.motion.shape.numpy(),
        "contacts": found.contacts.numpy(),
    }


def two_cameras(inputs: Path) -> Arrays:
    """Fit two views of one clip, a file each."""
    return _result(recon.fit(sorted((inputs / "two").glob("*.npz"))))


def two_people(inputs: Path) -> Arrays:
    """Fit one of two people in 2D keypoints of a camera without calibration."""
    seen = recon.load_observation(
        inputs / "openpose", frame_rate=30.0, image_size=(1920, 1080), person=1
    )
    return _result(recon.fit(seen, "pose"))


def markers_of_a_laboratory(inputs: Path) -> Arrays:
    """Fit Plug-in Gait's markers of a C3D file, read by the marker solver."""
    return _result(recon.fit(recon.load_observation(inputs / "pig.c3d")))


def command_line(inputs: Path) -> Arrays:
    """Run `recon fit` as in `joints pose`; return arrays of its motion file and report."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "motion.npz"
        recon_command("fit", inputs / "joints.npz", "--prior", "pose", "--out", out)
        said = json.loads(Path(f"{out}.json").read_text())
        with np.load(out) as file:
            found = {key: file[key] for key in ("joints", "trans", "poses", "betas", "contacts")}
    return found | {"objective": np.array(sum(said["stages"][-1]["energies"].values()))}


def _stream(prior: str) -> Case:
    return lambda inputs: {"joints": streamed(inputs / "joints.npz", prior)}


def streamed(path: Path, prior: str) -> np.ndarray:
    """Push a file's frames one after the other to a stream; return the final joints."""
    seen: Any = recon.load_observation(path)
    stream = recon.Stream(prior, lag=8, template=seen)
    told = []
    for k in range(seen.positions.shape[1]):
        found = stream.push(
            torch.where(seen.visible[0, k, :, None], seen.positions[0, k], math.nan)
        )
        told += [] if found is None else found.every
    told += stream.finish()
    return torch.stack([one.joints for one in told]).numpy()


def refine(inputs: Path) -> Arrays:
    """Refine a motion with jitter, as networks estimate it."""
    return _result(recon.refine(inputs / "estimate.npz", up="z"))


def sample_humor(_: Path) -> Arrays:
    """Sample two motions from HuMoR."""
    return _made(*recon.sample(count=2, seconds=1.5, seed=3))


def sample_humos(_: Path) -> Arrays:
    """Sample a motion for a body of 1.80 m from HUMOS."""
    return _made(*recon.sample("humos", seconds=1.5, seed=3, shape="height=1.80"))


def predict(inputs: Path) -> Arrays:
    """Predict two continuations of the clip."""
    return _made(*recon.predict(inputs / "clip.npz", seconds=1.0, samples=2, seed=3))


def interpolate(inputs: Path) -> Arrays:
    """Interpolate a cycle between the walk and the same walk in slow motion."""
    return _made(recon.interpolate(DEMO, inputs / "slow.npz", 0.3))


def _retarget(method: str) -> Case:
    def case(inputs: Path) -> Arrays:
        return _made(recon.retarget(inputs / "clip.npz", "height=1.60", method=method))

    return case


def to_body(inputs: Path) -> Arrays:
    """Transfer the clip to the mesh of a file of the SMPL family."""
    return _made(recon.to_body(inputs / "clip.npz", inputs / "SMPLX_NEUTRAL.npz"))


def _convert(name: str) -> Case:
    return lambda inputs: _made(recon.convert(inputs / name))


def _made(*results: Any) -> Arrays:
    shapes = [one.motion.shape.numpy() for one in results]
    return {"joints": np.stack([r.joints.numpy() for r in results]), "shape": np.stack(shapes)}


def evaluate(inputs: Path) -> Arrays:
    """Compute every metric of the jittered walk, also for the joints that were seen."""
    found = recon.evaluate(inputs / "jitter.npz", DEMO, observation=inputs / "hidden.npz")
    told = sorted(key for key, value in found.items() if value is not None)
    return {"words": np.array(told), "numbers": np.array([found[key] for key in told])}


def angles(inputs: Path) -> Arrays:
    """Compute joint angles after the ISB, degrees."""
    return dict(recon.joint_angles(inputs / "clip.npz").degrees)


def simulate(_: Path) -> Arrays:
    """Simulate every sensor; the other cases read what the reference simulated."""
    found: Arrays = {}
    for name, (kind, options) in OBSERVATIONS.items():
        with tempfile.TemporaryDirectory() as folder:
            seen = recon.simulate(DEMO, kind, **({"seed": 1, "frames": CLIP} | options))
            for path in seen.save(Path(folder) / ("a" if len(seen) > 1 else "a.npz")):
                with np.load(path) as file:
                    numbers = {k: v for k, v in file.items() if v.dtype.kind in "fiub"}
                found |= {f"{name} {path.stem} {key}": v for key, v in numbers.items()}
    return found


CASES: dict[str, Case] = {
    "simulate": simulate,
    "joints": _fit("joints.npz"),
    "joints pose": _fit("joints.npz", prior="pose"),
    "joints physics": _fit("joints.npz", physics=1.0),
    "joints shape": _fit("joints.npz", prior="pose", shape=1.80),
    "command line": command_line,
    "hidden": _fit("hidden.npz"),
    "markers": _fit("markers.npz"),
    "landmarks": _fit("landmarks.npz"),
    "keypoints 3D": _fit("halpe26.trc"),
    "one camera": _fit("camera.npz"),
    "phone": _fit("phone.npz"),
    "two people": two_people,
    "two cameras": two_cameras,
    "camera and joints": _fit("camera.npz", "joints.npz"),
    "cloud": _fit("cloud.npz"),
    "scans": _fit("scans.npz", prior="pose"),
    "C3D": markers_of_a_laboratory,
    "no ground": _fit("joints.npz", prior="pose", ground=None),
    "ground unknown": _fit("joints.npz", ground="unknown"),
    "long": _fit("long.npz"),
    "anchor": _fit("cycle.npz", prior="anchor"),
    "whole recording": _fit("sparse.npz", prior="recording"),
    "roll-out": _fit("joints.npz", method="rollout", between=(1.0, 1.5)),
    "stream pose": _stream("pose"),
    "stream humor": _stream("humor"),
    "refine": refine,
    "sample humor": sample_humor,
    "sample humos": sample_humos,
    "predict": predict,
    "interpolate": interpolate,
    "retarget physics": _retarget("physics"),
    "retarget network": _retarget("network"),
    "to body": to_body,
    "convert C3D": _convert("pig.c3d"),
    "convert TRC": _convert("pig.trc"),
    "convert BVH": _convert("clip.bvh"),
    "evaluate": evaluate,
    "angles": angles,
    "export glb": exported("--glb"),
    "export bvh": exported("--bvh"),
    "export trc opencap": exported("--trc", "--markers", "opencap"),
    "export trc bsm": exported("--trc", "--markers", "bsm", "--unit", "m", "--up", "z"),
    "export mot": exported("--mot"),
    "export mot gait2392": exported("--mot", "--model", "gait2392"),
    "export angles": exported("--angles"),
    "export joints": exported("--joints"),
    "export robot": exported("--robot", "--smplx", "SMPLX_NEUTRAL.npz"),
    "export smpl": exported("--smpl", "--onto", "SMPLX_NEUTRAL.npz"),
    "export ply": exported("--ply"),
    "export html": exported("--html"),
    **({} if find_spec("pxr") is None else {"export usd": exported("--usd")}),
}
"""All cases, keyed by name."""

"""What a file holds and what was assumed in reading it."""

from pathlib import Path
from typing import Any

import numpy as np

from recon.formats import read_recording
from recon.formats.amass import load_motion
from recon.formats.files import existing, load_arrays
from recon.formats.observation import KeypointsFile, PositionsFile, load_observation
from recon.formats.smpl import load_smpl
from recon.recording import MarkerRecording


def describe(path: Path) -> dict[str, Any]:
    """Format, sizes, rate, units and decisions of one file; plain values.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: when it is nothing that recon reads; the message says what was expected.
    """
    if path.suffix.lower() == ".pkl":
        return _body(path)
    if path.suffix.lower() != ".npz":
        return _recording(path)
    keys = set(load_arrays(existing(path)))
    if "kind" in keys:
        return _observation(path)
    if "trans" in keys:
        return _motion(path)
    if "v_template" in keys:
        return _body(path)
    raise ValueError(
        f"{path}: neither an observation (has `kind`), a motion (`trans`, `poses`) nor a body "
        f"(`v_template`); it has {', '.join(sorted(keys))}"
    )


def _motion(path: Path) -> dict[str, Any]:
    file = load_motion(path)
    motion = file.motion
    return {
        "format": "motion (AMASS .npz)",
        "frames": motion.frames,
        "fps": motion.fps,
        "seconds": motion.frames / motion.fps,
        "start_time": motion.start_time,
        "shape_coefficients": motion.shape.shape[-1],
        "body": file.body,
        "gender": file.gender,
        "has_contacts": file.contacts is not None,
        "units": "metres, z up",
    }


def _observation(path: Path) -> dict[str, Any]:
    file = load_observation(path)
    common = {"fps": file.fps, "start_time": file.start_time}
    if isinstance(file, PositionsFile):
        return {
            "format": f"observation: {file.kind}",
            "frames": len(file.positions),
            "points": len(file.names),
            **common,
            "missing": float(1 - file.visible.mean()) if file.visible.size else 1.0,
            "ground_known": file.ground_known,
            "names": list(file.names),
        }
    if isinstance(file, KeypointsFile):
        return {
            "format": "observation: keypoints2d",
            "frames": len(file.pixels),
            "points": file.pixels.shape[1],
            **common,
            "layout": file.layout,
            "missing": float((file.confidence <= 0).mean()) if file.confidence.size else 1.0,
            "image_size": list(file.camera.image_size),
        }
    return {
        "format": "observation: points",
        "frames": int(file.frame.max()) + 1,
        "points": len(file.points),
        **common,
    }


def _recording(path: Path) -> dict[str, Any]:
    recording = read_recording(path)
    names = (
        recording.marker_names if isinstance(recording, MarkerRecording) else recording.joint_names
    )
    facts: dict[str, Any] = {
        "format": "markers" if isinstance(recording, MarkerRecording) else "skeleton",
        "frames": recording.frames,
        "fps": recording.fps,
        "seconds": recording.frames / recording.fps,
        "names": list(names),
        "decisions": list(recording.decisions),
    }
    if isinstance(recording, MarkerRecording):
        facts["missing"] = float(1 - np.mean(recording.visible))
    else:
        facts["stature"] = recording.stature
    return facts


def _body(path: Path) -> dict[str, Any]:
    arrays = load_smpl(path)
    return {
        "format": "body model",
        "vertices": len(arrays.template),
        "joints": len(arrays.parents),
        "shape_coefficients": arrays.shape_directions.shape[-1],
        "pose_correctives": arrays.pose_directions is not None,
    }

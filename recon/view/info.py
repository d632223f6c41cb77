"""`recon info`: describes what a file holds and what was assumed in reading it."""

import math
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from recon.body.marker_labels import match_markers
from recon.body.model import BodyModel
from recon.core.coordinates import notes_on_missing_path
from recon.core.errors import FormatError
from recon.core.hands import right_handed_signs
from recon.core.motion import MotionFile
from recon.core.units import Hand, Unit, Up
from recon.detections.tables import holds_detections
from recon.formats import producers
from recon.formats.estimates import read_estimate
from recon.formats.joint_table import JointCertainty
from recon.formats.motions import load_motion
from recon.formats.observations import (
    CameraArrays,
    KeypointsFile,
    PositionsFile,
    load_observation,
)
from recon.formats.opening import existing_file, load_arrays
from recon.formats.pickles import read_tree
from recon.formats.producers import producer_of, refuse_unsupported
from recon.formats.projects import Project, project_at
from recon.formats.reports import read_report
from recon.formats.smpl import load_smpl
from recon.ingest.maps import recognise, right_handed_skeleton
from recon.keypoints3d.labels import are_keypoints
from recon.keypoints3d.reader import holds_points_3d, points_of_recording, read_points_3d
from recon.keypoints3d.records import Points3D
from recon.mocap.reader import read_recording
from recon.mocap.recording import MarkerRecording, head_to_foot_length
from recon.reading.keypoints3d import points_in_metres
from recon.reading.places import load_silhouettes
from recon.reading.points import positions_in_metres
from recon.view.info_cameras import (
    describe_calibration,
    describe_detections,
    describe_film,
    describe_folder,
)

_RATES = frozenset({"mocap_framerate", "mocap_frame_rate", "fps"})
"""Names of the frame rate in motion files; estimates of networks have none."""

_WITH_AXES = (
    "3D keypoints", "markers", "observation: joints3d", "observation: keypoints3d",
    "observation: markers3d", "per-frame SMPL parameters", "skeleton",
)  # fmt: skip
"""Formats of files whose unit, vertical or handedness a caller may state."""
_ANY_RATE = 30.0
"""Frames per second assumed for points without a rate; only times depend on it."""


def info(
    file: Path, *, unit: Unit | None = None, up: Up | None = None, hand: Hand | None = None
) -> dict[str, Any]:
    """Describe what a file or folder holds, and what was assumed in reading it.

    Motions, observations, recordings, bodies, 2D keypoints, calibrations, scans, depth images:
    their format, sizes, rate, units and decisions, as plain values.

    Args:
        file: any file or folder that recon reads.
        unit: of its coordinates, as for `recon fit`; default: found out.
        up: axis that points up, or down; default: found out.
        hand: handedness of the coordinates; default: found out.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: when it is nothing that recon reads; the message says what was expected.
    """
    if not file.exists():
        raise FileNotFoundError(f"{file}: no such file")
    refuse_unsupported(file, "info")
    found = producer_of(file)
    axes = {"unit": unit, "up": up, "hand": hand}
    facts = _describe_by_kind(file, axes)
    unused = [name for name, value in axes.items() if value is not None]
    if unused and not facts["format"].startswith(_WITH_AXES):
        raise FormatError(
            f"{file}: recon info uses no {', '.join(unused)} for {facts['format']}; leave it out"
        )
    if found is not None:
        facts |= {"producer": found.name, "taken_by": ", ".join(f"recon {v}" for v in found.verbs)}
    return facts


def _describe_by_kind(file: Path, axes: Mapping[str, Any]) -> dict[str, Any]:
    if (project := project_at(file)) is not None:
        return _describe_project(project)
    if holds_points_3d(file):
        return _describe_points(read_points_3d(file), axes)
    if file.is_dir():
        return describe_folder(file)
    ending, found = file.suffix.lower(), producer_of(file)
    keys = load_arrays(existing_file(file)).keys() if ending == ".npz" else set[str]()
    match "" if found is None else found.holds:
        case "an observation":
            return _describe_observation(file, axes)
        case "a motion":
            return _describe_motion(file)
        case "a body model":
            return _describe_body(file)
        case producers.BODIES if keys & _RATES:
            return _describe_motion(file)
        case producers.BODIES if ending == ".pkl" and "v_template" in read_tree(file):
            return _describe_body(file)
        case producers.BODIES:
            return _describe_estimate(file, axes["up"])
        case "a calibration of cameras":
            return describe_calibration(file)
        case producers.FILM:
            return describe_film(file)
        case "silhouettes":
            return {"format": "masks", "frames": len(load_silhouettes(file).images)}
        case producers.MARKERS:
            return _describe_recording(file, axes)
        case producers.POINTS_2D:
            return describe_detections(file)
        case _ if ending in (".json", ".csv") or holds_detections(file):
            return describe_detections(file)
        case _ if ending != ".npz":
            return _describe_recording(file, axes)
    raise FormatError(
        f"{file}: neither an observation (has `kind`), a motion (`trans`, `poses`), a body "
        f"(`v_template`), a calibration (`camera_matrix`) nor masks (`mask`); it has "
        f"{', '.join(sorted(keys))}"
    )


def _describe_project(project: Project) -> dict[str, Any]:
    """Describe the files of a project and its settings."""
    seen = project.detections or project.points
    inside = info(seen) if seen is not None else {"format": "nothing that can be fitted"}
    of_project = {"fps": project.fps or inside.get("fps"), "frame_range": project.frames}
    decisions = [*project.decisions, *inside.get("decisions", ())]
    return {**inside, **of_project, "decisions": decisions}


def _describe_motion(path: Path) -> dict[str, Any]:
    file = load_motion(path)
    motion = file.motion
    note = notes_on_missing_path(motion.translation.numpy(), motion.rotations.numpy())
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
        "has_camera": file.T_world_camera is not None,
        **_describe_certainty(file),
        **_describe_alternatives(path),
        "units": "metres, z up",
        **({"decisions": [note]} if note else {}),
    }


def _describe_certainty(file: MotionFile) -> dict[str, Any]:
    """Describe the standard deviations of joints by medians, if the motion file has them."""
    found = JointCertainty.of(file)
    if found is None:
        return {"has_joint_std": False}
    return {
        "has_joint_std": True,
        "median_joint_std_seen": found.seen,
        "median_joint_std_hidden": found.hidden,
        "share_of_hidden_joints": found.hidden_share,
        **_describe_ground(file),
    }


def _describe_ground(file: MotionFile) -> dict[str, float]:
    """Describe the standard deviations of an estimated ground; empty where there are none."""
    if file.ground_std is None:
        return {}
    normal, height = file.ground_std.tolist()
    return {"ground_normal_std_degrees": math.degrees(normal), "ground_height_std": height}


def _describe_alternatives(path: Path) -> dict[str, list[str]]:
    """Read messages on other motions that explain the data, from the report next to the file."""
    beside = path.with_name(f"{path.name}.json")
    report = read_report(beside)
    if report is None or report.checksum_if_own(path.name, path) is None:
        return {}
    told = report.content.get("alternatives", [])
    return {"alternatives": [one["message"] for one in told]} if told else {}


def _describe_observation(path: Path, axes: Mapping[str, Any]) -> dict[str, Any]:
    file = load_observation(path, unit=axes["unit"])
    common = {"fps": file.fps, "start_time": file.start_time}
    if isinstance(file, PositionsFile):
        file = positions_in_metres(file, path, BodyModel.load(), **axes)
        return {
            "format": f"observation: {file.kind}",
            "frames": len(file.positions),
            "points": len(file.names),
            **common,
            "missing": float(1 - file.visible.mean()) if file.visible.size else 1.0,
            "ground_known": file.ground_known,
            "std": file.std is not None,
            "names": list(file.names),
            "decisions": list(file.decisions),
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
            **_describe_pose(file.camera),
        }
    return {
        "format": "observation: points",
        "frames": int(file.frame.max()) + 1,
        "points": len(file.points),
        **common,
        **({"ground_known": True} if file.camera is None else _describe_pose(file.camera)),
    }


def _describe_pose(camera: CameraArrays) -> dict[str, Any]:
    """Describe whether the camera's pose, and with it the ground, is known."""
    poses = camera.T_camera_world
    return {"poses": 0 if poses is None else len(poses), "ground_known": poses is not None}


def _describe_recording(path: Path, axes: Mapping[str, Any]) -> dict[str, Any]:
    recording = read_recording(path, unit=axes["unit"], up=axes["up"])
    if isinstance(recording, MarkerRecording) and are_keypoints(recording.marker_names):
        return _describe_points(points_of_recording(recording), {"hand": axes["hand"]})
    if not isinstance(recording, MarkerRecording):
        with suppress(FormatError):  # `recon convert` says which joints are asked for
            recording = right_handed_skeleton(recording, recognise(recording), axes["hand"])
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
        matched, _ = match_markers(names)
        places = [matched.get(name, "") for name in names]
        _, said = right_handed_signs(places, recording.positions, recording.visible, axes["hand"])
        facts["decisions"] += said
        facts["missing"] = float(1 - np.mean(recording.visible))
    else:
        facts["stature"] = head_to_foot_length(
            recording.joint_names, recording.parents, recording.rest_offsets
        )
    return facts


def _describe_body(path: Path) -> dict[str, Any]:
    arrays = load_smpl(path)
    return {
        "format": "body model",
        "vertices": len(arrays.template),
        "joints": len(arrays.parents),
        "shape_coefficients": arrays.shape_directions.shape[-1],
        "pose_correctives": arrays.pose_directions is not None,
    }


def _describe_estimate(path: Path, up: Up | None) -> dict[str, Any]:
    """Describe the person with most frames in a file of body parameters.

    Raises:
        ValueError: when the file holds no such parameters.
    """
    found = read_estimate(path, up=up)
    note = notes_on_missing_path(found.translation[found.known], found.rotations[found.known])
    return {
        "format": "per-frame SMPL parameters (for `recon refine`)",
        "frames": len(found.translation),
        "frames_without_person": int((~found.known).sum()),
        "fps": found.fps,
        "shape_coefficients": len(found.betas),
        "up": found.up,
        "units": "metres",
        "decisions": [*found.notes, *([note] if note else [])],
    }


def _describe_points(points: Points3D, axes: Mapping[str, Any]) -> dict[str, Any]:
    """Describe 3D keypoints: names, sizes, frame rate and how they were read.

    Raises:
        ValueError: when layout, unit or axis cannot be told; the message says what was found.
    """
    file = points_in_metres(points, BodyModel.load(), fps=points.fps or _ANY_RATE, **axes)
    asked = () if points.fps is not None else ("no frame rate: give --frame-rate to fit",)
    return {
        "format": "3D keypoints",
        "frames": len(file.positions),
        "points": len(file.names),
        "fps": points.fps,
        "start_time": file.start_time,
        "missing": float(1 - file.visible.mean()),
        "units": "metres, z up" if file.level else "metres, frame of a camera turned to z up",
        "placed": file.placed,
        "ground_known": file.ground_known,
        "names": list(file.names),
        "decisions": [*file.decisions, *asked],
    }

"""One recording becomes a motion of our body, with what was decided and how well it went."""

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from recon.body import BodyModel
from recon.contacts import contact_labels, rest_heights
from recon.formats import read_recording
from recon.formats.amass import MotionFile, save_motion
from recon.ingest.skeletons import recognise
from recon.ingest.soles import Soles, ground_height
from recon.ingest.solve import Solved, residual_names, solve
from recon.ingest.subject import SubjectModel, calibrate
from recon.metrics import slip_speed
from recon.motion import Motion
from recon.recording import MarkerRecording, SkeletonRecording, drop_lead_in
from recon.skeleton import FEET, JOINTS
from recon.units import Axis

GLITCH_SPEED = 20.0
"""Metres per second: no joint of a body moves so fast; between such frames it jumped."""


@dataclass(frozen=True)
class Conversion:
    """A recording on our body, standing on z = 0, at its own rate unless another was asked for."""

    motion: Motion
    joints: Float[Tensor, "time 22 3"]
    """World, metres."""
    contacts: Bool[Tensor, "time 22"]
    """Joints that carry weight, judged at the recording's rate."""
    residuals: Mapping[str, float]
    """Mean distance of every observed joint or marker after constant offsets, millimetres."""
    ground_shift: float
    """Metres by which the recording was lowered."""
    decisions: tuple[str, ...]
    """What was read, guessed or cut, one sentence each."""
    report: Mapping[str, float | int | str | None]
    """Flat numbers for tables: frames, fps, residual_mm, slip_mps, ..."""

    def save(self, path: str | Path, body: BodyModel, *, contacts: bool = True) -> None:
        """Write an AMASS file with joints and, unless they are not to be trusted, contacts."""
        save_motion(
            path,
            MotionFile(
                motion=self.motion,
                body=body.name,
                checksum=body.checksum,
                joints=self.joints,
                contacts=self.contacts.to(self.joints) if contacts else None,
                ground=torch.tensor([0.0, 0.0, 1.0, 0.0]),
            ),
        )


def convert(
    recording: str | Path | SkeletonRecording | MarkerRecording,
    body: BodyModel | None = None,
    *,
    unit: str | None = None,
    up: Axis | None = None,
    subject: SubjectModel | None = None,
    mapping: str | Path | None = None,
    fps: float | None = None,
) -> Conversion:
    """Any full-body recording, of joints or of markers, as a motion of our body.

    Args:
        recording: a file (.bvh, .amc, .c3d, .trc, ...) or what its reader made of it.
        body: whose motion it becomes; None is the bundled body.
        unit: of the file; None finds it out.
        up: axis of the file that points up; None finds it out.
        subject: shape, offsets and alignments from other recordings of the same skeleton; None
            finds them from this one.
        mapping: TOML file that says which of its joints or markers are ours.
        fps: resample to this rate; None keeps the recording's.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: when it cannot be read, its unit or axis cannot be told, its skeleton or
            markers are not known or do not cover the body, or the rate is not positive.
    """
    if fps is not None and not fps > 0:
        raise ValueError(f"expected a positive frame rate, got {fps}")
    if isinstance(recording, (str, Path)):
        recording = read_recording(recording, unit=unit, up=up)
    body = BodyModel.load() if body is None else body
    if isinstance(recording, MarkerRecording):
        from recon.ingest.markers import convert_markers

        found = convert_markers(recording, body, mapping=mapping)
    else:
        recording = drop_lead_in(recording)
        if subject is None:
            subject = calibrate([recording], recognise(recording, mapping), body)
        (found,) = convert_skeletons([recording], subject, body)
    return found if fps is None or fps == found.motion.fps else resampled(found, body, fps)


def convert_skeletons(
    recordings: Sequence[SkeletonRecording], subject: SubjectModel, body: BodyModel
) -> list[Conversion]:
    """Recordings of one calibrated skeleton and one rate, as a batch of independent clips."""
    soles = Soles.of(body)
    solved = solve(recordings, subject, body)
    names = residual_names(subject)
    return [
        _finish(recording, found, names, body, soles)
        for recording, found in zip(recordings, solved, strict=True)
    ]


def _finish(
    recording: SkeletonRecording,
    solved: Solved,
    names: tuple[str, ...],
    body: BodyModel,
    soles: Soles,
) -> Conversion:
    jumps = glitches(recording)
    found = grounded(
        solved.motion,
        dict(zip(names, (1000 * solved.residuals).tolist(), strict=True)),
        recording.decisions,
        body,
        soles,
        n_glitch=len(jumps),
    )
    source = found.joints.clone()
    known = [joint for joint in FEET if JOINTS[joint] in names]
    source[:, known] = solved.source_feet
    slip = slip_speed(source, found.contacts, solved.motion.fps)
    return dataclasses.replace(found, report={**found.report, "slip_source_mps": slip})


def grounded(
    motion: Motion,
    residuals: Mapping[str, float],
    decisions: tuple[str, ...],
    body: BodyModel,
    soles: Soles,
    *,
    n_glitch: int,
) -> Conversion:
    """Stand a motion on z = 0, label its contacts and report."""
    shift, stance = ground_height(motion, body, soles)
    down = motion.translation.new_tensor([0.0, 0.0, shift])
    motion = motion.replace(translation=motion.translation - down)
    joints = body.pose(motion).joints
    contacts = contact_labels(joints, rest_heights(body, motion.shape), motion.fps)
    seen = f"in {stance} frames of stance" if stance > 0 else "in all frames: no foot ever stands"
    notes = [f"lowered by {shift:.3f} m: 5th percentile of the soles {seen}"]
    if n_glitch > 0:
        notes.append(f"{n_glitch} jumps: a joint is faster than {GLITCH_SPEED:g} m/s")
    values = list(residuals.values())
    return Conversion(
        motion=motion,
        joints=joints,
        contacts=contacts,
        residuals=residuals,
        ground_shift=shift,
        decisions=(*decisions, *notes),
        report={
            "frames": motion.frames,
            "fps": motion.fps,
            "seconds": round(motion.frames / motion.fps, 3),
            "residual_mm": float(np.mean(values)),
            "residual_max_mm": float(np.max(values)),
            "ground_shift_m": shift,
            "stance_frames": stance,
            "n_glitch": n_glitch,
            "slip_mps": slip_speed(joints, contacts, motion.fps),
        },
    )


def resampled(found: Conversion, body: BodyModel, fps: float) -> Conversion:
    """A conversion at another rate; contacts are those of the nearest recorded frame."""
    motion = found.motion.resample(fps)
    place = (motion.times - found.motion.start_time) * found.motion.fps
    nearest = place.round().long().clamp(max=found.motion.frames - 1)
    note = f"resampled from {found.motion.fps:g} to {fps:g} frames per second"
    return dataclasses.replace(
        found,
        motion=motion,
        joints=body.pose(motion).joints,
        contacts=found.contacts[nearest],
        decisions=(*found.decisions, note),
        report={**found.report, "frames": motion.frames, "fps": motion.fps},
    )


def glitches(recording: SkeletonRecording) -> tuple[int, ...]:
    """Frames after which a joint is elsewhere: it would have to be faster than 20 m/s.

    Joints below the wrists and tips of bones are not asked.
    """
    asked = [
        joint
        for joint, name in enumerate(recording.joint_names)
        if not name.endswith("_end") and not _is_finger(name)
    ]
    step = np.linalg.norm(np.diff(recording.positions[:, asked], axis=0), axis=-1)
    return tuple((step.max(1) * recording.fps > GLITCH_SPEED).nonzero()[0].tolist())


def _is_finger(name: str) -> bool:
    word = name.lower()
    return any(part in word for part in ("finger", "thumb", "index", "mid", "ring", "pinky"))

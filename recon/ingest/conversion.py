"""Converts recorded skeletons to motions of the body model, with residuals and findings."""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from recon.body.contacts import contact_labels, rest_heights
from recon.body.levelling import levelling_rotation, rotated_motion
from recon.body.model import BodyModel
from recon.body.soles import Soles, Stance
from recon.core.bone_names import FINGER_WORDS, side_and_words_of
from recon.core.motion import Motion, MotionFile
from recon.core.skeleton import FEET, JOINTS
from recon.diagnosis.findings import Finding
from recon.diagnosis.frame_rate import rate_finding
from recon.diagnosis.movement import belt_velocity, support_findings, treadmill_finding
from recon.formats.motions import save_motion
from recon.ingest.skeleton import FittedSkeleton, fit_skeletons
from recon.ingest.subject import SubjectModel
from recon.metrics.errors import slip_speed
from recon.mocap.recording import SkeletonRecording

GLITCH_SPEED = 20.0
"""Speed (m/s) that no joint of a body reaches: between such frames the recording jumps."""
_ENDS_OF_HANDS = 4
"""Joints named after fingers that skeletons without fingers may have, as CMU's do."""
_FINGERS = ("finger", "thumb", "index", "mid", "ring", "pinky")


@dataclass(frozen=True)
class Conversion:
    """A recording converted to a motion of the body model, with what was found and decided."""

    motion: Motion
    joints: Float[Tensor, "time 22 3"]
    """Joint positions in the world, metres."""
    contacts: Bool[Tensor, "time 22"]
    """Whether each joint touches the ground, judged at the recording's rate."""
    residuals: Mapping[str, float]
    """Mean distance of each joint or marker from the fitted one, offset included, millimetres."""
    ground_shift: float
    """Metres by which the recording was lowered."""
    decisions: tuple[str, ...]
    """What was read, guessed or cut, one sentence each."""
    report: Mapping[str, float | int | str | None]
    """Numbers for a row of a table: frames, fps, residual_mm, slip_mps, ..."""
    observed: Bool[Tensor, "time 22"] | None = None
    """False where a joint was inferred rather than seen; None where every joint was seen."""
    diagnosis: tuple[Finding, ...] = ()
    """Residuals by joint or marker, and by second of the recording."""
    repairs: tuple[Finding, ...] = ()
    """Errors of the recording that were corrected."""
    warnings: tuple[Finding, ...] = ()
    """Possible errors of the result."""
    ground: tuple[float, float, float, float] = (0.0, 0.0, 1.0, 0.0)
    """Plane n·x = d on which the feet stand, as (nx, ny, nz, d), metres."""
    on_belt: bool = False
    """Whether the feet stand on the moving belt of a treadmill; contacts are then not saved."""

    def findings(self) -> dict[str, list[dict[str, Any]]]:
        """Return `diagnosis`, `repairs` and `warnings` as lists of dictionaries for a report."""
        lists = {"diagnosis": self.diagnosis, "repairs": self.repairs, "warnings": self.warnings}
        return {name: [one.report() for one in found] for name, found in lists.items()}

    def file(self, body: BodyModel, *, contacts: bool = True) -> MotionFile:
        """Return the contents of a motion file, with joints and, if wanted, contacts."""
        return MotionFile(
            motion=self.motion,
            body=body.name,
            checksum=body.checksum,
            joints=self.joints,
            contacts=self.contacts.to(self.joints) if contacts and not self.on_belt else None,
            observed=self.observed,
            ground=torch.tensor(self.ground),
        )

    def save(self, path: str | Path, body: BodyModel, *, contacts: bool = True) -> None:
        """Write the motion as an AMASS file."""
        save_motion(path, self.file(body, contacts=contacts))


_MOSTLY_TOO_FAST = 0.2
"""Share of frames with impossible speeds from which on they are no single glitches."""


def convert_skeletons(
    recordings: Sequence[SkeletonRecording],
    subject: SubjectModel,
    body: BodyModel,
    *,
    keep_frame: bool = False,
) -> list[Conversion]:
    """Convert recordings of one calibrated skeleton and one frame rate, as a batch of clips.

    With `keep_frame`, motions stay where the recordings have them instead of standing on z = 0.
    """
    soles = Soles.of(body)
    solved = fit_skeletons(recordings, subject, body)
    names = tuple(JOINTS[joint] for joint in subject.skeleton.joints)
    return [
        _conversion_of(recording, found, names, body, soles, keep_frame)
        for recording, found in zip(recordings, solved, strict=True)
    ]


def _conversion_of(
    recording: SkeletonRecording,
    solved: FittedSkeleton,
    names: tuple[str, ...],
    body: BodyModel,
    soles: Soles,
    keep_frame: bool,
) -> Conversion:
    jumps = jump_frames(recording)
    sided = [words for side, words in map(side_and_words_of, recording.joint_names) if side]
    fingers = [words for words in sided if FINGER_WORDS.keys() & words and "end" not in words]
    lost = f"{len(fingers)} joints of fingers are left out: skeletons give the body alone"
    found = on_ground(
        solved.motion,
        dict(zip(names, (1000 * solved.residuals).tolist(), strict=True)),
        (*recording.decisions, *([lost] if len(fingers) > _ENDS_OF_HANDS else ())),
        body,
        soles,
        n_glitch=len(jumps),
        keep_frame=keep_frame,
    )
    source = found.joints.clone()
    known = [joint for joint in FEET if JOINTS[joint] in names]
    source[:, known] = solved.source_feet
    slip = slip_speed(source, found.contacts, solved.motion.fps)
    warnings, share = found.warnings, len(jumps) / solved.motion.frames
    if share > _MOSTLY_TOO_FAST:
        said = (
            f"a joint is faster than {GLITCH_SPEED:g} m/s in {share:.0%} of the frames: perhaps "
            "the root's translations have another unit than the bones, or the frame rate is wrong"
        )
        warnings = (*warnings, Finding("jump", said, value=share))
    report = {**found.report, "slip_source_mps": slip}
    return dataclasses.replace(found, report=report, warnings=warnings)


def on_ground(
    motion: Motion,
    residuals: Mapping[str, float],
    decisions: tuple[str, ...],
    body: BodyModel,
    soles: Soles,
    *,
    n_glitch: int,
    observed: Bool[Tensor, "time 22"] | None = None,
    keep_frame: bool = False,
) -> Conversion:
    """Move a fitted motion onto the ground z = 0 and label contacts; return a `Conversion`.

    The ground is the plane of the soles that stand (`recon.body.soles.Stance`): a tilted one is
    levelled, and the motion is lowered to it. With `keep_frame`, and where no foot is ever
    observed, the motion stays where it is; `ground` is then the plane of the soles.
    """
    given, unseen = motion, observed is not None and not bool(observed[:, list(FEET)].any())
    belt = belt_velocity(motion, body, observed)
    placed = None if observed is None else observed.any(-1)
    stance = Stance.of(motion, body, soles, belt, placed)
    notes: list[str] = []
    tilt = 0.0
    if (rotation := levelling_rotation(stance)) is not None:
        motion = rotated_motion(motion, rotation, body)
        stance = Stance.of(motion, body, soles, belt, placed)
        tilt = math.degrees(math.acos(min(1.0, float(rotation[2, 2]))))
        notes.append(f"levelled by {tilt:.1f} degrees: the soles stand on a tilted plane")
    shift = 0.0 if unseen else stance.ground_height()
    down = motion.translation.new_tensor([0.0, 0.0, shift])
    motion = motion.replace(translation=motion.translation - down)
    joints = body.pose(motion).joints
    contacts = contact_labels(joints, rest_heights(body, motion.shape), motion.fps)
    contacts = contacts if observed is None else contacts & observed
    seen = (
        f"in {stance.standing_frames} frames of stance"
        if stance.standing_frames > 0
        else "in all frames"
    )
    if unseen:
        notes.append("no foot is ever observed: the height of the recording was kept")
    elif not keep_frame:
        notes.append(f"lowered by {shift:.3f} m: 5th percentile of the soles {seen}")
    if n_glitch > 0:
        notes.append(f"{n_glitch} jumps: a joint is faster than {GLITCH_SPEED:g} m/s")
    values = list(residuals.values())
    plane = (0.0, 0.0, 1.0, 0.0)
    if keep_frame:
        plane = _ground_in_given_frame(given, motion, body)
        notes = [f"the recording's frame was kept, z up; the soles stand at {plane[3]:.3f} m"]
    judged = (
        rate_finding(motion, body, observed),
        None if belt is None else treadmill_finding(belt),
        *support_findings(motion, body, observed),
    )
    return Conversion(
        motion=given if keep_frame else motion,
        joints=body.pose(given).joints if keep_frame else joints,
        contacts=contacts,
        residuals=residuals,
        ground_shift=0.0 if keep_frame else shift,
        decisions=(*decisions, *notes),
        report={
            "frames": motion.frames,
            "fps": motion.fps,
            "seconds": round(motion.frames / motion.fps, 3),
            "residual_mm": float(np.mean(values)),
            "residual_max_mm": float(np.max(values)),
            "ground_shift_m": 0.0 if keep_frame else shift,
            "tilt_degrees": 0.0 if keep_frame else round(tilt, 2),
            "stance_frames": stance.standing_frames,
            "n_glitch": n_glitch,
            "slip_mps": slip_speed(joints, contacts, motion.fps),
        },
        observed=observed,
        diagnosis=tuple(
            Finding("residual", f"{name}: {value:.1f} mm on average", (name,), (), value / 1000)
            for name, value in residuals.items()
        ),
        warnings=tuple(finding for finding in judged if finding is not None),
        ground=plane,
        on_belt=belt is not None,
    )


def _ground_in_given_frame(
    given: Motion, moved: Motion, body: BodyModel
) -> tuple[float, float, float, float]:
    """Return the ground, which is z = 0 after a move, as a plane n·x = d before the move."""
    here, there = (body.pose(one.window(0, 1)) for one in (given, moved))
    turn = there.orientations[0, 0] @ here.orientations[0, 0].mT
    normal = turn[2]  # row 2 of a rotation is the vector that it maps to z
    height = normal @ here.joints[0, 0] - there.joints[0, 0, 2]
    nx, ny, nz = normal.tolist()
    return nx, ny, nz, float(height)


def resampled(found: Conversion, body: BodyModel, fps: float) -> Conversion:
    """Resample a conversion to another frame rate; contacts are those of the nearest frames."""
    motion = found.motion.resample(fps)
    place = (motion.times - found.motion.start_time) * found.motion.fps
    nearest = place.round().long().clamp(max=found.motion.frames - 1)
    note = f"resampled from {found.motion.fps:g} to {fps:g} frames per second"
    return dataclasses.replace(
        found,
        motion=motion,
        joints=body.pose(motion).joints,
        contacts=found.contacts[nearest],
        observed=None if found.observed is None else found.observed[nearest],
        decisions=(*found.decisions, note),
        report={**found.report, "frames": motion.frames, "fps": motion.fps},
    )


def jump_frames(recording: SkeletonRecording) -> tuple[int, ...]:
    """Return the frames after which a joint jumps, that is, moves faster than 20 m/s.

    Joints of fingers and tips of bones are left out.
    """
    checked = [
        joint
        for joint, name in enumerate(recording.joint_names)
        if not name.endswith("_end") and not any(word in name.lower() for word in _FINGERS)
    ]
    step = np.linalg.norm(np.diff(recording.positions[:, checked], axis=0), axis=-1)
    return tuple((step.max(1) * recording.fps > GLITCH_SPEED).nonzero()[0].tolist())

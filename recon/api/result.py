"""The result of a fit: the motion, its uncertainty, findings and report."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from time import monotonic
from typing import Any

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from recon.api.results import MotionResult, described_residual, in_ten_lines
from recon.body.contacts import contact_labels, rest_heights
from recon.body.model import BodyModel
from recon.core import rotations as so3
from recon.core.motion import FilmingCamera, Motion, MotionFile
from recon.core.residuals import Noise
from recon.diagnosis.certainty import AlternativeMotion, certainty_report
from recon.diagnosis.examination import ExaminedClip, ResidualSummary
from recon.diagnosis.findings import Finding
from recon.fitting.records import Clip
from recon.method.derivatives import GroundDeviation
from recon.method.reconstruction import Reconstruction
from recon.method.sensor import unposed_camera, views_of
from recon.method.stages import StageReport, Watch
from recon.solver.lbfgs import Progress, Termination


def describe(
    result: Reconstruction, inputs: Mapping[str, str], settings: Mapping[str, Any]
) -> dict[str, Any]:
    """Stages, windows, settings and inputs of a fit: the beginning of OUT.json.

    Args:
        result: of the fit.
        inputs: SHA-256 of everything that was read, by path (`recon.reading.inputs`).
        settings: of the fit, by name.
    """
    from recon.formats.reports import versions  # imported only when a result is written

    return {
        "failed": result.failed[0],
        "stages": [_stage_report(report) for report in result.reports],
        "windows": [
            {"start": start, "stop": stop, "failed": row in result.failed_windows}
            for row, (start, stop) in enumerate(result.windows)
        ],
        "settings": dict(settings),
        "inputs": dict(inputs),
        "versions": versions(),
    }


def _stage_report(report: StageReport) -> dict[str, Any]:
    """Return a stage's report for JSON: the most iterations and summed energies of all windows."""
    solution = report.solution
    energies = solution.trace[:, -1].sum(0).tolist()
    reasons = [reason for reason in Termination if reason in solution.termination]
    return {
        "name": report.stage.name,
        "seconds": round(report.seconds, 4),
        "iterations": int(solution.iterations.max()),
        "evaluations": int(solution.evaluations.max()),
        "termination": "; ".join(reason.value for reason in reasons),
        "energies": {
            term.name: value for term, value in zip(report.stage.terms, energies, strict=True)
        },
    }


def motion_file_of(
    motion: Motion,
    body: BodyModel,
    ground: float | None = 0.0,
    T_world_camera: Float[Tensor, "4 4"] | None = None,
    observed: Bool[Tensor, "time 22"] | None = None,
    belt: Float[Tensor, "time 3"] | None = None,
    joint_std: Float[Tensor, "time 22"] | None = None,
    ground_std: Float[Tensor, "2"] | None = None,
    contact_probability: Float[Tensor, "time 22"] | None = None,
    angle_std: Float[Tensor, "time 42"] | None = None,
    cameras: tuple[FilmingCamera, ...] = (),
) -> MotionFile:
    """Return a motion file with joints, ground and contacts, which need a ground.

    Where a camera's pose was found, the file has it and the root in the camera's frame besides.
    On a treadmill, contacts are told against the belt, by how far it has come.

    Args:
        motion: one clip, no batch axis.
        body: whose motion it is.
        ground: height of the ground, metres; None where there is none.
        T_world_camera: of a camera whose pose was found, metres.
        observed: false where a joint was inferred rather than seen.
        belt: how far the treadmill's belt has come at every frame, metres.
        joint_std: standard deviation of a coordinate of every joint, metres.
        ground_std: standard deviations of a ground that was found; see `MotionFile`.
        contact_probability: how likely each joint touches the ground.
        angle_std: standard deviations of joint angles; see `MotionFile`.
        cameras: that filmed it.
    """
    joints = body.pose(motion).joints
    contacts = None
    if ground is not None:
        above = joints - joints.new_tensor([0.0, 0.0, ground])
        if belt is not None:
            above = above - belt[:, None]
        heights = rest_heights(body, motion.shape)
        contacts = contact_labels(above, heights, motion.fps).to(joints)
    return MotionFile(
        motion,
        body=body.name,
        checksum=body.checksum,
        joints=joints,
        contacts=contacts,
        ground=None if ground is None else torch.tensor([0.0, 0.0, 1.0, ground]),
        ground_std=None if ground is None else ground_std,
        contact_probability=None if ground is None else contact_probability,
        joint_std=joint_std,
        angle_std=angle_std,
        observed=observed,
        T_world_camera=None if T_world_camera is None else T_world_camera[None],
        in_camera=None if T_world_camera is None else in_camera(motion, T_world_camera, body),
        cameras=cameras,
    )


def in_camera(
    motion: Motion, T_world_camera: Float[Tensor, "4 4"], body: BodyModel
) -> Float[Tensor, "time 6"]:
    """Return SMPL translation (m) and root rotation vector of a motion in a camera's frame."""
    pelvis = body.rest_joints(motion.shape)[..., 0, :]
    seen = motion.carried(torch.linalg.inv(T_world_camera), pelvis)
    return torch.cat((seen.translation, so3.log(seen.rotations[:, 0].double()).float()), -1)


@dataclass(frozen=True, repr=False)
class Result(MotionResult):
    """One clip's motion and everything the fit knows about it; tensors have no leading axis."""

    examined: ExaminedClip
    """The fit, and what is known about the data and the result."""
    notes: tuple[str, ...]
    """What was assumed in reading files."""
    cycle: dict[str, Any] | None
    """Facts about a completed gait cycle: seconds, moments seen, distance of its code from those
    of recorded cycles."""
    arguments: Mapping[str, Any]
    """What `recon.fit` was called with, in plain values."""

    @property
    def T_world_camera(self) -> Float[Tensor, "4 4"] | None:
        """Pose that the fit found for a camera that was given without a pose; metres."""
        return None if self.file.T_world_camera is None else self.file.T_world_camera[0]

    @property
    def residuals(self) -> tuple[ResidualSummary, ...]:
        """Summary of every observation's residuals after the fit, in the observation's unit."""
        return self.examined.residuals

    @property
    def noises(self) -> tuple[Noise, ...]:
        """Standard deviation of every observation, given or estimated."""
        return self.examined.fit.noises

    @property
    def diagnosis(self) -> tuple[Finding, ...]:
        """Findings that are no fault: unobserved limbs, steps, seats."""
        return self.examined.diagnosis

    @property
    def repairs(self) -> tuple[Finding, ...]:
        """Faults of the data that were repaired before the fit."""
        return self.examined.repairs

    @property
    def shape_std(self) -> Float[Tensor, " shape"] | None:
        """Standard deviation of every shape coefficient; None where none is known."""
        found = self.examined.deviations
        return None if found is None else found.shape.float()

    @property
    def root_std(self) -> Float[Tensor, " time"] | None:
        """Standard deviation of the root's rotation in radians, at the frames of the fit."""
        found = self.examined.deviations
        return None if found is None else found.root.float()

    @property
    def ground_std(self) -> GroundDeviation | None:
        """Standard deviations of the ground where it was found; None where it was known."""
        found = self.examined.deviations
        return None if found is None else found.ground

    @property
    def contact_probability(self) -> Float[Tensor, "time 22"] | None:
        """Probability that a joint touches the ground; None without a ground, and on a treadmill.

        By height, speed and standard deviation of the joints that were found; `contacts` are
        labels, 0 or 1, which are 1 where it is above one half.
        """
        return self.file.contact_probability

    @property
    def alternatives(self) -> tuple[AlternativeMotion, ...]:
        """Other motions that explain the data, the likeliest first, with their energies.

        They are first guesses (headings, postures, beginnings of a gait cycle) that the fit
        compared and gave up. Most sensors leave no doubt, and there are none.
        """
        return self.examined.alternatives

    @property
    def failed(self) -> bool:
        """Whether the fit met NaN or infinity; the motion is then its last finite estimate."""
        return self.examined.fit.result.failed[0]

    @property
    def reconstruction(self) -> Reconstruction:
        """The stages with their energies, as `recon.method.reconstruction.solve` returns them."""
        return self.examined.fit.result

    def report(
        self, inputs: Mapping[str, str] | None = None, settings: Mapping[str, Any] | None = None
    ) -> dict[str, Any]:
        """The report saved beside the motion: stages, noise, residuals, findings.

        Args:
            inputs: as of `MotionResult.report`.
            settings: of the fit, by name; by default its arguments.
        """
        fit = self.examined.fit
        report = describe(
            fit.result, inputs or {}, self.arguments if settings is None else settings
        )
        report |= {
            "noise": [asdict(noise) for noise in fit.noises],
            "ground_known": fit.ground_known,
            "grounded": fit.grounded,
            "read": self.notes,
            "residuals": [summary.report() for summary in self.residuals],
        }
        if self.examined.deviations is not None:
            report["standard_deviations"] = certainty_report(
                self.examined.deviations, self.certainty
            )
        if self.alternatives:
            report["alternatives"] = [one.report() for one in self.alternatives]
        if self.cycle is not None:
            report["cycle"] = self.cycle
        return report | {
            "diagnosis": [finding.report() for finding in self.diagnosis],
            "repairs": [finding.report() for finding in self.repairs],
            "warnings": [finding.report() for finding in self.warnings],
        }

    def __repr__(self) -> str:
        """A summary of at most ten lines: length, person, residuals, and findings."""
        first = self._headline() + (", FAILED: NaN or infinity" if self.failed else "")
        found = [f"repaired: {finding.message}" for finding in self.repairs]
        found += [f"warning: {finding.message}" for finding in self.warnings]
        sure = self.certainty
        known = [] if sure is None else [f"standard deviation of a joint: {sure}"]
        known += map(described_residual, self.residuals)
        return in_ten_lines(first, known, found)


def result_of(
    examined: ExaminedClip,
    clip: Clip,
    body: BodyModel,
    fps: float | None,
    completes: bool,
    arguments: Mapping[str, Any],
    stopped: Finding | None,
) -> Result:
    """Describe a fit as a `Result`, at the frame rate `fps` and in the recording's coordinates.

    Args:
        examined: the fit.
        clip: what was fitted.
        body: whose motion it is, on the processor.
        fps: rate of the result; None is that of the first observation.
        completes: whether a gait cycle or a recording was completed.
        arguments: of the fit, in plain values.
        stopped: why the fit was ended early, if it was.
    """
    found = examined.fit
    motion = found.result.clip(0).detach()
    first = clip.observations[0]
    # a completed recording may have fewer frames per second than the fit: keep the higher rate
    rate = max(first.fps, motion.fps) if completes else first.fps
    seen = max(one.start_time - motion.start_time + one.duration for one in clip.observations)
    # a motion at the 30 Hz of HuMoR's networks may outlast the data by up to one frame: cut it
    duration = motion.duration if completes else min(seen, motion.duration)
    motion = motion.resample(rate if fps is None else fps, duration)
    T, ground = found.T_world_recording[0].double().clone(), 0.0 if found.grounded else None
    if found.grounded and clip.T_recording_camera is None and not found.ground_known:
        # 3D data with z up keep their coordinates, in which the ground has the fitted height
        ground = -float(T[2, 3])
        raised = motion.translation + motion.translation.new_tensor([0.0, 0.0, ground])
        motion = motion.replace(translation=raised)
        T[2, 3] = 0.0
    T_world_camera = None
    T_recording_camera = clip.T_recording_camera
    if found.lens_found:  # a fitted focal length moves the camera
        T_recording_camera = unposed_camera(found.observations)
    if T_recording_camera is not None:
        T_world_camera = (T @ torch.from_numpy(T_recording_camera)).float()
    cycle = None
    if completes:
        # imported only when a gait cycle or a sparse recording was completed
        from recon.api.cycle import cycle_report
        from recon.method.cycle_prior import CyclePrior

        if isinstance(found.result.reports[-1].stage.prior, CyclePrior):
            cycle = cycle_report(found, [one.median for one in examined.residuals])
    belt, cameras = None, ()
    if views_of(found.observations):
        from recon.api.filming import filming_cameras  # imported only when a clip has images

        cameras = filming_cameras(examined, clip, T, motion)
    if examined.belt is not None:
        from recon.diagnosis.movement import motion_in_room, path_of_belt  # rarely needed

        belt = path_of_belt(motion, examined.belt)
        motion = motion_in_room(motion, examined.belt)
    if any(getattr(one, "fingers", None) is not None for one in clip.observations):
        from recon.api.hands import with_fingers  # imported only when a clip shows hands

        motion, said = with_fingers(motion, body, clip.observations, found.observations, T)
        examined = replace(examined, found=examined.found + said)
    known = examined.results_at_frames_of(motion)
    if belt is not None:
        # on a treadmill the prior's contacts are with the belt, not with the floor of the room
        known["contact_probability"] = None
    return Result(
        file=motion_file_of(
            motion, body, ground, T_world_camera, belt=belt, cameras=cameras, **known
        ),
        body=body,
        examined=examined,
        warnings=(
            *(() if stopped is None else (stopped,)),
            *examined.warnings,
            *(() if cycle is None else cycle[1]),
        ),
        notes=clip.notes,
        cycle=None if cycle is None else cycle[0],
        arguments=arguments,
    )


class Stopper:
    """Stops a fit when the callback asks for it or its time limit is reached.

    A fit is several minimisations in turn, and some of them are needed to make a motion at all.
    After the first stop each of them ends at its first step, so that the estimate so far passes
    through the rest within moments.
    """

    def __init__(self, callback: Watch | None, max_seconds: float | None) -> None:
        self._callback, self._seconds = callback, max_seconds
        self._deadline = None if max_seconds is None else monotonic() + max_seconds
        self.reason: str | None = None
        """The reason why the fit was stopped; None while it was not."""

    def __call__(self, stage: str, progress: Progress) -> bool:
        """Whether the fit should stop; after a first True the user's callback is not called."""
        if self.reason is None:
            self.reason = self._reason_to_stop(stage, progress)
        return self.reason is not None

    def _reason_to_stop(self, stage: str, progress: Progress) -> str | None:
        """Return why the fit should stop now (callback or time limit); None to go on."""
        if self._callback is not None and self._callback(stage, progress) is True:
            return "the callback"
        if self._deadline is not None and monotonic() > self._deadline:
            return f"max_seconds = {self._seconds:g}"
        return None

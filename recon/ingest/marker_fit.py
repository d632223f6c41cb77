"""Fits a body model's motion to markers at constant offsets from the skin (the idea of MoSh).

Loper, Mahmood and Black, MoSh, 2014: a marker sits a little off the skin and not quite where its
name says. Its offset is found together with the body's shape from some frames, then held constant.
"""

from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from observations.start.rigid import rigid_start
from recon.body.model import BodyModel
from recon.body.soles import Soles
from recon.core.errors import ReconError
from recon.core.motion import Motion
from recon.core.skeleton import JOINTS
from recon.ingest.marker_calibration import CalibratedFrames, SubjectEnergies, calibrated_frames
from recon.ingest.marker_frames import fit_all_frames, fit_singly, repaired_frames
from recon.ingest.marker_gaps import (
    interpolated_poses,
    joints_with_shown_rotation,
    observed_joints,
    placed_frames,
    with_gaps_filled,
)
from recon.ingest.marker_neighbours import fitted_about_gaps, frames_about_gaps
from recon.ingest.marker_poses import (
    PoseEnergies,
    Poses,
    SkinPoints,
    natural_pose,
    with_natural_pose,
)
from recon.ingest.marker_sets import MarkerSet
from recon.method.protocols import REFERENCE_FPS
from recon.mocap.recording import MarkerRecording

OUTLIER = 0.1
"""Scale (m) of the robust kernel, so that markers of exchanged labels and ghosts count less."""
CALIBRATION_FRAMES = 150
_ENOUGH = 15
"""Number of calibration frames that must show a marker to find its offset."""
_SHARES = (0.9, 0.8, 0.7, 0.6, 0.5, 0.0)
"""Least numbers of markers in a calibration frame, over the largest, in the order tried."""
_FOOT_MARKER = (0.0, 0.08)
"""Range of the height (m) above the ground of the lowest marker of a body that stands."""
_KEY_RATE = 10.0


# weights of energies, relative to half the sum of squared distances of markers (m²)
SHAPE_WEIGHT = 6e-5
BONY_WEIGHT, LOOSE_WEIGHT = 0.3, 0.03
"""Weights per frame: offsets of markers on bony landmarks, and of those anywhere on a limb."""
REST_WEIGHT = 1e-3
"""Weight of the distance from the natural pose."""
TURNING_WEIGHT = 2e-4
"""Weight of the rotation of joints from frame to frame."""
GROUND_WEIGHT = 20.0
"""Weight of soles below the ground, where the recording's ground is z = 0."""


@dataclass(frozen=True)
class MarkerFit:
    """The body model's motion fitted to markers, and the markers' constant offsets."""

    motion: Motion
    offsets: Float[Tensor, "markers 3"]
    """Offsets of the markers from the skin, in the frames of their bones, metres."""
    predicted: Float[Tensor, "time markers 3"]
    """Fitted position of every marker, metres; markers left out of the fit have no fitted
    offset."""
    observed: Bool[Tensor, "time 22"]
    """Whether a marker locates each joint; the positions of all others are inferred."""
    repaired: Bool[Tensor, " time"]
    """Whether a frame was solved again because the body was far from its markers."""
    unsupported: Bool[Tensor, "steps 22"]
    """Whether a joint still moves from a frame to the next although no marker near it does."""


def fit_markers(recording: MarkerRecording, markers: MarkerSet, body: BodyModel) -> MarkerFit:
    """Fit shape and marker offsets to some frames, then the poses of all frames.

    Args:
        recording: of exactly the markers of the set, in their order.
        markers: their vertices on the body and expected offsets.
        body: the body model that is fitted.

    Raises:
        ValueError: when no frame shows enough markers to place a body.
    """
    with torch.no_grad():
        visible, bones = torch.from_numpy(recording.visible), markers.bones
        shown = placed_frames(visible, bones)
        placed = shown.nonzero()[:, 0]
        if len(placed) == 0:
            raise ReconError(
                f"{recording.name}: no frame shows enough markers of one body to place it; at "
                f"most {int(visible.sum(-1).max())} of {len(markers.labels)} are seen in one frame"
            )
        chosen = _frames_with_most_markers(visible, shown)
        subject = subject_energies(recording, markers, body)
        found = _calibrated_to_frames(subject.frames(chosen), bones)
        offsets, poses = found.offsets, found.poses
        motion = Motion.create(poses.translation, poses.rotations, found.shape, recording.fps)
        energies = subject.for_body(found.shape, offsets)
        step = max(1, round(recording.fps / _KEY_RATE))
        keys = torch.unique(torch.cat((placed[::step], placed[-1:])))
        motion = fit_singly(energies, keys, interpolated_poses(motion, chosen, keys))
        near_gaps = frames_about_gaps(visible, recording.fps) & shown
        if bool(near_gaps.any()):
            points = partial(SkinPoints.of, body, found.shape, subject.vertices)
            energies, offsets, motion, keys = fitted_about_gaps(
                energies, points, offsets, bones, motion, keys, near_gaps
            )
        energies = energies.frames(placed)
        motion = fit_all_frames(energies, interpolated_poses(motion, keys, placed))
        motion, changed, unsupported = repaired_frames(
            energies, bones, lambda motion: body.pose(motion).joints, motion
        )
        motion = with_gaps_filled(motion, placed, joints_with_shown_rotation(visible, bones))
        motion = motion.replace(start_time=recording.start_time)
        predicted = _marker_positions(motion, offsets, subject.vertices, body)
    return MarkerFit(
        motion,
        offsets,
        predicted,
        observed=observed_joints(visible, markers.vertices, body),
        repaired=_flags_over_rows(changed, placed, recording.frames),
        unsupported=_flags_over_rows(unsupported, placed[1:] - 1, recording.frames - 1),
    )


def subject_energies(
    recording: MarkerRecording, markers: MarkerSet, body: BodyModel
) -> SubjectEnergies:
    """Return the energies of all frames, for a person of unknown shape and marker offsets."""
    visible, vertices = torch.from_numpy(recording.visible), torch.tensor(markers.vertices)
    positions = torch.from_numpy(recording.positions).float().where(visible[..., None], 0.0)
    rate, average = REFERENCE_FPS / recording.fps, positions.new_zeros(body.shape_size)
    loose = torch.tensor(markers.loose)
    poses = PoseEnergies(
        rest=body.rest_joints(average),
        markers=SkinPoints.of(body, average, vertices, markers.nominal),
        soles=None,
        positions=positions.mT.contiguous(),
        visible=visible.to(positions),
        linked=torch.ones(len(visible) - 1, dtype=torch.bool),
        natural=natural_pose()[None],
        pull=positions.new_full((1,), REST_WEIGHT),
        ground=GROUND_WEIGHT,
        turning=torch.full((len(JOINTS),), TURNING_WEIGHT / rate),
        weight=rate,
        sigma=OUTLIER,
    )
    return SubjectEnergies(
        body=body,
        vertices=vertices,
        under=Soles.of(body).points.flatten() if ground_is_zero(recording) else None,
        nominal=markers.nominal,
        stiffness=torch.where(loose, LOOSE_WEIGHT, BONY_WEIGHT),
        stature=SHAPE_WEIGHT,
        poses=poses,
        with_offsets=True,
    )


def _calibrated_to_frames(some: SubjectEnergies, bones: tuple[int, ...]) -> CalibratedFrames:
    """Fit shape, marker offsets and poses of some frames, without ties between these frames."""
    body, poses = some.body, some.poses.untied()
    poses = replace(poses, weight=1.0, turning=poses.weight * poses.turning)
    start = rigid_start(
        body, body.template[some.vertices], bones, poses.positions.mT.contiguous(),
        poses.visible > 0, fps=REFERENCE_FPS, start_time=0.0,
    )  # fmt: skip
    rotations = with_natural_pose(start.rotations)
    return calibrated_frames(replace(some, poses=poses), start.translation, rotations, OUTLIER)


def nominal_positions(
    fit: MarkerFit, markers: MarkerSet, body: BodyModel
) -> Float[Tensor, "time markers 3"]:
    """Return the positions (m) of markers on a fitted body if all had their expected offsets."""
    with torch.no_grad():
        return _marker_positions(fit.motion, markers.nominal, torch.tensor(markers.vertices), body)


def _marker_positions(
    motion: Motion, offsets: Tensor, vertices: Int[Tensor, " markers"], body: BodyModel
) -> Float[Tensor, "time markers 3"]:
    points = SkinPoints.of(body, motion.shape, vertices, offsets)
    rest = body.rest_joints(motion.shape)
    return points.places(Poses.of(motion.translation, motion.rotations, rest)).mT


def _flags_over_rows(
    values: Bool[Tensor, "..."], index: Int[Tensor, " rows"], count: int
) -> Tensor:
    """Spread flags over `count` rows: given values at the rows `index`, false elsewhere."""
    everything = torch.zeros(count, *values.shape[1:], dtype=torch.bool)
    everything[index] = values
    return everything


def _frames_with_most_markers(
    visible: Bool[Tensor, "time markers"], placed: Bool[Tensor, " time"]
) -> Int[Tensor, " chosen"]:
    """Choose frames for the calibration, spread over the recording, that show most markers.

    Frames with fewer markers are taken, too, if a marker would otherwise be seen in hardly any of
    the chosen frames, from which alone its offset is found.
    """
    count = visible.sum(-1)
    wanted = visible[placed].sum(0).clamp(max=_ENOUGH)
    chosen = count.new_zeros(0)
    for share in _SHARES:
        good = ((count >= share * count.max()) & placed).nonzero()[:, 0]
        pick = np.linspace(0, len(good) - 1, min(CALIBRATION_FRAMES, len(good))).round()
        chosen = good[torch.from_numpy(np.unique(pick.astype(int)))]
        if bool((visible[chosen].sum(0) >= wanted).all()):
            break
    return chosen


def ground_is_zero(recording: MarkerRecording) -> bool:
    """Return whether z = 0 is the ground: the lowest markers are as high as those of a foot."""
    low = np.where(recording.visible, recording.positions[..., 2], np.inf).min(-1)
    low = low[np.isfinite(low)]
    return len(low) > 0 and _FOOT_MARKER[0] < float(np.quantile(low, 0.1)) < _FOOT_MARKER[1]

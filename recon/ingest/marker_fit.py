"""The marker fit: a motion with constant marker offsets from the skin (the idea of MoSh).

Loper, Mahmood and Black, MoSh, 2014: a marker sits a little off the skin and not quite where its
name says; where exactly is found together with the body's shape from a few frames, and held.
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
from recon.ingest.marker_calibration import CalibratedFrames, SubjectEnergies, calibrated
from recon.ingest.marker_frames import repaired_frames, solved_apart, solved_together
from recon.ingest.marker_gaps import (
    interpolated_poses,
    observed_joints,
    placed_frames,
    turned_joints,
    with_gaps_filled,
)
from recon.ingest.marker_neighbours import frames_about_gaps, joined_in_time
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
"""Metres at which a marker counts half as much: swapped labels, ghosts."""
CALIBRATION_FRAMES = 150
_ENOUGH = 15
"""Frames in which a marker must be seen for its offset to be found."""
_SHARES = (0.9, 0.8, 0.7, 0.6, 0.5, 0.0)
"""Shares of the largest number of markers in a frame that make it well seen, in this order."""
_FOOT_MARKER = (0.0, 0.08)
"""Metres above the ground of the lowest marker of a body that stands."""
_KEY_RATE = 10.0


# weights of energies, relative to half the sum of squared distances of markers (m²)
SHAPE_WEIGHT = 6e-5
BONY_WEIGHT, LOOSE_WEIGHT = 0.3, 0.03
"""Per frame, of offsets of markers on bony landmarks, and of those put anywhere on a limb."""
REST_WEIGHT = 1e-3
"""Weight of the distance from the natural pose."""
TURNING_WEIGHT = 2e-4
"""Weight of the rotation from frame to frame."""
GROUND_WEIGHT = 20.0
"""Weight of soles below the ground, where the recording's ground is z = 0."""


@dataclass(frozen=True)
class MarkerFit:
    """The motion of a body fitted to markers, with the markers' offsets from the skin."""

    motion: Motion
    offsets: Float[Tensor, "markers 3"]
    """Offsets of the markers from the skin, in the frames of their bones, metres."""
    predicted: Float[Tensor, "time markers 3"]
    """Predicted place of every marker, metres; markers left out of the fit have no fitted
    offset."""
    observed: Bool[Tensor, "time 22"]
    """Joints whose place a fitted marker shows; all others are inferred."""
    repaired: Bool[Tensor, " time"]
    """Frames that were solved again because the body left its markers there."""
    unsupported: Bool[Tensor, "steps 22"]
    """Steps to the next frame in which a joint still moves and no marker about it does."""


def fit_markers(recording: MarkerRecording, markers: MarkerSet, body: BodyModel) -> MarkerFit:
    """Fit shape and marker offsets to some frames, then the poses of all frames.

    Args:
        recording: of exactly these markers, in their order.
        markers: their places on the body.
        body: whose motion it becomes.

    Raises:
        ValueError: when no frame shows enough markers to place a body.
    """
    with torch.no_grad():
        visible, bones = torch.from_numpy(recording.visible), markers.bones
        shown = placed_frames(visible, bones)
        placed = shown.nonzero()[:, 0]
        if len(placed) == 0:
            raise ReconError(
                f"{recording.name}: no frame shows enough markers of one body to place it; there "
                f"are {int(visible.sum(-1).max())} of {len(markers.labels)} at most"
            )
        chosen = _frames_with_most_markers(visible, shown)
        subject = subject_energies(recording, markers, body)
        found = _calibrated_to_frames(subject.frames(chosen), bones)
        offsets, poses = found.offsets, found.poses
        motion = Motion.create(poses.translation, poses.rotations, found.shape, recording.fps)
        energies = subject.of(found.shape, offsets)
        step = max(1, round(recording.fps / _KEY_RATE))
        keys = torch.unique(torch.cat((placed[::step], placed[-1:])))
        motion = solved_apart(energies, keys, interpolated_poses(motion, chosen, keys))
        about = frames_about_gaps(visible, recording.fps) & shown
        if bool(about.any()):
            points = partial(SkinPoints.of, body, found.shape, subject.vertices)
            energies, offsets, motion, keys = joined_in_time(
                energies, points, offsets, bones, motion, keys, about
            )
        energies = energies.frames(placed)
        motion = solved_together(energies, interpolated_poses(motion, keys, placed))
        motion, changed, unsupported = repaired_frames(
            energies, bones, lambda motion: body.pose(motion).joints, motion
        )
        motion = with_gaps_filled(motion, placed, turned_joints(visible, bones))
        motion = motion.replace(start_time=recording.start_time)
        predicted = _marker_positions(motion, offsets, subject.vertices, body)
    return MarkerFit(
        motion,
        offsets,
        predicted,
        observed=observed_joints(visible, markers.vertices, body),
        repaired=_among_all_frames(changed, placed, recording.frames),
        unsupported=_among_all_frames(unsupported, placed[1:] - 1, recording.frames - 1),
    )


def subject_energies(
    recording: MarkerRecording, markers: MarkerSet, body: BodyModel
) -> SubjectEnergies:
    """Energies of all frames of a subject whose shape and marker offsets are still unknown."""
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
    """Shape, marker offsets and poses of some frames, taken as independent of each other."""
    body, poses = some.body, some.poses.untied()
    poses = replace(poses, weight=1.0, turning=poses.weight * poses.turning)
    start = rigid_start(
        body, body.template[some.vertices], bones, poses.positions.mT.contiguous(),
        poses.visible > 0, fps=REFERENCE_FPS, start_time=0.0,
    )  # fmt: skip
    rotations = with_natural_pose(start.rotations)
    return calibrated(replace(some, poses=poses), start.translation, rotations, OUTLIER)


def nominal_positions(
    fit: MarkerFit, markers: MarkerSet, body: BodyModel
) -> Float[Tensor, "time markers 3"]:
    """Positions that markers exactly at their landmarks would have on a fitted body, metres."""
    with torch.no_grad():
        return _marker_positions(fit.motion, markers.nominal, torch.tensor(markers.vertices), body)


def _marker_positions(
    motion: Motion, offsets: Tensor, vertices: Int[Tensor, " markers"], body: BodyModel
) -> Float[Tensor, "time markers 3"]:
    points = SkinPoints.of(body, motion.shape, vertices, offsets)
    rest = body.rest_joints(motion.shape)
    return points.places(Poses.of(motion.translation, motion.rotations, rest)).mT


def _among_all_frames(
    values: Bool[Tensor, "..."], index: Int[Tensor, " rows"], count: int
) -> Tensor:
    """Flags of `count` rows: those given, at the rows `index`, and false elsewhere."""
    everything = torch.zeros(count, *values.shape[1:], dtype=torch.bool)
    everything[index] = values
    return everything


def _frames_with_most_markers(
    visible: Bool[Tensor, "time markers"], placed: Bool[Tensor, " time"]
) -> Int[Tensor, " chosen"]:
    """Frames spread over the recording, among those that show most markers.

    Frames that show fewer are taken where a marker would be seen in hardly any frame otherwise:
    its offset is found from these frames alone.
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
    """Whether z = 0 is the ground: the lowest markers are as high as markers on a foot."""
    low = np.where(recording.visible, recording.positions[..., 2], np.inf).min(-1)
    low = low[np.isfinite(low)]
    return len(low) > 0 and _FOOT_MARKER[0] < float(np.quantile(low, 0.1)) < _FOOT_MARKER[1]

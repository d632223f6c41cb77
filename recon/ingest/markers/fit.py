"""Markers on the skin become a motion, with constant offsets of each marker (MoSh's idea).

Loper, Mahmood and Black, MoSh, 2014: a marker sits a little off the skin and not quite where its
name says; where exactly is found together with the body's shape from a few frames, and held.
"""

from collections.abc import Callable
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
from recon.core.struct import TensorStruct
from recon.formats.mocap.recording import MarkerRecording
from recon.ingest.markers.calibration import SubjectEnergies, calibrated
from recon.ingest.markers.coverage import MarkerSet
from recon.ingest.markers.gaps import (
    between,
    bridged,
    observed_joints,
    placed_frames,
    turned_joints,
)
from recon.ingest.markers.neighbours import frames_about_gaps, joined_in_time
from recon.ingest.markers.poses import (
    PoseEnergies,
    Poses,
    SkinPoints,
    natural_pose,
    with_natural_pose,
)
from recon.ingest.markers.stages import mended_frames, solved_apart, solved_in_turn
from recon.method.protocols import REFERENCE_FPS

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


@dataclass(frozen=True)
class MarkerWeights:
    """Multipliers; markers count as ½ Σ distance² in metres²."""

    shape: float = 6e-5
    placed: float = 0.3
    """Per frame, of offsets of markers on bony landmarks."""
    loose: float = 0.03
    """Per frame, of offsets of markers that are put anywhere on a limb."""
    rest: float = 1e-3
    """Weight of the distance from the natural pose."""
    turning: float = 2e-4
    """Weight of the rotation from frame to frame."""
    ground: float = 20.0
    """Weight of soles below the ground, where the recording's ground is z = 0."""


@dataclass(frozen=True)
class MarkerSubject(TensorStruct):
    """Shape of a body and where its markers sit on it."""

    shape: Float[Tensor, " shape"]
    offsets: Float[Tensor, "markers 3"]
    """Offsets from the skin, in the frame of the marker's bone, metres."""


@dataclass(frozen=True)
class MarkerFit:
    """A body moved to meet markers."""

    motion: Motion
    subject: MarkerSubject
    predicted: Float[Tensor, "time markers 3"]
    """Predicted place of every marker, metres; markers left out of the fit have no fitted
    offset."""
    observed: Bool[Tensor, "time 22"]
    """Joints whose place a fitted marker shows; all others are inferred."""
    mended: Bool[Tensor, " time"]
    """Frames that were solved again because the body left its markers there."""
    unmade: Bool[Tensor, "steps 22"]
    """Steps to the next frame in which a joint still moves and no marker about it does."""


def fit_markers(
    recording: MarkerRecording,
    markers: MarkerSet,
    body: BodyModel,
    *,
    weights: MarkerWeights | None = None,
) -> MarkerFit:
    """Shape and offsets from some frames, then the pose of all frames.

    Args:
        recording: of exactly these markers, in their order.
        markers: their places on the body.
        body: whose motion it becomes.
        weights: of the energies.

    Raises:
        ValueError: when no frame shows enough markers to place a body.
    """
    with torch.no_grad():
        data = _Data.of(recording, markers, body, weights or MarkerWeights())
        shown = placed_frames(data.visible, data.bones)
        placed = shown.nonzero()[:, 0]
        if len(placed) == 0:
            raise ReconError(
                f"{recording.name}: no frame shows enough markers of one body to place it; there "
                f"are {int(data.visible.sum(-1).max())} of {len(markers.labels)} at most"
            )
        chosen = _well_seen(data.visible, shown)
        subject, motion = _calibrate(data, chosen)
        energies = data.energies(subject)
        step = max(1, round(recording.fps / _KEY_RATE))
        keys = torch.unique(torch.cat((placed[::step], placed[-1:])))
        motion = solved_apart(energies, keys, between(motion, chosen, keys))
        about = frames_about_gaps(data.visible, data.fps) & shown
        if bool(about.any()):
            joined = joined_in_time(
                energies, data.points(subject), subject.offsets, data.bones, motion, keys, about
            )
            energies, motion, keys = joined.energies, joined.motion, joined.frames
            subject = subject.replace(offsets=joined.offsets)
        energies = energies.frames(placed)
        motion = solved_in_turn(energies, between(motion, keys, placed))
        motion, changed, unmade = mended_frames(
            energies, data.bones, lambda motion: body.pose(motion).joints, motion
        )
        motion = bridged(motion, placed, turned_joints(data.visible, data.bones))
        motion = motion.replace(start_time=recording.start_time)
        predicted = _predicted(motion, subject, data.vertices, body)
    return MarkerFit(
        motion,
        subject,
        predicted,
        observed=observed_joints(data.visible, markers.vertices, body),
        mended=_spread(changed, placed, recording.frames),
        unmade=_spread(unmade, placed[1:] - 1, recording.frames - 1),
    )


@dataclass(frozen=True)
class _Data:
    """Markers of some frames, the body that they sit on, and what poses are held by."""

    positions: Float[Tensor, "frames markers 3"]
    """World, metres; zero where not visible."""
    visible: Bool[Tensor, "frames markers"]
    fps: float
    markers: MarkerSet
    body: BodyModel
    under: Int[Tensor, " soles"] | None
    """Vertices under the feet; None where the ground is not at z = 0."""
    weights: MarkerWeights

    @classmethod
    def of(
        cls,
        recording: MarkerRecording,
        markers: MarkerSet,
        body: BodyModel,
        weights: MarkerWeights,
    ) -> "_Data":
        visible = torch.from_numpy(recording.visible)
        positions = torch.from_numpy(recording.positions).float().where(visible[..., None], 0.0)
        on_ground = stands_on_zero(recording)
        under = Soles.of(body).points.flatten() if on_ground else None
        return cls(positions, visible, recording.fps, markers, body, under, weights)

    @property
    def vertices(self) -> Int[Tensor, " markers"]:
        return torch.tensor(self.markers.vertices)

    @property
    def bones(self) -> tuple[int, ...]:
        """The bone that moves each marker most."""
        return tuple(self.body.weights[self.vertices].argmax(-1).tolist())

    def frames(self, index: Int[Tensor, " chosen"]) -> "_Data":
        """Some of the frames."""
        return replace(self, positions=self.positions[index], visible=self.visible[index])

    def points(self, subject: MarkerSubject) -> Callable[[Tensor], SkinPoints]:
        """The markers on a subject, by their offsets from the skin."""
        return partial(SkinPoints.of, self.body, subject.shape, self.vertices)

    def energies(self, subject: MarkerSubject) -> PoseEnergies:
        """The energies of poses of a known subject, at 30 Hz."""
        rate, under = REFERENCE_FPS / self.fps, self.under
        return PoseEnergies(
            rest=self.body.rest_joints(subject.shape),
            markers=self.points(subject)(subject.offsets),
            soles=None if under is None else SkinPoints.of(self.body, subject.shape, under),
            positions=self.positions.mT.contiguous(),
            visible=self.visible.to(self.positions),
            linked=torch.ones(len(self.visible) - 1, dtype=torch.bool),
            natural=natural_pose()[None],
            pull=self.positions.new_full((1,), self.weights.rest),
            ground=self.weights.ground,
            turning=torch.full((len(JOINTS),), self.weights.turning / rate),
            weight=rate,
            sigma=OUTLIER,
        )


def _calibrate(data: _Data, chosen: Int[Tensor, " chosen"]) -> tuple[MarkerSubject, Motion]:
    """Shape and offsets, and the poses of the frames that they were found from.

    These frames count as 30 a second, without order.
    """
    nominal, weights, body = data.markers.nominal, data.weights, data.body
    average = MarkerSubject(data.positions.new_zeros(body.shape_size), nominal)
    some = replace(data.frames(chosen), fps=REFERENCE_FPS)
    loose = torch.tensor(data.markers.loose)
    energies = SubjectEnergies(
        body=body,
        vertices=data.vertices,
        under=data.under,
        nominal=nominal,
        stiffness=torch.where(loose, weights.loose, weights.placed),
        stature=weights.shape,
        poses=some.energies(average).untied(),
        with_offsets=True,
    )
    start = rigid_start(
        body, body.template[data.vertices], data.bones, some.positions, some.visible,
        fps=some.fps, start_time=0.0,
    )  # fmt: skip
    found = calibrated(energies, start.translation, with_natural_pose(start.rotations), OUTLIER)
    motion = Motion.create(found.poses.translation, found.poses.rotations, found.shape, data.fps)
    return MarkerSubject(found.shape, found.offsets), motion


def nominal_places(
    fit: MarkerFit, markers: MarkerSet, body: BodyModel
) -> Float[Tensor, "time markers 3"]:
    """Places of markers that sit exactly where their names say on a fitted body, metres."""
    subject = MarkerSubject(fit.motion.shape, markers.nominal)
    with torch.no_grad():
        return _predicted(fit.motion, subject, torch.tensor(markers.vertices), body)


def _predicted(
    motion: Motion, subject: MarkerSubject, vertices: Int[Tensor, " markers"], body: BodyModel
) -> Float[Tensor, "time markers 3"]:
    points = SkinPoints.of(body, subject.shape, vertices, subject.offsets)
    rest = body.rest_joints(subject.shape)
    return points.places(Poses.of(motion.translation, motion.rotations, rest)).mT


def _spread(some: Bool[Tensor, "..."], index: Int[Tensor, " rows"], count: int) -> Tensor:
    """Flags of some rows among all rows; false elsewhere."""
    everything = torch.zeros(count, *some.shape[1:], dtype=torch.bool)
    everything[index] = some
    return everything


def _well_seen(
    visible: Bool[Tensor, "time markers"], placed: Bool[Tensor, " time"]
) -> Int[Tensor, " chosen"]:
    """Frames evenly over the recording, among those that show most markers.

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


def stands_on_zero(recording: MarkerRecording) -> bool:
    """Whether z = 0 is the ground: the lowest markers are as high as markers on feet are."""
    low = np.where(recording.visible, recording.positions[..., 2], np.inf).min(-1)
    low = low[np.isfinite(low)]
    return len(low) > 0 and _FOOT_MARKER[0] < float(np.quantile(low, 0.1)) < _FOOT_MARKER[1]

"""Markers on the skin become a motion, with constant offsets of each marker (MoSh's idea).

Loper, Mahmood and Black, MoSh, 2014: a marker sits a little off the skin and not quite where its
name says; where exactly is found together with the body's shape from a few frames, and held.
"""

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from observations.markers3d import Markers3D
from recon.body.model import BodyModel
from recon.body.soles import Soles
from recon.core.errors import ReconError
from recon.core.motion import Motion
from recon.core.robust import geman_mcclure, squared
from recon.core.scene import Scene
from recon.core.struct import TensorStruct
from recon.formats.mocap.recording import MarkerRecording
from recon.ingest.energies import AboveGround
from recon.ingest.markers.coverage import MarkerSet
from recon.ingest.markers.gaps import (
    between,
    bridged,
    observed_joints,
    placed_frames,
    turned_joints,
)
from recon.ingest.markers.jumps import UNMADE, mended, unmade_steps
from recon.ingest.markers.rest import natural_rest, with_natural_pose
from recon.method import terms
from recon.method.free import FreeMotion
from recon.method.protocols import REFERENCE_FPS, Estimate
from recon.method.running import run_stages
from recon.method.stages import Stage
from recon.method.terms import Term
from recon.solver.lbfgs import LBFGS

logger = logging.getLogger(__name__)

OUTLIER = 0.1
"""Metres at which a marker counts half as much: swapped labels, ghosts."""
CALIBRATION_FRAMES = 150
_FOOT_MARKER = (0.0, 0.08)
"""Metres above the ground of the lowest marker of a body that stands."""
_NOISE = 3.0
"""Multiple of the mean residual by which joints may step without their markers, as noise does."""
_KEY_RATE = 10.0
_CHUNK = 3000
_PLACE = frozenset({"translation", "root"})
_POSE = _PLACE | {"pose"}


@dataclass(frozen=True)
class MarkerWeights:
    """Multipliers; markers count as ½ Σ distance² in metres²."""

    shape: float = 6e-5
    placed: float = 0.3
    """Per frame, of offsets of markers on bony landmarks."""
    loose: float = 0.03
    """Per frame, of offsets of markers that are put anywhere on a limb."""
    rest: float = 1e-3
    """Weight of the distance from the natural pose, where no better `pose_terms` are given."""
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
    pose_terms: Sequence[Term] = (),
    weights: MarkerWeights | None = None,
) -> MarkerFit:
    """Shape and offsets from some frames, then the pose of all frames.

    Args:
        recording: of exactly these markers, in their order.
        markers: their places on the body.
        body: whose motion it becomes.
        pose_terms: what is known of poses, in place of a pull towards the natural pose.
        weights: of the energies.

    Raises:
        ValueError: when no frame shows enough markers to place a body.
    """
    weights = MarkerWeights() if weights is None else weights
    positions = torch.from_numpy(recording.positions).float()
    visible = torch.from_numpy(recording.visible)
    data = _Data(positions, visible, markers.vertices, recording.fps)
    hold = tuple(pose_terms) or (Term("rest pose", natural_rest, weights.rest),)
    if _stands_on_zero(positions, visible):
        soles = Soles.of(body).points.flatten()
        hold = (*hold, Term("ground", AboveGround(soles), weights.ground))
    bones = data.observation().bones(body)
    placed = placed_frames(visible, bones).nonzero()[:, 0]
    if len(placed) == 0:
        raise ReconError(
            f"{recording.name}: no frame shows enough markers of one body to place it; there are "
            f"{int(visible.sum(-1).max())} of {len(markers.labels)} at most"
        )
    chosen = _well_seen(visible)
    subject, motion = _calibrate(data.frames(chosen), markers, body, hold, weights)
    step = max(1, round(recording.fps / _KEY_RATE))
    keys = torch.unique(torch.cat((placed[::step], placed[-1:])))
    motion = _solve(data.frames(keys), between(motion, chosen, keys), subject, body, hold, 100)
    smooth = (*hold, Term("turning", terms.rotation_velocity, weights.turning))
    parts = [
        _solve(data.frames(part), between(motion, keys, part), subject, body, smooth, 80)
        for part in placed.split(_CHUNK)
    ]
    motion = Motion.create(
        translation=torch.cat([part.translation for part in parts]),
        rotations=torch.cat([part.rotations for part in parts]),
        shape=subject.shape,
        fps=recording.fps,
    )
    motion, changed, unmade = _mended(data.frames(placed), motion, subject, body, smooth)
    motion = bridged(motion, placed, turned_joints(visible, bones))
    with torch.no_grad():
        predicted = _predict(data, motion, subject.offsets, body)
    return MarkerFit(
        motion,
        subject,
        predicted,
        observed=observed_joints(visible, markers.vertices, body),
        mended=_spread(changed, placed, len(positions)),
        unmade=_spread(unmade, placed[1:] - 1, len(positions) - 1),
    )


@dataclass(frozen=True)
class _Data:
    positions: Float[Tensor, "time markers 3"]
    visible: Bool[Tensor, "time markers"]
    vertices: tuple[int, ...]
    fps: float

    def frames(self, index: Int[Tensor, " chosen"]) -> "_Data":
        return _Data(self.positions[index], self.visible[index], self.vertices, self.fps)

    def observation(self) -> Markers3D:
        return Markers3D(
            positions=self.positions.where(self.visible[..., None], 0.0)[None],
            visible=self.visible[None],
            vertices=self.vertices,
            fps=self.fps,
            kernel=partial(geman_mcclure, sigma=OUTLIER),
            offset_rows=(0, len(self.vertices)),
        )


def _calibrate(
    data: _Data,
    markers: MarkerSet,
    body: BodyModel,
    hold: tuple[Term, ...],
    weights: MarkerWeights,
) -> tuple[MarkerSubject, Motion]:
    """Shape and offsets; the frames count as 30 a second, without order."""
    count = len(data.positions)
    data = _Data(data.positions, data.visible, data.vertices, REFERENCE_FPS)
    seen = data.observation()
    nominal = markers.nominal
    scene = Scene(nominal[None])
    with torch.no_grad():
        motion = seen.start(body)
    motion = motion.replace(rotations=with_natural_pose(motion.rotations))
    stiff = torch.tensor([weights.loose if loose else weights.placed for loose in markers.loose])

    def away(estimate: Estimate) -> Float[Tensor, "*batch"]:
        """½ Σ |o - nominal|², each marker with its own weight."""
        apart = (estimate.scene.offsets - nominal).square().sum(-1)
        return 0.5 * (apart * stiff).sum(-1)

    prior = FreeMotion()
    # first everything counts alike: a body lying in another pose is no outlier
    plain = Term("markers", seen.replace(kernel=squared), 1.0)
    robust = Term("markers", seen, 1.0)
    shape = Term("shape", terms.shape, weights.shape)
    offsets = Term("offsets", away, float(count))
    body_free = _POSE | {"shape"}
    stages = (
        Stage("place", prior, (plain, *hold), _PLACE, LBFGS(max_iterations=30)),
        Stage("pose", prior, (plain, shape, *hold), body_free, LBFGS(max_iterations=120)),
        Stage(
            "offsets",
            prior,
            (robust, shape, offsets, *hold),
            body_free | {"scene.offsets"},
            LBFGS(max_iterations=200, tolerance_decrease=1e-7),
        ),
    )
    estimate, _ = run_stages(stages, body, motion, scene)
    estimate_motion = estimate.motion.detach()
    subject = MarkerSubject(estimate_motion.shape[0], estimate.scene.offsets[0].detach())
    return subject, estimate_motion[0]


def _solve(
    data: _Data,
    start: Motion,
    subject: MarkerSubject,
    body: BodyModel,
    hold: tuple[Term, ...],
    iterations: int,
    kernel: Callable[[Tensor], Tensor] | None = None,
) -> Motion:
    """Poses of some frames, shape and offsets held, by the robust kernel or another."""
    seen = data.observation()
    seen = seen if kernel is None else seen.replace(kernel=kernel)
    motion = start.replace(fps=data.fps, shape=subject.shape).map(lambda tensor: tensor[None])
    stage = Stage(
        "frames",
        FreeMotion(),
        (Term("markers", seen, 1.0), *hold),
        _POSE,
        LBFGS(max_iterations=iterations, history=10, tolerance_decrease=1e-6),
    )
    estimate, _ = run_stages((stage,), body, motion, Scene(subject.offsets[None]))
    return estimate.motion.detach()[0]


def nominal_places(
    fit: MarkerFit, markers: MarkerSet, body: BodyModel
) -> Float[Tensor, "time markers 3"]:
    """Places of markers that sit exactly where their names say on a fitted body, metres."""
    with torch.no_grad():
        posed = body.pose(fit.motion)
        points = posed.points(torch.tensor(markers.vertices))
        bones = body.weights[list(markers.vertices)].argmax(-1)
        return points + (posed.orientations[:, bones] @ markers.nominal[..., None])[..., 0]


def _mended(
    data: _Data, motion: Motion, subject: MarkerSubject, body: BodyModel, hold: tuple[Term, ...]
) -> tuple[Motion, Bool[Tensor, " time"], Bool[Tensor, "steps 22"]]:
    """Frames in which the body leaves its markers solved again; which, and what steps remain."""
    bones = data.observation().bones(body)

    def unmade(motion: Motion) -> Bool[Tensor, "steps 22"]:
        with torch.no_grad():
            joints = body.pose(motion).joints
        limit = max(UNMADE, _NOISE * float(start[data.visible].mean()))
        return unmade_steps(joints, data.positions, data.visible, bones, limit)

    def residuals(motion: Motion) -> Float[Tensor, "time markers"]:
        with torch.no_grad():
            predicted = _predict(data, motion, subject.offsets, body)
        return (predicted - data.positions).norm(dim=-1).where(data.visible, 0.0)

    start = residuals(motion)

    def again(frames: Int[Tensor, " frames"], start: Motion) -> Motion:
        some = data.frames(frames)
        # first everything counts alike: limbs that were turned over are no outliers
        plain = _solve(some, start, subject, body, hold, 60, squared)
        return _solve(some, plain, subject, body, hold, 80)

    motion, changed = mended(motion, unmade, residuals, again)
    return motion, changed, unmade(motion)


def _spread(some: Bool[Tensor, "..."], index: Int[Tensor, " rows"], count: int) -> Tensor:
    """Flags of some rows among all rows; false elsewhere."""
    everything = torch.zeros(count, *some.shape[1:], dtype=torch.bool)
    everything[index] = some
    return everything


def _predict(
    data: _Data, motion: Motion, offsets: Float[Tensor, "markers 3"], body: BodyModel
) -> Float[Tensor, "time markers 3"]:
    posed = body.pose(motion)
    bones = list(data.observation().bones(body))
    points = posed.points(torch.tensor(data.vertices))
    return points + (posed.orientations[:, bones] @ offsets[..., None])[..., 0]


def _well_seen(visible: Bool[Tensor, "time markers"]) -> Int[Tensor, " chosen"]:
    """Frames evenly over the recording among those that show most markers."""
    count = visible.sum(-1)
    good = (count >= 0.9 * count.max()).nonzero()[:, 0]
    pick = np.linspace(0, len(good) - 1, min(CALIBRATION_FRAMES, len(good))).round()
    return good[torch.from_numpy(np.unique(pick.astype(int)))]


def _stands_on_zero(
    positions: Float[Tensor, "time markers 3"], visible: Bool[Tensor, "time markers"]
) -> bool:
    """Whether z = 0 is the ground: the lowest markers are as high as markers on feet are."""
    low = positions[..., 2].where(visible, torch.inf).amin(-1)
    low = low[low.isfinite()]
    return len(low) > 0 and _FOOT_MARKER[0] < float(low.quantile(0.1)) < _FOOT_MARKER[1]

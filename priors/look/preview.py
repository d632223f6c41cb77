"""Applies the trained network to whole clips of any length and rate, with gaps and sensors."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn import functional

from priors.look.looking import (
    FAMILIAR,
    interpolated_between_seen,
    load_network,
    mean_squared_deviation,
)
from priors.look.networks import LookNetwork
from priors.look.points import SeenPoints
from recon.body.model import BodyModel, forward_kinematics
from recon.core import rotations as so3
from recon.core.errors import ObservationError
from recon.core.motion import Motion
from recon.method.looks import ProposedMotions
from recon.method.pace import paced
from recon.method.protocols import REFERENCE_FPS
from recon.method.sensor import Sensor, standing_motion

_WINDOW, _OVERLAP = 90, 30
"""Frames that the network sees together, the most that it was trained on, and those that two
neighbouring windows share."""
_TOGETHER = 16
"""Windows that are looked at together."""
_CLOSE_S = 0.05
"""Seconds between two frames of the data up to which points are interpolated between them."""
_NEAREST_S = 1 / 120
"""Seconds from a frame of the data within which its points count as seen then."""
_REACH_S = 1.0
"""Seconds from the next moment with points from which on motions are interpolated: the network
was trained on gaps of two seconds."""
_DRIFT = 0.5
"""Metres per second by which a standard deviation grows beyond that."""
_MODEL_M = 0.15
"""Metres: standard deviation of a point about the body of the proposed rotations when its shape is
told. Their errors last, so that 60 frames are no 60 independent ones."""
_USUAL_FRAMES = 60.0
"""Frames that every clip counts as when its shape is told."""
_MOST_FRAMES = 300
"""Frames of a clip that tell its shape, at most."""
_OUTLIER_M = 0.3
"""Metres from the proposed motion at which a point counts by a quarter."""
_NEAR = 4.0
"""Frames within which points tell together where the body is."""


@dataclass(frozen=True, eq=False)
class LookAtPoints:
    """Proposes motions from named points in space with the network (`recon.method.looks.Look`)."""

    network: LookNetwork

    @classmethod
    def load(cls, weights: str | Path = "open", body: BodyModel | None = None) -> "LookAtPoints":
        """Load the bundled network, or a file that `python -m training look` has written."""
        del body
        return cls(load_network(weights))

    @torch.no_grad()
    def __call__(self, observations: Sequence[Sensor], body: BodyModel) -> ProposedMotions:
        """Propose motions at 30 Hz for the observations of a clip.

        Raises:
            ObservationError: when an observation is no named points in space, or nothing is seen.
        """
        body = body.to(dtype=torch.float32)
        seen, start_time, fps = seen_points(observations, body)
        rotations, pelvis, shape, std, log_weight = self._blended_over_windows(seen, body)
        rotations, pelvis, std = _interpolated_over_gaps(
            rotations, pelvis, std, seen.visible[0].any(-1)
        )
        placement, first = _PlacementFit(seen, body), int(log_weight.argmax())
        own = placement.points_on_bodies(
            rotations[first], pelvis[first], body.rest_joints(shape)[None]
        )[0]
        shape = placement.fitted_shape(rotations[first], pelvis[first], shape)
        every = zip(rotations, pelvis, strict=True)
        moved = torch.stack([placement.fitted_pelvis(*one, shape) for one in every])
        translation = moved - body.rest_joints(shape)[0]
        shapes = shape.expand(len(moved), -1)
        motions = Motion.create(translation, rotations, shapes, fps, start_time)
        spread = (std[first][:, seen.bone[0]].square() + seen.std.square()).sqrt()
        far = mean_squared_deviation(seen.positions[0] - own, spread, seen.visible[0])
        return ProposedMotions(
            motions, log_weight, std, _misfit_in_words(far) if far > FAMILIAR else None
        )

    def _blended_over_windows(self, seen: SeenPoints, body: BodyModel) -> tuple[Tensor, ...]:
        """Run the network on overlapping windows of time and blend its proposals linearly.

        Rotations and positions of the pelvis of every hypothesis, one shape, standard deviations
        and logarithms of the weights.
        """
        frames = seen.positions.shape[1]
        length = min(_WINDOW, frames)
        step = _WINDOW - _OVERLAP
        firsts = [min(k, frames - length) for k in range(0, max(frames - _OVERLAP, 1), step)]
        fade = torch.linspace(-1, 1, length + 2)[1:-1].abs().neg().add(1).clamp(max=0.5)
        total, sums, shape, weight = torch.zeros(frames), list[Tensor](), 0.0, 0.0
        for some in (firsts[k : k + _TOGETHER] for k in range(0, len(firsts), _TOGETHER)):
            cuts = [slice(first, first + length) for first in some]
            found = self.network(_cut_windows(seen, cuts), body)
            parts = [so3.to_6d(found.rotations).flatten(-2), found.pelvis, found.log_std]
            if not sums:
                sums = [one.new_zeros(one.shape[1], frames, one.shape[-1]) for one in parts]
            for row, cut in enumerate(cuts):
                total[cut] += fade
                for into, one in zip(sums, parts, strict=True):
                    into[:, cut] += fade[:, None] * one[row]
            shape, weight = shape + found.shape.sum(0), weight + found.log_weight.sum(0)
        six, pelvis, log_std = (one / total[:, None] for one in sums)
        rotations = so3.from_6d(six.unflatten(-1, (-1, 6)))
        assert isinstance(shape, Tensor)
        assert isinstance(weight, Tensor)
        return rotations, pelvis, shape / len(firsts), log_std.exp(), weight.log_softmax(-1)


def _misfit_in_words(mean_square: float) -> str:
    return (
        f"on average the points are {mean_square**0.5:.1f} standard deviations away from the "
        "motion that the network proposes, so this motion is not to be trusted; check the points' "
        "unit and names, and fit them without the method look"
    )


def seen_points(
    observations: Sequence[Sensor], body: BodyModel
) -> tuple[SeenPoints, float, float]:
    """Resample all sensors' points to about 30 Hz; also return start time and exact rate.

    Raises:
        ObservationError: when an observation is no named points in space, or nothing is seen.
    """
    named = [one.named for one in observations if one.named is not None and one.named.placed]
    if len(named) < len(observations):
        kinds = ", ".join(sorted({one.kind for one in observations}))
        raise ObservationError(
            "the method `look` takes named points in space alone (joints, markers, 3D keypoints, "
            f"or keypoints of calibrated views that share a clock), got {kinds}; "
            "fit all of them without a method, or give only named points"
        )
    if not any(bool(one.shown.any()) for one in named):
        raise ObservationError(
            "method `look` needs visible points, but all are marked as not seen; check the masks"
        )
    start = min(one.start_time for one in named)
    stop = max(one.start_time + one.duration for one in named)
    # both ends of the clip get a frame, so the rate may be slightly above 30 Hz
    steps = math.ceil((stop - start) * REFERENCE_FPS - 1e-3)
    fps = steps / (stop - start) if steps > 0 else REFERENCE_FPS
    times = start + torch.arange(steps + 1, dtype=torch.float64) / fps
    places, shown = zip(
        *(_points_at_times(paced(one, REFERENCE_FPS), times) for one in named), strict=True
    )
    bone = torch.tensor([joint for one in named for joint in one.bones(body)])
    rest = torch.cat([one.at_rest(body) for one in named]).float()
    counts = [float(one.shown.sum()) for one in named]
    anybody = standing_motion(body, (), 1, fps=REFERENCE_FPS, start_time=start)
    noises = [one.noise(anybody, body).metres for one in named]
    square = sum(n * noise**2 for n, noise in zip(counts, noises, strict=True)) / sum(counts)
    seen = SeenPoints(
        torch.cat(places, -2)[None].float(), torch.cat(shown, -1)[None], bone[None],
        (rest - body.joint_template[bone])[None], torch.tensor([square**0.5]),
        torch.ones(1, len(times), dtype=torch.bool),
    )  # fmt: skip
    return seen, start, fps


def _points_at_times(sensor: Sensor, times: Tensor) -> tuple[Tensor, Tensor]:
    """Interpolate a sensor's positions and visibility to given times (seconds)."""
    frame = (times - sensor.start_time) * sensor.fps
    last = sensor.moments - 1
    before = frame.floor().long().clamp(0, max(last - 1, 0))
    after = (before + 1).clamp(max=last)
    nearest = frame.round().long().clamp(0, last)
    exact = ((frame - nearest).abs() / sensor.fps <= _NEAREST_S)[:, None] & sensor.shown[nearest]
    inside = (frame >= 0) & (frame <= last) & (1 / sensor.fps <= _CLOSE_S)
    both = sensor.shown[before] & sensor.shown[after] & inside[:, None]
    mixed = sensor.values[before].lerp(
        sensor.values[after], (frame - before).to(sensor.values)[:, None, None]
    )
    return mixed.where(both[..., None], sensor.values[nearest]), exact | both


def _cut_windows(seen: SeenPoints, cuts: Sequence[slice]) -> SeenPoints:
    """Cut the points of a single clip into windows of time, stacked as a batch of clips."""
    count = len(cuts)
    return SeenPoints(
        torch.cat([seen.positions[:, cut] for cut in cuts]),
        torch.cat([seen.visible[:, cut] for cut in cuts]),
        seen.bone.expand(count, -1), seen.offset.expand(count, -1, -1), seen.std.expand(count),
        torch.cat([seen.exists[:, cut] for cut in cuts]),
    )  # fmt: skip


def _interpolated_over_gaps(
    rotations: Float[Tensor, "hypotheses time 22 3 3"],
    pelvis: Float[Tensor, "hypotheses time 3"],
    std: Float[Tensor, "hypotheses time 22"],
    filled: Bool[Tensor, " time"],
) -> tuple[Tensor, Tensor, Tensor]:
    """Interpolate motions over frames that are more than `_REACH_S` from any seen point."""
    reach = round(_REACH_S * REFERENCE_FPS)
    near = functional.max_pool1d(filled.float()[None], 2 * reach + 1, 1, reach)[0] > 0
    if bool(near.all()):
        return rotations, pelvis, std
    known = near[:, None]
    six = interpolated_between_seen(so3.to_6d(rotations), known.expand(-1, rotations.shape[2]))
    place = interpolated_between_seen(pelvis[:, :, None], known)[:, :, 0]
    frames = torch.arange(len(near), dtype=torch.float32)
    away = (frames[:, None] - frames[near]).abs().amin(1) / REFERENCE_FPS
    wide = (std.square() + (_DRIFT * away[:, None]).square()).sqrt()
    return so3.from_6d(six).where(known[..., None, None], rotations), place, wide


@dataclass(frozen=True, eq=False)
class _PlacementFit:
    """Fits shape and pelvis path of a proposed motion to the seen points."""

    seen: SeenPoints
    body: BodyModel

    def points_on_bodies(
        self,
        rotations: Float[Tensor, "time 22 3 3"],
        pelvis: Float[Tensor, "time 3"],
        rest: Float[Tensor, "bodies 22 3"],
    ) -> Float[Tensor, "bodies time points 3"]:
        """Predict the points, world, metres, on posed bodies with given rest joints."""
        bone = self.seen.bone[0]
        many = rotations.expand(len(rest), *rotations.shape)
        turns, joints = forward_kinematics(many, rest)
        joints = joints[..., bone, :] - joints[..., :1, :] + pelvis[:, None]
        return joints + (turns[..., bone, :, :] @ self.seen.offset[0, :, :, None])[..., 0]

    def fitted_shape(
        self,
        rotations: Float[Tensor, "time 22 3 3"],
        pelvis: Float[Tensor, "time 3"],
        shape: Float[Tensor, " shape"],
    ) -> Float[Tensor, " shape"]:
        """The shape coefficients with which proposed rotations fit the seen points best.

        Joints are linear in the shape, so that it solves a small linear system: ridge regression
        towards the average person, each frame about the mean of its points.
        """
        frames = self.seen.visible[0].any(-1).nonzero()[:, 0]
        rows = frames[torch.linspace(0, len(frames) - 1, min(len(frames), _MOST_FRAMES)).long()]
        one = torch.eye(len(shape))
        rest = self.body.rest_joints(torch.cat((shape[None], shape + one)))
        found = self.points_on_bodies(rotations[rows], pelvis[rows], rest)
        away, slope = self.seen.positions[0, rows] - found[0], found[1:] - found[0]
        weight = _robust_weights(away, self.seen.visible[0, rows])
        share = weight / weight.sum(1, keepdim=True).clamp(min=1e-6)
        away = away - (share * away).sum(1, keepdim=True)
        slope = slope - (share * slope).sum(2, keepdim=True)
        pulled = (weight * slope).flatten(1) * (_USUAL_FRAMES / len(rows) / _MODEL_M**2)
        known = pulled @ slope.flatten(1).mT + one
        return shape + torch.linalg.solve(known, pulled @ away.flatten() - shape)

    def fitted_pelvis(
        self,
        rotations: Float[Tensor, "time 22 3 3"],
        pelvis: Float[Tensor, "time 3"],
        shape: Float[Tensor, " shape"],
    ) -> Float[Tensor, "time 3"]:
        """The path of the pelvis, shifted by the mean residual of points near in time."""
        found = self.points_on_bodies(rotations, pelvis, self.body.rest_joints(shape)[None])[0]
        away = self.seen.positions[0] - found
        weight = _robust_weights(away, self.seen.visible[0])
        pull = torch.cat(((weight * away).sum(1), weight.sum(1)), -1)
        reach = torch.arange(-30.0, 31.0)
        near = (1 + (reach / _NEAR).square()) ** -2
        sums = functional.conv1d(pull.mT[:, None], near[None, None], padding=30)[:, 0].mT
        return pelvis + sums[:, :3] / sums[:, 3:].clamp(min=1e-6)


def _robust_weights(away: Tensor, visible: Tensor) -> Tensor:
    """Robust weights (frames, points, 1): less the farther a point is from its prediction."""
    near = (1 + (away.norm(dim=-1, keepdim=True) / _OUTLIER_M).square()) ** -2
    return near * visible[..., None]

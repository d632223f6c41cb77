"""Uses the trained network to propose rotations of limbs that no sensor saw for a while."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from priors.checkpoints import named_checkpoint
from priors.look.networks import LookNetwork, Proposed
from priors.look.points import SeenPoints
from recon.body.model import BodyModel
from recon.core import rotations as so3
from recon.core.arrays import cached_constant
from recon.core.motion import Motion
from recon.core.skeleton import JOINTS, PARENTS, descendants
from recon.core.struct import TensorStruct
from recon.method.protocols import Estimate
from recon.method.sensor import Sensor
from recon.method.terms import Term
from recon.method.timing import first_to_last

_STD_M = 0.01
"""Standard deviation of the joints of an estimate as the network is told, metres."""
FAMILIAR = 2.2
"""Mean square of what seen points are away from the likeliest motion, in standard deviations,
above which data are far from what the network knows. 78 validation windows reach 2.17; of 63 of
other laboratories the three above it are 8 to 14 cm off."""
_PROPOSED = 2
"""Motions that are proposed, the likeliest: four take longer and leave the errors as they are."""
_GAP_S = 0.2
"""Seconds; where less is missing, a smooth motion is as good as what the network proposes."""
_SELDOM = 1 / 3
"""A joint that is located in a smaller share of the moments than this counts as never seen."""
_BENDING = tuple(JOINTS.index(f"{side}_{name}") for side in ("left", "right")
                 for name in ("knee", "elbow"))  # fmt: skip
"""Joints one of which must be unseen for a limb to be."""


@lru_cache(maxsize=2)
def load_network(weights: str | Path = "open", device: torch.device | str = "cpu") -> LookNetwork:
    """Load the trained network onto a device.

    Raises:
        FileNotFoundError: when there are no such weights.
        ValueError: when they do not fit the network.
    """
    checkpoint = named_checkpoint(weights, "look")
    shape, width, hypotheses = checkpoint.integer_settings("shape", "width", "hypotheses")
    network = LookNetwork(shape, width, hypotheses=hypotheses)
    checkpoint.with_prefix("").copy_into(network)
    return network.eval().requires_grad_(False).to(device)


@dataclass(frozen=True)
class UnseenLimbs(TensorStruct):
    """Masks that say in which frames no sensor determines the rotation of each joint."""

    rotations: Bool[Tensor, "clips frames 22"]
    """True where no sensor saw a point at the joint's child or further down the tree for `_GAP_S`
    or longer; for the pelvis, where no sensor saw anything."""
    never: Bool[Tensor, "clips 22"]
    """Joints whose rotation hardly any moment shows; none in a clip in which every knee and elbow
    is seen now and then."""
    fps: float
    start_time: float

    @classmethod
    def of(cls, data: Sequence[Term], body: BodyModel) -> "UnseenLimbs | None":
        """Find the limbs that no sensor of the data terms sees for a while.

        None where every limb is seen, or where a sensor does not know which joints it locates. A
        joint at the end of a limb, whose rotation moves no other joint, counts as its parent
        does. A sensor on another clock counts by its nearest moment.
        """
        sensors = [term.energy for term in data if isinstance(term.energy, Sensor)]
        located = [one.joints_located(body) for one in sensors]
        if len(located) == 0 or len(located) < len(data) or any(one is None for one in located):
            return None
        first = sensors[0]
        times = first.start_time + torch.arange(first.moments, dtype=torch.float64) / first.fps
        seen = torch.stack([
            _mask_at_times(one, sensor.fps, sensor.start_time, times)
            for one, sensor in zip(located, sensors, strict=True) if one is not None
        ]).any(0)  # fmt: skip
        never = _rotations_below(_share_of_moments(seen) < _SELDOM)
        never &= never[:, list(_BENDING)].any(-1, keepdim=True)
        frames = max(1, min(round(_GAP_S * first.fps) + 1, first.moments))
        rotations = _long_runs(_rotations_below(~seen) & first_to_last(seen)[..., None], frames)
        rotations &= rotations[..., list(_BENDING)].any(-1, keepdim=True)
        rotations |= never[:, None]
        return cls(rotations, never, first.fps, first.start_time) if rotations.any() else None

    def at_frames_of(self, motion: Motion, clip: int) -> Bool[Tensor, "time 22"]:
        """Mask (frames, 22) of the unseen joint rotations of a clip, in the frames of a motion."""
        found = _mask_at_times(self.rotations[clip], self.fps, self.start_time, motion.times)
        return found & motion.valid[0][:, None]


def _share_of_moments(seen: Bool[Tensor, "clips moments 22"]) -> Float[Tensor, "clips 22"]:
    """Return, for each joint, the share of the moments with any data that locate it."""
    count = seen.any(-1).sum(-1, keepdim=True)
    return seen.sum(-2) / count.clamp(min=1)


def _rotations_below(missing: Bool[Tensor, "*shape 22"]) -> Bool[Tensor, "*shape 22"]:
    """Mask of joints whose rotation moves missing joints only; the pelvis only if all do."""
    found = torch.zeros_like(missing)
    found[..., 0] = missing.all(-1)
    for joint in range(1, len(JOINTS)):
        below = list(descendants(joint))[1:]
        found[..., joint] = missing[..., below].all(-1) if below else found[..., PARENTS[joint]]
    return found


def _long_runs(mask: Bool[Tensor, "clips time 22"], frames: int) -> Bool[Tensor, "clips time 22"]:
    """Keep only those runs of true values in a mask that last at least `frames` frames."""
    whole = mask.unfold(1, frames, 1).all(-1)
    around = torch.nn.functional.pad(whole, (0, 0, frames - 1, frames - 1))
    return around.unfold(1, frames, 1).any(-1)


def _mask_at_times(mask: Tensor, fps: float, start_time: float, times: Tensor) -> Tensor:
    """Sample a mask (..., frames, 22) at given times (seconds) from its nearest frames."""
    frame = ((times - start_time) * fps).round().long().clamp(0, mask.shape[-2] - 1)
    return mask.index_select(-2, frame.to(mask.device))


@dataclass(frozen=True, eq=False)
class UnseenLimbProposals:
    """Proposes motions of limbs that were not seen, for a stage (`recon.method.stages.Proposals`).

    The network is shown the joints of an estimate whose places are known.
    """

    network: LookNetwork
    unseen: UnseenLimbs

    @torch.no_grad()
    def __call__(self, estimate: Estimate, clip: int) -> tuple[Motion | None, str]:
        """Propose motions of one clip that replace the unseen limbs of the estimate.

        None where all is seen, or where what is seen is far from what the network knows.
        """
        motion, body = estimate.motion.detach(), estimate.body.model
        unseen = self.unseen.at_frames_of(motion, clip)
        if not bool(unseen.any()):
            return None, ""
        parents = cached_constant(tuple(max(parent, 0) for parent in PARENTS), unseen.device)
        joints = estimate.body.joints.detach()
        seen = ~unseen[:, parents]
        found = propose_motions(self.network, joints, motion.valid, seen, body)
        first = int(found.log_weight[0].argmax())
        away = found.joints(body.to(dtype=torch.float32))[:, first] - joints.float()
        std = (found.log_std[:, first].exp().square() + _STD_M**2).sqrt()
        if mean_squared_deviation(away, std, seen & motion.valid[..., None]) > FAMILIAR:
            return None, (
                "the observations are unlike the data of the network that proposes motions of "
                "unseen limbs: the fit of these limbs began from smooth motions, and may be wrong"
            )
        likely = found.log_weight[0].topk(min(_PROPOSED, found.log_weight.shape[1])).indices
        rotations = with_seen_rotations(
            found.rotations[0, likely].to(motion.rotations), motion.rotations[0], ~unseen
        )
        place = found.pelvis[0, likely].to(joints) - body.rest_joints(motion.shape)[:, :1]
        away = interpolated_between_seen((motion.translation - place)[:, :, None], ~unseen[:, :1])
        many = motion.map(lambda tensor: tensor.expand(len(rotations), *tensor.shape[1:]))
        many = many.replace(rotations=rotations, translation=place + away[:, :, 0])
        return many, (
            f"the fit of unseen limbs began from {len(rotations)} motions that a network "
            "proposed, and kept the best result"
        )


def mean_squared_deviation(
    away: Float[Tensor, "*batch 3"], std: Float[Tensor, "*batch"], counted: Bool[Tensor, "*batch"]
) -> float:
    """Mean of squared coordinates over their variance, where `counted`; 1 is expected."""
    squared = away.square().mean(-1) / std.square()
    return float(squared[counted].mean().nan_to_num()) if counted.any() else 0.0


def propose_motions(
    network: LookNetwork,
    joints: Float[Tensor, "clips time 22 3"],
    exists: Bool[Tensor, "clips time"],
    seen: Bool[Tensor, "time 22"],
    body: BodyModel,
) -> Proposed:
    """Run the network on the seen joints (world, ground z = 0) and return its proposals."""
    count = len(joints)
    points = SeenPoints(
        positions=joints.float(),
        visible=seen & exists[..., None],
        bone=torch.arange(len(JOINTS), device=joints.device).expand(count, -1),
        offset=joints.new_zeros(count, len(JOINTS), 3, dtype=torch.float32),
        std=joints.new_full((count,), _STD_M, dtype=torch.float32),
        exists=exists,
    )
    return network(points, body.to(dtype=torch.float32))


def with_seen_rotations(
    proposed: Float[Tensor, "hypotheses time 22 3 3"],
    known: Float[Tensor, "time 22 3 3"],
    seen: Bool[Tensor, "time 22"],
) -> Float[Tensor, "hypotheses time 22 3 3"]:
    """Correct proposed rotations R so that they equal the known ones K where those were seen.

    The result is R exp(δ), with δ = log(Rᵀ K) where a rotation is seen, and interpolated
    elsewhere; so it is K where that is known.
    """
    return proposed @ so3.exp(interpolated_between_seen(so3.log(proposed.mT @ known), seen))


def interpolated_between_seen(
    away: Float[Tensor, "hypotheses time joints n"], seen: Bool[Tensor, "time joints"]
) -> Float[Tensor, "hypotheses time joints n"]:
    """Keep vectors of frames marked as seen; interpolate the other frames linearly in time.

    They are constant beyond the first and the last, and zero where they are never seen.
    """
    frames = torch.arange(len(seen), device=seen.device)[:, None].expand_as(seen)
    last = frames.where(seen, -1).cummax(0).values
    following = frames.where(seen, len(seen)).flip(0).cummin(0).values.flip(0)
    ever = seen.any(0)
    before = last.where(last >= 0, following).where(ever, 0)
    after = following.where(following < len(seen), last).where(ever, 0)
    share = (frames - before) / (after - before).clamp(min=1)

    def away_at(index: Tensor) -> Tensor:
        return away.gather(1, index[None, :, :, None].expand_as(away))

    mixed = away_at(before).lerp(away_at(after), share[None, :, :, None].to(away))
    return mixed.where(ever[:, None], 0.0)

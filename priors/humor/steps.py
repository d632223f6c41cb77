"""HuMoR's networks evaluated on all steps of given motions at once, without a rollout."""

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor

from priors.checkpoints import named_checkpoint
from priors.humor.networks import HumorNetworks
from priors.humor.state import Frame, State
from priors.pose.prior import PoseWeights
from recon.core import rotations as so3
from recon.core.motion import Motion
from recon.core.struct import TensorStruct
from recon.method.quadratic import FRAME
from recon.solver.banded import Banded


@dataclass(frozen=True)
class StepOutputs(TensorStruct):
    """Outputs of the networks for the steps of motions; axes (clips, steps)."""

    error: Float[Tensor, "clips steps 207"]
    """The step from the decoded next state to the next state of the motion."""
    surprise: Float[Tensor, "clips steps"]
    """KL(q(z | x_(t-1), x_t) ‖ p(z | x_(t-1))), nats."""
    contacts: Float[Tensor, "clips steps 9"]
    """Logits."""


def posterior_outputs(
    networks: HumorNetworks, states: State, pelvis: Float[Tensor, "clips 3"]
) -> StepOutputs:
    """The networks' outputs for every step, decoded from the posterior's mean latent.

    Args:
        networks: in the states' precision.
        states: of motions at 30 Hz, axes (clips, time).
        pelvis: of the bodies at rest, horizontally.
    """
    steps = Steps.of(states, pelvis)
    mean, log_variance = networks.posterior(steps.start, steps.end)
    prior_mean, prior_log_variance = networks.prior(steps.start)
    raw = networks.decode(steps.start, mean)
    return StepOutputs(
        error=steps.error(raw),
        surprise=kl_divergence(mean, log_variance, prior_mean, prior_log_variance),
        contacts=raw[..., _MOVED:],
    )


@dataclass(frozen=True)
class Steps(TensorStruct):
    """Packed states (`State.pack`) before and after every step, in the frame of the earlier state.

    The same as `Frame.to_frame` and `step_between` make, with all vectors turned at once.
    """

    start: Float[Tensor, "clips steps 339"]
    end: Float[Tensor, "clips steps 339"]
    rotations: Float[Tensor, "2 clips steps 22 3 3"]
    """Rotations of root and joints, at the start and at the end."""

    @classmethod
    def of(cls, states: State, pelvis: Float[Tensor, "clips 3"]) -> "Steps":
        """The steps between neighbouring states; `pelvis` is that of the bodies at rest."""
        frame = Frame.of(states[:, :-1])
        level = torch.cat((frame.origin[..., None, :], pelvis[:, None, None].expand_as(
            frame.origin[..., None, :])), -2)  # fmt: skip
        vectors = torch.cat(
            (
                states.translation[..., None, :],
                states.velocity[..., None, :],
                states.angular_velocity[..., None, :],
                states.root.mT,
                states.joints,
                states.joint_velocities,
            ),
            -2,
        )
        # into the step's frame: move its origin to zero, then turn joints about the pelvis
        minus, plus = _offset_matrices(vectors.dtype, vectors.device)
        ends = torch.stack((vectors[:, :-1], vectors[:, 1:])) - minus @ level
        turned = ends @ frame.turn.mT + plus * pelvis[:, None, None]
        root = turned[..., 3:6, :].mT
        pose = torch.stack((states.pose[:, :-1], states.pose[:, 1:]))
        packed = torch.cat(
            (
                turned[..., :2, :].flatten(-2),
                root.flatten(-2),
                turned[..., 2, :],
                pose.flatten(-3),
                turned[..., 6:, :].flatten(-2),
            ),
            -1,
        )
        rotations = torch.cat((root[..., None, :, :], pose), -3)
        return cls(packed[0], packed[1], rotations)

    def error(self, raw: Float[Tensor, "clips steps 216"]) -> Float[Tensor, "clips steps 207"]:
        """Return the error of decoder outputs: the step from predicted to true next states."""
        straight = self.end - self.start
        turns = torch.cat((raw[..., 6:9], raw[..., 12:75]), -1).unflatten(-1, (-1, 3))
        before, after = self.rotations.unbind(0)
        left = so3.axis_sine(after @ (so3.exp(turns) @ before).mT).flatten(-2)
        return torch.cat(
            (
                straight[..., :6] - raw[..., :6],
                left[..., :3],
                straight[..., 15:18] - raw[..., 9:12],
                left[..., 3:],
                straight[..., 207:] - raw[..., 75:_MOVED],
            ),
            -1,
        )


_MOVED = 207
"""Numbers of a raw step before its contact logits."""


@lru_cache(maxsize=8)
def _offset_matrices(dtype: torch.dtype, device: torch.device) -> tuple[Tensor, Tensor]:
    """Matrices that subtract frame origin and pelvis from a state, and that add the pelvis."""
    minus = torch.zeros(50, 2, dtype=dtype, device=device)
    plus = torch.zeros(50, 1, dtype=dtype, device=device)
    minus[0, 0] = 1.0
    minus[6:28] = 1.0
    plus[6:28] = 1.0
    return minus, plus


def kl_divergence(
    mean: Float[Tensor, "*batch 48"],
    log_variance: Float[Tensor, "*batch 48"],
    prior_mean: Float[Tensor, "*batch 48"],
    prior_log_variance: Float[Tensor, "*batch 48"],
) -> Float[Tensor, "*batch"]:
    """KL(q ‖ p) of two Gaussians with independent numbers, nats."""
    ratio = log_variance - prior_log_variance
    away = (mean - prior_mean).square() * (-prior_log_variance).exp()
    return 0.5 * (ratio.exp() + away - 1 - ratio).sum(-1)


SPAN = 4
"""Frames that a step depends on, from the one before it starts to the one after it ends."""
_SIZE = SPAN * FRAME + 16


@dataclass(frozen=True)
class StepCurvature(TensorStruct):
    """Mean JᵀJ of the residuals of a transition between frames, over recorded motions.

    J has the derivatives by the variables of its frames and by the shape; energies are in nats,
    translations in the heading of the frame that the transition starts from.
    """

    error: Float[Tensor, "numbers numbers"]
    latents: Float[Tensor, "numbers numbers"]

    @classmethod
    def load(cls, path: str | Path = "open") -> "StepCurvature":
        """Load the bundled step curvature ("open") or that of a weights file.

        Raises:
            FileNotFoundError: when there is no such file.
            ValueError: when it holds something else.
        """
        shapes = {"error": (_SIZE, _SIZE), "latents": (_SIZE, _SIZE)}
        roots = named_checkpoint(path, "humor_steps").require(shapes)
        found = {name: root.double() @ root.double().mT for name, root in roots.items()}
        return cls(**{name: matrix.float() for name, matrix in found.items()})

    def add(
        self, motion: Motion, hessian: Banded, error: float | Tensor, latents: float | Tensor
    ) -> None:
        """Add the curvature of all steps of a clip.

        Args:
            motion: of one clip, without a batch axis.
            hessian: what it is added to, by the steps of its frames and by the shape.
            error: weight of a step's error, per nat.
            latents: weight of its surprise, per nat.
        """
        like, steps, moved = motion.translation, motion.frames - 1, SPAN * FRAME
        whole = (error * self.error + latents * self.latents).to(like)
        size = hessian.corner.shape[-1]
        exists = motion.pairs.to(like)[:, None, None]
        turn = so3.undo_heading(motion.rotations[:-1, 0]).mT
        mean = whole[:moved, :moved].unflatten(0, (SPAN, FRAME)).unflatten(2, (SPAN, FRAME))
        edge = whole[:moved, moved : moved + size].unflatten(0, (SPAN, FRAME))
        hessian.corner.add_(exists.sum() * whole[moved : moved + size, moved : moved + size])
        for a in range(SPAN):
            first, stop = max(0, 1 - a), min(steps, steps + 2 - a)
            rows = slice(first, stop)
            frame = slice(first + a - 1, stop + a - 1)
            border = hessian.border[frame]
            border[:, 3:].addcmul_(exists[rows], edge[a, 3:])
            border[:, :3].addcmul_(exists[rows], turn[rows] @ edge[a, :3])
            for b in range(a, SPAN):
                last = min(stop, steps + 2 - b)
                rows, frame = slice(first, last), slice(first + a - 1, last + a - 1)
                _add_in_world(hessian.inner[frame, b - a], mean[a, :, b], turn[rows], exists[rows])


def _add_in_world(
    hessian: Float[Tensor, "steps 69 69"],
    block: Float[Tensor, "69 69"],
    turn: Float[Tensor, "steps 3 3"],
    exists: Float[Tensor, "steps 1 1"],
) -> None:
    """Add a block to those of given steps, its translations turned from their heading to world."""
    from_left = turn @ block[:3]
    hessian[:, 3:, 3:].addcmul_(exists, block[3:, 3:])
    hessian[:, :3, 3:].addcmul_(exists, from_left[..., 3:])
    hessian[:, 3:, :3].addcmul_(exists, block[3:, :3] @ turn.mT)
    hessian[:, :3, :3].addcmul_(exists, from_left[..., :3] @ turn.mT)


@lru_cache(maxsize=2)
def bundled_curvature(device: torch.device) -> StepCurvature:
    """Load the step curvature measured for the bundled weights, on a device; cached.

    Minima do not depend on it. Networks of another width need their own for streams: with this
    one most of their steps are too long.
    """
    with torch.inference_mode(False):
        return StepCurvature.load().to(device=device)


ERROR, SURPRISE = 100.0, 20.0
"""Energies of one step, in nats, beyond which it counts less and less. A step that is far from
the corpus is one that the networks never saw, so the data should decide about it."""
RARITY = 300.0
"""Rarity of one state (`priors.humor.likely`), in nats, beyond which it counts less and
less. Draws of the mixture of initial states have 66 on average."""


@dataclass(frozen=True)
class CollocationWeights:
    """Weights by which the prior's energies are multiplied, for observations of weight one."""

    pose: PoseWeights
    """Weights of the pose density, of the shape and of the remaining smoothness."""
    step: float
    """Weight of the squared error of the decoder, in nats per step."""
    latents: float
    """Weight of the KL divergence of the posterior from the prior, in nats per step."""
    contact_velocity: float
    """Weight of ½ c |step|² in metres², where c is the probability of contact of a joint."""
    support: float
    """Weight of feet that carry the body where nobody saw them, in nats per frame
    (`recon.physics.support`)."""
    state: float
    """Weight of the rarity of a state where nobody saw a limb, in nats per frame
    (`priors.humor.likely`)."""

    @classmethod
    def for_noise(cls, noise: float) -> "CollocationWeights":
        """Weights for observations of a standard deviation of `noise` metres per coordinate.

        Chosen on validation people. The bound on -log p(x_t | x_(t-1)) has noise² as the weight of
        both of its parts, `step` and `latents`, but errors of neighbouring steps are correlated,
        so smaller weights are better. Where points are exact, 14 mm of noise are assumed, and 18.5
        mm for steps: nobody moves just like the people of the corpus. The steps tell how smooth a
        motion is, so a twenty-fifth of the pose prior's smoothness suffices; all of it would make
        accelerations too small.
        """
        pose = PoseWeights.for_noise(noise)
        variance = max(noise, 0.014) ** 2
        return cls(
            pose=PoseWeights(0.5 * pose.pose, pose.shape, acceleration=0.04 * pose.acceleration),
            step=0.125 * max(noise, 0.0185) ** 2,
            latents=0.3 * variance,
            contact_velocity=2e4 * max(noise, 0.008) ** 2,
            support=0.6 * variance,
            state=0.1 * variance,
        )


def heavy_tailed(nats: Tensor, scale: float) -> Tensor:
    """Robust kernel ρ(x) = s log(1 + x / s) with scale s: x if small, logarithmic if large."""
    return scale * torch.log1p(nats / scale)

"""HuMoR as a prior: a motion is a first state and the latents of its transitions."""

import logging
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from priors.humor.mixture import Mixture
from priors.humor.networks import HumorNetworks
from priors.humor.state import (
    Frame,
    State,
    compose,
    contact_probabilities,
    initial_features,
    states_of,
)
from priors.humor.weights import (
    bundled_weights,
    mixture_from,
    networks_from,
    read_weights,
    whitening_from,
)
from recon.body.model import BodyModel
from recon.core import rotations as so3
from recon.core.motion import Motion, carried_translation
from recon.core.struct import TensorStruct
from recon.method.plugins import imported
from recon.method.priors import USUAL_NOISE, Prior
from recon.method.protocols import REFERENCE_FPS, Decoded
from recon.method.stages import Stage
from recon.method.terms import Term

if TYPE_CHECKING:
    from priors.humor.live import LiveSteps
    from priors.humor.loop import FrozenDecoder

_LOG = logging.getLogger(__name__)

_LOG_TWO_PI = math.log(2 * math.pi)

_METHODS: Mapping[str, str] = {
    "collocation": "priors.humor.collocation:Collocation",
    "rollout": "priors.humor.shooting:Shooting",
}
"""Classes of the ways to fit by name; the usual one first."""


@dataclass(frozen=True)
class HumorVariables(TensorStruct):
    """A first state, as steps of its rotations away from a base, and what follows; at 30 Hz."""

    translation: Float[Tensor, "clips 3"]
    """SMPL translation of the first frame, metres."""
    root: Float[Tensor, "clips 3"]
    """Rotation vector of the root, relative to `base`, radians."""
    pose: Float[Tensor, "clips 21 3"]
    """Rotation vectors of the other joints: R = base · Exp(pose), radians."""
    velocity: Float[Tensor, "clips 3"]
    """Velocity of the pelvis in the first frame, m/s."""
    angular_velocity: Float[Tensor, "clips 3"]
    """Angular velocity of the root in the world, rad/s."""
    joint_velocities: Float[Tensor, "clips 21 3"]
    """Velocities in the world of all joints but the pelvis, m/s."""
    latents: Float[Tensor, "clips steps 48"]
    shape: Float[Tensor, "clips shape"]
    base: Float[Tensor, "clips 22 3 3"]
    valid: Bool[Tensor, "clips time"]
    start_time: float

    def carried(self, T: Float[Tensor, "clips 4 4"], body: BodyModel) -> "HumorVariables":
        """Variables of a motion that begins in the first state after a rigid transform.

        Latents are changes as the body sees them and stay. Where the transform tilts, the
        roll-out from there is another motion, because the decoder knows where up is.
        """
        turn, pelvis = T[:, :3, :3], body.rest_joints(self.shape)[:, 0]
        return self.replace(
            translation=carried_translation(self.translation[:, None], T, pelvis)[:, 0],
            velocity=(turn @ self.velocity[..., None])[..., 0],
            angular_velocity=(turn @ self.angular_velocity[..., None])[..., 0],
            joint_velocities=self.joint_velocities @ turn.mT,
            base=torch.cat((turn[:, None] @ self.base[:, :1], self.base[:, 1:]), 1),
        )

    def first(self, frames: int) -> "HumorVariables":
        """Variables of the motion's first frames."""
        return self.derived(latents=self.latents[:, : frames - 1], valid=self.valid[:, :frames])


@dataclass(frozen=True, eq=False)
class Humor(Prior[HumorVariables]):
    """Rempe et al., ICCV 2021: p(x_0) Π p(z_t | x_(t-1)), x_t = decoder(z_t, x_(t-1)).

    `decode(encode(m))` is near m but not m: the posterior's means say what the network can say.
    """

    methods: ClassVar[tuple[str, ...]] = tuple(_METHODS)
    level: ClassVar[bool] = True
    """Motions are in the world: a step depends on where up is and where the ground."""
    networks: HumorNetworks
    initial: Mixture
    body: BodyModel
    error_whitening: Float[Tensor, "207 207"]
    """U with C⁻¹ = U Uᵀ, C the covariance of the decoder's errors over the training corpus
    (`priors.humor.state.step_between`)."""

    @classmethod
    def load(
        cls,
        path: str | Path | None = None,
        body: BodyModel | None = None,
        *,
        mixture: str | Path | None = None,
    ) -> "Humor":
        """The bundled weights, ones of `python -m training humor`, or the released checkpoint.

        Args:
            path: .safetensors of ours, or the authors' .pth; `open` or None are the weights in the
                package, `nc` the non-commercial ones of a source checkout.
            body: whose joints the network sees; None is the bundled body.
            mixture: the authors' prior_gmm.npz; None takes the one beside the weights in a
                .safetensors file, and with a .pth the bundled one.

        Raises:
            FileNotFoundError: when there is no such file.
            ValueError: when it holds no HuMoR weights; the message names the layers.
        """
        body = BodyModel.load() if body is None else body.to(device="cpu")
        weights = read_weights("open" if path is None else path)
        networks = networks_from(weights)
        if mixture is not None:
            initial = Mixture.load(mixture)
        else:
            initial = mixture_from(weights) or mixture_from(bundled_weights())
        if path is not None and Path(path).suffix == ".pth" and body.name == "recon":
            _LOG.warning(
                "%s learned from SMPL-H bodies; joints of the bundled body sit elsewhere, so give "
                "a SMPL-H file of your own",
                path,
            )
        whitening = whitening_from(weights)
        if whitening is None:
            whitening = whitening_from(bundled_weights())
        assert initial is not None
        assert whitening is not None
        return cls(networks.requires_grad_(False), initial, body, whitening)

    def stages(
        self,
        data: tuple[Term, ...],
        noise: float = USUAL_NOISE,
        body: BodyModel | None = None,
        method: str | None = None,
    ) -> tuple[Stage[Any], ...]:
        """All frames at once by `collocation`; `rollout` moves a first state and latents."""
        kind = imported(_METHODS[self.methods[0] if method is None else method], "method")
        humor = self if body is None else self.like(body.template)
        return kind.for_noise(humor, noise).stages(data)

    def live(self, noise: float) -> "LiveSteps":
        """The energies of steps for a stream whose points are off by `noise` metres."""
        return imported("priors.humor.live:LiveSteps", "live").for_noise(self, noise)

    def to(
        self, *, device: torch.device | str | None = None, dtype: torch.dtype | None = None
    ) -> "Humor":
        """The prior on another device or in another precision."""
        networks = type(self.networks)(self.networks.width).requires_grad_(False)
        networks.load_state_dict(self.networks.state_dict())
        return replace(
            self,
            networks=networks.to(device=device, dtype=dtype),
            initial=self.initial.to(device=device, dtype=dtype),
            error_whitening=self.error_whitening.to(device=device, dtype=dtype),
            body=self.body.to(device=device, dtype=dtype),
        )

    def like(self, tensor: Tensor) -> "Humor":
        """The prior in a tensor's precision and on its device; made once for each."""
        own = self.body.template
        if own.dtype == tensor.dtype and own.device == tensor.device:
            return self
        return _cast(self, tensor.device, tensor.dtype)

    def encode(self, motion: Motion) -> HumorVariables:
        """First state and posterior means of a motion, which is brought to 30 Hz.

        Every latent leads from where the latents before it have led towards the motion's next
        state, so that the roll-out follows the motion instead of adding up errors.

        Raises:
            ValueError: when it has fewer than two frames.
        """
        own = self.like(motion.translation)
        motion = motion.resample(REFERENCE_FPS)
        states = states_of(motion, own.body)
        first = states[:, 0]
        zero = torch.zeros_like(motion.rotations[:, 0, :, 0])
        return HumorVariables(
            translation=first.translation,
            root=zero[:, 0],
            pose=zero[:, 1:],
            velocity=first.velocity,
            angular_velocity=first.angular_velocity,
            joint_velocities=first.joint_velocities[:, 1:],
            latents=own._latents_along(states, own.pelvis(motion.shape)),
            shape=motion.shape,
            base=motion.rotations[:, 0],
            valid=motion.valid,
            start_time=motion.start_time,
        )

    def decode(self, variables: HumorVariables) -> Decoded:
        """The motion of a first state and latents.

        `energies["transition"]` is -Σ log p(z_t | x_(t-1)), `energies["initial"]` -log p(x_0),
        nats.
        """
        # fits by collocation unroll nothing
        from priors.humor.rollout import roll_out

        own = self.like(variables.translation)
        first, pelvis = own._first(variables), own.pelvis(variables.shape)
        frame = Frame.of(first)
        start = frame.enter(first, pelvis)
        rollout = roll_out(own._decoder, start.pack(), pelvis, variables.latents)
        states = rollout.in_world(frame, pelvis)
        mean, log_variance = own.networks.prior(rollout.inputs)
        away = (variables.latents - mean).square() * (-log_variance).exp()
        nats = 0.5 * (away + log_variance + _LOG_TWO_PI).sum(-1)
        motion = _motion(first, states, variables.shape, variables.start_time)
        return Decoded(
            motion=motion.replace(valid=variables.valid),
            energies={
                "transition": nats.where(variables.valid[:, 1:], 0.0).sum(-1),
                "initial": own.initial.energy(initial_features(start)),
            },
            contacts=contact_probabilities(rollout.contacts),
            joints=torch.cat((first.joints[:, None], states.joints), 1),
        )

    def _first(self, variables: HumorVariables) -> State:
        steps = torch.cat((variables.root[:, None], variables.pose), 1)
        rotations = variables.base @ so3.exp(steps)
        motion = Motion.create(
            variables.translation[:, None], rotations[:, None], variables.shape, REFERENCE_FPS
        )
        velocities = torch.cat((variables.velocity[:, None], variables.joint_velocities), 1)
        return State(
            translation=variables.translation,
            velocity=variables.velocity,
            root=rotations[:, 0],
            angular_velocity=variables.angular_velocity,
            pose=rotations[:, 1:],
            joints=self.body.pose(motion).joints[:, 0],
            joint_velocities=velocities,
        )

    def _latents_along(
        self, states: State, pelvis: Float[Tensor, "clips 3"]
    ) -> Float[Tensor, "clips steps 48"]:
        """Posterior mean of every step from where the steps before have led.

        Were each taken from the true state before, errors would add up over the roll-out.
        """
        frame = Frame.of(states[:, 0])
        here = frame.enter(states[:, 0], pelvis).pack()
        latents: list[Tensor] = []
        for step in range(1, states.translation.shape[1]):
            ahead = frame.enter(states[:, step], pelvis).pack()
            latents.append(self.networks.posterior(here, ahead)[0])
            raw = self.networks.decode(here, latents[-1])
            reached = frame.leave(compose(State.unpack(here), raw)[0], pelvis)
            frame = Frame.of(reached)
            here = frame.enter(reached, pelvis).pack()
        return torch.stack(latents, 1)

    def pelvis(self, shape: Float[Tensor, "clips shape"]) -> Float[Tensor, "clips 3"]:
        """Pelvis of the unposed body with its height set to zero, metres; see `rest_pelvis`."""
        return self.body.rest_joints(shape)[:, 0] * shape.new_tensor([1.0, 1.0, 0.0])

    @cached_property
    def _decoder(self) -> "FrozenDecoder":
        from priors.humor.loop import FrozenDecoder

        return FrozenDecoder.of(self.networks.decoder)


@lru_cache(maxsize=8)
def _cast(humor: Humor, device: torch.device, dtype: torch.dtype) -> Humor:
    return humor.to(device=device, dtype=dtype)


def _motion(
    first: State, states: State, shape: Float[Tensor, "clips shape"], start_time: float
) -> Motion:
    roots = torch.cat((first.root[:, None], states.root), 1)
    poses = torch.cat((first.pose[:, None], states.pose), 1)
    return Motion.create(
        translation=torch.cat((first.translation[:, None], states.translation), 1),
        rotations=torch.cat((roots[:, :, None], poses), 2),
        shape=shape,
        fps=REFERENCE_FPS,
        start_time=start_time,
    )

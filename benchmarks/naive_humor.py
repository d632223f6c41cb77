"""HuMoR's roll-out as research code writes it, for `benchmarks.rollout` to compare with.

The objective is the same to rounding, and so is its gradient. What is left undone: the weights
keep their gradients; the conditional prior is asked inside the loop, one step at a time; latents
are joined to the input of every layer; every state goes to its canonical frame and back to the
world as a record of its parts, and its rotations from vectors to matrices to vectors; the body is
the whole mesh in every frame, and the joints are cut from one array with points of its surface.
"""

import math
from dataclasses import dataclass, replace

import roma
import torch
from jaxtyping import Float
from torch import Tensor

from priors.humor.mixture import Mixture
from priors.humor.networks import HumorNetworks
from priors.humor.prior import Humor, HumorVariables
from priors.humor.state import Frame, State, initial_features
from recon.body.model import BodyModel, PosedBody
from recon.core.motion import Motion
from recon.core.scene import Scene
from recon.core.skeleton import CONTACT_JOINTS, JOINTS
from recon.method.protocols import REFERENCE_FPS, Decoded, Estimate

_PARTS = (3, 3, 3, 3, 63, 66, 66, len(CONTACT_JOINTS))
"""Sizes of a raw step's parts: changes of translation and its velocity, of the root's rotation and
its velocity, of the pose, of joints and their velocities; and contacts."""

_EXTRA = slice(0, 21)
"""Points of the surface that come with the joints."""


@dataclass(frozen=True, eq=False)
class NaiveHumor:
    """A first state and latents become an estimate."""

    networks: HumorNetworks
    initial: Mixture
    body: BodyModel

    @classmethod
    def of(cls, humor: Humor) -> "NaiveHumor":
        """Networks with the weights of ours, and with gradients."""
        networks = HumorNetworks(humor.networks.width).to(humor.body.template)
        networks.load_state_dict(humor.networks.state_dict())
        return cls(networks.requires_grad_(True), humor.initial, humor.body)

    def estimate(self, variables: HumorVariables, scene: Scene) -> Estimate:
        """What the energies look at."""
        first = self._first(variables)
        pelvis = self.body.rest_joints(variables.shape)[:, 0]
        pelvis = pelvis * pelvis.new_tensor([1.0, 1.0, 0.0])
        frame = Frame.of(first)
        state = frame.enter(first, pelvis)
        initial = self.initial.energy(initial_features(state))

        world, nats, logits = [first], [], []
        vectors = [_to_vectors(first)]
        for latent in variables.latents.unbind(1):
            packed = state.pack()
            mean, log_variance = self.networks.prior(packed)
            away = (latent - mean) ** 2 / torch.exp(log_variance)
            nats.append(0.5 * (away + log_variance + math.log(2 * math.pi)).sum(-1))
            state, contacts = _stepped(state, self.networks.decode(packed, latent))
            logits.append(contacts)
            world.append(frame.leave(state, pelvis))
            vectors.append(_to_vectors(world[-1]))
            frame = Frame.of(world[-1])
            state = frame.enter(world[-1], pelvis)

        motion = Motion.create(
            translation=torch.stack([s.translation for s in world], 1),
            rotations=roma.rotvec_to_rotmat(torch.stack(vectors, 1)),
            shape=variables.shape,
            fps=REFERENCE_FPS,
        ).replace(valid=variables.valid)
        feet = torch.stack([logits[0], *logits], 1).sigmoid()
        contacts = feet.new_zeros(*feet.shape[:2], len(JOINTS))
        contacts[..., list(CONTACT_JOINTS)] = feet
        transition = torch.stack(nats, 1).where(variables.valid[:, 1:], 0.0).sum(-1)
        decoded = Decoded(
            motion,
            {"transition": transition, "initial": initial},
            contacts,
            torch.stack([s.joints for s in world], 1),
        )
        return Estimate(decoded, _with_mesh(self.body.pose(motion)), scene)

    def _first(self, variables: HumorVariables) -> State:
        steps = torch.cat((variables.root[:, None], variables.pose), 1)
        rotations = variables.base @ roma.rotvec_to_rotmat(steps)
        motion = Motion.create(
            variables.translation[:, None], rotations[:, None], variables.shape, REFERENCE_FPS
        )
        return State(
            translation=variables.translation,
            velocity=variables.velocity,
            root=rotations[:, 0],
            angular_velocity=variables.angular_velocity,
            pose=rotations[:, 1:],
            joints=_with_mesh(self.body.pose(motion)).joints[:, 0],
            joint_velocities=torch.cat(
                (variables.velocity[:, None], variables.joint_velocities), 1
            ),
        )


def _stepped(
    state: State, raw: Float[Tensor, "batch 216"]
) -> tuple[State, Float[Tensor, "batch 9"]]:
    """The decoder's step applied, part by part; and contact logits."""
    translation, velocity, root, angular, pose, joints, joint_velocities, contacts = raw.split(
        _PARTS, -1
    )
    after = State(
        translation=state.translation + translation,
        velocity=state.velocity + velocity,
        root=roma.rotvec_to_rotmat(root) @ state.root,
        angular_velocity=state.angular_velocity + angular,
        pose=roma.rotvec_to_rotmat(pose.unflatten(-1, (-1, 3))) @ state.pose,
        joints=state.joints + joints.unflatten(-1, (-1, 3)),
        joint_velocities=state.joint_velocities + joint_velocities.unflatten(-1, (-1, 3)),
    )
    return after, contacts


def _to_vectors(state: State) -> Float[Tensor, "batch 22 3"]:
    return roma.rotmat_to_rotvec(torch.cat((state.root[:, None], state.pose), 1))


def _with_mesh(posed: PosedBody) -> PosedBody:
    """The joints as they come from a body model that gives them with points of its surface."""
    together = torch.cat((posed.joints, posed.vertices[..., _EXTRA, :]), -2)
    return replace(posed, joints=together[..., : len(JOINTS), :])

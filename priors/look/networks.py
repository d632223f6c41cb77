"""The network that proposes several whole motions, with weights, from seen points of a clip.

Each frame becomes one vector: the sum over visible points of features of their place on the body
times their position, so any set of points is an input. Transformer layers with short convolutions
let frames look at each other. The last layers run once for every hypothesis.
"""

from contextlib import nullcontext
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn
from torch.nn import functional

from priors.look.points import REACH_M, SeenPoints, WalkingFrames
from recon.body.model import BodyModel, forward_kinematics
from recon.core import rotations as so3
from recon.core.skeleton import CONTACT_JOINTS, JOINTS
from recon.core.struct import TensorStruct

_FEATURES = 96
"""Features of a place on the body."""
_HEADS = 4
_NEAR = 9
"""Frames that a convolution sees."""
_USUAL_POINTS = 11.0
"""Visible points of a usual frame, by which sums over points are divided."""
_ROTATIONS, _PLACE, _SPREAD = 6 * len(JOINTS), 3, len(JOINTS)
_OUTPUTS = _ROTATIONS + _PLACE + _SPREAD + len(CONTACT_JOINTS)
_UPRIGHT_6D = (1.0, 0.0, 0.0, 0.0, 0.0, 1.0)
_STRAIGHT_6D = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0)
_PELVIS_M = 0.95
"""Height of a standing pelvis, metres, from which the network's own is counted."""
_STD_M = 0.05
"""Standard deviation of a joint before training, metres."""


@dataclass(frozen=True)
class Proposed(TensorStruct):
    """Motions that the network proposes for clips, in the world."""

    log_weight: Float[Tensor, "clips hypotheses"]
    """Logarithm of the probability of each hypothesis."""
    rotations: Float[Tensor, "clips hypotheses time 22 3 3"]
    """Of every joint relative to its parent; the first in the world."""
    pelvis: Float[Tensor, "clips hypotheses time 3"]
    """Position of the pelvis joint, metres."""
    shape: Float[Tensor, "clips shape"]
    """Coefficients of the body."""
    log_std: Float[Tensor, "clips hypotheses time 22"]
    """Natural logarithm of the standard deviation of every coordinate of a joint, metres."""
    contacts: Float[Tensor, "clips hypotheses time 9"]
    """Log-odds that a joint of `CONTACT_JOINTS` carries weight."""

    def joints(self, body: BodyModel) -> Float[Tensor, "clips hypotheses time 22 3"]:
        """Positions of the joints in the world, metres."""
        rest = body.rest_joints(self.shape)
        rest = rest[:, None].expand(-1, self.rotations.shape[1], -1, -1)
        _, joints = forward_kinematics(self.rotations, rest)
        return joints - joints[..., :1, :] + self.pelvis[..., None, :]


class LookNetwork(nn.Module):
    """Network that maps the seen points of clips to several motions with weights (`Proposed`)."""

    def __init__(
        self, shape: int, width: int = 224, common: int = 4, own: int = 2, hypotheses: int = 4
    ) -> None:
        """Build an untrained network.

        Args:
            shape: coefficients of the body that are found.
            width: numbers per frame inside the transformer.
            common: its layers before hypotheses part.
            own: its layers that run once for every hypothesis.
            hypotheses: their number.
        """
        super().__init__()
        self.place = nn.Sequential(
            nn.Linear(len(JOINTS) + 3, 64), nn.GELU(), nn.Linear(64, _FEATURES)
        )
        self.first = nn.Sequential(
            nn.Linear(4 * _FEATURES + 7, 2 * width), nn.GELU(), nn.Linear(2 * width, width)
        )
        self.common = nn.ModuleList(_ConvolutionAndAttention(width) for _ in range(common))
        self.codes = nn.Parameter(0.5 * torch.randn(hypotheses, width))
        self.own = nn.ModuleList(_ConvolutionAndAttention(width) for _ in range(own))
        self.norm = nn.LayerNorm(width)
        self.last = nn.Linear(width, _OUTPUTS)
        self.whole = nn.Linear(width, shape)
        self.weight = nn.Linear(width, 1)
        for layer in (self.last, self.whole, self.weight):
            nn.init.normal_(layer.weight, std=0.01)
            nn.init.zeros_(layer.bias)

    def forward(self, seen: SeenPoints, body: BodyModel, *, half: bool = False) -> Proposed:
        """Propose motions at 30 Hz for all clips; with `half`, layers multiply in bfloat16."""
        frames = WalkingFrames.of(seen, body)
        x = self.first(self._features(seen, frames))
        count = len(self.codes)
        exists = seen.exists.repeat_interleave(count, 0)
        with torch.autocast(x.device.type, torch.bfloat16) if half else nullcontext():
            for layer in self.common:
                x = layer(x, seen.exists)
            x = (x[:, None] + self.codes[:, None]).flatten(0, 1)
            for layer in self.own:
                x = layer(x, exists)
        x = self.norm(x)
        found = self.last(x).unflatten(0, (-1, count))
        exists = exists[..., None].to(x)
        mean = (x * exists).sum(1) / exists.sum(1).clamp(min=1)
        mean = mean.unflatten(0, (-1, count))
        rotations, pelvis, log_std, contacts = found.split(
            (_ROTATIONS, _PLACE, _SPREAD, len(CONTACT_JOINTS)), -1
        )
        usual = found.new_tensor([_UPRIGHT_6D] + [_STRAIGHT_6D] * (len(JOINTS) - 1))
        turns = so3.from_6d(rotations.unflatten(-1, (-1, 6)) + usual)
        turn, origin = frames.turn[:, None], frames.origin[:, None]
        turns = torch.cat((turn[..., None, :, :] @ turns[..., :1, :, :], turns[..., 1:, :, :]), -3)
        raised = pelvis + pelvis.new_tensor([0.0, 0.0, _PELVIS_M])
        return Proposed(
            log_weight=self.weight(mean)[..., 0].log_softmax(-1),
            rotations=turns,
            pelvis=origin + (turn @ raised[..., None])[..., 0],
            shape=self.whole(mean.mean(1)),
            log_std=log_std + torch.log(log_std.new_tensor(_STD_M)),
            contacts=contacts,
        )

    def _features(
        self, seen: SeenPoints, frames: WalkingFrames
    ) -> Float[Tensor, "clips time features"]:
        """Input of every frame: features summed over seen points, their number, noise, path."""
        bone = functional.one_hot(seen.bone, len(JOINTS)).to(seen.offset)
        place = self.place(torch.cat((bone, seen.offset / REACH_M), -1))
        inside = frames.in_walking_frames(seen.positions)
        inside = inside - inside.new_tensor([0.0, 0.0, _PELVIS_M])
        shown = seen.visible[..., None].to(inside)
        numbers = torch.cat((inside.where(seen.visible[..., None], 0.0), shown), -1)
        sums = torch.einsum("cpf,ctpn->ctfn", place, numbers).flatten(-2) / _USUAL_POINTS
        count = shown.sum((-2, -1))[..., None] / _USUAL_POINTS
        std = (seen.std.log() + 4.0)[:, None, None].expand_as(count)
        seldom = (count == 0).to(count)
        steps = frames.steps_ahead(seen.exists) * inside.new_tensor([30.0, 30.0, 30.0, 1.0])
        return torch.cat((sums, count, std, seldom, steps), -1)


class _ConvolutionAndAttention(nn.Module):
    """Transformer layer with a short convolution over time before attention, all residual."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.norms = nn.ModuleList(nn.LayerNorm(width) for _ in range(3))
        self.near = nn.Parameter(torch.randn(_NEAR, width) / _NEAR)
        self.bias = nn.Parameter(torch.zeros(width))
        self.far = nn.Parameter(torch.linspace(-6.0, -2.0, _HEADS))
        self.ask, self.answer = nn.Linear(width, 3 * width), nn.Linear(width, width)
        self.inner, self.outer = nn.Linear(width, 2 * width), nn.Linear(2 * width, width)

    def forward(
        self, x: Float[Tensor, "clips time width"], exists: Bool[Tensor, "clips time"]
    ) -> Float[Tensor, "clips time width"]:
        first, second, third = self.norms
        shown = exists[..., None]
        around = functional.pad(first(x) * shown, (0, 0, _NEAR // 2, _NEAR // 2))
        # a sum of shifted products and its derivative take less time than a grouped convolution
        parts = (w * around[:, k : k + x.shape[1]] for k, w in enumerate(self.near))
        x = x + sum(parts, self.bias)
        asked = self.ask(second(x)).unflatten(-1, (3, _HEADS, -1)).movedim(-3, 0)
        query, key, value = asked.transpose(-3, -2)
        place = torch.arange(x.shape[-2], device=x.device)
        apart = (place[:, None] - place).abs().to(x)
        # attention falls with the distance in time of two frames, at a rate that each head learns
        bias = -self.far.exp()[:, None, None] * apart
        bias = bias.to(query.dtype).masked_fill(~exists[:, None, None], -torch.inf)
        found = functional.scaled_dot_product_attention(query, key, value, attn_mask=bias)
        x = x + self.answer(found.transpose(-3, -2).flatten(-2))
        return x + self.outer(functional.gelu(self.inner(third(x))))

"""What HuMoR's parts are worth: the full model and five without some of them, learned alike.

    python -m benchmarks.ablations CORPUS --out FOLDER

Trains, on the freely licensed clips and one after the other, the full model, the paper's four
ablations, and all four at once (its MVAE baseline), by one short schedule. A run that was cut goes
on where it was. FOLDER/NAME.safetensors are the weights that `benchmarks.humor --ablations FOLDER`
fits with. States are not blurred here: a decoder that adds to a state gets it exactly all the
same, one that does not would have to guess it.
"""

import argparse
import logging
from dataclasses import dataclass, field, replace
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor

from priors.humor.collocation import Collocation
from priors.humor.networks import LATENT, RAW, HumorNetworks
from priors.humor.prior import Humor
from priors.humor.state import Frame, State, compose
from recon.benchmark.dataset import SPLITS
from recon.core import rotations as so3
from training.humor.run import HumorTraining, LossWeights, export_weights
from training.humor.scaling import ScaledNetworks, Scaling
from training.humor.train import train

WIDTH = 512
STEPS = 1500
WINDOWS = 100
"""Per step; published are 200."""

_LEAST = 1e-3
"""Smallest scale of a number of a state."""


class StandardPrior(HumorNetworks):
    """p(z) = N(0, 1) wherever the step starts."""

    def prior(self, state: Float[Tensor, "*batch 339"]) -> tuple[Tensor, Tensor]:
        """Mean zero, variance one."""
        return standard_normal(state)


class NoDelta(HumorNetworks):
    """The decoder gives the next state itself, rotations as rotation vectors, not a change."""

    def decode(
        self, state: Float[Tensor, "*batch 339"], latent: Float[Tensor, "*batch 48"]
    ) -> Float[Tensor, "*batch 216"]:
        """The raw step to that state, as everything behind the networks expects it."""
        return step_to(state, super().decode(state, latent))


class Mvae(NoDelta, StandardPrior):
    """Decodes the state itself, and samples latents from N(0, I)."""


class LearningStandardPrior(ScaledNetworks):
    """`StandardPrior` while it learns."""

    def prior(self, state: Float[Tensor, "*batch 339"]) -> tuple[Tensor, Tensor]:
        """Mean zero, variance one."""
        return standard_normal(state)


class LearningNoDelta(ScaledNetworks):
    """`NoDelta` while it learns; outputs are scaled as states are, not as steps."""

    @classmethod
    def scaling_of(cls, world: State, rest_pelvis: Float[Tensor, "windows 3"]) -> Scaling:
        """The usual scaling, but for the outputs."""
        frame = Frame.of(world[:, :-1])
        outputs = output_of(frame.enter(world[:, 1:], rest_pelvis[:, None])).flatten(0, 1)
        contacts = outputs.new_zeros(RAW - outputs.shape[1])
        return Scaling.of(world, rest_pelvis).replace(
            raw_mean=torch.cat((outputs.mean(0), contacts)),
            raw=torch.cat((outputs.std(0).clamp(min=_LEAST), contacts + 1)),
        )

    def decode(
        self, state: Float[Tensor, "*batch 339"], latent: Float[Tensor, "*batch 48"]
    ) -> Float[Tensor, "*batch 216"]:
        """The next state, decoded as by `NoDelta.decode`."""
        return step_to(state, super().decode(state, latent))


class LearningMvae(LearningNoDelta, LearningStandardPrior):
    """`Mvae` while it learns."""


@dataclass(frozen=True)
class Ablation:
    """One variant of HuMoR."""

    losses: LossWeights = field(default_factory=LossWeights)
    learning: type[ScaledNetworks] = ScaledNetworks
    networks: type[HumorNetworks] = HumorNetworks

    def load(self, path: Path) -> Humor:
        """Its networks, once they have learned."""
        humor = Humor.load(path)
        networks = self.networks(humor.networks.width).requires_grad_(False)
        networks.load_state_dict(humor.networks.state_dict())
        return replace(humor, networks=networks)

    def method(self, humor: Humor, noise: float) -> Collocation:
        """The default fit; contacts that were not learned count nothing in it."""
        method = Collocation.for_noise(humor, noise)
        if self.knows_contacts:
            return method
        weights = replace(method.weights, contact_velocity=0.0)
        return replace(method, weights=weights)

    @property
    def knows_contacts(self) -> bool:
        """Whether what it says of contacts was learned."""
        return self.losses.contacts > 0


_NO_CONTACTS = LossWeights(contacts=0.0, contact_velocity=0.0)
_NO_SMPL = LossWeights(posed_joints=0.0, consistency=0.0)
_NEITHER = replace(_NO_SMPL, contacts=0.0, contact_velocity=0.0)

ABLATIONS = {
    "full": Ablation(),
    "no-delta": Ablation(learning=LearningNoDelta, networks=NoDelta),
    "no-contacts": Ablation(_NO_CONTACTS),
    "no-smpl": Ablation(_NO_SMPL),
    "standard-prior": Ablation(learning=LearningStandardPrior, networks=StandardPrior),
    "mvae": Ablation(_NEITHER, LearningMvae, Mvae),
}
"""Methods by name: HuMoR, without each of its parts, and without all four (HuMoR, section 5.3)."""


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("corpus", type=Path, help="folder of converted motions")
    parser.add_argument("--out", type=Path, required=True, help="folder of the runs")
    parser.add_argument("--splits", type=Path, default=SPLITS)
    parser.add_argument("--steps", type=int, default=STEPS)
    arguments = parser.parse_args()
    logging.basicConfig(level=logging.INFO)
    for name, ablation in ABLATIONS.items():
        settings = HumorTraining(
            corpus=arguments.corpus,
            out=arguments.out / name,
            splits=arguments.splits,
            width=WIDTH,
            steps=arguments.steps,
            windows=WINDOWS,
            losses=ablation.losses,
            noise=0.0,
        )
        learn(ablation, settings)


def learn(ablation: Ablation, settings: HumorTraining, samples: int = 20_000) -> Path:
    """Train one variant, or go on training it; its weights, beside the folder of the run."""
    path = settings.out.with_suffix(".safetensors")
    if path.is_file():
        return path
    train(settings, ablation.learning)
    return export_weights(settings, path, samples, ablation.networks)


def load_ablations(folder: Path) -> dict[str, Humor]:
    """All variants that were trained, by name.

    Raises:
        FileNotFoundError: when weights of one are not there.
    """
    return {name: own.load(folder / f"{name}.safetensors") for name, own in ABLATIONS.items()}


def standard_normal(state: Float[Tensor, "*batch 339"]) -> tuple[Tensor, Tensor]:
    """Mean and log-variance of N(0, 1) for every state."""
    zero = state.new_zeros(*state.shape[:-1], LATENT)
    return zero, zero


def step_to(
    state: Float[Tensor, "*batch 339"], output: Float[Tensor, "*batch 216"]
) -> Float[Tensor, "*batch 216"]:
    """The raw step that `compose` takes from a state to the one that an output without delta is.

    x' - x of vectors, log(R' Rᵀ) of rotations; contact logits as they are.
    """
    with torch.autocast(state.device.type, enabled=False):
        before = State.unpack(state)
        after, contacts = compose(_origin(before), output)
        change = zip(before.tensors().values(), after.tensors().values(), strict=True)
        parts = [so3.log(b @ a.mT) if a.shape[-2:] == (3, 3) else b - a for a, b in change]
        return torch.cat([p.reshape(*state.shape[:-1], -1) for p in (*parts, contacts)], -1)


def output_of(state: State) -> Float[Tensor, "*batch 207"]:
    """What a decoder without delta gives for a state; no contact logits.

    A body that stands upright is turned by pi about (0, 1, 1) from the rest pose, where rotation
    vectors jump to the other side; the one on the side of that axis is taken.
    """
    root = so3.log(state.root)
    angle = root.norm(dim=-1, keepdim=True).clamp(min=1e-6)
    behind = root[..., 1:].sum(-1, keepdim=True) < 0
    root = torch.where(behind, root * (1 - 2 * torch.pi / angle), root)
    parts = state.tensors() | {"root": root, "pose": so3.log(state.pose)}
    batch = state.translation.shape[:-1]
    return torch.cat([part.reshape(*batch, -1) for part in parts.values()], -1)


def _origin(like: State) -> State:
    """Zeros, and rotations by nothing."""
    zero = like.map(torch.zeros_like)
    identity = torch.eye(3, dtype=like.root.dtype, device=like.root.device)
    return zero.replace(root=identity.expand_as(like.root), pose=identity.expand_as(like.pose))


if __name__ == "__main__":
    main()

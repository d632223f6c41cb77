"""One step of a motion by a latent that is drawn from the conditional prior."""

import torch
from jaxtyping import Float
from torch import Tensor

from priors.humor.networks import HumorNetworks
from priors.humor.state import Frame, State, compose


def drawn_step(
    networks: HumorNetworks,
    state: State,
    pelvis: Float[Tensor, "clips 3"],
    random: torch.Generator | None,
    *,
    temperature: float = 1.0,
) -> tuple[Frame, State, Float[Tensor, "clips 9"]]:
    """One step by a latent drawn from the conditional prior, or by the prior's mean.

    Args:
        networks: in the states' precision and on their device.
        state: in the world.
        pelvis: of the bodies at rest, horizontally.
        random: of the latents; None takes the mean.
        temperature: factor on the prior's standard deviations.

    Returns:
        The canonical frame of the state, the next state in it, and the logits of contacts.
    """
    frame = Frame.of(state)
    here = frame.enter(state, pelvis)
    packed = here.pack()
    latent, log_variance = networks.prior(packed)
    if random is not None:
        noise = torch.randn(latent.shape, generator=random).to(latent)
        latent = latent + temperature * noise * (0.5 * log_variance).exp()
    return frame, *compose(here, networks.decode(packed, latent))

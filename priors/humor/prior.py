"""HuMoR as a prior: a motion is a first state and the latents of its transitions.

Its weights are ours, in safetensors with the mixture of first states, or the authors' checkpoint.
"""

import logging
import pickle
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import torch
from jaxtyping import Float
from torch import Tensor

from priors.checkpoints import Checkpoint, named_checkpoint
from priors.humor.mixture import Mixture
from priors.humor.networks import HumorNetworks, width_of
from recon.body.model import BodyModel
from recon.core.arrays import cached_constant
from recon.core.errors import WeightsError
from recon.core.motion import Motion
from recon.core.plugins import imported_object
from recon.method.priors import USUAL_NOISE, Prior
from recon.method.protocols import Decoded
from recon.method.stages import Stage
from recon.method.terms import Term

if TYPE_CHECKING:
    from priors.humor.live import LiveSteps
    from priors.humor.loop import FrozenDecoder
    from priors.humor.unrolled import HumorVariables
else:  # at run time Any replaces HumorVariables, whose module need not be imported
    from typing import Any as HumorVariables

_LOG = logging.getLogger(__name__)

_METHODS: Mapping[str, str] = {
    "collocation": "priors.humor.collocation:Collocation",
    "rollout": "priors.humor.shooting:Shooting",
}
"""Classes of the ways to fit by name; the usual one first."""


@dataclass(frozen=True, eq=False)
class Humor(Prior[HumorVariables]):
    """HuMoR (Rempe et al. 2021): density p(x_0) Π p(z_t | x_(t-1)), x_t = decoder(z_t, x_(t-1)).

    `decode(encode(m))` is near m but not m: the posterior's means say what the network can say.
    """

    methods: ClassVar[tuple[str, ...]] = tuple(_METHODS)
    level: ClassVar[bool] = True
    """Motions are in the world: a step depends on where up is and where the ground is."""
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
        """Load the bundled weights, a file of `python -m training humor`, or the authors' file.

        Args:
            path: .safetensors of ours, or the authors' .pth; `open` or None are the weights in the
                package.
            body: whose joints the network sees; None is the bundled body.
            mixture: the authors' prior_gmm.npz; None takes the one beside the weights in a
                .safetensors file, and with a .pth the bundled one.

        Raises:
            FileNotFoundError: when there is no such file.
            ValueError: when it holds no HuMoR weights; the message names the layers.
        """
        body = BodyModel.load() if body is None else body.to(device="cpu")
        if path in (None, "open") and mixture is None:
            found = _bundled_prior()
            return found if body is found.body else replace(found, body=body)
        weights = read_weights("open" if path is None else path)
        networks = networks_from(weights)
        initial = mixture_from(weights) if mixture is None else Mixture.load(mixture)
        if path is not None and Path(path).suffix == ".pth" and body.name == "recon":
            _LOG.warning(
                "%s learned from SMPL-H bodies; joints of the bundled body sit elsewhere, so give "
                "a SMPL-H file of your own",
                path,
            )
        whitening = whitening_from(weights)
        return cls(
            networks.requires_grad_(False),
            _bundled_prior().initial if initial is None else initial,
            body,
            _bundled_prior().error_whitening if whitening is None else whitening,
        )

    def stages(
        self,
        data: tuple[Term, ...],
        noise: float = USUAL_NOISE,
        body: BodyModel | None = None,
        method: str | None = None,
    ) -> tuple[Stage[Any], ...]:
        """The stages of `collocation` (all frames) or `rollout` (first state and latents)."""
        kind = imported_object(_METHODS[self.methods[0] if method is None else method], "method")
        humor = self if body is None else self.like(body.template)
        return kind.for_noise(humor, noise).stages(data)

    def live(self, noise: float) -> "LiveSteps":
        """Return HuMoR's energies for a live stream of points with `noise` metres of noise."""
        return imported_object("priors.humor.live:LiveSteps", "live").for_noise(self, noise)

    def to(
        self, *, device: torch.device | str | None = None, dtype: torch.dtype | None = None
    ) -> "Humor":
        """Return the prior on another device or in another precision."""
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
        """Return the prior in a tensor's precision and on its device; cached."""
        own = self.body.template
        if own.dtype == tensor.dtype and own.device == tensor.device:
            return self
        return _converted_prior(self, tensor.device, tensor.dtype)

    def encode(self, motion: Motion) -> HumorVariables:
        """Encode a motion, resampled to 30 Hz, as its first state and a latent per step.

        Every latent leads from where the latents before it have led towards the motion's next
        state, so that the roll-out follows the motion instead of adding up errors.

        Raises:
            ValueError: when it has fewer than two frames.
        """
        from priors.humor.unrolled import encoded_variables

        return encoded_variables(self.like(motion.translation), motion)

    def decode(self, variables: HumorVariables) -> Decoded:
        """Roll out the motion that starts with a first state and follows the given latents.

        `energies["transition"]` is -Σ log p(z_t | x_(t-1)), `energies["initial"]` -log p(x_0),
        nats.
        """
        from priors.humor.unrolled import decoded_motion  # imported only for roll-outs

        return decoded_motion(self.like(variables.translation), variables)

    def pelvis(self, shape: Float[Tensor, "clips shape"]) -> Float[Tensor, "clips 3"]:
        """Pelvis of the unposed body with its height set to zero, metres; see `rest_pelvis`."""
        return self.body.rest_joints(shape)[:, 0] * cached_constant(
            (1.0, 1.0, 0.0), shape.device, shape.dtype
        )

    @cached_property
    def decoder(self) -> "FrozenDecoder":
        """A copy of the decoder's weights in the form that roll-outs use."""
        from priors.humor.loop import FrozenDecoder

        return FrozenDecoder.of(self.networks.decoder)


@lru_cache(maxsize=8)
def _converted_prior(humor: Humor, device: torch.device, dtype: torch.dtype) -> Humor:
    return humor.to(device=device, dtype=dtype)


@lru_cache(maxsize=1)
def _bundled_prior() -> Humor:
    """Load the prior with the packaged weights and the bundled body; cached."""
    with torch.inference_mode(False):  # autograd refuses inference tensors
        weights = read_weights("open")
        initial, whitening = mixture_from(weights), whitening_from(weights)
        assert initial is not None
        assert whitening is not None
        networks = networks_from(weights).requires_grad_(False)
        return Humor(networks, initial, BodyModel.load(), whitening)


INITIAL = "initial."
"""Prefix of the names of the mixture's tensors."""

WHITENING = "error_whitening"
"""Name of the tensor that says how far the decoder's steps are off."""

_DAMAGED = (pickle.UnpicklingError, RuntimeError, EOFError, LookupError, TypeError, ValueError)
"""Errors of reading bytes that are no checkpoint."""


def read_weights(path: str | Path) -> Checkpoint:
    """Read weights of recon (.safetensors) or a PyTorch checkpoint (.pth, .pt).

    Args:
        path: a file; or `open` for the weights in the package.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: when it holds something else.
    """
    if path in ("open", "nc") or Path(path).suffix == ".safetensors":
        return named_checkpoint(path, "humor")
    return _read_pytorch(Path(path))


def networks_from(weights: Checkpoint) -> HumorNetworks:
    """Build the three networks in the weights' width and copy the weights into them."""
    own = weights.without_prefixes(INITIAL, WHITENING)
    networks = HumorNetworks(width_of(own.tensors))
    own.copy_into(networks)
    return networks


def mixture_from(weights: Checkpoint) -> Mixture | None:
    """The mixture of initial states in a weights file; None if it has none."""
    own = weights.with_prefix(INITIAL)
    if len(own.tensors) == 0:
        return None
    count, size = own.tensors["means"].shape if "means" in own.tensors else (12, 138)
    shapes = {
        "features": (size,),
        "log_weights": (count,),
        "means": (count, size),
        "whitening": (count, size, size),
    }
    return Mixture(**own.require(shapes))


def whitening_from(weights: Checkpoint) -> Float[Tensor, "207 207"] | None:
    """The matrix in a weights file that whitens the decoder's errors; None if it has none."""
    own = weights.with_prefix(WHITENING)
    return own.require({"": (207, 207)})[""] if own.tensors else None


def _read_pytorch(path: Path) -> Checkpoint:
    """Read a PyTorch checkpoint without executing code from it."""
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such weights file; expected HuMoR weights there")
    try:
        found = torch.load(path, map_location="cpu", weights_only=True)
    except _DAMAGED as error:
        raise WeightsError(f"{path}: expected a PyTorch checkpoint, but {error}") from error
    for name in ("average", "model"):
        own = found.get(name) if isinstance(found, dict) else None
        if isinstance(own, dict) and all(isinstance(t, Tensor) for t in own.values()):
            return Checkpoint(path, own, {})
    raise WeightsError(f"{path}: expected a checkpoint with the networks' weights under 'model'")

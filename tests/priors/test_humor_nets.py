"""The networks against golden numbers of the public reference."""

import copy

import numpy as np
import pytest
import torch
from torch import Tensor, nn

from priors.humor.networks import GroupNorm, HumorNetworks, Perceptron, width_of
from priors.humor.state import State, state_after_step
from tests.conftest import GOLDEN


def made_up_weights(name: str, shape: torch.Size) -> Tensor:
    """The golden files' formula: a cubic residue as index into a sine."""
    s = sum(name.encode())
    k = np.arange(shape.numel(), dtype=np.int64)
    q, r = k // 9973, k % 9973
    m = (r * r * r + (31 + s) * r) % 9973
    u = np.sin(0.7 * m + 0.013 * s + 0.001 * q)
    if len(shape) == 2:
        w = np.sqrt(1 / shape[1]) * u
    elif name.endswith("bias"):
        w = 0.05 * u
    else:
        w = 1 + 0.05 * u
    if name.startswith("decoder.net.9."):
        w = 0.1 * w
    return torch.from_numpy(w.astype(np.float32)).reshape(shape)


def golden(name: str) -> dict[str, Tensor]:
    with np.load(GOLDEN / f"{name}.npz", allow_pickle=False) as file:
        return {
            k: torch.from_numpy(file[k].astype(np.float64))
            for k in file.files
            if file[k].dtype.kind == "f"
        }


def made_up_networks() -> HumorNetworks:
    networks = HumorNetworks()
    layers = networks.state_dict()
    networks.load_state_dict({k: made_up_weights(k, v.shape) for k, v in layers.items()})
    return networks.double().requires_grad_(False)


@pytest.fixture(scope="module")
def networks() -> HumorNetworks:
    return made_up_networks()


def test_layers_are_those_of_the_released_checkpoint(networks: HumorNetworks) -> None:
    with np.load(GOLDEN / "humor_step.npz", allow_pickle=False) as file:
        rows = {str(n): k for k, n in enumerate(file["weight_names"])}
        layers = {k: v.numpy() for k, v in networks.state_dict().items()}
        assert set(rows) == set(layers)
        for name, value in layers.items():
            k = rows[name]
            assert value.ravel()[0] == file["weight_first"][k]
            assert value.ravel()[-1] == file["weight_last"][k]
            assert np.isclose(value.sum(), file["weight_sum"][k], rtol=1e-9)
            assert np.isclose(np.abs(value).sum(), file["weight_abs_sum"][k], rtol=1e-9)
    assert sum(v.size for v in layers.values()) == 9_725_976
    assert width_of(networks.state_dict()) == networks.width == 1024


def test_single_calls_equal_the_reference(networks: HumorNetworks) -> None:
    g = golden("humor_step")
    mean, log_variance = networks.prior(g["x"])
    torch.testing.assert_close(mean, g["prior_mean"], rtol=0, atol=1e-10)
    torch.testing.assert_close(log_variance.exp(), g["prior_var"], rtol=0, atol=1e-10)
    mean, log_variance = networks.posterior(g["x"], g["x_next"])
    torch.testing.assert_close(mean, g["encoder_mean"], rtol=0, atol=1e-10)
    torch.testing.assert_close(log_variance.exp(), g["encoder_var"], rtol=0, atol=1e-10)
    raw = networks.decode(g["x"], g["z"])
    torch.testing.assert_close(raw, g["decoder_raw"], rtol=0, atol=1e-10)
    state, contacts = state_after_step(State.unpack(g["x"]), raw)
    decoded = torch.cat((state.pack(), contacts), -1)
    torch.testing.assert_close(decoded, g["decoded"], rtol=0, atol=1e-8)


def test_width_is_a_parameter() -> None:
    small = HumorNetworks(64)
    assert small.width == 64
    assert small.decoder.net[6].weight.shape == (32, 64 + 48)
    assert small.decode(torch.zeros(2, 3, 339), torch.zeros(2, 3, 48)).shape == (2, 3, 216)
    with pytest.raises(ValueError, match="multiple of 32"):
        HumorNetworks(100)
    with pytest.raises(ValueError, match="prior_net"):
        width_of({"something": torch.zeros(1)})


def test_frozen_layers_give_the_same_numbers_as_those_that_learn() -> None:
    """Normalisation and ReLU are one operation with a derivative of its own where frozen."""
    torch.manual_seed(0)
    network = Perceptron([5, 64, 64, 7], skip=2)
    for layer in network.net:
        if isinstance(layer, GroupNorm):
            nn.init.normal_(layer.weight)
            nn.init.normal_(layer.bias)
    frozen = copy.deepcopy(network).requires_grad_(False)
    x = torch.randn(6, 5, dtype=torch.float64)
    values, slopes = [], []
    for one in (network.double(), frozen.double()):
        at = x.clone().requires_grad_()
        out = one(at)
        values.append(out.detach())
        slopes.append(torch.autograd.grad(out.square().sum(), at)[0])
    torch.testing.assert_close(values[0], values[1])
    torch.testing.assert_close(slopes[0], slopes[1])
    at = x.clone().requires_grad_()
    assert torch.autograd.gradcheck(frozen, at)

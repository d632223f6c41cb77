import pytest
import torch

from priors.checkpoints import load_checkpoint, save_checkpoint


@pytest.mark.parametrize(
    "layer",
    [
        torch.tensor([1.0, torch.nan]),
        torch.tensor([1.0, -torch.inf]),
        torch.tensor([1.0, 67_000.0]).half(),
    ],
)
def test_weights_that_are_not_finite_are_not_written(tmp_path, layer):
    """A number beyond float16 was written as infinity without a word, and refused on loading."""
    path = tmp_path / "net.safetensors"
    save_checkpoint(path, "net", {"good": torch.ones(2)}, {})
    with pytest.raises(ValueError, match=r"net\.safetensors: weights not written, bad \(torch\."):
        save_checkpoint(path, "net", {"good": torch.zeros(2), "bad": layer}, {})
    assert torch.equal(load_checkpoint(path, "net").tensors["good"], torch.ones(2))

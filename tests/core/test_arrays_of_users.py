"""Arrays as users hold them: masked, with gradients, from inference; and devices."""

import subprocess
import sys

import numpy as np
import pytest
import torch

import recon
from recon.core.arrays import finite_number, usable_device


def test_masked_coordinates_are_not_visible():
    """The mask was dropped without a word, and what lay below it was fitted."""
    positions = np.ma.array(np.ones((4, 22, 3)), mask=False)
    positions[1, 5, 2] = np.ma.masked
    positions.data[1, 5, 2] = 1e6
    seen = recon.Joints3D(positions, np.ones((4, 22), bool), range(22), 30.0)
    assert not seen.visible[1, 5]
    assert int(seen.visible.sum()) == 4 * 22 - 1
    assert float(seen.positions[1, 5].abs().max()) == 0


def test_tensors_with_gradients_and_from_inference_are_taken():
    with torch.inference_mode():
        made = torch.zeros(4, 22, 3)
    for positions in (torch.zeros(4, 22, 3, requires_grad=True), made):
        seen = recon.Joints3D(positions, np.ones((4, 22), bool), range(22), 30.0)
        assert not seen.positions.requires_grad
        assert not seen.positions.is_inference()


def test_devices_that_are_not_there_and_inference_are_told():
    assert usable_device("cpu").type == "cpu"
    seen = recon.Joints3D(torch.zeros(4, 22, 3), np.ones((4, 22), bool), range(22), 30.0)
    for name in ("nowhere", "cpu:x", *(() if torch.cuda.is_available() else ("cuda",))):
        with pytest.raises(recon.ReconError, match="cannot be used here"):
            recon.fit(seen, "pose", device=name)
    with torch.inference_mode(), pytest.raises(recon.ReconError, match="inference_mode"):
        recon.fit(seen, "pose")


@pytest.mark.parametrize(
    "positions", [torch.zeros(4, 22, 3).to_sparse(), torch.zeros(4, 22, 3, device="meta")]
)
def test_tensors_that_are_not_dense_are_refused(positions):
    """Errors of torch's kernels came instead of a message."""
    with pytest.raises(recon.ReconError, match="positions: expected a dense tensor"):
        recon.Joints3D(positions, np.ones((4, 22), bool), range(22), 30.0)


ODD = """
import numpy as np, recon
seen = recon.Joints3D(np.zeros((4, 22, 3)), np.ones((4, 22), bool), range(22), 30.0)
for name, value in (("body", 5), ("start", np.zeros((4, 22, 3))), ("terms", [1]), ("checks", [0])):
    try:
        recon.fit(seen, "pose", **{name: value})
    except recon.ReconError as error:
        print(name in str(error))
"""


def test_arguments_of_another_type_are_told():
    """They ended in AttributeError and TypeError, the last two after a part of the work."""
    done = subprocess.run([sys.executable, "-c", ODD], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["True"] * 4


@pytest.mark.parametrize("value", [True, np.bool_(1), b"30"])
def test_true_and_bytes_are_no_numbers(value):
    """A frame rate of True was taken for one frame a second."""
    with pytest.raises(recon.ReconError, match="fps: expected one number"):
        finite_number(value, "fps")

"""What is refused has a kind of its own, and is a `ValueError` as before."""

import numpy as np
import pytest

import recon

JOINTS = np.random.default_rng(0).normal(0, 0.3, (4, 22, 3))
SEEN = np.ones((4, 22), bool)


def test_all_are_value_errors():
    kinds = (recon.FormatError, recon.ObservationError, recon.UnitsError, recon.WeightsError)
    assert all(issubclass(kind, recon.ReconError) for kind in kinds)
    assert issubclass(recon.ReconError, ValueError)


def test_millimetres_are_a_matter_of_units():
    with pytest.raises(recon.UnitsError, match="divide millimetres by 1000"):
        recon.Joints3D(1000 * JOINTS, SEEN, range(22), 30.0)


def test_masks_of_another_shape_are_a_matter_of_observations():
    with pytest.raises(recon.ObservationError, match="visible: expected the shape"):
        recon.Joints3D(JOINTS, SEEN[:, :5], range(22), 30.0)


@pytest.mark.parametrize("read", [recon.load_motion, recon.load_observation])
def test_damaged_files_are_a_matter_of_formats(read, tmp_path):
    (tmp_path / "damaged.npz").write_bytes(b"PK\x03\x04 and nothing else")
    with pytest.raises(recon.FormatError, match=r"damaged\.npz"):
        read(tmp_path / "damaged.npz")


def test_other_weights_are_a_matter_of_weights(tmp_path):
    path = tmp_path / "other.safetensors"
    path.write_bytes(b"no weights")
    with pytest.raises(recon.WeightsError, match=r"other\.safetensors: expected a safetensors"):
        recon.fit(recon.Joints3D(JOINTS, SEEN, range(22), 30.0), weights=str(path))

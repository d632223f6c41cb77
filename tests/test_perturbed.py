import numpy as np
import torch

from recon.body.model import BodyModel
from tests.perturbed import moved, moved_tensor


def test_numbers_move_by_units_in_the_last_place_and_no_more():
    values = np.random.default_rng(1).normal(size=(50, 20)).astype(np.float32)
    values[0] = 0.0
    away = moved(values, 4, np.random.default_rng(0))
    assert away.dtype == np.float32
    assert np.abs(away - values).max() > 0
    # eps is one unit of numbers just above a power of two, and two of those just below
    assert (np.abs(away - values) <= 9 * np.spacing(np.abs(values))).all()
    assert (away[0] == 0).all()
    for other in (np.arange(5), np.array(["left", "right"]), np.array(30.0)):
        assert moved(other, 4, np.random.default_rng(0)) is other


def test_tensors_move_alike():
    values = torch.randn(30, dtype=torch.float64)
    away = moved_tensor(values, 2, np.random.default_rng(0))
    assert torch.equal(away, moved_tensor(values, 2, np.random.default_rng(0)))
    assert not torch.equal(away, values)
    assert torch.allclose(away, values, rtol=1e-15)


def test_the_body_is_moved_where_it_was_asked_for(request):
    """Under `--ulps` every test gets the same moved body, else the bundled one."""
    again = BodyModel.load()
    assert again is BodyModel.load()
    checksum, spread = again.checksum, float(again.template.abs().max())
    assert checksum
    assert 0.5 < spread < 2.0
    assert request.config.getoption("--ulps") >= 0


def test_single_numbers_keep_their_shape():
    """A weight that is one number got an axis, and did not fit its network any more."""
    found = moved_tensor(torch.tensor(3.0), 4, np.random.default_rng(0))
    assert found.shape == ()

"""One step of training: clipped, averaged, and none where the gradient is not finite."""

from pathlib import Path

import pytest
import torch

from recon.body.model import BodyModel
from recon.formats.motions import save_motion
from tests.walking import a_walk
from training.run import Run, cosine_decay
from training.settings import TrainingSettings


class Weight(Run[TrainingSettings, torch.nn.Linear]):
    """One number that begins as one."""

    def untrained_networks(self, state):
        del state
        networks = torch.nn.Linear(1, 1, bias=False)
        torch.nn.init.ones_(networks.weight)
        return networks

    def optimiser_of(self, networks):
        return torch.optim.SGD(networks.parameters(), lr=1.0)


@pytest.fixture
def run(tmp_path: Path) -> Weight:
    save_motion(tmp_path / "walk.npz", a_walk(BodyModel.load()))
    return Weight(TrainingSettings(tmp_path, tmp_path / "run", clip=2.0))


def test_a_step_is_clipped_and_averaged(run):
    run.descend(100 * run.networks.weight.sum(), rate=0.1)
    assert run.networks.weight.item() == pytest.approx(1 - 0.1 * 2.0)
    # after the first step one eleventh of the average is kept
    assert run.averaged.weight.item() == pytest.approx((1 + 10 * 0.8) / 11)
    assert run.step == 1


def test_a_gradient_that_is_not_finite_moves_nothing(run):
    run.descend(run.networks.weight.sum() * torch.inf, rate=0.1)
    assert run.networks.weight.item() == 1.0
    assert run.step == 1


def test_rates_fall_to_a_hundredth():
    assert cosine_decay(0.0) == pytest.approx(1.0)
    assert cosine_decay(0.5) == pytest.approx(0.505)
    assert cosine_decay(1.0) == pytest.approx(0.01)

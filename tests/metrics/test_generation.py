"""Displacements and diversity by their definitions; and who stays on its feet."""

import pytest
import torch
from torch import Tensor

from recon.body.contacts import rest_heights
from recon.body.model import BodyModel
from recon.core import rotations as so3
from recon.core.motion import Motion
from recon.core.skeleton import joint_index
from recon.metrics import generation as metrics

FPS = 30.0


@pytest.fixture(scope="module")
def standing() -> tuple[Tensor, Tensor]:
    """Five seconds of a body that stands on the ground, and its rest heights."""
    body = BodyModel.load().to(dtype=torch.float64)
    shape = torch.zeros(16, dtype=torch.float64)
    rotations = torch.eye(3, dtype=torch.float64).repeat(151, 22, 1, 1)
    rotations[:, 0] = so3.exp(torch.tensor([torch.pi / 2, 0.0, 0.0], dtype=torch.float64))
    heights = rest_heights(body, shape)
    motion = Motion.create(torch.zeros(151, 3).double(), rotations, shape, FPS)
    joints = body.pose(motion).joints
    joints = joints + torch.tensor([0.0, 0.0, 1.0]) * (heights[0] - joints[0, 0, 2])
    return joints, heights


def test_displacements_are_mean_distances() -> None:
    truth = torch.zeros(4, 22, 3)
    predicted = torch.zeros(2, 4, 22, 3)
    predicted[1, 3] = torch.tensor([3.0, 4.0, 0.0])
    predicted[1, 2, :11, 2] = 1.0
    found = metrics.displacements(predicted, truth)
    torch.testing.assert_close(found, torch.tensor([[0.0, 0, 0, 0], [0.0, 0, 0.5, 5.0]]))


def test_diversity_is_the_mean_over_pairs() -> None:
    joints = torch.zeros(3, 5, 22, 3)
    joints[1, ..., 0] = 3.0
    joints[2, ..., 1] = 4.0
    assert metrics.pairwise_distance(joints) == pytest.approx((3 + 4 + 5) / 3)
    assert metrics.pairwise_distance(joints[:1]) is None
    with_random = torch.randn(4, 5, 22, 3, generator=torch.Generator().manual_seed(0))
    pairs = [(i, k) for i in range(4) for k in range(i)]
    expected = [(with_random[i] - with_random[k]).norm(dim=-1).mean().item() for i, k in pairs]
    assert metrics.pairwise_distance(with_random) == pytest.approx(sum(expected) / 6)


def test_a_body_that_stands_stays_on_its_feet(standing: tuple[Tensor, Tensor]) -> None:
    joints, heights = standing
    torch.testing.assert_close(
        metrics.lower_foot_height(joints, heights), torch.zeros(151).double(), atol=1e-6, rtol=0
    )
    assert metrics.stays_on_its_feet(joints, heights, FPS)


def test_what_does_not_stay_on_its_feet(standing: tuple[Tensor, Tensor]) -> None:
    """Every way to fail, and just not to, in one batch."""
    still, heights = standing
    up = torch.tensor([0.0, 0.0, 1.0])
    time = torch.arange(151)[:, None, None] / FPS

    def lifted(height: float, seconds: float) -> Tensor:
        return still + height * up * ((time > 1) & (time < 1 + seconds))

    head = joint_index("head")
    bent, fallen = still.clone(), still.clone()
    bent[:, head, 2] *= 0.65
    fallen[:, head, 2] *= 0.55
    broken = still.clone()
    broken[20, 3, 0] = torch.nan
    walking = still + time * torch.tensor([1.5, 0.0, 0.0])
    fast = still + time * torch.tensor([16.0, 0.0, 0.0])
    cases = [
        (lifted(0.3, 0.5), True), (lifted(0.3, 0.9), False), (lifted(0.07, 3.0), True),
        (lifted(-0.07, 0.5), True), (lifted(-0.09, 0.1), False),
        (bent, True), (fallen, False), (broken, False), (walking, True), (fast, False),
    ]  # fmt: skip
    found = metrics.stays_on_its_feet(torch.stack([case for case, _ in cases]), heights, FPS)
    assert found.tolist() == [expected for _, expected in cases]


def test_time_is_in_seconds(standing: tuple[Tensor, Tensor]) -> None:
    """At a quarter of the rate the same frames last four times as long, and are slower."""
    still, heights = standing
    flying = still.clone()
    flying[30:42, :, 2] += 0.3
    assert metrics.stays_on_its_feet(flying, heights, FPS)
    assert not metrics.stays_on_its_feet(flying, heights, FPS / 4)
    assert metrics.stays_on_its_feet(still[:5] + 0.3, heights, FPS)  # too short to tell


def test_heights_are_of_every_body_alone(standing: tuple[Tensor, Tensor]) -> None:
    still, heights = standing
    batch, both = torch.stack((still, still)), torch.stack((heights, heights + 0.1))
    assert metrics.stays_on_its_feet(batch, both, FPS).tolist() == [True, False]

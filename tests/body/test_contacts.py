"""Contact labels: speed in metres per second, height above where a joint touches."""

import pytest
import torch
from torch import Tensor

from recon.body.contacts import (
    contact_labels,
    contact_probabilities,
    heights_in_contact,
    rest_heights,
)
from recon.body.model import BodyModel
from recon.core.skeleton import CONTACT_JOINTS, JOINTS, MIRROR, joint_index


@pytest.fixture(scope="module")
def standing(body: BodyModel) -> tuple[Tensor, Tensor]:
    """Joints (22, 3) of the average body standing on z = 0, and their rest heights."""
    shape = torch.zeros(body.shape_size, dtype=torch.float64)
    height = rest_heights(body, shape)
    rest = body.rest_joints(shape)
    return torch.stack((rest[:, 0], -rest[:, 2], height), -1), height


def moving(joints: Tensor, speed: float, fps: float, seconds: float = 0.5) -> Tensor:
    """The body carried sideways without a move of its own."""
    time = torch.arange(int(seconds * fps) + 1, dtype=torch.float64) / fps
    shift = time[:, None] * torch.tensor([speed, 0.0, 0.0], dtype=torch.float64)
    return joints + shift[:, None]


def names(labels: Tensor) -> set[str]:
    return {JOINTS[j] for j in labels.nonzero()[:, -1].tolist()}


def test_standing_still_is_contact_of_both_feet_only(standing: tuple[Tensor, Tensor]) -> None:
    joints, height = standing
    labels = contact_labels(moving(joints, 0.0, 30.0), height, 30.0)
    feet = {"left_ankle", "right_ankle", "left_foot", "right_foot"}
    assert names(labels) == feet
    assert labels[:, [joint_index(name) for name in sorted(feet)]].all()


@pytest.mark.parametrize("fps", [30.0, 59.94, 240.0])
def test_speed_limit_means_the_same_at_every_rate(
    standing: tuple[Tensor, Tensor], fps: float
) -> None:
    joints, height = standing
    assert contact_labels(moving(joints, 0.24, fps), height, fps)[:, 10].all()
    assert not contact_labels(moving(joints, 0.26, fps), height, fps).any()


@pytest.mark.parametrize(("joint", "reach"), [("left_foot", 0.04), ("left_ankle", 0.08)])
def test_reach_is_measured_from_the_touching_height(
    standing: tuple[Tensor, Tensor], joint: str, reach: float
) -> None:
    joints, height = standing
    for lift, expected in ((reach - 0.001, True), (reach + 0.001, False)):
        raised = joints + torch.tensor([0.0, 0.0, lift], dtype=torch.float64)
        labels = contact_labels(moving(raised, 0.0, 30.0), height, 30.0)
        assert labels[0, joint_index(joint)].item() is expected


def test_a_knee_on_the_floor_is_contact_and_a_standing_knee_is_not(
    standing: tuple[Tensor, Tensor],
) -> None:
    joints, height = standing
    knee = joint_index("left_knee")
    kneeling = joints.clone()
    kneeling[knee, 2] = 0.06
    assert contact_labels(moving(kneeling, 0.0, 30.0), height, 30.0)[:, knee].all()
    assert heights_in_contact(height)[knee] < 0.05 < height[knee]  # metres


def test_only_contact_joints_are_labelled_and_never_the_pelvis() -> None:
    lying = torch.zeros(5, 22, 3, dtype=torch.float64)
    labels = contact_labels(lying, torch.full((22,), 0.02, dtype=torch.float64), 30.0)
    assert set(labels[2].nonzero()[:, 0].tolist()) == set(CONTACT_JOINTS) - {0}


def test_backwards_and_mirrored_motion_has_the_same_labels(
    standing: tuple[Tensor, Tensor],
) -> None:
    joints, height = standing
    walk = moving(joints, 0.0, 30.0) + 0.02 * torch.randn(16, 22, 3, dtype=torch.float64).cumsum(0)
    walk = walk + torch.tensor([0.0, 0.0, 0.02], dtype=torch.float64)
    labels = contact_labels(walk, height, 30.0)
    assert torch.equal(contact_labels(walk.flip(0), height, 30.0).flip(0), labels)
    symmetric = 0.5 * (height + height[list(MIRROR)])
    mirrored = contact_labels(walk[:, list(MIRROR)], symmetric, 30.0)[:, list(MIRROR)]
    assert torch.equal(mirrored, contact_labels(walk, symmetric, 30.0))


def test_batches_are_independent_and_one_frame_stands_still(
    standing: tuple[Tensor, Tensor],
) -> None:
    joints, height = standing
    clips = torch.stack((moving(joints, 0.0, 30.0), moving(joints, 0.3, 30.0)))
    labels = contact_labels(clips, height.expand(2, 22), 30.0)
    assert torch.equal(labels[0], contact_labels(clips[0], height, 30.0))
    assert not labels[1].any()
    assert contact_labels(joints[None], height, 30.0)[0, 10]


def test_rest_heights_are_of_a_human(body: BodyModel) -> None:
    shape = torch.randn(3, body.shape_size, dtype=torch.float64)
    heights = rest_heights(body, shape)
    assert (heights > 0).all()
    assert (heights[:, 10] < 0.08).all()  # metres: toes near the sole
    assert (heights[:, 7] < 0.2).all()
    assert (heights[:, 15] > 1.2).all()


@pytest.mark.parametrize("std", [None, 0.0, 0.02, 0.5])
def test_a_contact_is_likelier_than_not_where_its_label_says_so(
    standing: tuple[Tensor, Tensor], std: float | None
) -> None:
    """HuMoR's network was believed instead, and was right less often than the fitted motion."""
    joints, height = standing
    for speed, lift in ((0.0, 0.0), (0.2, 0.0), (0.3, 0.0), (0.0, 0.03), (0.0, 0.05), (0.3, 0.1)):
        moved = moving(joints, speed, 30.0) + torch.tensor([0.0, 0.0, lift], dtype=torch.float64)
        sure = None if std is None else torch.full(moved.shape[:2], std, dtype=torch.float64)
        likely = contact_probabilities(moved, height, 30.0, sure)
        labels = contact_labels(moved, height, 30.0)
        assert torch.equal(likely > 0.5, labels)
        assert likely[:, joint_index("head")].max() == 0


def test_a_foot_whose_place_is_not_known_may_stand_or_not(
    standing: tuple[Tensor, Tensor],
) -> None:
    joints, height = standing
    still, moved = moving(joints, 0.0, 30.0), moving(joints, 0.5, 30.0)
    foot = joint_index("left_foot")
    for std, low, high in ((0.005, 0.95, 0.05), (0.3, 0.51, 0.49)):
        sure = torch.full(still.shape[:2], std, dtype=torch.float64)
        stands = contact_probabilities(still, height, 30.0, sure)[0, foot].item()
        runs = contact_probabilities(moved, height, 30.0, sure)[0, foot].item()
        if std < 0.01:
            assert stands > low
            assert runs < high
        else:
            assert 0.5 < stands < 0.7
            assert 0.3 < runs < 0.5

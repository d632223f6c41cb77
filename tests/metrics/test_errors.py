"""Metrics: equal to the reference on its own samples, and to their definitions."""

from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from recon.core import rotations as so3
from recon.core.skeleton import FEET, LEGS, TOES, joint_index
from recon.metrics import errors as metrics

GOLDEN = Path(__file__).parents[1] / "golden" / "metrics.npz"
EXACT = 1e-9
"""Relative agreement asked of double precision."""


@pytest.fixture(scope="module")
def golden() -> dict[str, Tensor]:
    with np.load(GOLDEN, allow_pickle=False) as file:
        return {name: torch.from_numpy(np.asarray(file[name])) for name in file.files}


END_EFFECTORS = tuple(
    joint_index(f"{side}_{joint}")
    for joint in ("ankle", "foot", "wrist")
    for side in ("left", "right")
)


def pooled(golden: dict[str, Tensor], kind: str) -> tuple[Tensor, Tensor]:
    """Predicted and true points of both sequences, one after the other."""
    sides = ("pred", "gt")
    predicted, truth = (torch.cat([golden[f"seq{k}_{s}_{kind}"] for k in (0, 1)]) for s in sides)
    return predicted, truth


@pytest.mark.parametrize(
    ("kind", "joints", "expected"),
    [
        ("joints", None, "joints3d_all"),
        ("joints", LEGS, "joints3d_legs"),
        ("joints", END_EFFECTORS, "joints3d_ee"),
        ("keyverts", None, "verts3d_all"),
        ("mesh", None, "mesh3d_all"),
    ],
)
def test_position_errors_equal_the_reference(
    golden: dict[str, Tensor], kind: str, joints: tuple[int, ...] | None, expected: str
) -> None:
    errors = metrics.point_errors(*pooled(golden, kind))
    chosen = errors if joints is None else errors[:, list(joints)]
    wanted = golden[f"pooled_mean_{expected}"].item()
    assert metrics.mean(chosen) == pytest.approx(wanted, rel=EXACT)


def test_visible_and_hidden_errors_equal_the_reference(golden: dict[str, Tensor]) -> None:
    errors = metrics.point_errors(*pooled(golden, "joints"))
    observed = torch.cat([golden[f"seq{k}_observed_joints"] for k in (0, 1)])
    visible = observed.isfinite().all(-1)
    for name, where in (("vis", visible), ("occ", ~visible)):
        wanted = golden[f"pooled_mean_joints3d_{name}"].item()
        assert metrics.mean(errors, where) == pytest.approx(wanted, rel=EXACT)


def test_acceleration_equals_the_reference(golden: dict[str, Tensor]) -> None:
    found = [
        metrics.accelerations(golden[f"seq{k}_pred_joints"], 30.0).norm(dim=-1) for k in (0, 1)
    ]
    wanted = golden["pooled_mean_accel_mag"].item()
    assert metrics.mean(torch.cat(found)) == pytest.approx(wanted, rel=EXACT)
    rooted = metrics.root_aligned(golden["seq0_pred_joints"])
    magnitude = metrics.accelerations(rooted, 30.0).norm(dim=-1)
    wanted = golden["accel_root_relative_seq0"].item()
    assert metrics.mean(magnitude) == pytest.approx(wanted, rel=EXACT)


def test_penetration_equals_the_reference(golden: dict[str, Tensor]) -> None:
    heights = pooled(golden, "joints")[0][:, list(TOES), 2]
    thresholds = golden["ground_thresholds"].tolist()
    assert thresholds == pytest.approx(metrics.PENETRATION_THRESHOLDS)
    shares = metrics.penetration_fractions(heights)
    assert shares == pytest.approx(golden["ground_fraction"].tolist(), rel=EXACT)
    frequency, distance = golden["ground_freq"].item(), golden["ground_dist"].item()
    assert metrics.penetration_frequency(heights) == pytest.approx(frequency, rel=EXACT)
    assert metrics.penetration_distance(heights) == pytest.approx(distance, rel=EXACT)


def test_penetration_of_a_tilted_plane_equals_the_reference(golden: dict[str, Tensor]) -> None:
    plane = golden["plane"]
    heights = golden["seq0_pred_joints"][:, list(TOES)] @ plane[:3] - plane[3]
    shares = metrics.penetration_fractions(heights)
    assert shares is not None
    counts = [share * golden["plane_total"].item() for share in shares]
    assert counts == pytest.approx(golden["plane_counts"].tolist(), abs=1e-9)
    # Relative 1e-8, not 1e-9: the plane's normal is not exactly a unit vector.
    wanted = golden["plane_pen"].clamp(min=0).mean().item()
    assert metrics.penetration_distance(heights) == pytest.approx(wanted, rel=1e-8)


def test_contact_accuracy_equals_the_reference(golden: dict[str, Tensor]) -> None:
    predicted, truth = (labels.bool() for labels in pooled(golden, "contacts"))
    wanted = golden["contact_acc"].item()
    assert metrics.contact_accuracy(predicted, truth) == pytest.approx(wanted, rel=EXACT)


def test_balanced_accuracy_is_one_half_for_a_constant_guess() -> None:
    truth = torch.rand(50, 22) < 0.2
    guess = torch.zeros_like(truth)
    assert metrics.contact_balanced_accuracy(guess, truth) == 0.5
    assert metrics.contact_balanced_accuracy(truth, truth) == 1.0
    assert metrics.contact_balanced_accuracy(truth, ~truth) == 0.0
    assert metrics.contact_balanced_accuracy(truth, torch.zeros_like(truth)) is None


def test_balanced_accuracy_can_be_of_the_feet_alone() -> None:
    truth = torch.zeros(4, 22, dtype=torch.bool)
    truth[:2, 7] = True
    wrong_hands = truth.clone()
    wrong_hands[:, 20] = True
    assert metrics.contact_balanced_accuracy(wrong_hands, truth, FEET) == 1.0
    said = truth.clone()
    said[1, 7] = False
    assert metrics.contact_balanced_accuracy(said, truth, FEET) == 0.75


def test_similarity_alignment_undoes_a_similarity() -> None:
    target = torch.randn(4, 22, 3, dtype=torch.float64)
    turn = so3.exp(2 * torch.randn(4, 3, dtype=torch.float64))
    points = 0.3 * target @ turn.mT + torch.randn(4, 1, 3, dtype=torch.float64)
    aligned = metrics.similarity_aligned(points, target)
    torch.testing.assert_close(aligned, target, rtol=0, atol=1e-10)  # metres


def test_similarity_alignment_never_mirrors_and_never_hurts() -> None:
    target = torch.randn(5, 22, 3, dtype=torch.float64)
    mirrored = target * torch.tensor([-1.0, 1.0, 1.0], dtype=torch.float64)
    squared = (metrics.similarity_aligned(mirrored, target) - target).square().sum((-2, -1))
    assert (squared > 0.1).all()  # m²: a mirror image stays recognisable
    centred = target - target.mean(-2, keepdim=True)
    assert (squared <= centred.square().sum((-2, -1)) + 1e-9).all()  # scale 0 is admissible


def test_similarity_alignment_of_coinciding_points_is_finite() -> None:
    target = torch.randn(1, 22, 3, dtype=torch.float64)
    assert metrics.similarity_aligned(torch.ones_like(target), target).isfinite().all()


def test_acceleration_of_a_parabola_is_constant_at_any_rate() -> None:
    for fps in (30.0, 120.0):
        time = torch.arange(20, dtype=torch.float64) / fps
        fall = -0.5 * 9.81 * time.square()
        points = torch.stack((time, 2 * time, fall), -1)[:, None]
        found = metrics.accelerations(points, fps)
        expected = torch.tensor([0.0, 0.0, -9.81], dtype=torch.float64).expand_as(found)
        torch.testing.assert_close(found, expected, rtol=0, atol=1e-8)  # m/s²


def test_slip_speed_is_horizontal_and_counts_steps_in_contact_only() -> None:
    time = torch.arange(9, dtype=torch.float64)[:, None, None] / 30
    velocity = torch.tensor([0.3, 0.4, 5.0], dtype=torch.float64)
    joints = (time * velocity).expand(9, 22, 3)
    contacts = torch.zeros(9, 22, dtype=torch.bool)
    assert metrics.slip_speed(joints, contacts, 30.0) is None
    contacts[3:5, 10] = True
    assert metrics.slip_speed(joints, contacts, 30.0) == pytest.approx(0.5)  # m/s
    still = joints.clone()
    still[3:5, 10] = 0.0
    assert metrics.slip_speed(still, contacts, 30.0) == 0.0


def test_nothing_to_measure_is_none() -> None:
    nothing = torch.zeros(0, dtype=torch.float64)
    assert metrics.mean(nothing) is None
    assert metrics.penetration_frequency(nothing) is None
    assert metrics.penetration_distance(nothing) is None
    short = metrics.accelerations(torch.zeros(2, 22, 3, dtype=torch.float64), 30.0)
    assert metrics.mean(short.norm(dim=-1)) is None

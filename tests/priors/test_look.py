"""The network that looks first: neither order nor place of points matters, and seams close."""

import pytest
import torch

from priors.look.looking import load_network, with_seen_rotations
from priors.look.networks import LookNetwork
from priors.look.points import SeenPoints, WalkingFrames
from recon.body.model import BodyModel
from recon.core import rotations as so3
from recon.core.skeleton import LEGS
from recon.simulation.points import Corruption, markers3d
from tests.priors.test_humor_collocation import demo_clip

pytestmark = pytest.mark.numerics


def seen_joints(body: BodyModel, hidden: tuple[int, ...] = (), noise: float = 0.01) -> SeenPoints:
    joints = body.pose(demo_clip()).joints
    visible = torch.ones(joints.shape[:-1], dtype=torch.bool)
    visible[..., list(hidden)] = False
    away = noise * torch.randn(joints.shape, generator=torch.Generator().manual_seed(0))
    return SeenPoints(
        joints + away, visible, torch.arange(22)[None], torch.zeros(1, 22, 3),
        torch.tensor([noise]), torch.ones(joints.shape[:2], dtype=torch.bool),
    )  # fmt: skip


@pytest.fixture(scope="module")
def bundled() -> BodyModel:
    return BodyModel.load()


@pytest.fixture(scope="module")
def untrained(bundled: BodyModel) -> LookNetwork:
    torch.manual_seed(0)
    return LookNetwork(bundled.shape_size, width=32, common=1, own=1).requires_grad_(False)


def test_proposals_move_with_the_person(bundled: BodyModel, untrained: LookNetwork) -> None:
    seen = seen_joints(bundled, tuple(LEGS))
    turn, shift = so3.about_z(torch.tensor(2.0)), torch.tensor([3.0, -1.0, 0.0])
    here = untrained(seen, bundled).joints(bundled)
    moved = seen.derived(positions=seen.positions @ turn.mT + shift)
    there = untrained(moved, bundled).joints(bundled)
    torch.testing.assert_close(there, here @ turn.mT + shift, rtol=0, atol=2e-5)


def test_points_come_in_any_order(bundled: BodyModel, untrained: LookNetwork) -> None:
    seen = seen_joints(bundled, (4, 7))
    order = torch.randperm(22, generator=torch.Generator().manual_seed(1))
    mixed = seen.derived(
        positions=seen.positions[:, :, order], visible=seen.visible[:, :, order],
        bone=seen.bone[:, order], offset=seen.offset[:, order],
    )  # fmt: skip
    keep = torch.tensor([joint not in (4, 7) for joint in range(22)])
    fewer = seen.derived(
        positions=seen.positions[:, :, keep], visible=seen.visible[:, :, keep],
        bone=seen.bone[:, keep], offset=seen.offset[:, keep],
    )  # fmt: skip
    expected = untrained(seen, bundled).joints(bundled)
    for other in (mixed, fewer):
        found = untrained(other, bundled).joints(bundled)
        torch.testing.assert_close(found, expected, rtol=0, atol=2e-5)


def test_frames_that_do_not_exist_change_nothing(
    bundled: BodyModel, untrained: LookNetwork
) -> None:
    seen = seen_joints(bundled)
    short = seen.derived(
        positions=seen.positions[:, :40], visible=seen.visible[:, :40], exists=seen.exists[:, :40]
    )
    exists = torch.arange(60)[None] < 40
    padded = seen.derived(visible=seen.visible & exists[..., None], exists=exists)
    alone = untrained(short, bundled).joints(bundled)
    beside = untrained(padded, bundled).joints(bundled)[:, :, :40]
    torch.testing.assert_close(beside, alone, rtol=0, atol=2e-5)


def test_frames_walk_below_the_pelvis(bundled: BodyModel) -> None:
    """Also while nothing is seen."""
    seen = seen_joints(bundled)
    joints = bundled.pose(demo_clip()).joints
    visible = seen.visible.clone()
    visible[:, 20:30] = False
    for shown in (seen.visible, visible):
        frames = WalkingFrames.of(seen.derived(visible=shown), bundled)
        pelvis = frames.in_walking_frames(joints[:, :, :1])
        assert pelvis[..., :2].norm(dim=-1).max() < 0.2  # metres
        left = frames.in_walking_frames(
            joints[:, :, 1:2] - joints[:, :, 2:3] + frames.origin[:, :, None]
        )
        assert left[..., 0].min() > 0  # the left hip is at +x of the right one


def test_proposals_join_what_is_seen_without_a_jump() -> None:
    random = torch.Generator().manual_seed(2)
    known = so3.exp(torch.randn(30, 22, 3, generator=random).cumsum(0) * 0.02)
    proposed = so3.exp(torch.randn(2, 30, 22, 3, generator=random).cumsum(1) * 0.02)
    seen = torch.ones(30, 22, dtype=torch.bool)
    seen[10:20, 4] = False  # for a while
    seen[25:, 5] = False  # to the end
    seen[:, 7] = False  # never
    found = with_seen_rotations(proposed, known, seen)
    torch.testing.assert_close(
        found[:, seen], known.expand(2, -1, -1, -1, -1)[:, seen], rtol=0, atol=1e-5
    )
    torch.testing.assert_close(found[:, :, 7], proposed[:, :, 7])
    steps = so3.geodesic_angle(found[:, 1:], found[:, :-1])
    assert steps[:, :, (4, 5)].max() < 0.4  # radians
    eye = torch.eye(3).expand_as(found)
    torch.testing.assert_close(found @ found.mT, eye, rtol=0, atol=1e-5)


@pytest.mark.parametrize(("hidden", "most"), [((), 0.06), (tuple(LEGS), 0.12)])
def test_the_trained_network_sees_a_walk(
    bundled: BodyModel, hidden: tuple[int, ...], most: float
) -> None:
    found = load_network()(seen_joints(bundled, hidden), bundled)
    away = (found.joints(bundled) - bundled.pose(demo_clip()).joints[:, None]).norm(dim=-1)
    best = found.log_weight[0].argmax()
    assert away[0, best].mean() < most  # metres
    assert float(found.log_weight.exp().sum()) == pytest.approx(1.0, abs=1e-5)


def test_markers_are_an_input_as_joints_are(bundled: BodyModel) -> None:
    motion = demo_clip()[0]
    markers = markers3d(motion, bundled, Corruption(noise=0.01), seed=0)
    bone = torch.tensor(markers.bones(bundled))
    offset = markers.at_rest(bundled) - bundled.joint_template[bone]
    seen = SeenPoints(
        markers.positions[None].float(), markers.visible[None], bone[None], offset[None],
        torch.tensor([0.01]), torch.ones(1, motion.frames, dtype=torch.bool),
    )  # fmt: skip
    found = load_network()(seen, bundled)
    away = (found.joints(bundled)[0] - bundled.pose(motion).joints).norm(dim=-1)
    assert away.mean() < 0.06  # metres

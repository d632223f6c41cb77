"""Made-up motions of HuMoR's training: feet that touch stay, joints keep their ranges."""

import json
import math
from dataclasses import replace

import pytest
import torch
from torch import Tensor

from recon.body.model import BodyModel, forward_kinematics
from recon.core import rotations as so3
from recon.core.motion import Motion, MotionFile
from recon.core.skeleton import CONTACT_JOINTS, FEET
from recon.formats.motions import save_motion
from tests.training.test_humor import AS_RECORDED, SPLITS
from training.humor import moments as limits
from training.humor.corpus import Corpus, StateWindows, Variation
from training.humor.legs import (
    ANKLES,
    LegTargets,
    legs_reaching,
    may_raise_leg,
    may_step_aside,
    smallest_rotation,
    with_leg_raised,
    with_pelvis_moved,
    with_step_added,
)
from training.humor.moments import CHANNELS, PER_FRAME, Moments, at_frames, speeds
from training.humor.train import HumorTraining
from training.humor.variation import (
    GRAVITY,
    UPPER,
    arms_clear_of_trunk,
    with_flight,
    with_upper_body_of,
)
from training.humor.variation import with_arms_moved as moved

UPRIGHT = torch.tensor([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
"""Turns the rest pose (y up) so that z is up and it faces -y."""
WINDOWS, FRAMES = 60, 11
EVERYTHING = Variation(
    halves=0.5, bends=0.3, raises=0.3, sidesteps=0.2, flights=0.2, arms=0.5, kinds=0.5, people=0.5
)


def standing(bow: float = 0.0, knees: float = 0.3) -> Moments:
    """Bodies on both feet with bent knees, which sway and turn their trunks a little."""
    body = BodyModel.load()
    rest = body.rest_joints(torch.zeros(WINDOWS, 16))
    frame = torch.arange(FRAMES)[:, None] / 30 + (torch.arange(PER_FRAME) - 1) / 120
    seconds = frame.flatten().expand(WINDOWS, -1)
    rotations = torch.eye(3).repeat(WINDOWS, FRAMES * PER_FRAME, 22, 1, 1)
    phase = torch.arange(WINDOWS)[:, None] * 0.7
    sway = 0.05 * (2 * seconds + phase).sin()
    flat = torch.zeros_like(sway)

    def about_x(angle: Tensor) -> Tensor:
        return so3.exp(torch.stack((angle, flat, flat), -1))

    rotations[:, :, 0] = UPRIGHT @ about_x(sway + bow)
    hips = -(knees / 2) - sway - bow
    for side in (0, 1):
        rotations[:, :, 1 + side] = about_x(hips)
        rotations[:, :, 4 + side] = about_x(flat + knees)
        rotations[:, :, 7 + side] = about_x(flat - knees / 2)
        # arms hang
        down = torch.stack((flat, flat, flat - (1.2 if side == 0 else -1.2)), -1)
        rotations[:, :, 16 + side] = so3.exp(down)
        bent = torch.stack((flat, flat - (0.5 if side == 0 else -0.5), flat), -1)
        rotations[:, :, 18 + side] = so3.exp(bent)
    # the left ankle stays where it is
    ankle = forward_kinematics(rotations, rest)[1][:, :, ANKLES[0]]
    translation = torch.tensor([0.0, 0.0, 0.08]) - ankle
    contacts = torch.zeros(WINDOWS, FRAMES, len(CONTACT_JOINTS), dtype=torch.bool)
    contacts[..., [CHANNELS[j] for j in FEET]] = True
    return Moments(translation, rotations, contacts, seconds, rest)


def random(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


EDITS = (with_pelvis_moved, with_leg_raised, with_step_added, with_flight, moved)


@pytest.mark.parametrize("edit", EDITS)
def test_feet_that_touch_move_no_more_than_before(edit) -> None:
    old = standing()
    made, accepted = edit(old, random())
    assert accepted.float().mean() > 0.2
    old, made = old[accepted], made[accepted]
    before, after = old.posed()[1], made.posed()[1]
    faster = speeds(made.seconds, after) - speeds(old.seconds, before)
    for joint in FEET:
        touches = made.contacts[..., CHANNELS[joint]]
        if touches.any():
            assert faster[..., joint][touches].max() < 0.06, joint  # m/s
            height = at_frames(after)[..., joint, 2] - at_frames(before)[..., joint, 2]
            assert height[touches].abs().max() < 0.011, joint  # metres
    assert not (made.contacts & ~old.contacts).any()
    assert (made.rotations - old.rotations).abs().amax((1, 2, 3, 4)).min() > 1e-3


@pytest.mark.parametrize("edit", EDITS)
def test_joints_stay_within_their_ranges_and_above_the_ground(edit) -> None:
    old = standing()
    made, accepted = edit(old, random(1))
    made = made[accepted]
    angles = at_frames(limits.joint_angles(made.rotations, made.rest))
    slack = math.radians(1.01)
    assert (angles > torch.tensor(limits.LOWEST) - slack).all()
    assert (angles < torch.tensor(limits.HIGHEST) + slack).all()
    assert made.posed()[1][:, 1::PER_FRAME, :, 2].min() > 0.0
    identity = torch.eye(3).expand_as(made.rotations)
    torch.testing.assert_close(made.rotations @ made.rotations.mT, identity, rtol=0, atol=1e-5)


def test_angles_are_those_of_the_joints() -> None:
    """Each edit turned joints about axes whose signs only the right names tell."""
    rest = BodyModel.load().rest_joints(torch.zeros(1, 16))
    names = limits.NAMES

    def angle(joint: int, vector: tuple[float, float, float]) -> Tensor:
        rotations = torch.eye(3).repeat(1, 1, 22, 1, 1)
        plain = limits.joint_angles(rotations, rest)[0, 0]
        rotations[0, 0, joint] = so3.exp(torch.tensor(vector))
        return limits.joint_angles(rotations, rest)[0, 0] - plain

    for joint, vector, side, name in (
        (1, (-0.8, 0.0, 0.0), 0, "hip flexion"),
        (2, (-0.8, 0.0, 0.0), 1, "hip flexion"),
        (1, (0.0, 0.0, 0.8), 0, "hip abduction"),
        (2, (0.0, 0.0, -0.8), 1, "hip abduction"),
        (4, (0.8, 0.0, 0.0), 0, "knee flexion"),
        (8, (-0.4, 0.0, 0.0), 1, "ankle dorsiflexion"),
        (18, (0.0, -0.8, 0.0), 0, "elbow flexion"),
        (19, (0.0, 0.8, 0.0), 1, "elbow flexion"),
    ):
        size = max(abs(x) for x in vector)
        assert angle(joint, vector)[side, names.index(name)] == pytest.approx(size, abs=0.06), name


def test_legs_that_need_not_move_stay_exactly() -> None:
    old = standing()
    posed = orientations, joints = old.posed()
    aim = LegTargets(
        orientations[:, :, 0], joints[:, :, 0], joints[:, :, list(ANKLES)], torch.zeros(WINDOWS)
    )
    rotations, reached = legs_reaching(old.rotations, posed, old.rest, aim)
    assert reached.all()
    torch.testing.assert_close(rotations, old.rotations, rtol=0, atol=1e-4)


def test_ankles_out_of_reach_are_told() -> None:
    old = standing()
    posed = orientations, joints = old.posed()
    higher = joints[:, :, 0] + torch.tensor([0.0, 0.0, 0.4])
    aim = LegTargets(
        orientations[:, :, 0], higher, joints[:, :, list(ANKLES)], torch.zeros(WINDOWS)
    )
    assert not legs_reaching(old.rotations, posed, old.rest, aim)[1].any()


def test_the_shortest_rotation_leads_from_one_direction_to_the_other() -> None:
    a, b = torch.randn(2, 50, 3, generator=random())
    turned = (smallest_rotation(a, b) @ a[..., None])[..., 0]
    expected = b / b.norm(dim=-1, keepdim=True) * a.norm(dim=-1, keepdim=True)
    opposite = torch.cosine_similarity(a, b, dim=-1) < -0.98
    torch.testing.assert_close(turned[~opposite], expected[~opposite], rtol=0, atol=1e-4)


def test_pelvises_are_lowered_and_feet_are_not() -> None:
    old = standing()
    made, accepted = with_pelvis_moved(old, random())
    before, after = old.posed()[1][accepted], made.posed()[1][accepted]
    assert (after - before)[:, :, 0, 2].max() < 0
    assert (after - before)[:, :, 0, 2].min() < -0.2  # metres
    feet = list(FEET)
    torch.testing.assert_close(after[:, :, feet], before[:, :, feet], rtol=0, atol=1e-4)


def test_one_leg_is_raised_and_the_other_one_stands() -> None:
    old = standing()
    made, accepted = with_leg_raised(old, random())
    change = (made.posed()[1] - old.posed()[1])[accepted].norm(dim=-1)
    left, right = change[:, :, [7, 10]].amax((1, 2)), change[:, :, [8, 11]].amax((1, 2))
    assert torch.minimum(left, right).max() < 1e-4  # metres
    assert torch.maximum(left, right).max() > 0.5
    loose = ~made.contacts[accepted][..., [CHANNELS[j] for j in FEET]]
    assert loose.any()
    assert not loose.all(-1).any()
    # without a foot that stands all the time there is nothing to stand on
    lifted = old.derived(contacts=old.contacts & False)
    assert not may_raise_leg(lifted).any()
    assert may_raise_leg(old).all()
    assert may_step_aside(old).all()


def test_bodies_in_the_air_fall_as_gravity_says() -> None:
    old = standing()
    made, accepted = with_flight(old, random())
    added = (made.translation - old.translation)[accepted][..., 2]
    along = old.seconds[accepted]
    early, middle, late = added[:, 1], added[:, 16], added[:, 31]  # frames 0, 5, 10
    span = along[:, 16] - along[:, 1]
    torch.testing.assert_close(
        (early - 2 * middle + late) / span**2,
        torch.full_like(span, -GRAVITY),
        rtol=0, atol=0.01,
    )  # fmt: skip
    assert added.min() > 0
    assert not made.contacts[accepted].any()


def test_trunks_keep_their_tilt_and_follow_the_legs_heading() -> None:
    legs, trunks = standing(), standing(bow=0.4)
    turn = so3.about_z(torch.tensor(1.0))
    trunks = trunks.derived(
        rotations=torch.cat((turn @ trunks.rotations[:, :, :1], trunks.rotations[:, :, 1:]), 2)
    )
    made, accepted = with_upper_body_of(legs, trunks)
    assert accepted.all()
    chest, expected = made.posed()[0][:, :, 9], trunks.posed()[0][:, :, 9]
    # less the turn, the chest is tilted as it was recorded
    torch.testing.assert_close(chest, turn.mT @ expected, rtol=0, atol=1e-4)
    lower = [j for j in range(22) if j not in UPPER]
    torch.testing.assert_close(made.rotations[:, :, lower], legs.rotations[:, :, lower])
    arms = [16, 17, 18, 19]
    torch.testing.assert_close(made.rotations[:, :, arms], trunks.rotations[:, :, arms])
    torch.testing.assert_close(made.contacts, legs.contacts)
    leaning = trunks.contacts.clone()
    leaning[:, 3, CHANNELS[20]] = True
    assert not with_upper_body_of(legs, trunks.derived(contacts=leaning))[1].any()


def test_arms_do_not_reach_into_the_trunk() -> None:
    old = standing()
    inside = old.rotations.clone()
    inside[:, :, 18] = so3.exp(torch.tensor([0.0, 0.0, -1.9]))
    assert not arms_clear_of_trunk(old, old.derived(rotations=inside)).any()
    assert arms_clear_of_trunk(old, old).all()


@pytest.fixture(scope="module")
def corpus(tmp_path_factory: pytest.TempPathFactory) -> Corpus:
    """Three recordings of standing bodies by two people, of two kinds."""
    root = tmp_path_factory.mktemp("variety")
    (root / "splits.toml").write_text(SPLITS)
    actions = {"08_01": "walk", "08_02": "walk slowly", "09_01": "modern dance"}
    for row, (name, action) in enumerate(actions.items()):
        window = standing(bow=0.1 * row)
        contacts = torch.zeros(120, 22)
        contacts[:, list(FEET)] = 1.0
        motion = Motion.create(
            window.translation[row, :1].expand(120, 3),
            window.rotations[row, :1].expand(120, 22, 3, 3),
            torch.zeros(16),
            120.0,
        )
        save_motion(root / f"{name}.npz", MotionFile(motion, contacts=contacts))
        (root / f"{name}.json").write_text(json.dumps({"action": action, "clip": name}))
    settings = HumorTraining(root, root / "run", splits=root / "splits.toml")
    return Corpus.load(settings, "train", BodyModel.load())


def drawn(corpus: Corpus, variation: Variation, windows: int = 200) -> StateWindows:
    return corpus.draw(windows, FRAMES, variation, random(3))


def test_whatever_is_drawn_agrees_with_itself(corpus: Corpus) -> None:
    """Joints are those of the pose, and velocities those of the joints."""
    states = (windows := drawn(corpus, EVERYTHING)).states
    rotations = torch.cat((states.root[..., None, :, :], states.pose), -3)
    joints = forward_kinematics(rotations, windows.rest)[1] + states.translation[..., None, :]
    torch.testing.assert_close(joints, states.joints, rtol=0, atol=1e-5)  # metres
    difference = (states.joints[:, 2:] - states.joints[:, :-2]) * 15
    error = (states.joint_velocities[:, 1:-1] - difference).norm(dim=-1)
    assert error.quantile(0.99) < 0.1  # m/s; fast legs bend in 1/15 s
    assert error.max() < 0.6
    plain = drawn(corpus, AS_RECORDED).states
    assert (states.joint_velocities.norm(dim=-1).amax((1, 2)) > 0.5).float().mean() > 0.2
    assert plain.joint_velocities.norm(dim=-1).max() < 0.01


def test_the_same_seed_draws_the_same(corpus: Corpus) -> None:
    first, again = drawn(corpus, EVERYTHING), drawn(corpus, EVERYTHING)
    for name, value in first.tensors().items():
        assert torch.equal(value, again.tensors()[name]), name


@pytest.mark.parametrize("name", ["halves", "bends", "raises", "sidesteps", "flights", "arms"])
def test_every_edit_has_its_setting(corpus: Corpus, name: str) -> None:
    plain, own = drawn(corpus, AS_RECORDED), drawn(corpus, replace(AS_RECORDED, **{name: 1.0}))
    changed = (own.states.joints - plain.states.joints).abs().amax((1, 2, 3)) > 1e-3
    assert changed.float().mean() > 0.15
    torch.testing.assert_close(own.rest, plain.rest)


def test_kinds_and_people_are_drawn_as_often_as_they_are_balanced(corpus: Corpus) -> None:
    """The only dancer gives a third of the windows by length, and half where kinds are equal."""

    def dancing(variation: Variation) -> float:
        bow = drawn(corpus, variation, 1500).states.root[:, 0] @ UPRIGHT.mT
        return float((so3.log(bow).norm(dim=-1) > 0.15).float().mean())

    assert dancing(AS_RECORDED) == pytest.approx(1 / 3, abs=0.04)
    for name in ("kinds", "people"):
        assert dancing(replace(AS_RECORDED, **{name: 1.0})) == pytest.approx(1 / 2, abs=0.04)

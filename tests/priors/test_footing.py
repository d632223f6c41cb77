"""Steps of motions that are made up: feet carry the body, and stay near the ground."""

import pytest
import torch

from priors.humor.generation import FootingSettings, roll_out_from
from priors.humor.state import State, states_of
from recon.body.contacts import heights_in_contact, rest_heights
from recon.body.model import BodyModel
from recon.core.skeleton import FEET
from recon.physics.zmp import GRAVITY
from tests.priors.test_humor import humor, motions
from tests.standing_body import path, standing, times


@pytest.fixture
def stands(body: BodyModel) -> tuple[State, torch.Tensor]:
    """A standing body's state, axis (1), and the heights of its feet."""
    motion = standing(body, path(like=times(0.1, 30.0)), 30.0).map(lambda t: t[None])
    touching = heights_in_contact(rest_heights(body, motion.shape))[:, FEET]
    return states_of(motion, body)[:, 1], touching


def lifted(state: State, up: float) -> State:
    shift = torch.tensor([0.0, 0.0, up], dtype=state.joints.dtype)
    return state.replace(translation=state.translation + shift, joints=state.joints + shift)


def several(state: State, count: int) -> State:
    return state.map(lambda t: t.expand(count, *t.shape[1:]))


def test_the_draw_whose_feet_rest_is_kept(stands) -> None:
    state, touching = stands
    before = several(state, 8)
    heights = [0.1, 0.0, -0.1, 0.2, 0.2, 0.1, 0.0, -0.1]
    after = before.replace(
        joints=torch.cat([lifted(state, up).joints for up in heights]),
        translation=torch.cat([lifted(state, up).translation for up in heights]),
    )
    footing = FootingSettings(draws=4, strictness=50.0)
    random = torch.Generator().manual_seed(0)
    equal = torch.zeros(8)
    selected = footing.selected_draws(before, after, touching.expand(8, -1), equal, random)
    assert selected.tolist() == [1, 6]


def test_of_draws_that_stand_alike_the_usual_state_is_kept(stands) -> None:
    state, touching = stands
    before = several(state, 8)
    rarity = torch.tensor([60.0, 70.0, 50.0, 60.0, 0.0, 20.0, 20.0, 20.0])
    footing, random = FootingSettings(draws=4), torch.Generator().manual_seed(0)
    selected = footing.selected_draws(before, before, touching.expand(8, -1), rarity, random)
    assert selected.tolist() == [2, 4]


def test_bodies_come_nearer_to_the_ground_but_fly_where_they_fly(stands) -> None:
    state, touching = stands
    footing = FootingSettings(raised=0.2, lowered=0.1)

    def height(after: State, before: State) -> float:
        return float(footing.moved_towards_ground(before, after, touching).translation[0, 2])

    level = float(state.translation[0, 2])
    high, low = lifted(state, 0.12), lifted(state, -0.06)
    assert height(high, high) == pytest.approx(level + 0.12 - 0.1 * 0.1, abs=1e-6)
    assert height(low, low) == pytest.approx(level - 0.06 + 0.2 * 0.05, abs=1e-6)
    assert height(state, state) == pytest.approx(level, abs=1e-6)
    falls = high.replace(velocity=high.velocity + high.velocity.new_tensor([0, 0, GRAVITY / 30]))
    assert height(high, falls) == pytest.approx(level + 0.12, abs=1e-6)


def test_the_ground_holds_what_networks_let_sink(body: BodyModel) -> None:
    """Networks that leave a sunken body as it is: with footing it rises, without it does not."""
    prior, motion = humor(body, still=True), motions()[:1]
    first = lifted(states_of(motion, body)[:, 0], 0.0)
    touching = heights_in_contact(rest_heights(body, motion.shape))[:, FEET]
    sunk = lifted(first, float(-0.3 - (first.joints[:, FEET, 2] - touching).amin()))
    random = torch.Generator().manual_seed(0)
    lowest = []
    for footing in (None, FootingSettings()):
        made = roll_out_from(prior, sunk, motion.shape, 30, random, footing=footing)
        assert made.joints is not None
        lowest.append(float((made.joints[0, -1, FEET, 2] - touching[0]).amin()))
    assert lowest[0] == pytest.approx(-0.3, abs=0.02)
    assert lowest[1] > -0.03

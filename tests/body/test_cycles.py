import math

import numpy as np
import pytest
import torch

from recon.body.cycles import find_cycles, hip_flexion, warping_costs
from recon.body.model import BodyModel
from recon.core import rotations as so3
from recon.core.skeleton import MIRROR
from tests.walking import a_walk

pytestmark = pytest.mark.numerics

BODY = BodyModel.load()


@pytest.mark.parametrize("period", [0.6, 1.0, 1.7])
def test_cycles_of_any_duration_are_found_where_they_are(period):
    walk = a_walk(BODY, seconds=3 * period, period=period)
    found = find_cycles(walk)
    left = [cycle for cycle in found if cycle.side == "left"]
    right = [cycle for cycle in found if cycle.side == "right"]
    assert len(left) >= 2
    assert len(right) >= 2
    for cycle in found:
        assert cycle.duration == pytest.approx(period, rel=0.15)
    # the strike of a heel is where its hip is flexed most, within the template's 7 % of a cycle
    for cycle in left:
        phase = (cycle.start / period + 0.5) % 1 - 0.5
        assert abs(phase) < 0.13


def test_an_inserted_warped_template_is_found_within_two_frames():
    random = np.random.default_rng(0)
    phase = np.linspace(0, 1, 40) ** 1.3
    whole = math.tau * np.linspace(0, 1, 51)
    template = np.stack([np.sin(whole), np.cos(whole)], -1)
    inserted = np.stack([np.sin(math.tau * phase), np.cos(math.tau * phase)], -1)
    row = 2 + 0.1 * random.standard_normal((150, 2))
    row[60:100] = inserted
    cost, first = warping_costs(template, row)
    last = int(cost.argmin())
    assert abs(last - 99) <= 2
    assert abs(first[last] - 60) <= 2
    assert cost[last] < 0.01


def test_each_cycle_is_found_once():
    found = find_cycles(a_walk(BODY, seconds=1.0, pause=0.6))
    left = [cycle for cycle in found if cycle.side == "left"]
    assert len(left) == 1
    assert left[0].start == pytest.approx(0.6, abs=0.15)
    assert left[0].duration == pytest.approx(1.0, abs=0.2)


def test_standing_still_and_hopping_on_both_legs_are_no_gait():
    walk = a_walk(BODY, seconds=3.0)
    still = walk.replace(rotations=walk.rotations[:1].expand_as(walk.rotations))
    assert find_cycles(still) == ()
    hips = walk.rotations.clone()
    hips[:, 2] = hips[:, 1]
    assert find_cycles(walk.replace(rotations=hips)) == ()


def test_a_motion_shorter_than_any_cycle_has_none():
    assert find_cycles(a_walk(BODY, seconds=0.2)) == ()


def test_mirroring_exchanges_the_sides():
    walk = a_walk(BODY, seconds=2.6, period=1.0)
    flip = torch.tensor([-1.0, 1.0, 1.0])
    mirrored = walk.replace(
        rotations=(flip[:, None] * walk.rotations * flip)[:, list(MIRROR)],
        translation=walk.translation * flip,
    )
    sides = {"left": "right", "right": "left"}
    here = [(round(c.start, 2), c.side) for c in find_cycles(walk)]
    there = [(round(c.start, 2), sides[c.side]) for c in find_cycles(mirrored)]
    assert here == there


def test_flexion_is_the_angle_of_the_thigh():
    walk = a_walk(BODY, seconds=1.0)
    flexion = np.degrees(hip_flexion(walk))
    assert flexion[0] == pytest.approx([32, -12], abs=1e-3)
    turned = walk.replace(rotations=walk.rotations.clone())
    turned.rotations[:, 0] = so3.about_z(torch.tensor(1.0)) @ turned.rotations[:, 0]
    assert np.allclose(hip_flexion(turned), hip_flexion(walk), atol=1e-6)

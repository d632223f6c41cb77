"""Frame rates by the laws of gait and gravity; treadmills by where their feet are carried."""

import math
from importlib import resources
from pathlib import Path

import pytest
import torch

from recon.body.model import BodyModel
from recon.core.motion import Motion
from recon.core.skeleton import JOINTS
from recon.diagnosis.frame_rate import RateRange, rate_finding, rate_range
from recon.diagnosis.movement import belt_velocity, treadmill_finding
from recon.formats.motions import load_motion


@pytest.fixture(scope="module")
def walk() -> Motion:
    """The demo's walk, four seconds at 30 frames per second."""
    return load_motion(Path(str(resources.files("recon") / "assets" / "demo.npz"))).motion


@pytest.fixture(scope="module")
def single() -> BodyModel:
    return BodyModel.load()


def a_jump(body: BodyModel, fps: float = 60.0, fall: float = 9.81) -> Motion:
    """Stands for 0.3 s, is in the air for 0.5 s and stands again, as stiff as a board."""
    air, rest = 0.5, 0.3
    time = torch.arange(round((air + 2 * rest) * fps) + 1) / fps - rest
    rise = (0.5 * fall * time * (air - time)).clamp(min=0)
    rest_joints = body.rest_joints(torch.zeros(body.shape_size))
    sole = body.rest_vertices(torch.zeros(body.shape_size))[:, 1].amin()
    place = torch.zeros(len(time), 3)
    place[:, 2] = rise - sole
    upright = torch.eye(3).repeat(len(time), 22, 1, 1)
    upright[:, 0] = torch.tensor([[1.0, 0, 0], [0, 0, -1.0], [0, 1.0, 0]])
    pelvis = torch.stack((rest_joints[0, 0], -rest_joints[0, 2], rest_joints[0, 1]))
    return Motion.create(
        place + pelvis - rest_joints[0], upright, torch.zeros(body.shape_size), fps
    )


@pytest.mark.parametrize("factor", [0.25, 0.5, 2.0, 4.0])
def test_a_walk_at_a_wrong_rate(walk: Motion, single: BodyModel, factor: float) -> None:
    """A rate that was wrong by two or four was taken as it came, speeds and all."""
    found = rate_finding(walk.replace(fps=factor * walk.fps), single)
    assert found is not None
    assert found.code == "rate"
    assert found.value is not None
    assert (found.value < 1) == (factor > 1)
    told = rate_range(walk.replace(fps=factor * walk.fps), single)
    assert told is not None
    assert told.low <= 1 / factor <= told.high


def test_a_walk_at_its_own_rate(walk: Motion, single: BodyModel) -> None:
    found = rate_range(walk, single)
    assert found is not None
    assert found.holds_one
    assert found.likeliest == 1.0
    assert rate_finding(walk, single) is None


@pytest.mark.parametrize("fps", [60.0, 240.0])
@pytest.mark.parametrize("factor", [0.4, 1.0, 2.5])
def test_free_fall_has_one_acceleration(single: BodyModel, fps: float, factor: float) -> None:
    """A jump without a single step tells the rate, from above and from below."""
    found = rate_range(a_jump(single, fps).replace(fps=factor * fps), single)
    if factor == 1.0:
        assert found is None
    else:
        assert found is not None
        assert not found.holds_one
        assert found.low <= 1 / factor <= 1.1 * found.high
        assert found.evidence == ("the acceleration of its falls against gravity",)


def test_a_jump_of_the_data_is_no_fall(walk: Motion, single: BodyModel) -> None:
    """One displaced frame accelerates by hundreds of g; it is no sign of a wrong rate."""
    place = walk.translation.clone()
    place[60, 2] += 0.3
    assert rate_finding(walk.replace(translation=place), single) is None


def test_what_was_inferred_is_not_asked(walk: Motion, single: BodyModel) -> None:
    """Legs that nobody saw walk at the rate of whoever invented them."""
    observed = torch.ones(walk.frames, 22, dtype=torch.bool)
    observed[:, JOINTS.index("left_ankle")] = False
    assert rate_range(walk.replace(fps=120.0), single, observed) is None
    observed[:90] = True
    found = rate_range(walk.replace(fps=120.0), single, observed)
    assert found is not None
    assert not found.holds_one


def test_the_likeliest_factor() -> None:
    assert RateRange(0.3, 0.8, ()).likeliest == 0.5
    assert RateRange(1.7, math.inf, ()).likeliest == 2.0
    assert RateRange(0.6, 0.8, ()).likeliest == 0.8
    assert RateRange(0.9, 1.3, ()).holds_one


def on_belt(walk: Motion, speed: float) -> Motion:
    """The same steps over ground that moves: the walker's mean velocity is taken away."""
    seconds = torch.arange(walk.frames) / walk.fps
    drift = (walk.translation[-1] - walk.translation[0]) / seconds[-1]
    drift[2] = 0.0
    still = walk.translation - seconds[:, None] * drift * speed
    return walk.replace(translation=still)


def test_a_treadmill_is_told_with_its_speed(walk: Motion, single: BodyModel) -> None:
    """Feet that a belt carries along were called slipping, and the floor was blamed."""
    belt = belt_velocity(on_belt(walk, 1.0), single)
    assert belt is not None
    mean = (walk.translation[-1] - walk.translation[0])[:2] / (walk.frames - 1) * walk.fps
    torch.testing.assert_close(belt, -mean, atol=0.1, rtol=0.1)
    assert treadmill_finding(belt).value == pytest.approx(float(mean.norm()), rel=0.1)


def test_no_treadmill_where_feet_stand(walk: Motion, single: BodyModel) -> None:
    assert belt_velocity(walk, single) is None
    assert belt_velocity(a_jump(single), single) is None


def test_feet_that_slip_with_the_body_are_no_treadmill(walk: Motion, single: BodyModel) -> None:
    """A fit without ground lets the whole body drift; that is no belt."""
    assert belt_velocity(on_belt(walk, 0.3), single) is None
    assert belt_velocity(on_belt(walk, -0.5), single) is None

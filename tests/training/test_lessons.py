"""What a second may teach: feet that hold, jumps, what was not seen, whose bones they are."""

from dataclasses import replace

import pytest
import torch

from recon.body.model import BodyModel
from recon.core.motion import MotionFile
from tests.standing_body import path, standing, times
from training.lessons import Source, lesson_rows

RATE = 30.0


@pytest.fixture(scope="module")
def body() -> BodyModel:
    return BodyModel.load().to(dtype=torch.float64)


def clip(body: BodyModel, speed: float = 0.0, seconds: float = 3.0) -> MotionFile:
    """Somebody who stands, or is pushed along on feet that do not move."""
    time = times(seconds, RATE)[:-1]
    motion = standing(body, path(speed * time, like=time), RATE)
    return MotionFile(motion, joints=body.pose(motion).joints)


def test_who_stands_teaches_everything(body: BodyModel) -> None:
    (span,) = lesson_rows(clip(body), Source(), body)
    assert (span.first, span.stop) == (0, 90)
    assert span.poses
    assert span.steps
    assert span.contacts
    assert span.shape
    assert span.why == ""


def test_feet_that_slide_teach_poses_and_no_steps(body: BodyModel) -> None:
    (span,) = lesson_rows(clip(body, speed=0.4), Source(), body)
    assert span.poses
    assert not span.steps
    assert not span.contacts
    assert span.why == "slides"


def test_bones_of_nobody_teach_steps_where_feet_hold_and_never_contacts(body: BodyModel) -> None:
    common = Source(own_bones=False)
    (holds,) = lesson_rows(clip(body), common, body)
    assert holds.steps
    assert not holds.contacts
    assert not holds.shape
    (slides,) = lesson_rows(clip(body, speed=0.4), common, body)
    assert slides.poses
    assert not slides.steps


@pytest.mark.parametrize(
    "source", [Source(retargeted=True), Source(true_rate=False), Source(flat=False)]
)
def test_what_the_source_lacks_leaves_poses(body: BodyModel, source: Source) -> None:
    (span,) = lesson_rows(clip(body), source, body)
    assert span.poses
    assert not span.steps


def test_a_jump_spoils_its_second_alone(body: BodyModel) -> None:
    file = clip(body)
    moved = file.motion.translation.clone()
    moved[45:, 0] += 2.0
    motion = file.motion.replace(translation=moved)
    spans = lesson_rows(MotionFile(motion, joints=body.pose(motion).joints), Source(), body)
    assert [(span.first, span.stop, span.poses) for span in spans] == [
        (0, 30, True), (30, 60, False), (60, 90, True),
    ]  # fmt: skip
    assert "jump" in spans[1].why


def test_what_is_unsure_is_not_learned_from(body: BodyModel) -> None:
    file = clip(body)
    observed = torch.ones(90, 22, dtype=torch.bool)
    observed[10, 20] = False  # a wrist, once
    spans = lesson_rows(
        replace(file, observed=observed), Source(residuals=(0.005, 0.005, 0.03)), body
    )
    assert [(span.poses, span.why) for span in spans] == [
        (False, "unseen"), (True, ""), (False, "residual"),
    ]  # fmt: skip


def test_who_stands_on_a_chair_teaches_no_steps_there(body: BodyModel) -> None:
    time = times(6.0, RATE)[:-1]
    motion = standing(body, path(z=0.4 * (time > 4.0).double(), like=time), RATE)
    spans = lesson_rows(MotionFile(motion), Source(), body)
    assert spans[0].steps
    assert not spans[-1].steps
    assert "raised" in spans[-1].why


def test_who_sits_with_feet_in_the_air_teaches_no_steps_there(body: BodyModel) -> None:
    time = times(6.0, RATE)[:-1]
    swing = 0.2 * (1.5 * torch.pi * time).sin()
    high = 0.3 * ((time > 2.0) & (time < 4.0)).double()
    motion = standing(body, path(swing, high, like=time), RATE)
    words = [span.why for span in lesson_rows(MotionFile(motion), Source(), body)]
    assert any("raised" in why for why in words)
    (short,) = lesson_rows(clip(body), Source(), body)
    assert "raised" not in short.why

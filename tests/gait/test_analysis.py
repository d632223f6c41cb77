"""Gait events, cycles and figures: against events that laboratories marked, and by laws."""

import math
import os
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import torch

import recon
from recon.body.model import BodyModel
from recon.body.motion_files import load_motion_of
from recon.core import rotations as so3
from recon.core.motion import Motion
from recon.core.skeleton import JOINTS, joint_index
from recon.gait.analysis import CURVES, Gait, analyse

DEMO = Path(recon.__file__).parent / "assets" / "demo.npz"
DATA = os.environ.get("RECON_DATA")


@pytest.fixture(scope="module")
def body() -> BodyModel:
    return BodyModel.load()


@pytest.fixture(scope="module")
def walk(body) -> Motion:
    """Someone who stands, then walks for 4 s."""
    return load_motion_of(DEMO, body).motion


@pytest.fixture(scope="module")
def gait(walk, body) -> Gait:
    return analyse(walk, body)


def figures(gait: Gait) -> dict[tuple[str, str], float]:
    return {(one.name, one.side): one.mean for one in gait.figures}


def events(gait: Gait) -> list[tuple[str, int | None, int | None]]:
    return [(one.side, one.strike, one.off) for one in gait.stances]


def test_a_walk_has_figures_of_a_walk(gait):
    found = figures(gait)
    assert 80 < found["cadence", "both"] < 130
    assert 0.9 < found["speed", "both"] < 1.5
    assert 55 < found["stance", "both"] < 70
    assert found["stride length", "both"] == pytest.approx(
        found["speed", "both"] * found["stride time", "both"], rel=0.05
    )
    # two steps are a stride
    steps = found["step length", "left"] + found["step length", "right"]
    assert steps == pytest.approx(found["stride length", "both"], rel=0.05)


def test_feet_strike_in_turn(gait):
    """A foot that stood from the beginning once had a strike there, and a cycle of 1.9 s."""
    strikes = sorted((one.strike, one.side) for one in gait.stances if one.strike is not None)
    sides = [side for _, side in strikes]
    assert len(sides) >= 4
    assert all(a != b for a, b in pairwise(sides))
    assert max(cycle.seconds for cycle in gait.cycles) < 1.4
    for cycle in gait.cycles:
        assert cycle.strike < cycle.off < cycle.next_strike


def test_where_a_walk_goes_changes_nothing(walk, body, gait):
    T = torch.eye(4)
    T[:3, :3] = so3.about_z(torch.tensor(2.0))
    T[:3, 3] = torch.tensor([3.0, -1.0, 0.0])
    pelvis = body.rest_joints(walk.shape)[0]
    moved = analyse(walk.carried(T, pelvis), body)
    assert events(moved) == events(gait)
    for name, value in figures(gait).items():
        assert figures(moved)[name] == pytest.approx(value, rel=1e-3, abs=1e-3), name
    for curve in CURVES:
        for side in ("left", "right"):
            np.testing.assert_allclose(
                moved.curves(curve, side), gait.curves(curve, side), atol=0.05
            )


def test_a_belt_changes_nothing(walk, body, gait):
    """On a treadmill no foot ever stands still in the room."""
    belt = torch.tensor([0.1, 1.1])
    path = (walk.times - walk.start_time)[:, None].float() * belt
    shifted = torch.nn.functional.pad(path, (0, 1)) + walk.translation
    found = analyse(walk.replace(translation=shifted), body, belt=belt)
    assert events(found) == events(gait)
    assert found.belt == pytest.approx(belt.norm().item())
    for name, value in figures(gait).items():
        assert figures(found)[name] == pytest.approx(value, rel=1e-3, abs=1e-3), name


def test_the_rate_hardly_matters(walk, body, gait):
    faster = figures(analyse(walk.resample(100.0), body))
    assert faster["speed", "both"] == pytest.approx(figures(gait)["speed", "both"], rel=0.03)
    assert faster["stance", "both"] == pytest.approx(figures(gait)["stance", "both"], abs=4)


def test_who_stands_has_no_steps(walk, body):
    still = walk.replace(
        translation=walk.translation[:1].expand_as(walk.translation),
        rotations=walk.rotations[:1].expand_as(walk.rotations),
    )
    found = analyse(still, body)
    assert (found.stances, found.cycles, found.figures) == ((), (), ())


def test_legs_that_swing_in_the_air_take_no_steps(walk, body):
    found = analyse(walk, body, ground=-0.5)
    assert found.stances == ()
    assert len(analyse(walk, body, ground=None).stances) >= 4


def test_a_single_frame_is_refused(walk, body):
    """NumPy's words about gradients stood in the error."""
    with pytest.raises(recon.ReconError, match="two frames or more"):
        analyse(walk.window(0, 1), body)


def test_joints_that_nobody_saw_are_told(walk, body):
    observed = torch.ones(walk.frames, len(JOINTS), dtype=torch.bool)
    observed[:, joint_index("left_ankle")] = False
    found = analyse(walk, body, observed=observed)
    assert found.unseen["knee_flexion_l"] == 1.0
    assert "knee_flexion_r" not in found.unseen


def test_other_bodies_have_no_heels(walk):
    bundled = BodyModel.load()
    other = bundled.replace(checksum="another", name="another")
    with pytest.raises(recon.ReconError, match="only for the bundled body"):
        analyse(walk, other)


@pytest.mark.skipif(DATA is None, reason="RECON_DATA is not set")
def test_events_are_those_that_a_laboratory_marked():
    """Five steps of a person whom a laboratory recorded; its events stand in the file."""
    import ezc3d

    path = Path(str(DATA)) / "observations" / "biomechzoo" / "HC033A10.c3d"
    if not path.is_file():
        pytest.skip(f"{path} is not there")
    file = ezc3d.c3d(str(path))
    marked = file["parameters"]["EVENT"]
    points = file["header"]["points"]
    made = recon.convert(path)
    motion = made.motion
    # conversions that keep the clock of the recording begin with its first frame
    shift = 0.0 if motion.start_time > 0 else points["first_frame"] / points["frame_rate"]
    found = recon.report(made).gait
    errors = []
    for context, label, time in zip(
        marked["CONTEXTS"]["value"], marked["LABELS"]["value"], marked["TIMES"]["value"][1],
        strict=True,
    ):  # fmt: skip
        own = [one for one in found.stances if one.side == context.lower()]
        frames = [one.strike if "Strike" in label else one.off for one in own]
        moments = [found.times[frame] + shift for frame in frames if frame is not None]
        errors.append(min(abs(moment - time) for moment in moments))
    assert len(errors) == 8
    assert np.mean(errors) < 0.02
    assert max(errors) < 0.045
    assert math.isfinite(found.figures[0].mean)

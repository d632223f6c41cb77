"""Feet that stay where they are in one view: which are held, and by how much."""

from dataclasses import replace

import pytest
import torch

from priors.pose.prior import PosePrior
from recon.core.skeleton import FEET
from recon.fitting import clip as clip_module
from recon.fitting.clip import fit_clip
from recon.fitting.methods import FitOptions
from recon.fitting.still_feet import StillFeet, with_still_feet
from recon.method.terms import Term
from tests import laws
from tests.filmed import bundled, cameras, joint_error, view, walk


def speeds(frames: int) -> torch.Tensor:
    """Of ankles and toes from frame to frame, m/s."""
    joints = bundled().pose(walk(frames)).joints[:, FEET]
    return joints.diff(dim=0).norm(dim=-1) * 30


@pytest.mark.parametrize("kind", ["still", "turned", "carried"])
def test_feet_that_stand_are_held_and_feet_that_step_are_not(kind: str):
    truth = walk(60)
    camera = cameras(truth, 1, 0.5)[0]
    place = camera.T_world_camera[..., :3, 3].reshape(3).expand(60, 3)
    pelvis = bundled().pose(truth).joints[:, 0]
    if kind == "still":
        place, pelvis = place[:1], pelvis[:1]
    elif kind == "carried":
        place = place + pelvis - pelvis[:1]
    poses = [
        camera.placed(eye, aim).T_camera_world for eye, aim in zip(place, pelvis, strict=True)
    ]
    camera = camera.replace(T_camera_world=torch.stack(poses) if len(poses) > 1 else poses[0])
    seen = view(truth, camera, noise=1.0)
    held = StillFeet.of(seen, bundled(), seen.pixel_size(truth.map(lambda t: t[None]), bundled()))
    slow, fast = speeds(60) < 0.05, speeds(60) > 1.0
    assert slow.sum() > 40
    assert held.held[0][slow].mean() > 0.85
    assert held.held[0][fast].max() < 0.05


def test_feet_that_nobody_sees_are_not_held():
    seen = view(walk(30), cameras(walk(30))[0])
    confidence = seen.confidence.clone()
    confidence[:, 12:20] = 0
    held = StillFeet.of(seen.derived(confidence=confidence), bundled(), 0.003).held
    assert (held[:, 10:20] == 0).all()
    assert held[:, :8].max() > 0.9


def test_energy_is_the_quadratic_form_of_its_curvature():
    """Also at half the rate of the images, where each step counts half as often."""
    seen = view(walk(31), cameras(walk(31))[0])
    energy = StillFeet.of(seen, bundled(), 0.003)
    whole = walk(31).map(lambda t: t[None])
    values = []
    for motion in (whole, whole.resample(15.0)):
        estimate = laws.estimate_of(bundled(), motion)
        rows = torch.zeros(motion.frames, 3, 66, dtype=torch.float64)
        energy.add_curvature(2.0, estimate, 0, rows)
        x = estimate.body.joints[0].double().flatten(1)
        form = (rows[:, 0] * x.square()).sum() + 2 * (rows[:-1, 1] * x[1:] * x[:-1]).sum()
        found = energy(estimate)
        assert float(form) == pytest.approx(4 * float(found), rel=1e-2)
        values.append(float(found))
    assert min(values) > 1e-5


def test_one_view_holds_them_and_several_do_not():
    truth = walk(16)
    one, two = (view(truth, camera) for camera in cameras(truth, 2))
    reports = [
        fit_clip(seen, FitOptions(), bundled()).result.reports for seen in ([one], [one, two])
    ]
    terms = [{term.name for term in report[-1].stage.terms} for report in reports]
    assert "still feet" in terms[0]
    assert "still feet" not in terms[1]
    assert all("contact velocity" in names for names in terms)


def test_none_are_held_where_a_foot_may_leave_and_come_back_between_two_moments():
    seen = view(walk(16), cameras(walk(16))[0])
    stage = PosePrior.load().stages((Term("data", seen, 1.0),))[-1]
    contacts = replace(stage, name="contacts", terms=(Term("contact velocity", seen, 1.0),))
    for fps, more in ((30.0, 1), (5.0, 0)):
        (stage,) = with_still_feet([contacts], seen.replace(fps=fps), bundled(), 0.003)
        assert len(stage.terms) == 1 + more


def test_windows_of_a_long_view_that_are_tied_to_others_hold_them_too(monkeypatch):
    monkeypatch.setattr(clip_module, "LONG", 1.0)
    there = [*range(60), *range(59, -1, -1)]  # forwards and back, twice
    there = [*there, *there[1:80]]
    truth = walk(60)
    truth = truth.replace(
        translation=truth.translation[there], rotations=truth.rotations[there],
        valid=truth.valid[[0] * len(there)],
    )  # fmt: skip
    found = fit_clip([view(truth, cameras(truth)[0])], FitOptions(), bundled()).result
    names = {
        report.stage.name: {term.name for term in report.stage.terms} for report in found.reports
    }
    assert {"overlap", "still feet"} <= names["tied: contacts"]
    assert joint_error(found.motion[0], truth) < 0.15

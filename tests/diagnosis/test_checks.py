"""Checks are functions of the clip that a caller may choose, leave out and add to."""

import subprocess
import sys

import numpy as np
import pytest
import torch

import recon
from recon.core.camera import full_hd_camera
from recon.diagnosis.checks import AFTER, BEFORE, frame_rate, points, unseen
from recon.diagnosis.examination import ExaminedClip, checked
from recon.diagnosis.findings import Finding, Findings
from recon.simulation.images import camera_ring
from recon.simulation.points import Corruption, joints3d
from tests.diagnosis.test_views import SIDES, checked_clip, filmed, renamed, screened
from tests.filmed import bundled, view, walk

WITHOUT = """
import sys, numpy as np, recon
joints = np.load(sys.argv[1])
seen = recon.Joints3D(joints, np.ones(joints.shape[:-1], bool), range(22), fps=30.0)
print(recon.fit(seen, "pose", checks=()).warnings)
print(*sorted(name for name in sys.modules if name.startswith("recon.diagnosis.")))
"""


def seen():
    """A walk with a wrist that is never seen."""
    clip = joints3d(walk(), bundled(), Corruption(noise=0.015), 0)
    visible = clip.visible.clone()
    visible[:, 20] = False
    return clip.replace(visible=visible, positions=clip.positions * visible[..., None])


def test_every_check_says_what_it_does_and_of_which_sensors():
    for check in (*BEFORE, *AFTER):
        assert check.__doc__
        assert set(check.sees) <= {"named", "view", "cloud"}  # type: ignore[attr-defined]
        assert check.comes_before_fit == (check in BEFORE)  # type: ignore[attr-defined]


def test_a_caller_chooses_checks_and_adds_own():
    def mine(clip: ExaminedClip) -> tuple[ExaminedClip, Findings]:
        said = Finding("gap", f"{clip.names[0]} lasts {clip.motion.frames} frames")
        return clip, Findings(warnings=(said,))

    result = recon.fit(seen(), "pose", body=bundled(), checks=(points, unseen, mine))
    assert [finding.code for finding in result.diagnosis] == ["unseen"]
    assert [finding.message for finding in result.warnings] == ["joints3d lasts 24 frames"]


def test_a_fit_to_few_moments_says_so_and_judges_no_speed():
    """A film of few pictures a second was fitted without a word, or under a false warning."""
    for step, fps, said in ((15, 2.0, ["few moments"]), (4, 30.0, ["rate"])):
        joints = bundled().pose(walk(120)).joints[::step]
        clip = recon.Joints3D(joints, np.ones(joints.shape[:2], bool), range(22), fps=fps)
        result = recon.fit(clip, "pose", body=bundled(), checks=(frame_rate, unseen))
        assert [finding.code for finding in result.warnings] == said


def test_a_fit_without_checks_loads_none(tmp_path):
    np.save(tmp_path / "joints.npy", bundled().pose(walk(8)).joints.numpy())
    ran = subprocess.run(
        [sys.executable, "-c", WITHOUT, str(tmp_path / "joints.npy")],
        check=True, capture_output=True, text=True,
    )  # fmt: skip
    said, loaded = ran.stdout.splitlines()
    assert said == "()"
    needed = ("certainty", "examination", "findings")
    loaded = [name.removeprefix("recon.diagnosis.") for name in loaded.split()]
    assert sorted(loaded) == sorted(needed)


def test_a_fit_screens_its_views_unless_told_not_to() -> None:
    spoilt = renamed(filmed(1)[0], slice(8, 18), SIDES)
    clip = checked_clip(spoilt)
    found = checked(clip, BEFORE)
    assert [f.code for f in found.repairs] == ["sides exchanged"]
    assert found.repairs[0].sensors == ("one",)
    assert torch.equal(found.observations[0].pixels, filmed(1)[0].pixels)  # type: ignore[union-attr]
    for how in ({"repair": False}, {"checks": AFTER}):
        result = recon.fit(spoilt, "pose", body=bundled(), **how)
        assert result.repairs == ()


def test_somebody_upside_down_throughout_is_told_of_one_view():
    """The warnings spoke of lens, unit and ground; one view does not tell a turned film apart."""
    (seen,) = filmed(1)
    height = seen.camera.image_size[1]
    over = seen.replace(
        pixels=seen.pixels * torch.tensor([1.0, -1.0]) + torch.tensor([0.0, height])
    )
    assert not any("upside down" in one.message for one in screened((seen,))[2])
    assert any("upside down" in one.message for one in screened((over,))[2])


def test_a_film_turned_by_90_degrees_is_told():
    """Without a pose, the world turned with the film, and nothing was said."""
    (seen,) = filmed(1)
    camera = seen.camera.replace(T_camera_world=torch.eye(4)[None, None])
    alone = seen.derived(camera=camera, ground_known=False)
    turned = alone.replace(pixels=alone.pixels.flip(-1))
    assert not any("the person lies" in one.message for one in screened((alone,))[2])
    assert any("the person lies" in one.message for one in screened((turned,))[2])


LEG = ("hip", "knee", "ankle", "heel", "big_toe", "small_toe")


@pytest.mark.parametrize("parts", [("hip", "knee"), ("hip",), ("knee", "ankle"), LEG, ("elbow",)])
def test_left_and_right_of_a_limb_exchanged_in_all_views_are_exchanged_back(parts) -> None:
    """Rays met under the wrong names, and nothing was said: hips and knees cost 4.9 cm."""
    views = filmed(2)
    pairs = [(f"left_{part}", f"right_{part}") for part in parts]
    out, repairs, warnings = screened(tuple(renamed(one, slice(None), pairs) for one in views))
    assert [f.code for f in repairs] == ["points exchanged"]
    assert {*repairs[0].joints} == {name for pair in pairs for name in pair}
    assert not warnings
    assert all(torch.equal(a.pixels, b.pixels) for a, b in zip(out, views, strict=True))


@pytest.mark.parametrize(
    ("parts", "when"),
    [(("knee",), slice(None)), (LEG, slice(None)), (("elbow", "wrist"), slice(8, 18))],
)
def test_left_and_right_of_a_limb_exchanged_in_one_view_are_exchanged_back(parts, when) -> None:
    """Rays missed each other by the width of a body, and nothing was said."""
    motion, heights = walk(30), (0.5, 3.5)
    rigs = [
        camera_ring(motion, bundled(), full_hd_camera(), 2, height=h, first=0.7) for h in heights
    ]
    views = tuple(view(motion, rigs[k][k], seed=k) for k in range(2))
    pairs = [(f"left_{part}", f"right_{part}") for part in parts]
    out, repairs, warnings = screened((views[0], renamed(views[1], when, pairs)))
    assert {f.code for f in repairs} == {"points exchanged"}
    assert {name for f in repairs for name in f.joints} == {n for pair in pairs for n in pair}
    assert not warnings
    assert all(torch.equal(a.pixels, b.pixels) for a, b in zip(out, views, strict=True))

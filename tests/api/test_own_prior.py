"""A prior in one file: named, placed, loaded; long recordings, unknown ground, cameras, CLI."""

import json

import pytest
import torch

import recon
from recon import cli
from recon.core import plugins
from recon.core.errors import WeightsError
from recon.core.skeleton import JOINTS
from recon.fitting.long import LongReconstruction
from recon.fitting.methods import loaded_prior, prior_class, prior_trait
from recon.formats.motions import save_motion
from recon.formats.observations import PositionsFile, save_observation
from recon.simulation.points import Corruption, joints3d
from tests import laws
from tests.filmed import bundled, cameras, joint_error, view, walk
from tests.own import PRIOR, NearPoses

OURS = ("humor", "pose", "anchor")


def prior() -> NearPoses:
    return NearPoses.load("open", bundled())


def test_it_keeps_the_laws_of_priors(toy_body):
    motion = laws.a_motion(toy_body)
    laws.check_prior(prior(), motion, 1e-6)
    laws.check_heading_invariance(prior(), motion, 0.7, torch.tensor([1.0, -2.0, 0.3]).double())


def test_ours_are_registered_through_the_same_door():
    """A name was written into eight places of the library; now into `pyproject.toml` alone."""
    assert set(OURS) <= set(plugins.registered_places(plugins.PRIORS))
    assert [prior_trait(name, "completes") for name in OURS] == [False, False, True]
    assert [prior_trait(name, "knows_gravity") for name in OURS] == [True, False, True]


def test_what_did_not_earn_a_name_has_a_place():
    """HUMOS is fitted by its place: for some people feet slip more than without it."""
    assert "humos" not in plugins.registered_places(plugins.PRIORS)
    assert prior_trait("priors.humos.prior:Humos", "knows_gravity")


def test_a_registered_prior_has_a_name(monkeypatch):
    names = {**plugins.registered_places(plugins.PRIORS), "near": PRIOR}
    monkeypatch.setattr("recon.fitting.methods.registered_places", lambda _: names)
    assert prior_class("near") is NearPoses
    assert type(loaded_prior("near", "open", bundled())) is NearPoses


def test_a_package_written_for_version_0_2_works_on():
    """It had no base class: an object with `method(noise, body)`, and traits apart."""
    former = "tests.former_prior:NearPoses"
    assert not prior_trait(former, "knows_gravity")
    truth = walk(16)
    seen = joints3d(truth, bundled(), Corruption(noise=0.02), 0)
    results = [recon.fit(seen, former, ground=ground) for ground in ("auto", None)]
    for result in results:
        # its stage "root" is left out where the checks have found a motion
        assert [report.stage.name for report in result.reconstruction.reports] == ["all"]
        assert joint_error(result.motion, truth) < 0.05
    with pytest.raises(recon.ReconError, match="fitted in one way only"):
        recon.fit(seen, former, method="other")


def test_a_prior_that_lacks_a_half_is_told_which():
    with pytest.raises(WeightsError, match="lacks decode and encode"):
        loaded_prior("recon.method:Prior", "open", bundled())


def test_names_of_nobody_are_refused():
    with pytest.raises(WeightsError, match=r"prior: expected .*humor"):
        prior_class("humr")
    with pytest.raises(WeightsError, match="cannot be imported"):
        recon.fit(joints3d(walk(4), bundled(), Corruption(), 0), "nobody:Nothing")


@pytest.mark.slow
def test_long_recordings_and_unknown_ground():
    slow = walk(43).replace(fps=4.0)
    slow = slow.replace(translation=slow.translation + torch.tensor([0.0, 0.0, 0.5]))
    seen = joints3d(slow, bundled(), Corruption(noise=0.02), 0)
    result = recon.fit(seen, PRIOR, ground="unknown")
    assert isinstance(result.reconstruction, LongReconstruction)
    assert joint_error(result.motion, slow) < 0.05
    assert float(result.ground[3]) == pytest.approx(0.5, abs=0.04)


def test_one_camera_without_a_pose():
    truth = walk(16)
    posed = view(truth, cameras(truth)[0], seed=3)
    lens = posed.camera.camera_matrix.flatten(0, -3)[0]
    unposed = posed.replace(camera=recon.Camera.create(lens, posed.camera.image_size))
    result = recon.fit(unposed, prior())
    assert not result.failed
    assert result.T_world_camera is not None
    aligned = result.joints - result.joints.mean((0, 1))
    expected = bundled().pose(truth).joints
    assert float(aligned.norm(dim=-1).mean()) == pytest.approx(
        float((expected - expected.mean((0, 1))).norm(dim=-1).mean()), rel=0.15
    )


def test_the_command_line_takes_it_by_its_place(tmp_path, monkeypatch, capsys):
    truth = walk(16)
    points, own, out = (tmp_path / name for name in ("joints.npz", "own.npz", "out.npz"))
    joints = joints3d(truth, bundled(), Corruption(noise=0.02), 0)
    save_observation(
        points,
        PositionsFile("joints3d", joints.positions.numpy(), joints.visible.numpy(), JOINTS, 30.0),
    )
    save_motion(own, truth)
    words = f"fit {points} --prior {PRIOR} --weights {own} --json --out {out}"
    assert cli.run(words.split()) == cli.OK
    report = json.loads(capsys.readouterr().out)
    assert [stage["name"] for stage in report["stages"]] == ["root", "all"]
    assert report["settings"]["prior"] == PRIOR
    assert joint_error(recon.load_motion(out).motion, truth) < 0.05
    misspelt = f"fit {points} --prior humr --out {tmp_path / 'no.npz'}"
    assert cli.run(misspelt.split()) == cli.BAD_INPUT
    assert "did you mean humor?" in capsys.readouterr().err

"""What `recon` does besides fitting, from Python: motions in any form in, results out."""

import json
from importlib import resources

import numpy as np
import pytest
import torch

import recon
from recon.api import retarget as retarget_module
from recon.api.given import motion_given
from recon.body.motion_files import with_shape
from recon.core.motion import MotionFile
from recon.formats.motions import save_motion
from recon.formats.observations import PositionsFile
from tests.filmed import bundled, walk


def ten_lines(result: object) -> str:
    text = repr(result)
    assert len(text.splitlines()) <= 10
    assert max(map(len, text.splitlines())) <= 110
    assert "tensor" not in text
    return text


@pytest.fixture(scope="module")
def forms(tmp_path_factory) -> dict[str, object]:
    """One motion in all the forms that functions take."""
    body, motion = bundled(), walk(40)
    path = tmp_path_factory.mktemp("forms") / "walk.npz"
    save_motion(path, MotionFile(motion, body.name, body.checksum))
    arrays = dict(np.load(path))
    made = recon.predict(motion, seconds=0.1)[0]
    return {
        "motion": motion,
        "batch of one": motion[None],
        "double": motion.to(dtype=torch.float64),
        "path": path,
        "text": str(path),
        "file": recon.load_motion(path),
        "arrays": arrays,
        "result": type(made)(MotionFile(motion), body, (), {}),
    }


FORMS = ("motion", "batch of one", "double", "path", "text", "file", "arrays", "result")


@pytest.mark.parametrize("form", FORMS)
def test_every_form_of_a_motion_is_the_same_motion(form, forms):
    seen = recon.simulate(forms[form], "joints3d", frames=(2, 5))
    (points,) = seen.observations
    torch.testing.assert_close(
        points.positions[0], bundled().pose(walk(40)).joints[2:5], atol=1e-5, rtol=0
    )
    assert points.start_time == pytest.approx(walk(40).start_time + 2 / 30)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (3, "motion: expected a recon.Motion, a result, the path"),
        (walk(4).map(lambda t: torch.stack((t, t))), r"motion: expected one clip, got .*\(2,\)"),
        (
            walk(4).replace(translation=torch.full((4, 3), torch.nan)),
            "motion: translation holds NaN",
        ),
        ({"trans": np.zeros((4, 3))}, "motion: expected a motion in AMASS layout"),
        (MotionFile(walk(4), "other", "0" * 16), "motion: made with the body other"),
    ],
    ids=["number", "batch", "nan", "arrays", "body"],
)
def test_what_is_no_motion_is_refused_by_name(given, words):
    with pytest.raises(recon.ReconError, match=words):
        motion_given(given, bundled())


def test_a_simulation_is_fitted_and_written(tmp_path):
    """From a known motion to a fit without a file between."""
    seen = recon.simulate(walk(6), "keypoints2d", noise=2.0, views=2)
    assert len(seen) == 2
    assert "camera cam1" in ten_lines(seen)
    result = recon.fit(seen, "pose", callback=lambda *_: True)
    assert [one.name for one in result.residuals] == ["keypoints2d 1", "keypoints2d 2"]
    paths = seen.save(tmp_path / "seen")
    assert [path.name for path in paths] == ["cam1.npz", "cam2.npz"]
    from_files = recon.fit(list(paths), "pose", callback=lambda *_: True)
    assert torch.equal(result.motion.translation, from_files.motion.translation)
    with pytest.raises(recon.ReconError, match="give a folder"):
        seen.save(tmp_path / "seen.npz")
    with pytest.raises(recon.ReconError, match="do not apply to joints3d"):
        recon.simulate(walk(6), "joints3d", views=2)


def test_cycles_are_completed_from_what_was_simulated():
    seen = recon.simulate(walk(30), "landmarks", fps=10.0)
    result = recon.complete(seen, "anchor", callback=lambda *_: True)
    assert result.cycle is not None
    assert result.arguments["prior"] == "anchor"
    with pytest.raises(recon.ReconError, match="2D keypoints"):
        recon.complete(recon.simulate(walk(30), "keypoints2d"), "anchor")


def test_samples_are_a_row_of_motions(tmp_path):
    made = recon.sample(count=2, seconds=0.2, seed=3)
    assert len(made) == 2
    assert [one.motion.frames for one in made] == [7, 7]
    assert made[0].joints.shape == (7, 22, 3)
    assert "2 motions (sample) of 7 frames" in ten_lines(made)
    assert "feet" in ten_lines(made[0])
    again = recon.sample(count=2, seconds=0.2, seed=3)
    assert torch.equal(made[1].motion.rotations, again[1].motion.rotations)
    made.save(tmp_path / "made")
    kept = recon.load_motion(tmp_path / "made" / "sample_001.npz").motion
    torch.testing.assert_close(kept.rotations, made[1].motion.rotations, atol=1e-5, rtol=0)
    report = json.loads((tmp_path / "made" / "report.json").read_text())
    assert set(report["files"]) == {str(tmp_path / "made" / f"sample_00{k}.npz") for k in (0, 1)}


def test_a_motion_is_continued_from_any_moment(forms):
    made = recon.predict(forms["arrays"], seconds=0.2, samples=2, at=0.5)
    assert made[0].motion.start_time == pytest.approx(walk(40).start_time + 0.5)
    assert torch.equal(made[0].motion.translation[0], made[1].motion.translation[0])
    made[0].save(forms["path"].with_name("next.npz"))


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: recon.sample("anchor"), "prior: expected 'humor', 'humos'"),
        (lambda: recon.sample(count=0), "count: expected"),
        (lambda: recon.sample(seconds=-1.0), "seconds: expected"),
        (lambda: recon.sample(shape="tall"), "are options of the prior humos"),
        (lambda: recon.sample("humos", device="cuda"), "device: HUMOS"),
        (lambda: recon.sample("humos", shape="huge"), "shape 'huge': 'huge' is not known"),
        (lambda: recon.predict(walk(4), "pose"), "prior: expected"),
        (lambda: recon.predict(walk(4), at=1.0), "at: expected"),
        (lambda: recon.predict(walk(1)), "motion: a single frame has no velocity"),
        (lambda: recon.interpolate(walk(4), walk(4), at=2.0), "at: expected a number from 0"),
        (lambda: recon.interpolate(walk(4), walk(4)), "a: found no cycle of gait"),
        (
            lambda: recon.retarget(walk(4), "tall"),
            "of 1 s or longer and two frames or more, got 0.13 s",
        ),
        (lambda: recon.retarget(walk(40), [[1.0]]), "shape: expected 1 to 16 coefficients"),
        (lambda: recon.retarget(walk(40), "tall", fps=0.0), "fps: expected"),
        (
            lambda: recon.retarget(walk(40), "tall", weights="nc"),
            "weights='nc' needs method='network'",
        ),
        (lambda: recon.convert("nothing.xyz", fps=-1.0), "fps: expected"),
        (lambda: recon.convert("nothing.xyz", fps=1e9), "fps: expected a frame rate"),
        (
            lambda: recon.simulate(walk(4), "joints3d", frames=(2, 9)),
            "expected frames within 0 to 4",
        ),
        (lambda: recon.evaluate(walk(4), walk(4, 8)), "truth does not cover"),
        (lambda: recon.evaluate(walk(4), np.zeros((3, 22, 3))), "truth: expected the shape"),
        (lambda: recon.evaluate(walk(4), walk(4), contacts=np.ones((4, 3))), "contacts: expected"),
    ],
)
def test_what_cannot_be_done_is_refused_by_name(call, words):
    with pytest.raises(recon.ReconError, match=words):
        call()


def test_another_body_does_the_same(monkeypatch, tmp_path, forms):
    def retargeted(motion, shape, body, method, weights):
        return with_shape(motion, body, shape)

    monkeypatch.setattr(retarget_module, "_retargeted", retargeted)
    made = recon.retarget(forms["result"], "height=2.1", fps=20.0)
    assert made.about["target"]["height"] == pytest.approx(2.1, abs=1e-3)
    assert made.motion.fps == 20.0
    assert made.warnings[0].code == "body size"
    text = ten_lines(made)
    assert "target: 2.10 m" in text
    assert "warning: shape height=2.1: the body is 2.10 m tall" in text
    made.save(tmp_path / "tall.npz")
    assert json.loads((tmp_path / "tall.npz.json").read_text())["ground"] == 0.0
    like = recon.retarget(walk(40), tmp_path / "tall.npz")
    torch.testing.assert_close(like.motion.shape, made.motion.shape, atol=1e-5, rtol=0)


def test_physics_alone_asks_for_no_weights(monkeypatch):
    def no_weights(*_):
        raise AssertionError("weights were loaded")

    monkeypatch.setattr(retarget_module.Humos, "load", no_weights)
    made = recon.retarget(walk(40), "tall")
    assert made.about["method"] == "physics"
    assert made.motion.frames == 40


def test_between_two_cycles_lies_a_cycle():
    with resources.as_file(resources.files("recon") / "assets" / "demo.npz") as demo:
        made = recon.interpolate(demo, recon.load_motion(demo), 0.25)
    assert made.about["feet agree"] == pytest.approx(1.0, abs=1e-4)
    assert "cycle of result" in ten_lines(made)
    durations = made.about["durations"]
    assert durations["result"] == pytest.approx(durations["A"], abs=0.05)


def test_metrics_are_the_same_for_files_results_and_joints(tmp_path):
    """`recon.evaluate` took motions alone, and knew nothing of what results and files hold."""
    truth = walk(8)
    seen = recon.simulate(truth, "joints3d", hide_below=0.3)
    result = recon.fit(seen, "pose", callback=lambda *_: True)
    file = seen.files[""]
    assert isinstance(file, PositionsFile)
    found = recon.evaluate(result, truth, observation=file)
    assert found["contact_accuracy"] is not None
    assert found["joints_hidden"] is not None
    assert found["observed_hidden"] is not None
    result.save(tmp_path / "m.npz")
    save_motion(tmp_path / "t.npz", MotionFile(truth))
    seen.save(tmp_path / "o.npz")
    from_files = recon.evaluate(
        tmp_path / "m.npz", tmp_path / "t.npz", observation=tmp_path / "o.npz"
    )
    assert from_files.keys() == found.keys()
    for key, value in found.items():
        assert from_files[key] == (
            None if value is None else pytest.approx(value, rel=5e-5, abs=1e-4)
        )
    joints = bundled().pose(truth).joints.numpy()
    alone = recon.evaluate(result, joints)
    assert alone["joints_all"] == pytest.approx(found["joints_all"], abs=1e-5)
    assert alone["accel_error"] == pytest.approx(found["accel_error"], abs=1e-2)
    np.save(tmp_path / "joints.npy", joints)
    assert recon.evaluate(result, tmp_path / "joints.npy") == alone
    assert "joints, all" in ten_lines(found)
    found.save(tmp_path / "metrics.json")
    assert json.loads((tmp_path / "metrics.json").read_text())["joints_all"] == found["joints_all"]
    plain = recon.evaluate(result.motion, truth, bundled())
    assert plain["joints_all"] == found["joints_all"]
    assert plain["contact_accuracy"] is None

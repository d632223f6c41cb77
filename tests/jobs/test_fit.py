"""Fitting files as a user does: good ones, damaged ones, hostile ones."""

import json
import pickle
import zipfile
from importlib import resources
from pathlib import Path

import numpy as np
import pytest
import torch

from recon.api.evaluate import evaluate
from recon.cli.errors import Failed
from recon.core.skeleton import JOINTS
from recon.fitting.settings import FitSettings
from recon.formats.motions import load_motion, save_motion
from recon.simulation.points import Corruption
from tests import laws
from tests.verbs import fit_files, simulate_file


@pytest.fixture(scope="module")
def truth(tmp_path_factory) -> Path:
    """A short motion on the bundled body, in a file."""
    from recon.body.model import BodyModel

    body = BodyModel.load().to(dtype=torch.float64)
    path = tmp_path_factory.mktemp("truth") / "truth.npz"
    save_motion(path, laws.a_motion(body, clips=1, frames=12)[0].to(dtype=torch.float32))
    return path


def observation(truth: Path, folder: Path, kind="joints3d", **corruption) -> Path:
    path = folder / f"{kind}.npz"
    simulate_file(truth, path, kind, Corruption(**corruption), seed=1)
    return path


def rewritten(path: Path, **changes) -> Path:
    """The same file with some arrays exchanged."""
    with np.load(path) as file:
        arrays = {key: file[key] for key in file.files}
    arrays |= {key: np.asarray(value) for key, value in changes.items() if value is not None}
    for key in [key for key, value in changes.items() if value is None]:
        del arrays[key]
    np.savez(path, **arrays)
    return path


@pytest.mark.parametrize("kind", ["joints3d", "markers3d"])
def test_a_simulated_observation_is_fitted_written_and_evaluated(kind, truth, tmp_path):
    seen = observation(truth, tmp_path, kind, noise=0.01, missing_points=0.2)
    out = tmp_path / "motion.npz"
    report = fit_files([seen], out, FitSettings())
    assert not report["failed"]
    assert json.loads((tmp_path / "motion.npz.json").read_text())["inputs"]
    result = load_motion(out)
    assert result.motion.frames == 12
    assert result.joints is not None
    metrics = evaluate(out, truth, observation=seen)
    metrics.save(tmp_path / "m.json")
    assert metrics["observed_visible"] is not None
    assert metrics["observed_visible"] < 0.04  # metres
    assert metrics.items() <= json.loads((tmp_path / "m.json").read_text()).items()


def test_two_observations_of_a_clip_add_up(truth, tmp_path):
    joints = observation(truth, tmp_path, "joints3d", noise=0.01)
    markers = observation(truth, tmp_path, "markers3d", noise=0.01)
    report = fit_files([joints, markers], tmp_path / "motion.npz", FitSettings(prior="pose"))
    assert {"data 1", "data 2"} <= set(report["stages"][-1]["energies"])


def test_another_rate_may_be_asked_for(truth, tmp_path):
    seen = observation(truth, tmp_path, noise=0.01)
    fit_files([seen], tmp_path / "motion.npz", FitSettings(prior="pose", fps=60.0))
    assert load_motion(tmp_path / "motion.npz").motion.fps == 60.0


def spoil(name: str, path: Path, rng: np.random.Generator) -> None:
    """One way for a file to be wrong."""
    with np.load(path) as file:
        positions, visible = file["positions"], file["visible"]
    if name == "nothing visible":
        rewritten(path, visible=visible & False)
    elif name == "nan":
        positions[3, 4] = np.nan
        rewritten(path, positions=positions)
    elif name == "inf":
        positions[3, 4, 1] = np.inf
        rewritten(path, positions=positions)
    elif name == "millimetres":
        rewritten(path, positions=1000 * positions)
    elif name == "y up":
        rewritten(path, positions=positions[..., [1, 2, 0]])
    elif name == "no frames":
        rewritten(path, positions=positions[:0], visible=visible[:0])
    elif name == "wrong shape":
        rewritten(path, positions=positions[:, :, :2])
    elif name == "a key missing":
        rewritten(path, visible=None)
    elif name == "unknown joint":
        rewritten(path, names=np.array([*JOINTS[:-1], "tail"]))
    elif name == "no rate":
        rewritten(path, fps=0.0)
    elif name == "truncated":
        path.write_bytes(path.read_bytes()[: int(rng.integers(1, path.stat().st_size))])
    elif name == "noise":
        path.write_bytes(rng.bytes(500))
    elif name == "empty":
        path.write_bytes(b"")
    elif name == "pickle":
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr("kind.npy", pickle.dumps({"kind": "joints3d"}))
    else:
        raise AssertionError(name)


WRONG = (
    "nothing visible", "nan", "inf", "millimetres", "y up", "no frames", "wrong shape",
    "a key missing", "unknown joint", "no rate", "truncated", "noise", "empty", "pickle",
)  # fmt: skip


@pytest.mark.parametrize("name", WRONG)
def test_bad_files_are_refused_by_name_and_nothing_is_written(name, truth, tmp_path):
    seen = observation(truth, tmp_path, noise=0.01)
    spoil(name, seen, np.random.default_rng(0))
    with pytest.raises(ValueError, match="joints3d"):
        fit_files([seen], tmp_path / "motion.npz", FitSettings(prior="pose"))
    assert not (tmp_path / "motion.npz").exists()


def test_the_stated_remedies_work(truth, tmp_path):
    seen = observation(truth, tmp_path, noise=0.005)
    spoil("millimetres", seen, np.random.default_rng(0))
    fit_files([seen], tmp_path / "a.npz", FitSettings(prior="pose", unit="mm"))
    seen.unlink()
    seen = observation(truth, tmp_path, noise=0.005)
    spoil("y up", seen, np.random.default_rng(0))
    with pytest.raises(ValueError, match="--up y"):
        fit_files([seen], tmp_path / "b.npz", FitSettings(prior="pose"))
    fit_files([seen], tmp_path / "b.npz", FitSettings(prior="pose", up="y"))
    assert load_motion(tmp_path / "b.npz").motion.translation.isfinite().all()


@pytest.mark.parametrize(
    "trial", [0, 1, *(pytest.param(k, marks=pytest.mark.slow) for k in range(2, 8))]
)
def test_hard_but_honest_data_never_gives_nan(trial, truth, tmp_path):
    rng = np.random.default_rng(trial)
    corruption = {
        "noise": float(rng.choice([0.0, 0.04, 0.2])),
        "missing_points": float(rng.uniform(0, 0.9)),
        "missing_frames": float(rng.choice([0.0, 0.5])),
        "outliers": float(rng.choice([0.0, 0.4])),
    }
    seen = observation(truth, tmp_path, "joints3d" if trial % 2 else "markers3d", **corruption)
    out = tmp_path / "motion.npz"
    report = fit_files([seen], out, FitSettings(prior="pose", robust=0.1 if trial % 3 else None))
    assert not report["failed"]
    motion = load_motion(out).motion
    assert motion.rotations.isfinite().all()


def test_an_unknown_ground_is_found_under_the_feet(truth, tmp_path):
    seen = observation(truth, tmp_path, noise=0.005)
    with np.load(seen) as file:
        lifted = file["positions"] + np.array([0.0, 0.0, 3.0]) * file["visible"][..., None]
    rewritten(seen, positions=lifted, ground_known=False)
    report = fit_files([seen], tmp_path / "motion.npz", FitSettings(prior="pose"))
    assert report["noise"][0]["metres"] >= 0.01
    result = load_motion(tmp_path / "motion.npz")
    assert result.ground is not None
    assert result.joints is not None
    lowest = float(result.joints[..., 2].min())
    assert abs(lowest - float(result.ground[3])) < 0.3  # metres; the toy walker floats and tilts
    assert float(result.ground[3]) > 2


def test_one_frame_and_a_still_person(truth, tmp_path):
    seen = tmp_path / "one.npz"
    simulate_file(truth, seen, "joints3d", Corruption(), seed=1, frames=(3, 4))
    fit_files([seen], tmp_path / "motion.npz", FitSettings(prior="pose"))
    assert load_motion(tmp_path / "motion.npz").motion.frames == 1
    seen = observation(truth, tmp_path)
    with np.load(seen) as file:
        still = np.repeat(file["positions"][:1], 12, 0)
    fit_files(
        [rewritten(seen, positions=still)], tmp_path / "motion.npz", FitSettings(prior="pose")
    )
    joints = load_motion(tmp_path / "motion.npz").joints
    assert joints is not None
    assert (joints[-1] - joints[0]).norm(dim=-1).max() < 0.01  # metres


def test_failure_is_its_own_kind_of_error():
    assert issubclass(Failed, Exception)
    assert not issubclass(Failed, ValueError)


def test_an_unknown_ground_is_found_before_feet_are_judged(tmp_path):
    """A walk half a metre above z = 0, whose file does not say where the ground is."""
    with resources.as_file(resources.files("recon") / "assets" / "demo.npz") as path:
        walk = load_motion(path).motion.window(0, 40)
    up = walk.translation.new_tensor([0.0, 0.0, 0.5])
    save_motion(tmp_path / "walk.npz", walk.replace(translation=walk.translation + up))
    seen = observation(tmp_path / "walk.npz", tmp_path, noise=0.01)
    seen = rewritten(seen, ground_known=False)
    report = fit_files([seen], tmp_path / "motion.npz", FitSettings())
    assert report["ground_known"] is False
    found = load_motion(tmp_path / "motion.npz")
    assert found.ground is not None
    assert found.ground[3].item() == pytest.approx(0.5, abs=0.03)
    away = found.motion.translation - (walk.translation + up)
    assert away.norm(dim=-1).mean() < 0.05

"""Completing cycles from files: what comes out, what is refused, and when a warning is due."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from priors.anchor.prior import AnchorFrames
from recon import cli
from recon.api.cycle import SWING, swing_difference_from_textbook
from recon.body.cycles import find_cycles
from recon.body.landmarks import LANDMARKS_16
from recon.body.model import BodyModel
from recon.fitting import cycles as completion
from recon.fitting.methods import FitOptions
from recon.fitting.settings import FitSettings
from recon.fitting.stages import prior_stages
from recon.formats.motions import load_motion
from recon.formats.observations import (
    PointsFile,
    PositionsFile,
    load_observation,
    save_observation,
)
from recon.formats.scans import write_ply, write_scans
from recon.method.stages import Stage
from recon.method.terms import Term
from recon.reading.clouds import cloud_of
from recon.simulation.points import Corruption, landmarks3d, scan_points
from recon.solver.lbfgs import LBFGS
from tests.verbs import fit_files
from tests.walk_prior import one_cycle, tiny_weights

pytestmark = pytest.mark.numerics


@pytest.fixture(scope="module")
def settings(tmp_path_factory) -> FitSettings:
    path = tiny_weights(tmp_path_factory.mktemp("weights") / "anchor.safetensors")
    return FitSettings(prior="anchor", weights=str(path))


@pytest.fixture(autouse=True)
def _quick(monkeypatch) -> None:  # pyright: ignore[reportUnusedFunction]
    """Few beginnings and few steps: the prior of these tests knows little else than the truth."""
    monkeypatch.setattr(completion, "TRIED", 2)
    monkeypatch.setattr(completion, "KEPT", 1)
    search = AnchorFrames.search

    def some(self: AnchorFrames, data: tuple[Term, ...], noise: float) -> tuple[Stage, ...]:
        return tuple(replace(stage, minimiser=LBFGS(10)) for stage in search(self, data, noise))

    monkeypatch.setattr(AnchorFrames, "search", some)


@pytest.fixture(scope="module")
def scans() -> PointsFile:
    return scan_points(one_cycle(), BodyModel.load(), Corruption(noise=0.005), 0, points=60)


def markers(path: Path, motion=None) -> Path:
    """Sixteen landmarks of a cycle."""
    seen = landmarks3d(
        one_cycle() if motion is None else motion, BodyModel.load(), Corruption(), 0
    )
    file = PositionsFile(
        kind="markers3d",
        positions=seen.positions.double().numpy(),
        visible=seen.visible.numpy(),
        names=LANDMARKS_16,
        fps=seen.fps,
    )
    save_observation(path, file)
    return path


def error(out: Path) -> float:
    """Mean distance of joints from the truth, metres."""
    found = load_motion(out)
    truth = one_cycle(found.motion.fps)
    both = min(found.motion.frames, truth.frames)
    assert found.joints is not None
    joints = BodyModel.load().pose(truth).joints
    return float((found.joints[:both] - joints[:both]).norm(dim=-1).mean())


def test_landmarks_are_completed_from_the_command_line(settings, tmp_path, capsys):
    seen, out = markers(tmp_path / "seen.npz"), tmp_path / "out.npz"
    line = ["complete", str(seen), "--out", str(out), "--prior", "anchor"]
    line += ["--weights", settings.weights, "--json"]
    assert cli.run(line) == cli.OK
    report = json.loads(capsys.readouterr().out)
    written = json.loads((tmp_path / "out.npz.json").read_text())
    assert report == {name: written[name] for name in report}
    assert error(out) < 0.04  # metres
    cycle = report["cycle"]
    assert cycle["seconds"] == pytest.approx((one_cycle().frames - 1) / 30, abs=0.04)
    assert 0 <= cycle["code_distance"] < 2
    assert cycle["residual_mm"][0] < 30
    assert not cycle["details"]
    assert report["warnings"] == []
    assert load_motion(out).motion.fps == 30
    assert cli.run([*line[:4], "--prior", "pose"]) == cli.BAD_INPUT
    assert "recon fit --prior pose" in capsys.readouterr().err
    assert cli.run([*line[:4], "--weights", settings.weights, "--overwrite"]) == cli.BAD_INPUT
    assert "expected humor weights, but it holds 'anchor'" in capsys.readouterr().err


def test_a_folder_of_few_scans_at_odd_times_named_in_any_order(settings, scans, tmp_path):
    folder, last = tmp_path / "scans", int(scans.frame.max())
    folder.mkdir()
    some = [0, 3, 4, 11, last // 2, last - 5, last]
    lines = []
    for name, frame in zip("gbcdaef", some, strict=True):
        write_ply(folder / f"{name}.ply", 1000 * scans.points[scans.frame == frame])
        lines.append(f"{name}.ply,{frame / 30 + 0.004 * (frame % 2):.4f}")
    (folder / "times.csv").write_text("\n".join(lines))
    out = tmp_path / "out.npz"
    report = fit_files([folder], out, settings)
    assert any("another order" in line for line in report["read"])
    assert any("unit is mm" in line for line in report["read"])
    assert report["cycle"]["moments_seen"] == 7
    assert error(out) < 0.06  # metres
    assert load_motion(out).motion.fps >= 30
    lines[0] = lines[0].replace("g.ply", "g.ply").rsplit(",")[0] + "," + lines[1].rsplit(",")[1]
    (folder / "times.csv").write_text("\n".join(lines))
    with pytest.raises(ValueError, match="no two alike"):
        fit_files([folder], out, settings)


def test_floor_and_furniture_are_no_person(settings, scans, tmp_path):
    g, frames = np.random.default_rng(0), int(scans.frame.max()) + 1
    where = scans.points.mean(0) * (1, 1, 0)
    floor = g.uniform((-2, -2, -0.003), (2, 2, 0.003), (60 * frames, 3)) + where
    box = g.uniform((1.2, -0.3, 0), (1.7, 0.3, 0.8), (20 * frames, 3)) + where

    def with_clutter(*things: np.ndarray, up: float = 0.0) -> PointsFile:
        clutter = np.concatenate(things)
        return replace(
            scans,
            points=np.concatenate([scans.points, clutter]) + np.array([0.0, 0.0, up]),
            frame=np.concatenate([scans.frame, np.resize(np.arange(frames), len(clutter))]),
        )

    save_observation(tmp_path / "seen.npz", with_clutter(floor, box))
    fit_files([tmp_path / "seen.npz"], tmp_path / "out.npz", settings)
    assert error(tmp_path / "out.npz") < 0.05  # metres
    alone = cloud_of(with_clutter(box), BodyModel.load()).cloud.present.sum()
    assert alone == pytest.approx(len(scans.points), rel=0.05)
    assert cloud_of(scans, BodyModel.load()).cloud.present.sum() == len(scans.points)
    save_observation(tmp_path / "low.npz", with_clutter(floor, up=-1.0))
    with pytest.raises(ValueError, match=r"ground at z = -1\.00 m"):
        fit_files([tmp_path / "low.npz"], tmp_path / "no.npz", settings)


def test_one_cycle_is_cut_out_of_a_longer_recording(settings, tmp_path):
    seen, out = markers(tmp_path / "seen.npz"), tmp_path / "out.npz"
    file = load_observation(seen)
    assert isinstance(file, PositionsFile)
    long = replace(
        file,
        positions=np.concatenate([file.positions] * 5),
        visible=np.concatenate([file.visible] * 5),
    )
    save_observation(seen, long)
    with pytest.raises(ValueError, match="--between"):
        fit_files([seen], out, settings)
    begin, end = len(file.visible) / 30, (2 * len(file.visible) - 1) / 30
    fit_files([seen], out, replace(settings, between=(begin, end)))
    motion = load_motion(out).motion
    assert motion.start_time == pytest.approx(begin)
    assert motion.frames == len(file.visible)
    for between, message in (((1.0, 1.0), "rising"), ((90.0, 91.0), "nothing was seen")):
        with pytest.raises(ValueError, match=message):
            fit_files([seen], out, replace(settings, between=between))


def test_too_little_is_refused_and_little_is_said(settings, scans, tmp_path):
    seen, out = tmp_path / "seen.npz", tmp_path / "out.npz"
    last = int(scans.frame.max())

    def only(*frames: int) -> Path:
        kept = np.isin(scans.frame, frames)
        save_observation(seen, replace(scans, points=scans.points[kept], frame=scans.frame[kept]))
        return seen

    with pytest.raises(ValueError, match="at most one frame has data"):
        fit_files([only(last)], out, settings)
    with pytest.raises(ValueError, match=r"one gait cycle, 0\.3 to 3 s"):
        fit_files([only(0, 1, 2)], out, settings)
    assert not out.exists()
    report = fit_files([only(0, last)], out, settings)
    assert any("2 moments only" in one["message"] for one in report["warnings"])
    folder = tmp_path / "one"
    folder.mkdir()
    with pytest.raises(ValueError, match="folder is empty"):
        fit_files([folder], out, replace(settings, frame_rate=30.0))
    write_ply(folder / "0.ply", scans.points[scans.frame == 0])
    (folder / "times.csv").write_text("0.0\n")
    with pytest.raises(ValueError, match="a single scan has no motion"):
        fit_files([folder], out, settings)


def test_a_folder_is_completed_like_the_file_it_was_written_from(settings, scans, tmp_path):
    write_scans(tmp_path / "scans", scans)
    fit_files([tmp_path / "scans"], tmp_path / "out.npz", settings)
    assert error(tmp_path / "out.npz") < 0.05  # metres


def test_somebody_who_stands_is_out_of_domain(settings, tmp_path):
    walk = one_cycle()
    still = walk.replace(
        translation=walk.translation[:1].expand_as(walk.translation),
        rotations=walk.rotations[:1].expand_as(walk.rotations),
    )
    seen = markers(tmp_path / "still.npz", still)
    report = fit_files([seen], tmp_path / "out.npz", settings)
    assert any("no cycle of gait" in one["message"] for one in report["warnings"])


def test_hips_tell_cycles_of_gait():
    walk = one_cycle()
    assert len(find_cycles(walk)) > 0
    gait = swing_difference_from_textbook(walk)
    assert gait is not None
    assert gait < SWING / 2
    half = swing_difference_from_textbook(walk.window(0, walk.frames // 2))
    assert half is None or half > SWING
    backwards = swing_difference_from_textbook(
        walk.replace(rotations=walk.rotations[:1].expand_as(walk.rotations))
    )
    assert backwards is None or backwards > SWING


def test_the_prior_has_a_way_of_its_own():
    with pytest.raises(ValueError, match="recon complete"):
        prior_stages(FitOptions(prior="anchor"), 0.01, BodyModel.load())


def test_physics_is_refused_rather_than_left_out():
    with pytest.raises(ValueError, match="without physics"):
        completion.complete([], FitOptions(prior="anchor", physics=1.0), BodyModel.load())

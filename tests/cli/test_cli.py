"""The command line as a shell would call it: every verb, its files, its exit codes."""

import json
import subprocess
import sys
from importlib import resources
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import recon
from recon import cli
from recon.formats.motions import load_motion, save_motion

EMPTY = str(Path(__file__).with_name("__init__.py"))
"""A file without any line."""


@pytest.fixture(scope="module")
def clip(tmp_path_factory) -> Path:
    """Half a second of the bundled clip."""
    with resources.as_file(resources.files("recon") / "assets" / "demo.npz") as path:
        motion = load_motion(path).motion.window(30, 45)
    target = tmp_path_factory.mktemp("clip") / "truth.npz"
    save_motion(target, motion)
    return target


def recon_(*arguments: object) -> int:
    return cli.run([str(argument) for argument in arguments])


def test_simulate_fit_evaluate_view_export_info(clip, tmp_path, capsys):
    seen, out = tmp_path / "seen.npz", tmp_path / "motion.npz"
    kind = ("--kind", "markers3d", "--noise", 0.01, "--hide-below", 0.9, "--seed", 3)
    assert recon_("simulate", clip, seen, *kind) == cli.OK
    assert recon_("fit", seen, "--out", out, "--json") == cli.OK
    report = json.loads(capsys.readouterr().out)
    names = ["limbs", "contacts"]  # the checks have placed the person already
    assert [stage["name"] for stage in report["stages"]] == names
    metrics = tmp_path / "metrics.json"
    assert recon_("evaluate", out, clip, "--obs", seen, "--json", metrics) == cli.OK
    found = json.loads(metrics.read_text())
    assert found["observed_visible"] < 0.05  # metres
    assert found["joints_hidden"] is not None
    page, picture = tmp_path / "m.html", tmp_path / "m.png"
    view = ("--obs", seen, "--compare", clip, "--html", page, "--png", picture)
    assert recon_("view", out, *view) == cli.OK
    assert page.stat().st_size > 100_000
    targets = (
        "--glb",
        tmp_path / "m.glb",
        "--bvh",
        tmp_path / "m.bvh",
        "--trc",
        tmp_path / "m.trc",
    )
    assert recon_("export", out, *targets, "--ply", tmp_path / "ply") == cli.OK
    assert len(list((tmp_path / "ply").glob("*.ply"))) == 15
    for file in (clip, seen, tmp_path / "m.bvh", tmp_path / "m.trc"):
        capsys.readouterr()
        assert recon_("info", file, "--json") == cli.OK
        assert json.loads(capsys.readouterr().out)["fps"] == 30


def test_one_camera_from_simulate_to_evaluate(clip, tmp_path, capsys):
    seen, out = tmp_path / "seen.npz", tmp_path / "motion.npz"
    film = ("--camera", "side", "--layout", "coco17", "--noise", 2, "--unknown-ground")
    assert recon_("simulate", clip, seen, "--kind", "keypoints2d", *film) == cli.OK
    capsys.readouterr()
    assert recon_("fit", seen, "--out", out, "--prior", "pose") == cli.OK
    shown = capsys.readouterr()
    assert shown.out == ""
    stages = [line for line in shown.err.splitlines() if "iterations" in line]
    assert [line.split()[0] for line in stages] == ["pose"]
    assert all(len(line) < 100 and "…" not in line for line in stages)
    assert recon_("evaluate", out, clip, "--obs", seen) == cli.OK
    found = json.loads(capsys.readouterr().out)
    assert found["ground_normal"] < 0.3  # radians
    assert found["root_joints_all"] < 0.15  # metres
    with np.load(out) as file:
        assert file["in_camera"].shape == (15, 6)


def test_what_was_assumed_and_what_is_wrong_is_said(clip, tmp_path, capsys, monkeypatch):
    """A stand-in for the fit: only what is shown of its report matters here."""
    report = {
        "read": ["view a: camera b"],
        "repairs": [{"message": "a: zeros were left out"}],
        "warnings": [{"message": "a: check the focal length"}],
        "failed": False,
        "stages": [
            {"name": "pose", "iterations": 3, "seconds": 0.1, "termination": "converged",
             "energies": {"data": 1.0, "pose": 0.5}},
        ],
    }  # fmt: skip
    result = SimpleNamespace(report=lambda *_: report, save=lambda *_, **__: None, tables={})
    monkeypatch.setattr("recon.api.fit.fit", lambda *_, **__: result)
    seen = tmp_path / "seen.npz"
    assert recon_("simulate", clip, seen, "--kind", "joints3d") == cli.OK
    capsys.readouterr()
    assert recon_("fit", seen, "--out", tmp_path / "o.npz", "--json") == cli.OK
    shown = capsys.readouterr()
    assert json.loads(shown.out) == report
    assert "view a: camera b" in shown.err
    assert "repaired: a: zeros were left out" in shown.err
    assert "warning: a: check the focal length" in shown.err
    assert "total 1.5: converged" in shown.err
    report["failed"] = True
    assert recon_("fit", seen, "--out", tmp_path / "o.npz") == cli.FAILED
    assert "converged" in capsys.readouterr().err


def test_an_exported_skeleton_converts_back(clip, tmp_path, capsys):
    assert recon_("export", clip, "--bvh", tmp_path / "m.bvh") == cli.OK
    assert recon_("convert", tmp_path / "m.bvh", tmp_path / "back.npz", "--json") == cli.OK
    assert json.loads(capsys.readouterr().out)["residual_mm"] < 10
    assert load_motion(tmp_path / "back.npz").motion.frames == 15


def test_simulate_takes_a_part_at_another_rate(clip, tmp_path, capsys):
    seen = tmp_path / "seen.npz"
    options = ("--frames", "3:12", "--fps", 60, "--unknown-ground")
    assert recon_("simulate", clip, seen, "--kind", "joints3d", *options) == cli.OK
    with np.load(seen) as file:
        assert file["positions"].shape == (17, 22, 3)
        assert file["fps"] == 60
        assert not file["ground_known"]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("fit", "nowhere.npz", "--out", "out.npz"), "nowhere.npz"),
        (("fit", "--out", "out.npz"), "nothing to fit"),
        (("fit", ".", "--out", "../out.npz"), "the folder is empty"),
        (("fit", __file__, "--out", "out.npz"), "an observation"),
        (("info", "nowhere.bvh"), "nowhere.bvh"),
        (("info", "."), "expected a folder of"),
        (("view", __file__), "--html"),
        (("export", __file__), "--glb"),
        (("convert", "nowhere.c3d", "out.npz"), "nowhere.c3d"),
        (("batch", "nowhere.jsonl", "--out", "out"), "nowhere.jsonl"),
        (("batch", EMPTY, "--out", "out"), "got no line"),
        (("simulate", __file__, "o.npz", "--kind", "joints3d", "--frames", "9:3"), "A:B"),
        (("simulate", __file__, "o", "--kind", "depth", "--during", 2, 1), "A < B"),
        (("sample", "--out", "a.npz", "--temperature", -1), "temperature: expected a number"),
    ],
)
def test_bad_input_is_exit_code_2_and_a_sentence(arguments, words, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert recon_(*arguments) == cli.BAD_INPUT
    assert words in capsys.readouterr().err
    assert list(tmp_path.iterdir()) in ([], [tmp_path / "out"])


def test_a_shard_is_one_of_several(tmp_path, capsys):
    manifest = tmp_path / "clips.jsonl"
    manifest.write_text('{"id": "a", "observations": "a.npz"}')
    assert recon_("batch", manifest, "--out", tmp_path / "out", "--shard", "2") == cli.BAD_INPUT
    assert "--shard" in capsys.readouterr().err


def test_an_unknown_option_is_refused(capsys):
    with pytest.raises(SystemExit) as exit_:
        recon_("fit", "a.npz", "--out", "b.npz", "--priro", "pose")
    assert exit_.value.code == 2
    assert "priro" in capsys.readouterr().err


def test_importing_recon_loads_nothing_heavy():
    heavy = "torch", "numpy", "scipy", "cv2", "viser", "sklearn"
    code = f"import recon, recon.cli.listing, sys; print([m for m in {heavy} if m in sys.modules])"
    answer = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    assert answer.stdout.strip() == "[]"


def test_public_names_exist():
    for name in recon.__dir__():
        assert getattr(recon, name) is not None
    with pytest.raises(AttributeError, match="no attribute 'frobnicate'"):
        _ = recon.frobnicate


@pytest.mark.parametrize("words", ["OUT", "--out OUT", "--out=OUT"])
def test_an_output_is_named_by_its_place_or_by_an_option(tmp_path, words):
    """`recon convert` took no --out, `recon fit` nothing else."""
    out = tmp_path / "seen.npz"
    with resources.as_file(resources.files("recon") / "assets" / "demo.npz") as motion:
        before, after = ([], [str(motion)]) if "-" in words else ([str(motion)], [])
        said = words.replace("OUT", str(out)).split(" ")
        assert recon_("simulate", *before, *said, *after, "--kind", "joints3d") == cli.OK
    assert out.is_file()

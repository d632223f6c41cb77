"""`recon bench`: everybody sees the same, anything may be judged, and what is wrong is named."""

import json
from pathlib import Path

import numpy as np
import pytest

import recon
from recon import cli
from recon.benchmark.dataset import Splits
from recon.benchmark.judged import bench, write_windows
from recon.benchmark.methods import BUILT_IN, method_named
from recon.benchmark.protocols import (
    GAP,
    PROTOCOLS,
    noise_of,
    protocol_named,
    seen_windows,
)
from recon.benchmark.windows import FRAMES, bench_windows, with_freely_licensed_windows
from recon.core.errors import ReconError
from recon.formats.motions import save_motion
from recon.formats.observations import load_observation

BODY = recon.BodyModel.load()
WINDOWS, _, _ = bench_windows(None, "test", None, None, BODY)
SEEN = {name: seen_windows(own, WINDOWS, BODY) for name, own in PROTOCOLS.items()}


class Knows:
    """A method that was told the truth, in one of the ways in which methods may answer."""

    def __init__(self, protocol: str, answer: str) -> None:
        self.windows, self.answer, self.calls = SEEN[protocol], answer, 0

    def __call__(self, seen):
        window = self.windows[self.calls]
        np.testing.assert_array_equal(seen.positions, window.seen.positions)
        self.calls += 1
        joints = BODY.pose(window.truth).joints.numpy()
        if self.answer == "motion":
            return window.truth
        if self.answer == "joints":
            return joints + 0.01
        return {"joints": joints, "points": window.points.numpy() + 0.02}


class Zeros:
    """A class as somebody else would name it on the command line."""

    def __call__(self, seen):
        return np.zeros((len(seen.positions), 22, 3))


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_the_truth_has_no_error_and_every_built_in_is_named(protocol):
    table = bench(protocol, {"knows": Knows(protocol, "motion")})
    metric = next(iter(PROTOCOLS[protocol].columns))
    found = table.mean("knows", metric)
    assert found is not None
    assert found.mean == pytest.approx(0.0, abs=1e-6)
    assert table.feet["knows"] == table.feet["truth"] == 1.0
    assert set(table.rows()) == {"knows", "truth"}
    assert {"pose", "collocation", "rollout", "butterworth"} <= set(BUILT_IN)


def test_joints_alone_and_points_beside_them_are_judged():
    joints = bench("noisy-joints", {"own": Knows("noisy-joints", "joints")})
    found = joints.mean("own", "joints_all")
    assert found is not None
    assert found.mean == pytest.approx(0.01 * 3**0.5, rel=1e-4)
    assert joints.feet["own"] is None
    assert joints.rows()["own"]["joints cm"] == "1.73"  # no interval: it is one clip
    assert {"w_mpjpe", "wa_mpjpe", "rte", "jitter", "foot_sliding"} <= set(joints.values["own"])
    points = bench("hidden-points", {"own": Knows("hidden-points", "points")})
    hidden = points.mean("own", "observed_hidden")
    assert hidden is not None
    assert hidden.mean == pytest.approx(0.02 * 3**0.5, rel=1e-4)


def test_what_is_seen_is_what_the_protocols_say():
    first = {name: windows[0] for name, windows in SEEN.items()}
    noisy = first["noisy-joints"]
    error = noisy.seen.positions - noisy.points.numpy()
    assert error.std() == pytest.approx(0.04, rel=0.05)
    assert noise_of(noisy.seen) == pytest.approx(0.04)
    hidden = first["hidden-points"].seen
    assert (hidden.positions[hidden.visible][:, 2] >= 0.9).all()
    assert not hidden.visible.all()
    assert noise_of(hidden) == 0
    assert not first["gap"].seen.visible[slice(*GAP)].any()
    assert GAP == (15, 45)
    assert first["upper-body"].seen.positions.shape[1] == 14
    # a window's noise does not depend on which other windows there are
    alone = WINDOWS.take([1])
    (again,) = seen_windows(protocol_named("noisy-joints"), alone, BODY)
    np.testing.assert_array_equal(again.seen.positions, SEEN["noisy-joints"][1].seen.positions)


def test_smoothers_are_nearer_than_the_data_and_the_pose_prior_is_nearer_still():
    methods = ("linear", "least-squares", "pose")
    table = bench("noisy-joints", methods, only=1)
    errors = [table.values[name]["joints_all"][0] for name in methods]
    assert errors == sorted(errors, reverse=True)
    assert len(table.names) == 1
    assert "1 of the windows only" in table.source
    assert all(value is not None and value > 0 for value in table.values["pose"]["seconds"])
    with pytest.raises(ReconError, match="all 22 joints"):
        bench("upper-body", ("butterworth",))


def test_predictions_from_files_are_judged_as_methods_are(tmp_path):
    files = write_windows("gap", tmp_path / "seen")
    assert [path.name for path in files] == ["16_32@0.00.npz", "16_32@2.00.npz"]
    for path, window in zip(files, SEEN["gap"], strict=True):
        np.testing.assert_array_equal(load_observation(path).positions, window.seen.positions)
    own, motions = tmp_path / "own", tmp_path / "motions"
    own.mkdir(), motions.mkdir()
    for window in SEEN["gap"]:
        joints = BODY.pose(window.truth).joints.numpy()
        np.savez(own / window.file_name, joints=joints + 0.01)
        save_motion(motions / window.file_name, window.truth)
    table = bench("gap", predictions=[own, motions])
    for name, error in (("own", 0.01 * 3**0.5), ("motions", 0.0)):
        found = table.mean(name, "joints_all")
        assert found is not None
        assert found.mean == pytest.approx(error, abs=1e-5)
    (own / SEEN["gap"][1].file_name).unlink()
    with pytest.raises(FileNotFoundError, match=r"16_32@2.00.npz: expected a prediction"):
        bench("gap", predictions=[own])


@pytest.mark.parametrize(
    ("answer", "said"),
    [
        (np.zeros((59, 22, 3)), r"expected joints of shape \(60, 22, 3\)"),
        (np.full((60, 22, 3), np.nan), "NaN"),
        ({"points": np.zeros((60, 22, 3))}, "expected joints"),
        ("nowhere.npz", "nowhere"),
        (7, "expected a recon.Motion"),
        (SEEN["gap"][0].truth.window(0, 30), "expected 60 frames at 30 Hz, got 30"),
    ],
)
def test_answers_of_no_use_are_refused_by_name(answer, said):
    with pytest.raises((ReconError, FileNotFoundError), match=said):
        bench("gap", {"own": lambda _: answer}, only=1)


def test_unknown_names_are_answered_with_those_there_are():
    with pytest.raises(ReconError, match="there are noisy-joints"):
        bench("noise", ("pose",))
    with pytest.raises(ReconError, match="there are linear"):
        bench("gap", ("possum",))
    with pytest.raises(ReconError, match="cannot be imported"):
        method_named("no_such_module:Mine", BODY)
    with pytest.raises(ReconError, match="expected different names of methods"):
        bench("gap", {"truth": Zeros()})


def corpus_of(folder: Path) -> Path:
    """Two clips of one listed test person, and what is needed of the splits."""
    for name in ("07_01", "07_02"):
        save_motion(folder / f"{name}.npz", recon.load_motion(SOURCE_CLIP).motion)
    (folder / "splits.toml").write_text(
        """
        subjects = {}
        test = {subjects = ["07"]}
        validation = {subjects = [], every_tenth = []}
        licence = {non_commercial = []}
        excluded = {clips = []}
        windows = {test = {60 = [["07_01", 0.0], ["07_02", 1.0]]}}
        """
    )
    return folder


SOURCE_CLIP = Path(recon.__file__).parent / "assets" / "demo.npz"


def test_a_folder_of_motions_gives_intervals_over_its_clips(tmp_path):
    corpus = corpus_of(tmp_path)
    table = bench("noisy-joints", ("linear",), corpus, splits=corpus / "splits.toml")
    assert table.names == ("07_01@0.00", "07_02@1.00")
    assert table.source == "test part, 2 windows, means over 07"
    assert "[" in table.rows()["linear"]["joints cm"]
    with pytest.raises(ReconError, match=r"test clips are missing there: .*07_03.* and others"):
        bench("noisy-joints", ("linear",), corpus)


def test_the_committed_windows_are_of_freely_licensed_clips_alone():
    splits = Splits.load()
    assert not all(splits.has_open_licence(clip) for clip, _ in splits.windows["test"][FRAMES])
    free = with_freely_licensed_windows(splits, "test").windows["test"][FRAMES]
    assert {splits.subject(clip) for clip, _ in free} == {"07", "49", "16"}
    assert len(free) == 46


def test_the_command_judges_a_class_of_the_current_folder(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend("")
    text = "import numpy\nclass Mine:\n    def __call__(self, seen):\n"
    (tmp_path / "own_bench.py").write_text(text + "        return numpy.ones((60, 22, 3))\n")
    line = ["bench", "gap", "--only", "1", "--method", "own_bench:Mine", "linear"]
    assert cli.run([*line, "--json", "found.json"]) == cli.OK
    found = json.loads((tmp_path / "found.json").read_text())
    assert set(found["methods"]) == {"own_bench:Mine", "linear", "truth"}
    assert found["windows"]["names"] == ["16_32@0.00"]
    assert found["methods"]["linear"]["mean"]["joints_all"]["mean"] > 0
    assert cli.run(["bench", "gap", "--write", "seen", "--method", "linear"]) == cli.BAD_INPUT
    assert "--write writes observations only" in capsys.readouterr().err

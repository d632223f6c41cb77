"""`recon retarget` as a shell would call it; a stand-in takes the place of the trained prior."""

import json
import math
from pathlib import Path

import pytest
import torch

from recon import cli
from recon.body.identities import identity
from recon.body.model import BodyModel
from recon.body.motion_files import with_shape
from recon.core.motion import Motion, MotionFile
from recon.formats.motions import load_motion, save_motion
from tests.standing_body import path, standing, times

BODY = BodyModel.load()
EXACT = BODY.to(dtype=torch.float64)


def recon_(*arguments: object) -> int:
    return cli.run([str(argument) for argument in arguments])


def stand(seconds: float = 1.2, fps: float = 30.0, z: float = 0.0) -> Motion:
    at = times(seconds, fps)
    sway = 0.05 * torch.sin(2 * math.pi * at)
    return standing(EXACT, path(sway, z, like=at), fps).to(dtype=torch.float32)


def save(file: Path, motion: Motion, ground: list[float] | None = None) -> Path:
    plane = None if ground is None else torch.tensor(ground)
    save_motion(file, MotionFile(motion, BODY.name, BODY.checksum, ground=plane))
    return file


@pytest.fixture(autouse=True)
def _stand_in(monkeypatch) -> None:  # pyright: ignore[reportUnusedFunction]
    """The path scaled to the legs, soles where they were."""

    def retargeted(motion, shape, body, method, weights):
        return with_shape(motion, body, shape)

    monkeypatch.setattr("recon.api.retarget._retargeted", retargeted)


def test_another_body_does_the_same(tmp_path: Path, capsys) -> None:
    clip = save(tmp_path / "a.npz", stand().replace(start_time=2.0))
    out = tmp_path / "new" / "b.npz"
    ask = ("retarget", clip, "--out", out, "--shape", "height=1.8,weight=75", "--json")
    assert recon_(*ask) == cli.OK
    shown = capsys.readouterr()
    report = json.loads(shown.out)
    assert report.items() <= json.loads(out.with_name("b.npz.json").read_text()).items()
    assert report["target"]["height"] == pytest.approx(1.8, abs=1e-3)
    assert report["target"]["weight"] == pytest.approx(75, abs=0.1)
    assert report["rotation_change"] < 1e-3
    assert report["windows"] == [0]
    assert report["warnings"] == []
    # the copy keeps the path of the unposed origin, from which soles of longer legs are farther
    assert report["physics"]["copy"]["penetrate"] > 0.03  # metres
    assert report["physics"]["retargeted"]["penetrate"] < 0.006
    assert "penetrate, cm" in shown.err
    made, source = load_motion(out), load_motion(clip)
    assert (made.motion.frames, made.motion.fps, made.motion.start_time) == (37, 30, 2)
    assert made.checksum == BODY.checksum
    torch.testing.assert_close(made.motion.rotations, source.motion.rotations)
    assert made.joints is not None
    torch.testing.assert_close(made.joints, BODY.pose(made.motion).joints, atol=1e-5, rtol=0)


@pytest.mark.parametrize("fps", [12.0, 30.0, 120.0])
def test_any_rate_goes_in_and_comes_out(fps, tmp_path: Path, capsys) -> None:
    clip = save(tmp_path / "a.npz", stand(fps=fps))
    ask = ("retarget", clip, "--shape", "tall", "--out")
    assert recon_(*ask, tmp_path / "b.npz") == cli.OK
    warned = " ".join(capsys.readouterr().err.split())
    assert ("12 frames per second, the prior 20" in warned) == (fps == 12)
    assert load_motion(tmp_path / "b.npz").motion.fps == fps
    assert recon_(*ask, tmp_path / "c.npz", "--fps", 60) == cli.OK
    assert load_motion(tmp_path / "c.npz").motion.fps == 60


def test_a_shape_may_begin_with_a_minus_or_be_somebodys(tmp_path: Path) -> None:
    clip = save(tmp_path / "a.npz", stand())
    assert recon_("retarget", clip, "--out", tmp_path / "b.npz", "--shape=-1,0.5") == cli.OK
    short = load_motion(tmp_path / "b.npz").motion.shape
    torch.testing.assert_close(short, identity("-1,0.5", BODY))
    ask = ("retarget", clip, "--out", tmp_path / "c.npz", "--shape", tmp_path / "b.npz")
    assert recon_(*ask) == cli.OK
    assert torch.equal(load_motion(tmp_path / "c.npz").motion.shape, short)


@pytest.mark.parametrize(
    ("lift", "ground", "option"),
    [
        (0.4, [0.0, 0.0, 1.0, 0.4], ()),
        (0.4, None, ("--ground", 0.4)),
        (-0.9, None, ("--ground", -0.9)),
        (0.4, [0.0, 0.0, 1.0, 0.0], ("--ground", 0.4)),
    ],
)
def test_a_ground_elsewhere_stays_there(lift, ground, option, tmp_path: Path, capsys) -> None:
    clip = save(tmp_path / "a.npz", stand(z=lift), ground)
    ask = ("retarget", clip, "--shape", "tall", "--out", tmp_path / "b.npz", "--json", *option)
    assert recon_(*ask) == cli.OK
    report = json.loads(capsys.readouterr().out)
    assert (report["ground"], report["warnings"]) == (pytest.approx(lift), [])
    made = load_motion(tmp_path / "b.npz")
    assert made.ground is not None
    assert float(made.ground[3]) == pytest.approx(lift)
    sole = float(BODY.pose(made.motion).vertices[..., 2].amin())
    assert sole == pytest.approx(lift, abs=0.006)
    assert made.contacts is not None
    assert made.contacts[:, 7:9].any()


def test_a_body_without_ground_is_refused_or_warned_about(tmp_path: Path, capsys) -> None:
    ask = ("--shape", "man", "--out", tmp_path / "b.npz")
    lost = save(tmp_path / "a.npz", stand(z=0.8))
    assert recon_("retarget", lost, *ask) == cli.BAD_INPUT
    words = " ".join(capsys.readouterr().err.split())
    assert "0.80 m above it" in words
    assert "`ground`: 0.80" in words
    assert not (tmp_path / "b.npz").exists()
    assert recon_("retarget", lost, *ask, "--ground", 0) == cli.OK
    assert "never comes within 5 cm of the ground" in " ".join(capsys.readouterr().err.split())
    sunk = save(tmp_path / "c.npz", stand(z=-0.3), [0.0, 0.0, 1.0, 0.0])
    assert recon_("retarget", sunk, *ask) == cli.OK
    assert "0.30 m below it" in " ".join(capsys.readouterr().err.split())


def test_implausible_bodies_and_rates_are_warned_about(tmp_path: Path, capsys) -> None:
    fast = stand(seconds=1.2, fps=30.0)
    path = fast.translation.clone()
    path[:, 0] = torch.arange(len(path)) * 0.6
    clip = save(tmp_path / "a.npz", fast.replace(translation=path))
    assert recon_("retarget", clip, "--shape", "height=2.1", "--out", tmp_path / "b.npz") == cli.OK
    words = " ".join(capsys.readouterr().err.split())
    assert "18 m/s; check that 30 is its frame rate" in words
    assert "shape height=2.1: the body is 2.10 m tall" in words


@pytest.mark.parametrize(
    ("name", "options", "words"),
    [
        ("good", ("--shape", "blue"), "'blue' is not known"),
        ("good", ("--shape", "height=180"), "metres"),
        ("good", ("--shape", "nobody.npz"), "nobody.npz"),
        ("good", ("--shape", "0", "--fps", 0), "fps: expected"),
        ("good", ("--shape", "0", "--ground", "nan"), "ground: expected"),
        ("short", ("--shape", "0"), "got 0.93 s"),
        ("one", ("--shape", "0"), "two frames or more"),
        ("tilted", ("--shape", "0"), "not level"),
        ("other", ("--shape", "0"), "--body"),
        ("nowhere", ("--shape", "0"), "nowhere.npz"),
    ],
)
def test_bad_input_is_refused_and_nothing_is_written(
    name, options, words, tmp_path: Path, capsys
) -> None:
    motion = stand()
    save(tmp_path / "good.npz", motion)
    save(tmp_path / "short.npz", stand(seconds=0.9))
    save(tmp_path / "one.npz", motion.window(0, 1).replace(fps=1.0))
    save(tmp_path / "tilted.npz", motion, [0.1, 0.0, 1.0, 0.0])
    save_motion(tmp_path / "other.npz", MotionFile(motion, body="mine", checksum="0123"))
    files = set(tmp_path.iterdir())
    ask = ("retarget", tmp_path / f"{name}.npz", "--out", tmp_path / "out.npz", *options)
    assert recon_(*ask) == cli.BAD_INPUT
    assert words in capsys.readouterr().err
    assert set(tmp_path.iterdir()) == files

"""Motions of another body: shape coefficients mean nothing on this one, so they are refused."""

from pathlib import Path

import numpy as np
import pytest
import torch

from recon import cli
from recon.body.model import BodyModel
from recon.body.motion_files import load_motion_of
from recon.core.motion import Motion, MotionFile
from recon.formats.motions import load_motion, save_motion
from tests.formats.test_smpl_files import model

BODY = BodyModel.load()


def _motion(shape: int = 10) -> Motion:
    return Motion.create(
        torch.zeros(8, 3), torch.eye(3).expand(8, 22, 3, 3), torch.ones(shape), 30.0
    )


def _own(folder: Path) -> Path:
    path = folder / "own.npz"
    save_motion(path, MotionFile(_motion(), body=BODY.name, checksum=BODY.checksum))
    return path


def _foreign(folder: Path) -> Path:
    path = folder / "foreign.npz"
    save_motion(path, MotionFile(_motion(), body="somebody", checksum="0123456789abcdef"))
    return path


def _of_amass(folder: Path) -> Path:
    path = folder / "amass.npz"
    np.savez(
        path, trans=np.zeros((8, 3)), poses=np.zeros((8, 156)), betas=np.ones(16),
        gender="male", mocap_framerate=30.0, dmpls=np.zeros((8, 8)),
    )  # fmt: skip
    return path


VERBS = (
    "export {m} --bvh {out}.bvh",
    "export {m} --html {out}.html",
    "simulate {m} {out}.npz --kind joints3d",
    "view {m} --html {out}.html",
    "view {own} --compare {m} --html {out}.html",
    "view {own} --beside {m} --html {out}.html",
    "evaluate {m} {own} --json {out}.json",
    "evaluate {own} {m} --json {out}.json",
    "retarget {m} --shape tall --out {out}.npz",
    "predict {m} --out {out}.npz",
    "interpolate {own} {m} --out {out}.npz",
)


@pytest.mark.parametrize("verb", VERBS)
@pytest.mark.parametrize("make", [_foreign, _of_amass])
def test_verbs_refuse_motions_of_another_body(verb, make, tmp_path, capsys):
    """Some verbs drew, exported and measured them as if they were of the bundled body."""
    motion, own, out = make(tmp_path), _own(tmp_path), tmp_path / "out"
    line = [word.format(m=motion, own=own, out=out) for word in verb.split()]
    assert cli.run(line) == 2
    said = " ".join(capsys.readouterr().err.split())
    assert motion.name in said
    assert "made with the body somebody" in said or "does not name its body" in said
    assert "--body" in said or "bundled body only" in said
    assert list(tmp_path.glob("out*")) == []


def test_the_function_refuses_them_too(tmp_path):
    for make in (_foreign, _of_amass):
        with pytest.raises(ValueError, match="body"):
            load_motion_of(make(tmp_path), BODY)
    ours = load_motion_of(_own(tmp_path), BODY.to(dtype=torch.float64)).motion
    assert ours.shape.shape == (BODY.shape_size,)
    assert ours.translation.dtype == torch.float64


def test_files_of_other_programs_are_of_the_body_that_is_given(tmp_path):
    np.savez(tmp_path / "smpl.npz", **model())
    path = _of_amass(tmp_path)
    with np.load(path) as file:
        amass = dict(file)
    np.savez(path, **{k: v for k, v in amass.items() if k != "betas"}, betas=np.ones(8))
    out = tmp_path / "out.glb"
    line = ["export", str(path), "--glb", str(out), "--body", str(tmp_path / "smpl.npz")]
    assert cli.run(line) == 0
    assert out.stat().st_size > 0
    # more coefficients than the body has are of another one
    np.savez(path, **{k: v for k, v in amass.items() if k != "betas"}, betas=np.ones(16))
    assert cli.run(line) == 2


def test_a_file_of_another_program_stays_one_when_it_is_saved_again(tmp_path):
    file = load_motion(_of_amass(tmp_path))
    assert file.format_version == 0
    save_motion(tmp_path / "again.npz", file)
    with pytest.raises(ValueError, match="does not name its body"):
        load_motion_of(tmp_path / "again.npz", BODY)

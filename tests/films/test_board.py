"""Lenses and poses from films of a checkerboard, beside those it was rendered with."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import recon
from recon import cli
from recon.films.board import Board
from recon.formats.calibration import load_cameras
from recon.formats.cameras import CameraArrays
from tests.films.boards import (
    BOARD,
    DISTORTION,
    FOCAL,
    RATE,
    TURN,
    board_poses,
    camera,
    film,
    picture,
)
from tests.films.painted import write

TRUE = {"left": camera(0.0, FOCAL), "right": camera(TURN, 400.0)}
WORDS = ["--board", f"{BOARD.columns}x{BOARD.rows}", "--square", "50mm"]


@pytest.fixture(scope="module")
def films(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("boards")
    return {name: film(folder / f"{name}.mp4", one) for name, one in TRUE.items()}


def check_lens(found: CameraArrays, true: CameraArrays) -> None:
    np.testing.assert_allclose(found.camera_matrix, true.camera_matrix, atol=3.0)
    assert found.image_size == true.image_size
    assert found.distortion is not None
    np.testing.assert_allclose(found.distortion[:2], DISTORTION[:2], atol=0.05)


def test_two_films_of_a_board_tell_lenses_poses_and_the_floor(films, tmp_path, capsys):
    out = tmp_path / "rig.toml"
    assert cli.run(["calibrate", *map(str, films.values()), *WORDS, "--out", str(out)]) == cli.OK
    assert "the ground is where the board lies from 5." in capsys.readouterr().err
    found = load_cameras(out).cameras
    poses = [np.linalg.inv(one.T_camera_world[0]) for one in found.values()]
    true = [np.linalg.inv(one.T_camera_world[0]) for one in TRUE.values()]
    for name, one in TRUE.items():
        check_lens(found[name], one)
    turned, apart = (np.linalg.inv(one[0]) @ one[1] for one in (poses, true))
    angle = Rotation.from_matrix(turned[:3, :3] @ apart[:3, :3].T).magnitude()
    assert np.degrees(angle) < 0.3
    assert np.linalg.norm(turned[:3, 3] - apart[:3, 3]) < 0.01
    for pose, right in zip(poses, true, strict=True):
        assert pose[2, 3] == pytest.approx(right[2, 3], abs=0.01), "height above the floor"
        assert np.degrees(np.arccos(min(pose[2, :3] @ right[2, :3], 1.0))) < 0.5


@pytest.mark.parametrize("change", ["late", "mirrored"])
def test_films_that_disagree_where_the_board_is_are_refused(films, tmp_path, change):
    """Both gave cameras that were decimetres off."""
    rng = np.random.default_rng(0)
    images = [picture(TRUE["right"], one, rng) for one in board_poses()]
    wrong = images[1:] if change == "late" else [image[:, ::-1].copy() for image in images]
    write(tmp_path / "wrong.mp4", wrong, RATE)
    with pytest.raises(recon.ReconError, match="wrong disagree where the board is"):
        recon.calibrate([films["left"], tmp_path / "wrong.mp4"], board="7x4", square="50mm")


def test_one_film_of_a_board_tells_its_lens(films, tmp_path):
    rig = recon.calibrate(films["left"], board="7x4", square="5 cm")
    check_lens(rig.cameras["left"], TRUE["left"])
    assert rig.cameras["left"].T_camera_world is None
    assert "left: pose not known, focal length 4" in repr(rig)
    rig.save(tmp_path / "lens.toml")
    assert load_cameras(tmp_path / "lens.toml").cameras["left"].T_camera_world is None


def test_corners_have_one_order_whichever_way_the_board_is_turned():
    """Upside down in one of two cameras, the poses of both would not agree."""
    rng = np.random.default_rng(0)
    image = picture(TRUE["left"], board_poses()[0], rng)
    upright = BOARD.seen_in(image)
    turned = BOARD.seen_in(np.ascontiguousarray(image[::-1, ::-1]))
    assert upright is not None
    assert turned is not None
    size = np.array(TRUE["left"].image_size) - 1
    np.testing.assert_allclose(turned, size - upright, atol=1.0)


def test_what_is_no_board_is_refused(films, tmp_path):
    left = films["left"]
    with pytest.raises(recon.ReconError, match="board: expected its numbers of inner corners"):
        recon.calibrate([left], board="9", square="25mm")
    for square in (None, "25", "25mm2", "3 furlongs", "4m"):
        with pytest.raises(ValueError, match="expected"):
            Board.of("9x6", square)
    for unused in ({"height": 1.8}, {"camera": left}, {"frame_rate": 30.0}, {"person": 0}):
        with pytest.raises(recon.ReconError, match=f"does not use {next(iter(unused))}"):
            recon.calibrate(left, board="7x4", square="50mm", **unused)  # pyright: ignore[reportArgumentType]
    with pytest.raises(recon.ReconError, match="9x6 inner corners is seen in 0 moments"):
        recon.calibrate(left, board="9x6", square="25mm")
    (tmp_path / "rig.toml").write_text("")
    with pytest.raises(recon.ReconError, match="expected films of a checkerboard"):
        recon.calibrate([left, tmp_path / "rig.toml"], board="7x4", square="50mm")


def test_a_board_that_is_not_laid_down_tells_no_ground(tmp_path, monkeypatch):
    monkeypatch.setattr("tests.films.boards.STILL", 0)
    paths = [film(tmp_path / f"{name}.mp4", one) for name, one in TRUE.items()]
    with pytest.raises(recon.ReconError, match="lay it on the floor"):
        recon.calibrate(paths, board="7x4", square="50mm")

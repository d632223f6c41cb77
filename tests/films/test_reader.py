"""People in films: where they are found, followed, kept and read again."""

import hashlib
import importlib.util
import sys
from pathlib import Path
from unittest.mock import ANY

import cv2
import numpy as np
import pytest

import recon
from recon import cli
from recon.films.blazepose import BlazePose
from recon.films.reader import read_film
from recon.formats.opening import load_arrays
from recon.reading.places import files_of_views
from tests.films.painted import FRAMES, LANDMARKS, RATE, SIZE, walker, write

MODELS = Path(__file__).parents[2] / "film-models"
COLUMNS = list(LANDMARKS.values())
MIRRORED = [COLUMNS.index(k + 1 if k % 2 else k - 1) for k in COLUMNS]
HEIGHT = 300
"""Pixels of the walker."""


@pytest.fixture(scope="module")
def film(tmp_path_factory) -> Path:
    return write(tmp_path_factory.mktemp("film") / "cam.mp4", walker()[0])


def away(pixels, truth) -> float:
    """Median distance, as a share of the walker's height."""
    return float(np.median(np.linalg.norm(pixels - truth, axis=-1))) / HEIGHT


def test_one_person_is_found_where_their_joints_are(film):
    found = read_film(film)
    assert (found.layout, found.image_size) == ("mediapipe33", SIZE)
    assert found.frame_rate == pytest.approx(RATE)
    assert found.frame.tolist() == found.frame_numbers.tolist() == list(range(FRAMES))
    truth = walker()[1]
    assert away(found.pixels[:, COLUMNS], truth) < 0.03
    assert away(found.pixels[:, COLUMNS], truth[:, MIRRORED]) > 0.05


def test_a_mirror_image_has_the_other_left(tmp_path):
    images, truth = walker()
    found = read_film(write(tmp_path / "a.mp4", images[:, :, ::-1]))
    mirrored = truth[:, MIRRORED] * (-1, 1) + (SIZE[0] - 1, 0)
    assert away(found.pixels[:, COLUMNS], mirrored) < 0.03


def test_two_people_are_found_and_none_is_invented(tmp_path):
    images, truth = walker()
    found = read_film(write(tmp_path / "a.mp4", np.concatenate((images, images), axis=2)))
    left = found.pixels[:, COLUMNS].mean((1, 2)) < SIZE[0]
    assert left.sum() == (~left).sum() == FRAMES
    assert away(found.pixels[~left][:, COLUMNS], truth + np.array([SIZE[0], 0])) < 0.03


def test_an_empty_room_is_said_to_be_empty(tmp_path):
    floor = np.full((4, 240, 320, 3), 128, np.uint8)
    with pytest.raises(recon.FormatError, match="nobody was found in any of its 4 frames"):
        read_film(write(tmp_path / "a.mp4", floor))


def test_what_the_image_cuts_off_is_not_seen(tmp_path):
    images, truth = walker()
    knees = int(truth[:, 8:10, 1].max()) + 10
    cut = images[:, : knees - knees % 2]
    found = read_film(write(tmp_path / "a.mp4", cut))
    assert (found.confidence[:, [27, 28, 31, 32]] < 0.05).all()
    assert (found.confidence[:, [11, 12, 23, 24]] > 0.5).all()


def test_an_interrupted_film_goes_on_where_it_was(film, tmp_path, monkeypatch):
    """Once all sights of a film were written anew with every part."""
    monkeypatch.setattr("recon.films.reader._SAVED_EVERY", 2)

    def interrupt(done: int, _: int) -> None:
        seen.append(done)
        if done == 5 and len(seen) == 5:
            raise KeyboardInterrupt

    whole, seen = read_film(film), list[int]()
    with pytest.raises(KeyboardInterrupt):
        read_film(film, kept=tmp_path, watch=interrupt)
    (parts,) = tmp_path.iterdir()
    count = {one.name: len(load_arrays(one)["sights"]) for one in parts.iterdir()}
    assert count == {"000000000.npz": 2, "000000002.npz": 2, "000000004.npz": 1}
    again = read_film(film, kept=tmp_path, watch=interrupt)
    assert seen == [*range(1, 6), *range(1, FRAMES + 1)]
    np.testing.assert_allclose(again.pixels, whole.pixels)
    assert [one.suffix for one in tmp_path.iterdir()] == [".npz"]


def test_kept_detections_are_of_the_content_of_a_film(film, tmp_path, monkeypatch):
    first = read_film(film, kept=tmp_path)
    same = tmp_path / "renamed" / "cam.mp4"
    same.parent.mkdir()
    same.write_bytes(film.read_bytes())
    (tmp_path / "other").mkdir()
    other = write(tmp_path / "other" / "cam.mp4", walker()[0][:8])
    with monkeypatch.context() as without:
        without.setattr(BlazePose, "poses", None)
        np.testing.assert_array_equal(read_film(same, kept=tmp_path).pixels, first.pixels)
        with pytest.raises(TypeError):
            read_film(other, kept=tmp_path)


def test_detect_writes_what_fit_reads(film, tmp_path, capfd):
    out = tmp_path / "keypoints.npz"
    assert cli.run(["detect", str(film), "--out", str(out)]) == cli.OK
    assert "person 0" in capfd.readouterr().err
    quietly = ["detect", str(film), "--out", str(tmp_path / "b.npz"), "--quiet"]
    assert cli.run(quietly) == cli.OK
    assert capfd.readouterr().err == f"{tmp_path / 'b.npz'}\n", "LiteRT wrote of its networks"
    assert load_arrays(out)["keypoints"].shape == (FRAMES, 1, 33, 2)
    view = recon.read(out)
    direct = recon.read(film)
    assert view.camera.image_size == direct.camera.image_size == SIZE
    assert float(view.fps) == pytest.approx(RATE)
    np.testing.assert_allclose(view.pixels, direct.pixels, atol=1e-3)
    assert repr(recon.detect(film)).startswith("DetectedPeople: 1 in 12 frames of cam.mp4")


def test_frame_numbers_and_people_that_do_not_fit_are_refused(film, tmp_path):
    arrays = dict(load_arrays(write_detections(film, tmp_path / "a.npz")))
    for name, wrong in {
        "frame_numbers": np.arange(FRAMES)[::-1],
        "identity": np.zeros(FRAMES, int),
    }.items():
        np.savez(tmp_path / "b.npz", **arrays | {name: wrong})
        with pytest.raises(recon.FormatError, match=r"expected .*frame_numbers"):
            recon.read(tmp_path / "b.npz")


def write_detections(film: Path, path: Path) -> Path:
    recon.detect(film).save(path)
    return path


def test_a_fit_keeps_detections_beside_its_result(film, tmp_path, capsys):
    out = tmp_path / "motion.npz"
    line = ["fit", str(film), "--prior", "pose", "--checks", "none", "--out", str(out)]
    assert cli.run(line) == cli.OK
    assert "image size 320 x 360: of cam.mp4" in capsys.readouterr().err
    (kept,) = (tmp_path / "motion.detections").iterdir()
    assert kept.name.startswith("cam-")
    assert len(recon.load_motion(out).motion.translation) == FRAMES
    sheet = cv2.imread(str(tmp_path / "motion.sheet.png"))
    assert sheet is not None
    assert sheet.shape[1] > 3 * sheet.shape[0] / 2, "two rows of four moments"


def test_a_sheet_that_cannot_be_drawn_leaves_the_result(film, tmp_path, capsys):
    (tmp_path / "motion.sheet.png").write_bytes(b"of somebody else")
    out = tmp_path / "motion.npz"
    line = ["fit", str(film), "--prior", "pose", "--checks", "none", "--out", str(out)]
    assert cli.run(line) == cli.OK
    assert "no sheet of moments was drawn: " in capsys.readouterr().err
    assert out.is_file()
    assert (tmp_path / "motion.sheet.png").read_bytes() == b"of somebody else"


def test_a_folder_of_films_is_the_views_of_one_clip(film, tmp_path, capsys):
    """It was refused with `give one of its files`, and several films after all were looked at."""
    views = tmp_path / "views"
    views.mkdir()
    for name in ("cam1.mp4", "cam2.mp4"):
        (views / name).write_bytes(film.read_bytes())
    (views / "Calib.toml").write_text("")
    assert files_of_views([views]) == ([views / "cam1.mp4", views / "cam2.mp4"], ANY)
    assert cli.run(["fit", str(views), "--out", str(tmp_path / "a.npz")]) == cli.BAD_INPUT
    said = " ".join(capsys.readouterr().err.split())
    assert all(word in said for word in ("--camera", "`recon calibrate`", "`recon batch`"))
    assert [one.name for one in tmp_path.iterdir()] == ["views"]


class Corners:
    """A detector that finds the corners of everything."""

    def __call__(self, frames):
        for frame in frames:
            height, width = frame.image.shape[:2]
            y, x = np.mgrid[1:5, 1:5].reshape(2, -1) / 5
            points = np.stack((x * width, y * height, np.full(16, 0.9)), -1)
            yield frame.number, np.concatenate((points, points[:1])), 7


def test_a_detector_of_ones_own_is_one_class(film):
    found = read_film(film, detector=f"{__name__}:Corners")
    assert (found.layout, found.identity.tolist()) == ("coco17", [7] * FRAMES)
    with pytest.raises(recon.ReconError, match="a class"):
        read_film(film, detector="heavy")


def test_without_the_extra_an_error_says_how_to_install_it(film, monkeypatch):
    monkeypatch.setitem(sys.modules, "recon_film_models", None)
    with pytest.raises(recon.ReconError, match=r"pip install 'motion-recon\[film\]'"):
        read_film(film)


def test_a_file_that_is_no_network_of_blazepose_is_refused(film, tmp_path):
    wrong = tmp_path / "a.tflite"
    wrong.write_bytes(b"TFL3")
    with pytest.raises(recon.ReconError, match=r"expected a network \(.tflite\)"):
        read_film(film, detector=str(wrong))
    other = MODELS / "src" / "recon_film_models" / "pose_detection.tflite"
    with pytest.raises(recon.ReconError, match=r"with an output of shape \(195,\)"):
        read_film(film, detector=str(other))


def test_the_model_files_are_those_of_the_readme():
    spec = importlib.util.spec_from_file_location("take_models", MODELS / "take_models.py")
    assert spec is not None
    assert spec.loader is not None
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    files = {one.name: one.read_bytes() for one in script.FOLDER.glob("*.tflite")}
    assert {name: hashlib.sha256(one).hexdigest() for name, one in files.items()} == (
        script.checksums()
    )
    assert len(files) == len(script.PLACES) == 4

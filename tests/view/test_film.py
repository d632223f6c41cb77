"""Bodies drawn over films: a sheet of moments, a film, and films that do not belong."""

import base64
from pathlib import Path

import av
import cv2
import numpy as np
import pytest
import torch

import recon
from recon.films.decoding import Film
from recon.formats.motions import load_motion
from recon.view.files import view
from recon.view.film import views_of_cameras, with_films
from recon.view.overlay import MOMENTS
from tests.filmed import walk

GREY = 90


def film(path: Path, frames: int, size: tuple[int, int], fps: int = 30) -> Path:
    """A grey film."""
    with av.open(str(path), "w") as out:
        stream = out.add_stream("libx264", fps)
        stream.width, stream.height, stream.pix_fmt = *size, "yuv420p"
        for _ in range(frames):
            picture = np.full((size[1], size[0], 3), GREY, np.uint8)
            out.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
        out.mux(stream.encode(None))
    return path


@pytest.fixture(scope="module")
def fitted(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A motion that was fitted to what one camera saw."""
    folder = tmp_path_factory.mktemp("fitted")
    seen = recon.simulate(walk(16), "keypoints2d", noise=2.0, unknown_ground=True)
    recon.fit(seen, "pose").save(folder / "motion.npz")
    return folder / "motion.npz"


def test_sheet_shows_the_body_over_the_film(fitted: Path, tmp_path: Path):
    grey = film(tmp_path / "walk.mp4", 16, (960, 540))
    view(fitted, film=(grey,), png=tmp_path / "sheet.png", mp4=tmp_path / "over.mp4")
    sheet = cv2.imread(str(tmp_path / "sheet.png"))
    assert sheet is not None
    body = np.abs(sheet.astype(int) - GREY).max(-1) > 25
    rows = np.flatnonzero((np.abs(sheet.astype(int) - GREY).max(-1) < 12).any(1))
    assert 0.01 < body[rows].mean() < 0.6
    with av.open(str(tmp_path / "over.mp4")) as drawn:
        assert len(list(drawn.decode(video=0))) == 16


def test_a_page_holds_the_film_that_was_drawn_beside_it(fitted: Path, tmp_path: Path, monkeypatch):
    """Both drew the whole film with the body, which takes most of the time."""
    grey = film(tmp_path / "walk.mp4", 16, (960, 540))
    monkeypatch.setattr("recon.view.html_films.write_overlay", None)
    page, over = tmp_path / "page.html", tmp_path / "over.mp4"
    view(fitted, film=(grey,), html=page, mp4=over)
    assert base64.b64encode(over.read_bytes()).decode("ascii") in page.read_text()


def test_film_of_another_form_is_refused(fitted: Path, tmp_path: Path):
    with pytest.raises(recon.ReconError, match="has images of 400 x 400 pixels"):
        view(
            fitted,
            film=(film(tmp_path / "square.mp4", 16, (400, 400)),),
            png=tmp_path / "sheet.png",
        )


def test_a_sheet_makes_images_of_its_moments_alone(fitted, tmp_path, monkeypatch):
    """Every picture of the film became an image, and was looked at for cuts, a second time."""
    made, usual = [], Film.image_of
    monkeypatch.setattr(Film, "image_of", lambda *own: made.append(1) or usual(*own))
    grey = film(tmp_path / "walk.mp4", 16, (960, 540))
    view(fitted, film=(grey,), png=tmp_path / "sheet.png")
    assert len(made) == MOMENTS


@pytest.mark.parametrize(
    ("size", "images"),
    [((1920, 1088), (1920, 1088)), ((1910, 1080), (1910, 1080)), ((960, 540), (1920, 1080))],
)
def test_film_that_a_codec_filled_up_is_drawn_where_it_was(fitted, tmp_path, size, images):
    """A film of 1080 rows was refused beside a camera of 1088: filling up moves no pixel."""
    grey, file = film(tmp_path / "walk.mp4", 16, size), load_motion(fitted)
    (own,) = views_of_cameras(file.cameras)
    (drawn,) = with_films([own], [grey], file.motion, "walk")
    assert (own.camera.image_size, drawn.camera.image_size) == ((1920, 1080), images)
    assert torch.equal(drawn.camera.camera_matrix, own.camera.camera_matrix)
    view(fitted, film=(grey,), png=tmp_path / "sheet.png")


def test_film_that_ends_early_is_refused(fitted: Path, tmp_path: Path):
    short = film(tmp_path / "short.mp4", 6, (960, 540))
    with pytest.raises(recon.ReconError, match="give the whole film"):
        view(fitted, film=(short,), png=tmp_path / "sheet.png")


def test_motion_without_a_camera_is_refused(tmp_path: Path):
    recon.save_motion(tmp_path / "walk.npz", walk(8))
    grey = film(tmp_path / "grey.mp4", 8, (320, 240))
    with pytest.raises(recon.ReconError, match="does not say with which camera"):
        view(tmp_path / "walk.npz", film=(grey,), png=tmp_path / "sheet.png")

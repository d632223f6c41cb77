"""Films as people have them, a few small pictures each."""

from fractions import Fraction

import av
import numpy as np
import pytest

from recon.core.errors import FormatError
from recon.films.decoding import open_film

WIDTH, HEIGHT = 64, 48


def picture(k=0, size=(WIDTH, HEIGHT)):
    """Green at the top, a red square that moves at the left, blue elsewhere."""
    image = np.full((size[1], size[0], 3), (0, 0, 200), np.uint8)
    image[: size[1] // 4] = (0, 200, 0)
    image[size[1] // 2 :, k : k + size[0] // 4] = (200, 0, 0)
    return image


def write(path, pictures, codec="libx264", pixels="yuv420p", rate=30, stamps=None, setup=None):
    """Write pictures as a film, at `stamps` in seconds; `setup` changes file and stream."""
    with av.open(str(path), "w", options={"movflags": "use_metadata_tags"}) as film:
        stream = film.add_stream(codec, rate=rate)
        stream.height, stream.width = pictures[0].shape[:2]
        stream.pix_fmt = pixels
        if stamps is not None:
            stream.codec_context.time_base = Fraction(1, 1000)
        if setup is not None:
            setup(film, stream)
        for k, image in enumerate(pictures):
            frame = av.VideoFrame.from_ndarray(image, format="rgb24")
            if stamps is not None:
                frame.pts, frame.time_base = round(1000 * stamps[k]), Fraction(1, 1000)
            film.mux(stream.encode(frame))
        film.mux(stream.encode(None))
    return path


def looks_like(image, wanted):
    """Whether two images show the same, but for what a codec changes."""
    return image.shape == wanted.shape and np.abs(image.astype(int) - wanted).mean() < 12


def test_frames_have_images_times_and_numbers(tmp_path):
    film = open_film(write(tmp_path / "a.mp4", [picture(k) for k in range(12)]))
    frames = list(film)
    assert film.image_size == (WIDTH, HEIGHT)
    assert film.frames == len(frames) == 12
    assert film.frame_rate == pytest.approx(30)
    assert [frame.number for frame in frames] == list(range(12))
    assert [frame.time for frame in frames] == pytest.approx(np.arange(12) / 30)
    assert all(looks_like(frame.image, picture(k)) for k, frame in enumerate(frames))
    assert film.notes == []


@pytest.mark.parametrize("clockwise", [90, 180, 270])
def test_a_rotation_flag_turns_the_image_upright(tmp_path, clockwise):
    def flag(film, stream):
        stream.set_display_rotation(-clockwise)

    stored = [np.rot90(picture(k), clockwise // 90).copy() for k in range(4)]
    film = open_film(write(tmp_path / "a.mov", stored, setup=flag))
    assert film.turned_by == clockwise
    assert film.image_size == (WIDTH, HEIGHT)
    assert all(looks_like(frame.image, picture(k)) for k, frame in enumerate(film))


def test_what_is_no_film_is_refused(tmp_path):
    (tmp_path / "a.mp4").write_text("no film\n" * 100)
    with pytest.raises(FormatError, match="expected a film"):
        open_film(tmp_path / "a.mp4")

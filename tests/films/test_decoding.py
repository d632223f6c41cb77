"""Films as people have them, a few small pictures each."""

import os
import tracemalloc
from fractions import Fraction

import av
import cv2
import numpy as np
import pytest

from recon.core.errors import FormatError, ReconError
from recon.films.decoding import open_film

WIDTH, HEIGHT = 64, 48


def picture(k=0, size=(WIDTH, HEIGHT)):
    """Green at the top, a red square that moves at the left, blue elsewhere."""
    image = np.full((size[1], size[0], 3), (0, 0, 200), np.uint8)
    image[: size[1] // 4] = (0, 200, 0)
    image[size[1] // 2 :, k : k + size[0] // 4] = (200, 0, 0)
    return image


def noise(seed):
    """A picture that no codec makes small."""
    return np.random.default_rng(seed).integers(0, 255, (HEIGHT, WIDTH, 3), np.uint8)


def write(
    path, pictures, codec="libx264", pixels="yuv420p", rate=30, stamps=None, setup=None,
    flags="use_metadata_tags",
):  # fmt: skip
    """Write pictures as a film, at `stamps` in seconds; `setup` changes file and stream."""
    with av.open(str(path), "w", options={"movflags": flags}) as film:
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
            else:
                frame.pts, frame.time_base = k, Fraction(1, rate)
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


def test_dropped_frames_leave_gaps(tmp_path):
    stamps = [k / 30 for k in range(20) if k not in (7, 8, 15)]
    film = open_film(write(tmp_path / "a.mkv", [picture(k) for k in range(17)], stamps=stamps))
    numbers = [frame.number for frame in film]
    assert numbers == [k for k in range(20) if k not in (7, 8, 15)]
    assert film.frame_rate == pytest.approx(30, rel=2e-3)
    assert film.notes == ["3 of 20 frames were not recorded"]


def test_uneven_time_stamps_are_kept_and_said(tmp_path):
    stamps = np.cumsum([0, *[0.025, 0.041] * 10])
    film = open_film(write(tmp_path / "a.mkv", [picture(k) for k in range(21)], stamps=stamps))
    frames = list(film)
    assert [frame.time for frame in frames] == pytest.approx(stamps, abs=1e-3)
    assert film.frame_rate == pytest.approx(20 / stamps[-1], rel=1e-3)
    assert [frame.number for frame in frames] == list(range(21))
    assert not film.clock.is_even
    assert "unevenly" in film.notes[0]


def test_rounded_time_stamps_do_not_add_up(tmp_path):
    """Stamps of 33, 33 and 34 ms have a median of 33, by which ten seconds had 303 frames."""
    stamps = np.round(np.arange(300) / 30, 3)
    film = open_film(
        write(tmp_path / "a.mkv", [picture(k % 20) for k in range(300)], stamps=stamps)
    )
    assert film.frames == 300
    assert film.clock.is_even


def test_time_stamps_that_jump_for_weeks_are_refused(tmp_path):
    stamps = [k / 30 + 500_000 * (k > 5) for k in range(10)]
    path = write(tmp_path / "a.mkv", [picture(k) for k in range(10)], stamps=stamps)
    with pytest.raises(ReconError, match="time stamps") as refusal:
        open_film(path)
    assert "number of frames" in str(refusal.value)


@pytest.mark.parametrize("told", ["by the phone", "by the caller"])
def test_slow_motion_has_the_times_of_the_recording(tmp_path, told):
    def phone(film, stream):
        if told == "by the phone":
            film.metadata["com.android.capture.fps"] = "240.000000"

    path = write(tmp_path / "a.mp4", [picture(k) for k in range(24)], setup=phone)
    film = open_film(path, frame_rate=None if told == "by the phone" else 240.0)
    assert film.frame_rate == pytest.approx(240)
    assert [frame.time for frame in film] == pytest.approx(np.arange(24) / 240)
    assert "recorded at 240 Hz" in film.notes[0]


def test_a_phone_that_plays_as_it_records_is_taken_by_its_time_stamps(tmp_path):
    def phone(film, stream):
        film.metadata["com.android.capture.fps"] = "30.000000"

    film = open_film(write(tmp_path / "a.mp4", [picture()] * 9, rate=29, setup=phone))
    assert film.frame_rate == pytest.approx(29)
    assert film.notes == []


@pytest.mark.parametrize(
    ("name", "codec", "pixels"),
    [
        ("a.mov", "libx265", "yuv420p10le"),
        ("a.mov", "prores_ks", "yuv422p10le"),
        ("a.webm", "libvpx-vp9", "yuv420p"),
        ("a.mkv", "ffv1", "gray"),
        ("a.avi", "mpeg4", "yuv420p"),
        ("a.avi", "libx264", "yuv420p"),
        ("a.mpg", "mpeg2video", "yuv420p"),
        ("a.ts", "libx264", "yuv420p"),
        ("a.gif", "gif", "rgb8"),
    ],
)
def test_codecs_and_containers(tmp_path, name, codec, pixels):
    """Time stamps of H.264 in AVI are of the wrong order, and were taken for the times."""
    stored = [picture(k) for k in range(12)]
    film = open_film(write(tmp_path / name, stored, codec, pixels, rate=25))
    frames = list(film)
    assert [frame.number for frame in frames] == list(range(12))
    assert film.frame_rate == pytest.approx(25, rel=2e-3)
    for frame, wanted in zip(frames, stored, strict=True):
        if pixels == "gray":
            wanted = np.repeat((wanted @ [0.299, 0.587, 0.114])[..., None], 3, -1)
        assert np.abs(frame.image.astype(int) - wanted).mean() < 25


@pytest.mark.parametrize("transfer", [16, 18])
def test_a_high_dynamic_range_is_mapped(tmp_path, transfer):
    def hdr(film, stream):
        name = {16: "smpte2084", 18: "arib-std-b67"}[transfer]
        # one thread and no reordered frames: with several, the encoder's last packet
        # sometimes had a time stamp that the file refused
        only = "pools=none:frame-threads=1:bframes=0"
        stream.options = {"x265-params": f"transfer={name}:colorprim=bt2020:log-level=0:{only}"}

    grey = np.full((HEIGHT, WIDTH, 3), 148 if transfer == 16 else 191, np.uint8)
    path = write(tmp_path / "a.mkv", [grey, picture()], "libx265", "yuv420p10le", setup=hdr)
    film = open_film(path)
    # the value of white paper: 203 cd/m2 in PQ are 0.58 of the signal, in HLG 0.75
    assert next(iter(film)).image.mean() > 240
    assert any("high dynamic range" in note for note in film.notes)


def test_odd_sizes(tmp_path):
    film = open_film(
        write(tmp_path / "a.mp4", [picture(k, (65, 49)) for k in range(4)], pixels="yuv444p")
    )
    assert film.image_size == (65, 49)
    assert all(looks_like(frame.image, picture(k, (65, 49))) for k, frame in enumerate(film))


def test_pixels_become_square(tmp_path):
    def wide(film, stream):
        stream.codec_context.sample_aspect_ratio = Fraction(4, 3)

    film = open_film(write(tmp_path / "a.mp4", [picture()] * 3, setup=wide))
    assert film.image_size == (85, HEIGHT)
    assert next(iter(film)).image.shape == (HEIGHT, 85, 3)
    assert "not square" in film.notes[0]


def test_an_interlaced_film_has_no_comb(tmp_path):
    def fields(film, stream):
        stream.options = {"x264-params": "interlaced=1", "crf": "4"}

    stored = []
    for k in range(6):
        first, second = picture(8 * k, (128, 96)), picture(8 * k + 8, (128, 96))
        first[1::2] = second[1::2]
        stored.append(first)
    film = open_film(write(tmp_path / "a.mp4", stored, setup=fields, pixels="yuv420p"))
    image = list(film)[2].image.astype(int)[60:90]
    assert np.abs(image[1:-1:2] - (image[:-2:2] + image[2::2]) / 2).max() <= 1
    assert any("interlaced" in note for note in film.notes)


def test_a_film_of_8k_is_looked_at_in_half_its_size(tmp_path):
    path = write(tmp_path / "a.mp4", [picture(k, (7680, 64)) for k in range(2)])
    film = open_film(path)
    assert film.image_size == (7680, 64)
    assert film.shrunk == 2
    assert next(iter(film)).image.shape == (32, 3840, 3)


def test_one_picture_a_second(tmp_path):
    film = open_film(write(tmp_path / "a.mp4", [picture(k) for k in range(5)], rate=1))
    assert [frame.time for frame in film] == pytest.approx([0, 1, 2, 3, 4])


def test_repeated_pictures_are_left_out(tmp_path):
    """Films of cameras that start together repeat their first picture, in which nobody moves."""
    stored = [picture(0)] * 3 + [picture(k) for k in range(1, 8)]
    film = open_film(write(tmp_path / "a.mkv", stored, "ffv1", "bgr0"))
    assert [frame.number for frame in film] == [0, *range(3, 10)]
    assert film.notes == ["2 pictures that repeat the one before were left out"]


def test_a_long_film_is_never_held_in_memory(tmp_path):
    film = open_film(write(tmp_path / "a.mkv", [picture(k % 40) for k in range(400)], "mpeg4"))
    tracemalloc.start()
    try:
        assert sum(1 for _ in film) == 400
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 60 * picture().nbytes


def test_a_film_that_was_cut_off_is_used_up_to_there(tmp_path):
    def index_first(film, stream):
        stream.options = {"crf": "1"}

    path = write(
        tmp_path / "a.mp4", [noise(k) for k in range(30)], setup=index_first, flags="faststart"
    )
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    film = open_film(path)
    assert 8 < len(list(film)) < 20
    assert "the file ends early" in film.notes[0]


def test_a_film_with_damage_in_the_middle(tmp_path):
    path = write(tmp_path / "a.mkv", [noise(k) for k in range(30)], "mjpeg", "yuvj420p")
    data = bytearray(path.read_bytes())
    data[len(data) // 2 : len(data) // 2 + 4000] = bytes(4000)
    path.write_bytes(data)
    film = open_film(path)
    numbers = [frame.number for frame in film]
    assert numbers[:10] == list(range(10))
    assert len(numbers) < 30
    assert film.notes, "damage was not said"


def _without_index(path):
    write(path, [noise(k) for k in range(20)])
    path.write_bytes(path.read_bytes()[:9000])


def _half_an_index(path):
    write(path, [noise(k) for k in range(20)])
    path.write_bytes(path.read_bytes()[:-600])


def _audio(path):
    with av.open(str(path), "w") as film:
        stream = film.add_stream("aac", rate=48_000)
        sound = av.AudioFrame.from_ndarray(np.zeros((1, 4096), np.float32), "fltp", "mono")
        sound.sample_rate = 48_000
        film.mux(stream.encode(sound))
        film.mux(stream.encode(None))


def _still(path):
    path.write_bytes(cv2.imencode(".png", picture())[1].tobytes())


def _playlist(path):
    write(path.with_name("other.mp4"), [picture()] * 3)
    path.write_text("ffconcat version 1.0\nfile other.mp4\n")


REFUSED = {
    "text": (lambda path: path.write_text("no film\n" * 100), "expected a film"),
    "empty": (lambda path: path.touch(), "empty"),
    "folder": (lambda path: path.mkdir(), "got a directory"),
    "pipe": (lambda path: os.mkfifo(path), "got a directory or device"),
    "nothing": (lambda path: path.with_name("b.mp4").touch(), "no such file"),
    "half an index": (_half_an_index, "index is damaged"),
    "without index": (_without_index, "its index, which cameras write last, is missing"),
    "audio": (_audio, "holds audio without pictures"),
    "still": (_still, "single picture"),
    "one picture": (lambda path: write(path, [picture()]), "two or more pictures, got 1"),
    "playlist": (_playlist, "expected a film"),
    "zeros": (lambda path: path.write_bytes(bytes(100_000)), "expected a film"),
}


@pytest.mark.parametrize("kind", REFUSED)
def test_what_is_no_film_is_refused(tmp_path, kind):
    make, said = REFUSED[kind]
    make(tmp_path / "a.mp4")
    with pytest.raises((FormatError, FileNotFoundError), match=said):
        open_film(tmp_path / "a.mp4")


def test_a_colon_in_a_name_is_no_protocol(tmp_path):
    path = write(tmp_path / "a.mp4", [picture(k) for k in range(3)])
    assert len(list(open_film(path.rename(tmp_path / "http:a.mp4")))) == 3

"""The focal length that phones write into films."""

import re
import struct

import numpy as np
import pytest

import recon
from recon.detections.records import detections_of_rows
from recon.detections.tables import detection_arrays, read_detection_arrays
from recon.films.decoding import open_film
from recon.films.lens import stated_focal_length
from recon.fitting.settings import ReadOptions
from recon.formats.calibration import camera_table
from recon.formats.cameras import FILM_DIAGONAL, STATED_FOCAL_STD, CameraArrays, guessed_camera
from recon.formats.replacing import save_arrays
from recon.reading.views import read_views
from recon.view.info_cameras import describe_film
from tests.films.test_decoding import picture, write

KEY = "com.apple.quicktime.camera.focal_length.35mm_equivalent"


def box(kind: bytes, *parts: bytes) -> bytes:
    content = b"".join(parts)
    return struct.pack(">I4s", 8 + len(content), kind) + content


def metadata(kind: int, value: bytes, version: bytes = b"") -> bytes:
    """A metadata atom with one item; ISO's begins with a version."""
    names = [b"com.apple.quicktime.make", KEY.encode()]
    keys = b"".join(box(b"mdta", name) for name in names)
    item = box((2).to_bytes(4), box(b"data", struct.pack(">II", kind, 0), value))
    handler = box(b"hdlr", bytes(8), b"mdta", bytes(13))
    return box(
        b"meta", version, handler, box(b"keys", struct.pack(">II", 0, 2), keys), box(b"ilst", item)
    )


def in_track(source, out, atom: bytes):
    """A copy of a film whose track of pictures has a further atom; the index stands last."""
    data = source.read_bytes()
    film, track = data.index(b"moov") - 4, data.index(b"trak") - 4
    sizes = [int.from_bytes(data[one : one + 4]) for one in (film, track)]
    grown = [(size + len(atom)).to_bytes(4) for size in sizes]
    end = track + sizes[1]
    parts = (data[:film], grown[0], data[film + 4 : track], grown[1], data[track + 4 : end])
    out.write_bytes(b"".join((*parts, atom, data[end:])))
    return out


@pytest.fixture(scope="module")
def film(tmp_path_factory):
    return write(tmp_path_factory.mktemp("lens") / "plain.mov", [picture(k) for k in range(4)])


@pytest.mark.parametrize(
    "atom",
    [
        metadata(1, b"26"), metadata(1, b"26.00mm"), metadata(21, (26).to_bytes(4)),
        metadata(22, (26).to_bytes(1)), metadata(23, struct.pack(">f", 26)),
        metadata(24, struct.pack(">d", 26)), metadata(77, (26).to_bytes(4), bytes(4)),
        box(b"udta", metadata(1, b"26", bytes(4))),
    ],
)  # fmt: skip
def test_track_that_states_its_lens(film, tmp_path, atom):
    path = in_track(film, tmp_path / "a.mov", atom)
    read = open_film(path)
    assert read.stated_focal == 26.0
    assert "focal length of 26 mm" in read.notes[-1]
    assert len(list(read)) == 4
    diagonal = np.hypot(*read.image_size)
    assert describe_film(path)["lens"] == (
        f"focal length {26 / FILM_DIAGONAL * diagonal:.0f} pixels, as the file states: "
        "believed within 10%"
    )


@pytest.mark.parametrize("name", ["a.mp4", "a.mov"])
def test_film_that_states_its_lens(tmp_path, name):
    def phone(film, stream):
        film.metadata[KEY] = "13"

    assert open_film(write(tmp_path / name, [picture()] * 4, setup=phone)).stated_focal == 13.0


@pytest.mark.parametrize(
    ("atom", "said"),
    [
        (metadata(21, bytes(4)), "of 0 mm .* not used"),
        (metadata(1, b"1e9"), "of 1e.09 mm .* not used"),
        (metadata(1, b"nan"), "nan"), (metadata(1, b"-26"), "-26"),
        (metadata(1, b"wide"), "cannot be read"), (metadata(23, b"abc"), "cannot be read"),
        (metadata(1, b"\xff\xfe"), "cannot be read"), (metadata(0, bytes(300)), "cannot be read"),
        (metadata(1, b"26") + metadata(1, b"77"), "or several"),
    ],
)  # fmt: skip
def test_absurd_lens_is_told_and_not_used(film, tmp_path, atom, said):
    path = in_track(film, tmp_path / "a.mov", atom)
    focal, note = stated_focal_length(path)
    assert focal is None
    assert re.search(said, note)
    told = describe_film(path)
    assert note in told["decisions"]
    assert told["lens"].endswith("as the file states none: believed within 30%")


def test_damaged_indices_state_nothing(film, tmp_path):
    """Every cut, sizes that reach too far or are zero, and boxes within boxes without end."""
    path, whole = tmp_path / "a.mov", in_track(film, tmp_path / "b.mov", metadata(1, b"26"))
    data = whole.read_bytes()
    start = data.index(b"moov") - 4
    for cut in range(start, len(data), 7):
        path.write_bytes(data[:cut])
        assert stated_focal_length(path)[0] in (None, 26.0)
    rng = np.random.default_rng(0)
    for _ in range(300):
        broken = bytearray(data)
        for place in rng.integers(start, len(data), 8):
            broken[place] = rng.integers(256)
        path.write_bytes(broken)
        stated_focal_length(path)
    deep = b""
    for _ in range(3000):
        deep = box(b"meta", deep)
    path.write_bytes(box(b"moov", deep) + bytes(64))
    assert stated_focal_length(path) == (None, "")


def test_stated_lens_is_the_camera_of_the_fit(tmp_path):
    """It is kept with the detections, and the fit begins with it and believes it more."""
    rows = [(k, np.column_stack((np.arange(17.0) * 20, np.full(17, 90.0), np.ones(17))), 0)
            for k in range(5)]  # fmt: skip
    found = detections_of_rows("film.mov", list(range(5)), rows)
    arrays = detection_arrays(found) | {
        "frame_rate": np.array(30.0), "image_size": np.array((1920, 1080)),
        "stated_focal": np.array(52.0),
    }  # fmt: skip
    save_arrays(tmp_path / "seen.npz", arrays)
    assert read_detection_arrays(tmp_path / "seen.npz").stated_focal == 52.0
    views = read_views([tmp_path / "seen.npz"], ReadOptions())
    (camera,) = views.cameras
    assert camera.camera_matrix[0, 0] == pytest.approx(52 / FILM_DIAGONAL * np.hypot(1920, 1080))
    assert camera.focal_std == STATED_FOCAL_STD < guessed_camera((1920, 1080)).focal_std
    assert any("52 mm for 35 mm film which the film states" in one for one in views.decisions)
    save_arrays(tmp_path / "absurd.npz", arrays | {"stated_focal": np.array(0.0)})
    assert read_detection_arrays(tmp_path / "absurd.npz").stated_focal is None


@pytest.mark.parametrize(
    ("size", "scale"), [((1920, 1080), 1.0), ((1912, 1088), 1.0), ((960, 544), 0.5)]
)
def test_images_of_another_size_than_the_calibration_s(tmp_path, size, scale):
    """Codecs fill up 1080 rows to 1088, which moves no pixel; a copy in another size does."""
    matrix = np.array([[1500.0, 0.0, 950.0], [0.0, 1510.0, 530.0], [0.0, 0.0, 1.0]])
    calibration = tmp_path / "rig.toml"
    calibration.write_text(camera_table("seen", CameraArrays(matrix, (1920, 1088))))
    rows = [(k, np.column_stack((np.arange(17.0) * 20, np.full(17, 90.0), np.ones(17))), 0)
            for k in range(5)]  # fmt: skip
    arrays = detection_arrays(detections_of_rows("seen.npz", list(range(5)), rows))
    more = {"frame_rate": np.array(30.0), "image_size": np.array(size)}
    save_arrays(tmp_path / "seen.npz", arrays | more)
    views = read_views([tmp_path / "seen.npz"], ReadOptions(camera=calibration))
    (camera,) = views.cameras
    assert camera.image_size == size
    wanted = [1500 * scale, 950.5 * scale - 0.5, 530.5 * scale - 0.5]
    assert camera.camera_matrix[[0, 0, 1], [0, 2, 2]] == pytest.approx(wanted)
    assert views.found[0].pixels[0, 3] == pytest.approx(np.array((60.0, 90.0)))
    assert any("the calibration's have 1920 x 1088" in one for one in views.decisions)
    for other in ((1280, 960), (1920, 1200), (1088, 1920)):
        save_arrays(tmp_path / "seen.npz", arrays | more | {"image_size": np.array(other)})
        with pytest.raises(recon.ObservationError, match="give the calibration of this film"):
            read_views([tmp_path / "seen.npz"], ReadOptions(camera=calibration))

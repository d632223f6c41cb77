"""Files of gait laboratories: clocks, what is left out, points without labels, rotations."""

import struct
from pathlib import Path

import numpy as np
import pytest

from recon.keypoints3d.labels import are_keypoints
from recon.mocap.marker_tables import write_trc
from recon.mocap.reader import read_recording
from recon.mocap.recording import MarkerRecording
from tests.formats.test_markers import make_markers, write_c3d

SEGMENTS = (
    "worldbody", "pelvis",
    *(f"{side}_{part}" for side in "lr" for part in ("thigh", "shank", "foot", "toes")),
    *(f"{side}_{part}" for side in "lr" for part in ("uarm", "larm", "hand")),
)  # fmt: skip
FRAMES = 3


def read(path: Path) -> MarkerRecording:
    found = read_recording(path)
    assert isinstance(found, MarkerRecording)
    return found


def numbered_from(path: Path, first: int) -> None:
    """Let the frames of a C3D file begin with another number."""
    data = bytearray(path.read_bytes())
    begin, end = struct.unpack_from("<HH", data, 6)
    struct.pack_into("<HH", data, 6, first, end - begin + first)
    path.write_bytes(bytes(data))


def test_the_first_frame_of_a_c3d_tells_its_time(tmp_path: Path) -> None:
    """Trials that were cut began at zero, so that events and forces did not fit them."""
    write_c3d(tmp_path / "clip.c3d", make_markers())
    assert read(tmp_path / "clip.c3d").start_time == 0
    numbered_from(tmp_path / "clip.c3d", 725)
    back = read(tmp_path / "clip.c3d")
    assert back.start_time == pytest.approx(7.24)
    assert back.frames == 5
    assert "frame 725 is the first, at 7.240 s" in back.decisions
    assert back.window(2, 5).start_time == pytest.approx(7.26)


def test_more_frames_than_sixteen_bits_count_are_read_from_trial(tmp_path: Path) -> None:
    import ezc3d

    write_c3d(tmp_path / "clip.c3d", make_markers())
    file = ezc3d.c3d(str(tmp_path / "clip.c3d"))
    # 70,001 to 70,005, as pairs of 16 bits, low ones first
    for key, frame in (("ACTUAL_START_FIELD", 70_001), ("ACTUAL_END_FIELD", 70_005)):
        file.add_parameter("TRIAL", key, [frame & 0xFFFF, frame >> 16])
    file.write(str(tmp_path / "long.c3d"))
    data = bytearray((tmp_path / "long.c3d").read_bytes())
    struct.pack_into("<HH", data, 6, 0xFFFF, 0xFFFF)
    (tmp_path / "long.c3d").write_bytes(bytes(data))
    back = read(tmp_path / "long.c3d")
    assert (back.frames, back.start_time) == (5, pytest.approx(700.0))
    struct.pack_into("<HH", data, 6, 1, 5)  # where 16 bits are enough, the header counts
    (tmp_path / "long.c3d").write_bytes(bytes(data))
    assert read(tmp_path / "long.c3d").start_time == 0


@pytest.mark.parametrize(
    ("key", "frames", "said"),
    [
        ("LONG_FRAMES", 70_000, "70000 frames by its parameters: its header counts to 65,535"),
        ("LONG_FRAMES", 90_000, "room for 4465 more"),  # the file does not hold as many
        ("OTHER", 70_000, "room for 4465 more"),
    ],
)
def test_frames_beyond_the_header_s_sixteen_bits_are_read_or_said(
    tmp_path: Path, key: str, frames: int, said: str
) -> None:
    """All after number 65,535 were left out without a word."""
    write_c3d(tmp_path / "clip.c3d", make_markers(), **{key: [float(frames)]})
    data = bytearray((tmp_path / "clip.c3d").read_bytes())
    start = (struct.unpack_from("<H", data, 16)[0] - 1) * 512
    struct.pack_into("<HH", data, 6, 1, 0xFFFF)
    frame = bytes(data[start : start + 4 * 16])
    (tmp_path / "clip.c3d").write_bytes(bytes(data[:start]) + frame * 70_000)
    back = read(tmp_path / "clip.c3d")
    assert back.frames == (frames if said.startswith(str(frames)) else 65_535)
    assert any(said in one for one in back.decisions)


def test_the_rate_of_the_header_is_taken_where_none_is_stated(tmp_path: Path) -> None:
    write_c3d(tmp_path / "clip.c3d", make_markers())
    data = bytearray((tmp_path / "clip.c3d").read_bytes().replace(b"RATE", b"PACE"))
    struct.pack_into("<f", data, 20, 50.0)
    (tmp_path / "clip.c3d").write_bytes(bytes(data))
    assert read(tmp_path / "clip.c3d").fps == 50


def test_integers_are_scaled_and_analog_samples_passed_over(tmp_path: Path) -> None:
    """Old files store 16-bit integers, and two analog samples behind the points of a frame."""
    markers = make_markers()
    write_c3d(tmp_path / "clip.c3d", markers)
    data = (tmp_path / "clip.c3d").read_bytes()
    start = (struct.unpack_from("<H", data, 16)[0] - 1) * 512
    head, scale = bytearray(data[:start]), 0.1
    struct.pack_into("<H", head, 4, 2)
    struct.pack_into("<f", head, 12, scale)
    frames = np.zeros((5, 18), dtype="<i2")
    points = frames[:, :16].reshape(5, 4, 4)
    points[..., :3] = np.rint(markers.positions * 1000 / scale)
    points[..., 3] = np.where(markers.visible, 1, -1)
    frames[:, 16:] = -5
    (tmp_path / "integers.c3d").write_bytes(bytes(head) + frames.tobytes())
    back = read(tmp_path / "integers.c3d")
    assert np.array_equal(back.visible, markers.visible)
    assert np.abs(back.positions - markers.positions).max() < 0.6e-3 * scale  # metres, rounded
    assert "analog channels left out: without names" in back.decisions
    (tmp_path / "integers.c3d").write_bytes(bytes(head) + frames.tobytes()[:-1])
    with pytest.raises(ValueError, match="which hold 4 frames"):
        read(tmp_path / "integers.c3d")


def test_only_the_subject_before_the_first_colon_is_taken_off(tmp_path: Path) -> None:
    names = ["Ann:LFHD:1", "Ann:C7", "Ann:RKNE", "Ann:LHEE"]
    write_c3d(tmp_path / "clip.c3d", make_markers(), LABELS=names)
    assert read(tmp_path / "clip.c3d").marker_names[0] == "LFHD:1"


def test_outputs_and_analog_channels_are_named(tmp_path: Path) -> None:
    import ezc3d

    write_c3d(tmp_path / "clip.c3d", make_markers(), ANGLES=["Ann:RKNE"])
    file = ezc3d.c3d(str(tmp_path / "clip.c3d"))
    file["parameters"]["ANALOG"]["RATE"]["value"] = [100.0]
    file["parameters"]["ANALOG"]["LABELS"]["value"] = ["Fx1", "Fz1"]
    file["data"]["analogs"] = np.ones((1, 2, 5))
    file.write(str(tmp_path / "forces.c3d"))
    said = read(tmp_path / "forces.c3d").decisions
    assert "analog channels left out: Fx1, Fz1" in said
    assert "1 angles, forces and other outputs left out: Ann:RKNE" in said


def test_times_of_a_trc_are_kept(tmp_path: Path) -> None:
    from dataclasses import replace

    write_trc(tmp_path / "clip.trc", replace(make_markers(), start_time=2.5))
    assert read(tmp_path / "clip.trc").start_time == pytest.approx(2.5)


def test_points_without_a_label_are_left_out_of_a_trc(tmp_path: Path) -> None:
    """Files with unlabelled points behind or between the markers were refused, or their labels
    went to the points beside them."""
    markers = make_markers()
    write_trc(tmp_path / "clip.trc", markers)
    lines = (tmp_path / "clip.trc").read_text().split("\n")
    lines[6:8] = [f"{line}\t1\t2\t3\t4\t5\t6" for line in lines[6:8]]
    (tmp_path / "more.trc").write_text("\n".join(lines))
    back = read(tmp_path / "more.trc")
    assert back.marker_names == markers.marker_names
    assert np.abs(back.positions - markers.positions).max() < 1e-6  # m
    assert "6 columns of points without a label left out" in back.decisions

    lines = (tmp_path / "clip.trc").read_text().split("\n")
    lines[3] = lines[3].replace("C7", "")
    (tmp_path / "between.trc").write_text("\n".join(lines))
    back = read(tmp_path / "between.trc")
    assert back.marker_names == ("LFHD", "RKNE", "LHEE")
    assert np.abs(back.positions - markers.positions[:, [0, 2, 3]]).max() < 1e-6  # m

    (tmp_path / "odd.trc").write_text("\n".join([*lines[:6], lines[6] + "\t1", *lines[7:]]))
    with pytest.raises(ValueError, match="row 1 below the header has 15 cells, expected 14"):
        read(tmp_path / "odd.trc")


def test_poses_of_segments_give_joint_centres(tmp_path: Path) -> None:
    """Files without points but with a group ROTATION were refused as empty."""
    matrices, places = standing_segments()
    (tmp_path / "theia.c3d").write_bytes(rotation_file(matrices))
    back = read(tmp_path / "theia.c3d")
    assert are_keypoints(back.marker_names)
    assert back.fps == 85
    assert back.start_time == pytest.approx(4 / 85)
    hip, wrist = (back.marker_names.index(name) for name in ("left_hip", "right_wrist"))
    np.testing.assert_allclose(back.positions[2, hip], places["l_thigh"] / 1000, atol=1e-6)
    np.testing.assert_allclose(back.positions[0, wrist], places["r_hand"] / 1000, atol=1e-6)
    assert not back.visible[1, wrist]  # its reliability is negative there
    assert back.visible.sum() == back.visible.size - 1
    assert any("left out: worldbody_4X4, pelvis_4X4" in said for said in back.decisions)


def test_rotations_that_nobody_knows_or_that_are_cut_short_are_refused(tmp_path: Path) -> None:
    matrices, _ = standing_segments()
    whole = rotation_file(matrices)
    (tmp_path / "cut.c3d").write_bytes(whole[:-512])
    with pytest.raises(ValueError, match="promises 3 frames of 16 segments"):
        read(tmp_path / "cut.c3d")
    (tmp_path / "other.c3d").write_bytes(whole.replace(b"_thigh_4X4", b"_tail!_4X4"))
    other = read(tmp_path / "other.c3d")
    assert "left_hip" not in other.marker_names
    (tmp_path / "none.c3d").write_bytes(whole.replace(b"_4X4", b"_abc"))
    with pytest.raises(ValueError, match="poses of segments"):
        read(tmp_path / "none.c3d")


def standing_segments() -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Poses of all segments, frames x segments x 17, and the places of their origins, mm."""
    heights = {"thigh": 900, "shank": 480, "foot": 90, "toes": 20, "uarm": 1400, "larm": 1120,
               "hand": 880}  # fmt: skip
    places = {
        name: np.array([100.0 if name.startswith("l") else -100.0, 50.0, heights[name[2:]]])
        for name in SEGMENTS[2:]
    }
    table = np.zeros((FRAMES, len(SEGMENTS), 17), dtype=np.float32)
    for k, name in enumerate(SEGMENTS):
        matrix = np.eye(4)
        matrix[:3, :3] = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
        matrix[:3, 3] = places.get(name, np.zeros(3))
        table[:, k, :16] = matrix.T.flatten()  # column by column
        table[:, k, 16] = 1.0
    table[1, SEGMENTS.index("r_hand"), 16] = -1.0
    return table, places


def rotation_file(table: np.ndarray) -> bytes:
    """A C3D file of these poses at 85 Hz whose first frame is number 5."""
    labels = [f"{name}_4X4".ljust(16).encode() for name in SEGMENTS]
    parameters = b"".join(
        (
            group(1, b"POINT"), parameter(1, b"UNITS", -1, (2,), b"mm"),
            group(2, b"ROTATION"), parameter(2, b"RATE", 4, (), struct.pack("<f", 85.0)),
            parameter(2, b"DATA_START", 2, (), struct.pack("<h", 4)),
            parameter(2, b"LABELS", -1, (16, len(labels)), b"".join(labels)),
        )
    )  # fmt: skip
    header = bytearray(512)
    header[:2] = bytes((2, 0x50))
    struct.pack_into("<HHHHH", header, 2, 0, 0, 5, 5 + FRAMES - 1, 0)
    struct.pack_into("<H", header, 16, 4)
    section = (bytes((1, 0x50, 2, 84)) + parameters).ljust(1024, b"\0")
    return bytes(header) + section + table.astype("<f4").tobytes()


def group(number: int, name: bytes) -> bytes:
    return struct.pack("<bb", len(name), -number) + name + struct.pack("<hB", 3, 0)


def parameter(number: int, name: bytes, kind: int, shape: tuple[int, ...], data: bytes) -> bytes:
    rest = struct.pack("<bB", kind, len(shape)) + bytes(shape) + data + b"\0"
    head = struct.pack("<bb", len(name), number) + name
    return head + struct.pack("<h", 2 + len(rest)) + rest

"""C3D, TRC and MATLAB markers: values, units, gaps, names."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from recon.mocap.c3d import _doubles as vax_floats  # pyright: ignore[reportPrivateUsage]
from recon.mocap.marker_tables import write_trc
from recon.mocap.reader import read_recording
from recon.mocap.recording import MarkerRecording

NAMES = ("LFHD", "C7", "RKNE", "LHEE")


def make_markers(frames: int = 5) -> MarkerRecording:
    """A standing body in metres with z up, and one gap."""
    rng = np.random.default_rng(0)
    places = np.array([[0.1, 0.2, 1.7], [0.0, 0.2, 1.5], [0.0, 0.1, 0.5], [0.1, 0.1, 0.05]])
    positions = places + 0.01 * rng.standard_normal((frames, 4, 3))
    visible = np.ones((frames, 4), dtype=bool)
    visible[2, 1] = False
    return MarkerRecording("clip", NAMES, positions * visible[..., None], visible, 100.0, ())


def write_c3d(path: Path, markers: MarkerRecording, **point: Any) -> None:
    import ezc3d

    file = ezc3d.c3d()
    values = np.where(markers.visible[..., None], markers.positions * 1000, np.nan)
    file["parameters"]["POINT"]["RATE"]["value"] = [markers.fps]
    file["parameters"]["POINT"]["LABELS"]["value"] = [f"Ann:{n}" for n in markers.marker_names]
    file["parameters"]["POINT"]["UNITS"]["value"] = ["mm"]
    for key, value in point.items():
        if key in file["parameters"]["POINT"]:
            file["parameters"]["POINT"][key]["value"] = value
        else:
            file.add_parameter("POINT", key, value)
    file["data"]["points"] = np.concatenate(
        (values.transpose(2, 1, 0), np.ones((1, values.shape[1], values.shape[0])))
    )
    file.write(str(path))


def test_c3d_gives_metres_names_and_gaps(tmp_path: Path) -> None:
    markers = make_markers()
    write_c3d(tmp_path / "clip.c3d", markers)
    back = read_recording(tmp_path / "clip.c3d")
    assert isinstance(back, MarkerRecording)
    assert back.marker_names == NAMES
    assert back.fps == 100
    assert np.array_equal(back.visible, markers.visible)
    assert np.abs(back.positions - markers.positions).max() < 1e-6  # m, float32 in the file
    assert "subject Ann" in back.decisions


def test_c3d_outputs_that_are_no_points_are_left_out(tmp_path: Path) -> None:
    write_c3d(tmp_path / "clip.c3d", make_markers(), ANGLES=["Ann:RKNE"])
    back = read_recording(tmp_path / "clip.c3d")
    assert isinstance(back, MarkerRecording)
    assert back.marker_names == ("LFHD", "C7", "LHEE")


def test_c3d_without_units_is_told_by_the_body_or_refused(tmp_path: Path) -> None:
    write_c3d(tmp_path / "clip.c3d", make_markers(), UNITS=[""])
    back = read_recording(tmp_path / "clip.c3d")
    assert any("unit mm: the markers span" in decision for decision in back.decisions)
    low = make_markers()
    write_c3d(
        tmp_path / "low.c3d",
        MarkerRecording("low", NAMES, low.positions * 0.1, low.visible, 100.0, ()),
        UNITS=[""],
    )
    # 0.17 m, 1.7 m and 17 m are what mm, cm and m would make of it: only one is a body
    assert any("unit cm" in d for d in read_recording(tmp_path / "low.c3d").decisions)
    with pytest.raises(ValueError, match="--unit"):
        read_recording(tmp_path / "low.c3d", unit="parsec")


def test_the_screen_axis_decides_only_where_the_body_does_not(tmp_path: Path) -> None:
    markers = make_markers()
    write_c3d(tmp_path / "wrong.c3d", markers, Y_SCREEN=["+Y"])
    back = read_recording(tmp_path / "wrong.c3d")
    assert any("hints at y" in decision for decision in back.decisions)
    assert np.abs(back.positions - markers.positions).max() < 1e-6  # m
    unnamed = MarkerRecording(
        "u", ("a", "b", "c", "d"), markers.positions, markers.visible, 100.0, ()
    )
    write_c3d(tmp_path / "hint.c3d", unnamed, Y_SCREEN=["+Y"])
    assert any("up axis y" in d for d in read_recording(tmp_path / "hint.c3d").decisions)
    flat = markers.positions * [1, 1, 0] + [0, 0, 1]
    lying = MarkerRecording("l", ("a", "b", "c", "d"), flat, markers.visible, 100.0, ())
    write_c3d(tmp_path / "none.c3d", lying)
    with pytest.raises(ValueError, match="--up"):
        read_recording(tmp_path / "none.c3d", unit="cm")


def test_c3d_points_of_negative_residual_are_not_seen(tmp_path: Path) -> None:
    """A fault that dropped the sign of the residual went unnoticed."""
    write_c3d(tmp_path / "clip.c3d", make_markers())
    data = bytearray((tmp_path / "clip.c3d").read_bytes())
    words = np.frombuffer(bytes(data), "<u2", 10, 2)
    place = (int(words[7]) - 1) * 512 + 3 * 4  # residual of the first point of the first frame
    data[place : place + 4] = np.float32(-1.0).tobytes()
    (tmp_path / "clip.c3d").write_bytes(bytes(data))
    back = read_recording(tmp_path / "clip.c3d")
    assert isinstance(back, MarkerRecording)
    assert not back.visible[0, 0]
    assert (back.positions[0, 0] == 0).all()
    assert back.visible[1:, 0].all()


def test_c3d_without_its_second_block_or_with_too_many_points_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "clip.c3d"
    write_c3d(path, make_markers())
    whole = path.read_bytes()
    path.write_bytes(whole[:1000])
    with pytest.raises(ValueError, match="its first block is no C3D header"):
        read_recording(path)
    crowd = bytearray(whole)
    crowd[2:4] = np.uint16(5001).tobytes()
    path.write_bytes(bytes(crowd) + bytes(5 * 4 * 4 * 5001))
    with pytest.raises(ValueError, match="number of joints or markers of 1 to 5000"):
        read_recording(path)


@pytest.mark.parametrize("unit", ["m", "mm"])
def test_trc_round_trip(tmp_path: Path, unit: str) -> None:
    markers = make_markers()
    write_trc(tmp_path / "clip.trc", markers, unit=unit)
    back = read_recording(tmp_path / "clip.trc")
    assert isinstance(back, MarkerRecording)
    assert back.marker_names == NAMES
    assert back.fps == 100
    assert np.array_equal(back.visible, markers.visible)
    assert np.abs(back.positions - markers.positions).max() < 1e-6  # m
    assert back.decisions[1] == f"unit {unit}: stated by the file"


def test_trc_with_and_without_the_blank_line_and_trailing_cells(tmp_path: Path) -> None:
    write_trc(tmp_path / "clip.trc", make_markers())
    lines = (tmp_path / "clip.trc").read_text().split("\n")
    assert lines[5] == ""
    (tmp_path / "tight.trc").write_text("\r\n".join(lines[:5] + [f"{x}\t" for x in lines[6:]]))
    commas = [*lines[:2], lines[2].replace("100\t", "100,00\t"), *lines[3:5]]
    commas += [line.replace(".", ",") for line in lines[5:]]
    (tmp_path / "commas.trc").write_text("\n".join(commas))  # as where Windows speaks German
    first, second, third = (
        read_recording(tmp_path / f"{n}.trc") for n in ("clip", "tight", "commas")
    )
    assert np.array_equal(first.positions, second.positions)
    assert np.array_equal(first.positions, third.positions)
    assert third.fps == 100


def test_trc_rate_comes_from_the_times_where_the_header_is_wrong(tmp_path: Path) -> None:
    write_trc(tmp_path / "clip.trc", make_markers())
    text = (tmp_path / "clip.trc").read_text().replace("\n100\t100\t", "\n50\t50\t")
    (tmp_path / "clip.trc").write_text(text)
    assert read_recording(tmp_path / "clip.trc").fps == 100


def rewritten(path: Path, change: Callable[[list[list[str]]], object]) -> MarkerRecording:
    """Write five frames as a TRC file, change the cells of its rows, and read it."""
    write_trc(path, make_markers())
    lines = path.read_text().splitlines()
    rows = [line.split("\t") for line in lines[6:]]
    change(rows)
    path.write_text("\n".join([*lines[:6], *("\t".join(row) for row in rows)]))
    back = read_recording(path)
    assert isinstance(back, MarkerRecording)
    return back


@pytest.mark.parametrize(("unit", "per_second"), [("ms", 1000), ("frames", 100)])
def test_times_of_a_table_may_be_in_another_unit(
    unit: str, per_second: int, tmp_path: Path
) -> None:
    """Thousands of unseen frames were put between the rows."""

    def change(rows: list[list[str]]) -> None:
        for row in rows:
            row[1] = f"{float(row[1]) * per_second:g}"

    back = rewritten(tmp_path / "clip.trc", change)
    assert (back.frames, back.fps) == (5, 100)
    assert any(f"times are in {unit}" in said for said in back.decisions)


def test_a_row_missing_from_the_middle_of_a_trc_is_a_frame(tmp_path: Path) -> None:
    """The file was refused as cut short, which is true only where its end is missing."""
    back = rewritten(tmp_path / "clip.trc", lambda rows: rows.pop(2))
    assert back.visible.any(1).tolist() == [True, True, False, True, True]
    with pytest.raises(ValueError, match=r"expected 5 frames .*, got 4; the file is cut"):
        rewritten(tmp_path / "clip.trc", lambda rows: rows.pop())


def test_a_row_that_lost_a_cell_is_refused(tmp_path: Path) -> None:
    """All coordinates after it went to other axes and points."""
    with pytest.raises(ValueError, match="row 2 below the header has 13 cells, expected 14"):
        rewritten(tmp_path / "clip.trc", lambda rows: rows[1].pop(3))


def test_rows_that_repeat_a_frame_do_not_change_the_rate(tmp_path: Path) -> None:
    """The rate became that of the number of rows."""
    back = rewritten(tmp_path / "clip.trc", lambda rows: rows.insert(2, rows[1]))
    assert (back.frames, back.fps) == (5, 100)
    assert "rows that repeat frame number and time are left out: 1" in back.decisions


def test_a_last_row_cut_within_a_number_is_said(tmp_path: Path) -> None:
    """It was taken without a word, and with the rest of the number."""

    def change(rows: list[list[str]]) -> None:
        rows[-1][7:] = [rows[-1][7][:2]]

    back = rewritten(tmp_path / "clip.trc", change)
    assert back.visible[-1].tolist() == [make_markers().visible[-1, 0], False, False, False]
    assert any("last row is cut short after 1 of 4 points" in said for said in back.decisions)


def test_repeated_labels_are_numbered(tmp_path: Path) -> None:
    write_trc(tmp_path / "clip.trc", make_markers())
    text = (tmp_path / "clip.trc").read_text().replace("RKNE", "C7")
    (tmp_path / "clip.trc").write_text(text)
    back = read_recording(tmp_path / "clip.trc")
    assert isinstance(back, MarkerRecording)
    assert back.marker_names == ("LFHD", "C7#2", "C7", "LHEE")  # the former has a gap


def test_of_repeated_labels_the_copy_seen_most_keeps_the_name(tmp_path: Path) -> None:
    """The first copy was taken, also where it was of another person or nearly empty."""
    one, two = make_markers(), make_markers()
    one.visible[1:] = False
    both = replace(
        one,
        marker_names=NAMES * 2,
        positions=np.concatenate((one.positions, two.positions), 1),
        visible=np.concatenate((one.visible, two.visible), 1),
    )
    write_trc(tmp_path / "clip.trc", both)
    back = read_recording(tmp_path / "clip.trc")
    assert isinstance(back, MarkerRecording)
    assert back.marker_names == (*(f"{name}#2" for name in NAMES), *NAMES)
    assert back.decisions[-1].startswith("labels that repeat: 4 (LFHD, ...); those of copy 2")


def test_labels_without_prefix_beside_a_subject_are_another_person(tmp_path: Path) -> None:
    """The prefix was cut off, and the other person was taken, though seen in fewer frames."""
    data = (NAMES[0], *(f"Ann:{name}" for name in NAMES[:3]))
    write_c3d(tmp_path / "clip.c3d", make_markers())
    raw = (tmp_path / "clip.c3d").read_bytes()
    for old, new in zip((f"Ann:{name}" for name in NAMES), data, strict=True):
        raw = raw.replace(old.encode().ljust(8), f"{new:8}".encode(), 1)
    (tmp_path / "clip.c3d").write_bytes(raw)
    back = read_recording(tmp_path / "clip.c3d")
    assert isinstance(back, MarkerRecording)
    assert back.marker_names == data


def test_selecting_markers_keeps_order_and_names_the_missing() -> None:
    markers = make_markers()
    chosen = markers.select(["LHEE", "LFHD"])
    assert np.array_equal(chosen.positions[:, 1], markers.positions[:, 0])
    with pytest.raises(ValueError, match="NOSE"):
        markers.select(["NOSE"])
    assert markers.window(1, 3).frames == 2


def test_matlab_structs(tmp_path: Path) -> None:
    from scipy.io import savemat

    markers = make_markers()
    values = np.where(markers.visible[..., None], markers.positions * 1000, np.nan)
    struct = {
        "data": values.reshape(len(values), -1),
        "markerName": np.array(NAMES, dtype=object)[:, None],
        "freq": 100,
    }
    savemat(tmp_path / "one.mat", {"walk": struct, "other": 3})
    back = read_recording(tmp_path / "one.mat")
    assert isinstance(back, MarkerRecording)
    assert back.marker_names == NAMES
    assert np.abs(back.positions - markers.positions).max() < 1e-9  # m
    savemat(tmp_path / "two.mat", {"walk": struct, "run": struct})
    with pytest.raises(ValueError, match="run, walk"):
        read_recording(tmp_path / "two.mat")
    assert read_recording(f"{tmp_path / 'two.mat'}::run").frames == 5


def test_vax_numbers() -> None:
    """1.0, -0.5 and 0 as a DEC processor wrote them."""
    data = bytes.fromhex("80400000" + "00c00000" + "00000000")
    assert vax_floats(data, 85).tolist() == [1.0, -0.5, 0.0]


@pytest.mark.parametrize(
    "file",
    ["bmc/Gait.c3d", "cmu_c3d/02_05.c3d", "cmu_c3d/06_01.c3d", "pycgm/RoboStatic.c3d"],
)
def test_c3d_agrees_with_ezc3d(data: Path, file: str) -> None:
    import ezc3d

    path = data / "observations" / file
    theirs = ezc3d.c3d(str(path))["data"]["points"][:3].transpose(2, 1, 0) / 1000
    mine = read_recording(path, up="z")
    assert isinstance(mine, MarkerRecording)
    theirs = theirs[:, : mine.positions.shape[1]]
    seen = np.isfinite(theirs).all(-1)
    assert np.array_equal(mine.visible, seen)
    assert np.abs(mine.positions - theirs)[seen].max() < 1e-9  # m

"""Files as spreadsheets, scripts and depth cameras save them: read, or refused by their fault."""

from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

from recon.body.model import BodyModel
from recon.core.errors import FormatError, ReconError
from recon.core.layouts import keypoint_names
from recon.core.units import METRES
from recon.detections.reader import read_keypoints
from recon.formats.json_files import read_json
from recon.formats.scans import read_scans
from recon.keypoints3d.reader import holds_points_3d, read_points_3d
from recon.mocap.bvh import parse_bvh
from recon.mocap.reader import read_recording
from recon.reading.keypoints3d import points_in_metres
from tests.formats.producer_files import points
from tests.keypoint_scene import camera, figure, image, write_openpose

NAMES = keypoint_names("coco17")
POINTS = points("coco17")
ENDS = [f"{name}_{axis}" for name in NAMES for axis in "xyz"]


def table(header=tuple(ENDS), sep=",", values=POINTS, units=()) -> str:
    rows = [[f"{v:.4f}" for v in frame.ravel()] for frame in values]
    return "".join(sep.join(row) + "\n" for row in [header, *([units] if units else []), *rows])


TABLES = {
    "bars": table(sep="|"),
    "spaces": table(sep=" "),
    "comments": "# by a laboratory\n#\n" + table(),
    "header of numpy.savetxt": "# written by numpy\n# " + table(),
    "brackets": table([f"{name} ({axis})" for name in NAMES for axis in "xyz"]),
    "unit in names": table([f"{end} [mm]" for end in ENDS], values=1000 * POINTS),
    "axis first": table([f"{axis}_{name}" for name in NAMES for axis in "xyz"]),
    "row of units": table(units=["m"] * len(ENDS)),
}


@pytest.mark.parametrize("kind", TABLES)
@pytest.mark.parametrize("ending", [".csv", ".tsv", ".txt"])
def test_tables_of_points_are_read_however_they_are_written(tmp_path, kind, ending):
    """Columns were there and the message asked for them."""
    path = tmp_path / f"a{ending}"
    path.write_text(TABLES[kind])
    assert holds_points_3d(path)
    file = points_in_metres(read_points_3d(path), BodyModel.load(), fps=30.0)
    assert file.names == NAMES
    np.testing.assert_allclose(file.positions, POINTS, atol=1e-4)


def test_tables_in_utf_32_are_read(tmp_path):
    (tmp_path / "a.csv").write_bytes(table().encode("utf-32"))
    assert read_points_3d(tmp_path / "a.csv").names == NAMES


def test_a_table_without_rows_says_so(tmp_path):
    (tmp_path / "a.csv").write_text(table(values=POINTS[:0]))
    with pytest.raises(ReconError, match="row for every frame"):
        read_points_3d(tmp_path / "a.csv")


@pytest.mark.parametrize("code", [-9999.0, -1.0, 3.4e38])
def test_a_number_that_stands_for_no_point_is_no_place(tmp_path, code):
    """The ground was sought at -9999 m."""
    values = POINTS.copy()
    values[1, :4] = code
    (tmp_path / "a.csv").write_text(table(values=values))
    found = read_points_3d(tmp_path / "a.csv")
    unseen = np.isnan(found.positions).all(-1)
    assert unseen[1, :4].all()
    assert unseen.sum() == 4
    assert "4 points" in found.decisions[-1]


@pytest.mark.parametrize("stamp", ["00:01:{:09.6f}", "2026-03-01T10:00:{:09.6f}"])
def test_times_of_day_are_times(tmp_path, stamp):
    lines = table().splitlines()
    rows = [f"{stamp.format(k / 25)},{line}" for k, line in enumerate(lines[1:])]
    (tmp_path / "a.csv").write_text("\n".join([f"time,{lines[0]}", *rows]))
    assert read_points_3d(tmp_path / "a.csv").fps == 25.0


@pytest.mark.parametrize("unit", ["ft", "inch"])
def test_points_in_feet_are_refused_with_their_unit(tmp_path, unit):
    (tmp_path / "a.csv").write_text(table(values=POINTS / METRES[unit]))
    raw = read_points_3d(tmp_path / "a.csv")
    with pytest.raises(ReconError, match=f"--unit {unit}"):
        points_in_metres(raw, BodyModel.load(), fps=30.0)
    spelled = {"ft": "feet", "inch": "inches"}[unit]
    file = points_in_metres(raw, BodyModel.load(), fps=30.0, unit=spelled)
    np.testing.assert_allclose(file.positions, POINTS, atol=1e-3)


def cloud(path: Path, values: np.ndarray) -> None:
    head = f"ply\nformat ascii 1.0\nelement vertex {len(values)}\n"
    head += "".join(f"property float {axis}\n" for axis in "xyz") + "end_header\n"
    path.write_text(head + "".join("{} {} {}\n".format(*row) for row in values.tolist()))


@pytest.fixture
def person() -> np.ndarray:
    return BodyModel.load().template[::10].double().numpy()


@pytest.mark.parametrize("invalid", [np.nan, 0.0])
def test_pixels_without_depth_and_frames_without_points_are_no_damage(tmp_path, person, invalid):
    """Zeros moved the clouds' ends; an empty frame was called a damaged file."""
    cloud(tmp_path / "0.ply", np.concatenate((person, np.full((500, 3), invalid))))
    cloud(tmp_path / "1.ply", person[:0])
    cloud(tmp_path / "2.ply", person)
    found = read_scans(tmp_path, fps=30.0, up="z", outliers=None)
    assert np.bincount(found.frame).tolist() == [len(person), 0, len(person)]


def test_decimal_commas_in_clouds_are_points(tmp_path, person):
    """Every number became two, and the unit was asked for."""
    for mark in "; ":
        rows = [mark.join(f"{v:.5f}".replace(".", ",") for v in row) for row in person]
        (tmp_path / "0.xyz").write_text("\n".join(rows))
        found = read_scans(tmp_path, fps=30.0, up="z", outliers=None)
        np.testing.assert_allclose(np.ptp(found.points, 0), np.ptp(person, 0), atol=1e-4)


BVH = """HIERARCHY
ROOT Hips
{{
  OFFSET 0 90,0 0
  CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
  JOINT Spine
  {{ OFFSET 0 40,0 0 CHANNELS 3 Zrotation Xrotation Yrotation
    End Site
    {{ OFFSET 0 30,0 0 }}
  }}
}}
MOTION
Frames: 2
Frame Time: {}
0 90,0 0 0 0 0 0 0 0
0 90,0 0 0 0 0 {} 0 0
""".replace(" CHANNELS 3", "\n    CHANNELS 3")


def test_bvh_with_decimal_commas_or_small_keywords_is_read():
    for text in (BVH.format("0,04", "20,0"), BVH.replace(",", ".").format("0.04", "20.0").lower()):
        found = parse_bvh(text, "a.bvh", unit="cm", up="y")
        assert found.fps == 25.0
        assert np.isclose(found.positions[0, 0, 2], 0.9)


@pytest.mark.parametrize("step", ["33.333", "30"])
def test_bvh_that_counts_in_milliseconds_or_hertz_is_refused(step):
    """30 frames lasted for a quarter of an hour."""
    with pytest.raises(ReconError, match=r"Frame Time.*seconds"):
        parse_bvh(BVH.replace(",", ".").format(step, "20.0"), "a.bvh", unit="cm", up="y")


def test_bvh_in_radians_is_told():
    for angle, told in (("1.5", True), ("20.0", False)):
        text = BVH.replace(",", ".").format("0.04", angle)
        found = parse_bvh(text, "a.bvh", unit="cm", up="y")
        assert ("radians" in " ".join(found.decisions)) == told


def test_files_that_systems_hide_are_no_frames(tmp_path):
    """macOS writes ._NAME beside NAME, which was taken for the same frame of another camera."""
    people = [image(figure("openpose25"), camera(0.0))]
    folder = write_openpose(tmp_path / "view", [people, people])
    (folder / "._view_000000000000_keypoints.json").write_bytes(b"\0\5\x16\7")
    (folder / ".DS_Store").write_bytes(b"\0")
    assert read_keypoints(folder).frame.tolist() == [0, 1]


def test_keypoints_without_confidences_or_with_none_above_zero(tmp_path):
    pixels = image(figure("coco17"), camera(0.0))[:, :2]
    lines = [
        ["scorer", *["net"] * 34],
        ["bodyparts", *np.repeat(NAMES, 2)],
        ["coords", *["x", "y"] * 17],
    ]
    lines += [[str(k), *(f"{v:.2f}" for v in pixels.ravel())] for k in range(3)]
    (tmp_path / "a.csv").write_text("".join(",".join(line) + "\n" for line in lines))
    assert (read_keypoints(tmp_path / "a.csv").confidence == 1.0).all()
    np.savez(tmp_path / "a.npz", keypoints=pixels[None], scores=np.zeros((1, 17)))
    with pytest.raises(ReconError, match="confidence above zero"):
        read_keypoints(tmp_path / "a.npz")


def test_json_with_a_value_on_every_line_is_not_called_damaged(tmp_path):
    """OpenPifPaf's file of a film, a value per frame on its line, was called damaged."""
    line = '{"frame": 1, "predictions": []}\n'
    (tmp_path / "a.json").write_text(line * 3)
    with pytest.raises(FormatError, match="several follow each other"):
        read_json(tmp_path / "a.json")
    (tmp_path / "a.json").write_text(line + "}")
    with pytest.raises(FormatError, match="it is damaged"):
        read_json(tmp_path / "a.json")


def test_matlab_files_without_a_recording_say_what_to_export(tmp_path):
    """Qualisys' and MoVi's .mat files were said to hold "the recordings (none)"."""
    savemat(tmp_path / "a.mat", {"walk": {"Frames": 3.0, "Trajectories": {"Labeled": np.ones(3)}}})
    with pytest.raises(FormatError, match=r"MoCap Toolbox.*C3D or TSV"):
        read_recording(tmp_path / "a.mat")

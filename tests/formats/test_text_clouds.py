"""Clouds as text (.xyz, .pts, .csv, ...) as other programs write them, and damaged."""

import numpy as np
import pytest

import recon
from recon.core.errors import ReconError
from recon.formats.producers import POINTS_3D, producer_of
from recon.formats.scans import read_cloud, read_scans
from recon.view.info import info

POINTS = np.random.default_rng(0).uniform(-1, 1, (240, 3)).round(6)
ROWS = [" ".join(f"{value:.10f}" for value in row) for row in POINTS]
TEXTS = {
    "a.xyz": "\n".join([*ROWS, ""]),
    "b.xyz": "//X,Y,Z,R,G,B\r\n" + "\r\n".join(f"{row.replace(' ', ',')},1,2,3" for row in ROWS),
    "a.xyzn": "\n".join(f"{row} 0 0 1" for row in ROWS),
    "a.xyzrgb": "\n".join(f"{row} 0.1 0.2 0.3" for row in ROWS),
    "a.csv": "x,y,z\n" + "\n".join(row.replace(" ", ",") for row in ROWS),
    "b.csv": "\n".join(f"{row} 1 2 3".replace(" ", ",") for row in ROWS),
    "a.txt": "# x y z\n" + "\n".join(ROWS),
    "b.txt": "\n".join([*ROWS, ""]),
    "a.pts": "240\n" + "\n".join(f"{row} 0.0 70 117 234" for row in ROWS) + "\n",
}


@pytest.mark.parametrize("name", TEXTS)
def test_points_of_text(tmp_path, name):
    (tmp_path / name).write_bytes(TEXTS[name].encode())
    assert np.allclose(read_cloud(tmp_path / name), POINTS)
    found = read_scans(tmp_path, fps=30.0, unit="m", up="z", outliers=None)
    assert np.allclose(found.points, POINTS)


@pytest.mark.parametrize(
    "text",
    [
        "1 2\n3 4\n", "1 2 3\n4 five 6\n", "1 2 3\n4 5\n", "41\n" + TEXTS["a.xyz"], "7", "",
        "1 2 3 " * 4000 + "\n" * 4000 + "1", "1" + " " * 1_000_000, "1" + "\n" * 1_000_000 + "2,5",
    ],
)  # fmt: skip
def test_damaged_text_is_refused_by_name(tmp_path, text):
    (tmp_path / "bad.pts").write_text(text)
    with pytest.raises(ReconError, match=r"bad\.pts"):
        read_cloud(tmp_path / "bad.pts")


@pytest.mark.parametrize("name", TEXTS)
def test_damage_ends_in_an_error_or_in_finite_points(tmp_path, name):
    """Open3D passes over lines that it cannot read, and gives fewer points or zeros in silence."""
    random, whole = np.random.default_rng(0), TEXTS[name].encode()
    path = tmp_path / name
    for trial in range(28):
        damaged = bytearray(whole)
        if trial % 2:
            for place in random.integers(0, len(whole), 1 + trial // 2):
                damaged[place] = random.integers(0, 256)
        else:
            damaged = damaged[: random.integers(0, len(whole) - 20)]
        path.write_bytes(damaged)
        said, found = name, np.zeros((0, 3))
        try:
            found = read_cloud(path)
        except ReconError as error:
            said = str(error)
        assert name in said
        assert found.shape[1] == 3
        assert np.isfinite(found).all()


@pytest.mark.parametrize("name", [name for name in TEXTS if name[-4:] in (".csv", ".txt")])
def test_folders_of_tables_or_arrays_of_points_are_scans_for_every_verb(tmp_path, name):
    """They were keypoints in space for one verb, detections for another, unknown for a third."""
    folder = tmp_path / "clouds"
    folder.mkdir()
    for k in range(3):
        (folder / f"{k}{name[1:]}").write_text(TEXTS[name])
    assert info(folder)["frames"] == 3
    assert len(read_scans(folder, fps=30.0, unit="m", up="z", outliers=None).points) == 720
    with pytest.raises(ReconError, match="scans: `recon fit` takes it"):
        recon.convert(folder)
    for verb in (info, recon.fit, recon.convert):
        with pytest.raises(ReconError, match="give the folder"):
            verb(folder / f"0{name[1:]}")


@pytest.mark.parametrize(
    "array", [POINTS.reshape(60, 4, 3), POINTS.T, POINTS.ravel().view("f8,f8,f8")]
)
def test_arrays_of_clouds_of_other_shapes_are_told_the_expected_one(tmp_path, array):
    """They were said to be keypoints, of which one file is to be given."""
    for k in range(2):
        np.save(tmp_path / f"{k}.npy", array)
    with pytest.raises(ReconError, match=r"numbers \(points, 3\), but 0.npy .*shape"):
        recon.fit(tmp_path, frame_rate=30.0)


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("a.csv", "x,y,z,joint,frame\n" + "1.0,1.0,1.0,nose,0\n" * 40),
        ("a.csv", "left_hip_x,left_hip_y,left_hip_z\n" + "1.0,1.0,1.0\n" * 40),
        ("a.txt", "0 0.5 0.5 0.2 0.2\n" * 40),
        ("a.txt", "1.5 0 0 0 0 0 0 1\n" * 40),
    ],
)
def test_tables_of_other_things_are_no_clouds(tmp_path, name, text):
    (tmp_path / name).write_text(text)
    found = producer_of(tmp_path / name)
    assert found is None or found.holds == POINTS_3D

"""The same recording as several producers write it: dialects, gaps, line ends, units, rates."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import recon


@pytest.fixture(scope="module")
def truth(whole: Path) -> np.ndarray:
    """Joints of the conversion of the whole C3D file, metres."""
    return recon.convert(whole / "walk.c3d").joints.numpy()


def _changed(path: Path, out: Path, change: Callable[[Any], None]) -> Path:
    """A C3D file after a change of its contents by ezc3d."""
    import ezc3d

    file = ezc3d.c3d(str(path))
    change(file)
    file["header"]["points"]["last_frame"] = file["data"]["points"].shape[-1] - 1
    file.write(str(out))
    return out


def _units(unit: str, metres: float) -> Callable[[Any], None]:
    def change(file: Any) -> None:
        file["parameters"]["POINT"]["UNITS"]["value"] = [unit]
        file["data"]["points"][:3] *= 0.001 / metres

    return change


def _prefixed(file: Any) -> None:
    labels = file["parameters"]["POINT"]["LABELS"]
    labels["value"] = [f"Anna:{name}" for name in labels["value"]]


C3D = {
    "centimetres": _units("cm", 0.01),
    "metres": _units("m", 1.0),
    "units in capitals": _units("MM", 0.001),
    "subject before the label": _prefixed,
}


@pytest.mark.parametrize("name", C3D)
def test_a_c3d_says_the_same_in_other_words(
    whole: Path, tmp_path: Path, truth: np.ndarray, name: str
) -> None:
    path = _changed(whole / "walk.c3d", tmp_path / "a.c3d", C3D[name])
    assert np.abs(recon.convert(path).joints.numpy() - truth).max() < 1e-3


@pytest.mark.parametrize("gap", ["zeros", "nan", "frozen", "residual"])
def test_gaps_are_gaps_however_they_are_written(
    whole: Path, tmp_path: Path, truth: np.ndarray, gap: str
) -> None:
    """Ten frames of three markers of the leg; zeros and frozen places were taken for places."""

    def change(file: Any) -> None:
        names = file["parameters"]["POINT"]["LABELS"]["value"]
        points = file["data"]["points"]
        for row in map(names.index, ("LKNE", "LTIB", "LANK")):
            if gap == "zeros":
                points[:3, row, 12:22] = 0.0
            elif gap == "nan":
                points[:3, row, 12:22] = np.nan
            elif gap == "frozen":
                points[:3, row, 12:22] = points[:3, row, 11:12]
            else:
                file["data"]["meta_points"]["residuals"][0, row, 12:22] = -1.0

    path = _changed(whole / "walk.c3d", tmp_path / "a.c3d", change)
    found = recon.convert(path)
    away = np.linalg.norm(found.joints.numpy() - truth, axis=-1)
    assert away.mean() < 0.01
    assert away.max() < 0.1


def _spelt(text: str, name: str) -> bytes:
    match name:
        case "crlf":
            return text.replace("\n", "\r\n").encode()
        case "mark of utf-8":
            return b"\xef\xbb\xbf" + text.encode()
        case "spaces at the ends of lines":
            return text.replace("\n", "  \n").encode()
        case _:
            return (text + "\n\n").encode()


SPELT = ("crlf", "mark of utf-8", "spaces at the ends of lines", "empty lines at the end")


@pytest.mark.parametrize("spelling", SPELT)
def test_a_trc_is_read_in_any_spelling(
    whole: Path, tmp_path: Path, truth: np.ndarray, spelling: str
) -> None:
    text = (whole / "walk.trc").read_text()
    (tmp_path / "a.trc").write_bytes(_spelt(text, spelling))
    assert np.abs(recon.convert(tmp_path / "a.trc").joints.numpy() - truth).max() < 2e-3


def test_a_bvh_is_read_in_any_spelling(whole: Path, tmp_path: Path) -> None:
    """Dialects in one file: line ends of Windows, tabs, small letters, no spaces around braces."""
    text = (whole / "walk.bvh").read_text()
    other = text.replace("  ", "\t").replace("ROOT", "ROOT ").replace("\n", "\r\n")
    other = other.replace("Xrotation", "xrotation").replace("Frame Time:", "Frame Time :")
    (tmp_path / "a.bvh").write_bytes(other.encode())
    found = recon.evaluate(recon.convert(tmp_path / "a.bvh"), whole / "short.npz")
    assert found["joints_all"] is not None
    assert found["joints_all"] < 0.02


def test_times_tell_the_rate_where_the_header_is_wrong(whole: Path, tmp_path: Path) -> None:
    """A TRC file that says 300 Hz over rows of 30 Hz."""
    lines = (whole / "walk.trc").read_text().split("\n")
    lines[2] = "\t".join(["300.00", "300.00", *lines[2].split("\t")[2:]])
    (tmp_path / "a.trc").write_text("\n".join(lines))
    assert recon.convert(tmp_path / "a.trc").motion.fps == pytest.approx(30.0)

"""Copies of C3D files with other names of points keep everything else."""

import runpy
from pathlib import Path

import numpy as np
import pytest

from recon.core.errors import FormatError
from recon.mocap.c3d import read_c3d
from recon.mocap.c3d_copy import write_renamed_c3d
from recon.mocap.force_plates import read_analog

FILES = (
    "biomechzoo/HC002D06.c3d", "bmc/Gait.c3d", "vendors/btk_DEC_INT.C3D",
    "vendors/btk_sgi_real.c3d",
)  # fmt: skip


@pytest.mark.parametrize("file", FILES)
def test_only_points_change(data: Path, tmp_path: Path, file: str) -> None:
    source, out = data / "observations" / file, tmp_path / "out.c3d"
    read = read_c3d(source)
    count = len(read.marker_names)
    columns = np.tile(np.random.default_rng(0).permutation(count), (read.frames, 1))
    columns[read.frames // 2 :, [0, 1]] = columns[read.frames // 2 :, [1, 0]]
    columns = np.concatenate((columns, np.full((read.frames, 1), -1)), 1)
    names = tuple(f"N{k}" for k in range(count + 1))
    write_renamed_c3d(out, source, names, columns)
    again = read_c3d(out).select(names)
    frame = np.arange(read.frames)[:, None]
    assert np.array_equal(again.visible, (columns >= 0) & read.visible[frame, columns])
    expected = np.where(again.visible[..., None], read.positions[frame, columns], 0.0)
    assert np.array_equal(again.positions, expected)
    assert (again.fps, again.start_time) == (read.fps, read.start_time)
    first, then = read_analog(source), read_analog(out)
    assert np.array_equal(first.values, then.values)
    for group, parameters in first.groups.items():
        for key, value in parameters.items():
            if (group, key.rstrip("0123456789")) not in [
                ("POINT", word) for word in ("USED", "DATA_START", "LABELS", "DESCRIPTIONS")
            ]:
                assert np.array_equal(value, then.groups[group][key]), f"{group}:{key}"


def test_a_file_of_ezc3d_is_copied(tmp_path: Path) -> None:
    """Every file that ezc3d wrote was refused, since it has a group ROTATION without rotations."""
    pytest.importorskip("ezc3d")
    example = Path(__file__).parents[2] / "examples" / "05_c3d.py"
    source = runpy.run_path(str(example))["written"](tmp_path / "in.c3d")
    out = tmp_path / "out.c3d"
    read = read_c3d(source)
    names = tuple(f"N{name}" for name in read.marker_names)
    write_renamed_c3d(out, source, names, np.tile(np.arange(len(names)), (read.frames, 1)))
    again = read_c3d(out)
    assert again.marker_names == names
    assert np.array_equal(again.positions, read.positions)


def test_a_file_with_poses_of_segments_is_refused(data: Path, tmp_path: Path) -> None:
    source = data / "observations/vendors/ez_C3DRotationExample.c3d"
    with pytest.raises(FormatError, match="rotations"):
        write_renamed_c3d(tmp_path / "out.c3d", source, ("A",), np.zeros((1, 1), int))

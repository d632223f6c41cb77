"""Reads MATLAB files of the MoCap Toolbox: structs with `data`, `markerName` and `freq`."""

import io
import os
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np

from recon.core.errors import FormatError
from recon.core.limits import BINARY, JOINTS, SAMPLES
from recon.core.units import Up
from recon.formats.opening import existing_file
from recon.mocap.recording import MarkerRecording, markers_in_metres, stated_rate

_READER = Path(__file__).with_name("mat_process.py")
_ONE = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
"""Threads of algebra, of which reading needs none, take memory by their number."""
_TIMEOUT_S = 120.0
"""Seconds that reading may take; `mat_process` ends sooner when it computes all the time."""


def read_mat(
    path: Path, variable: str | None = None, *, unit: str | None = None, up: Up | None = None
) -> MarkerRecording:
    """Read a recording of a .mat file, by name if the file has several.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: when it holds no such recording, or its unit or up axis cannot be told.
    """
    arrays = _read_in_other_process(existing_file(path))
    found = sorted({key.split("/")[0] for key in arrays})
    if not found:
        raise FormatError(
            f"{path}: expected a struct with data, markerName and freq, as the MoCap Toolbox has; "
            "instead of .mat files of Qualisys, MoVi and others, give their C3D or TSV files"
        )
    if variable is None and len(found) == 1:
        variable = found[0]
    if variable not in found:
        raise FormatError(
            f"{path}: holds the recordings {', '.join(found)}; choose one as {path.name}::NAME"
        )
    name = f"{path.name}::{variable}"
    labels = tuple(arrays[f"{variable}/markerName"].tolist())
    data = arrays[f"{variable}/data"]
    fps, said = stated_rate(float(arrays[f"{variable}/freq"].reshape(())), name, "freq")
    JOINTS.check(len(labels), name, "markerName")
    if data.ndim != 2 or data.shape[1] != 3 * len(labels) or len(data) == 0:
        raise FormatError(
            f"{name}: expected data of 3 columns for each of {len(labels)} markers, got "
            f"{data.shape}"
        )
    SAMPLES.check(len(data) * len(labels), name, "data")
    raw = MarkerRecording(
        name=name,
        marker_names=labels,
        positions=data.reshape(len(data), len(labels), 3),
        visible=np.ones((len(data), len(labels)), bool),
        fps=fps,
        decisions=(said,),
    )
    return markers_in_metres(raw, unit=unit, up=up, usual_up="z")


def _read_in_other_process(path: Path) -> dict[str, np.ndarray]:
    BINARY.check(path.stat().st_size, path)
    command = [sys.executable, "-P", str(_READER), str(path)]
    try:
        done = subprocess.run(
            command, capture_output=True, timeout=_TIMEOUT_S, check=True, env=os.environ | _ONE
        )
        with np.load(io.BytesIO(done.stdout), allow_pickle=False) as file:
            return dict(file)
    except (subprocess.SubprocessError, zipfile.BadZipFile, ValueError, EOFError) as error:
        trace = getattr(error, "stderr", None) or b""
        reason = (trace.decode("utf-8", "replace").strip().splitlines() or ["it crashed"])[-1]
        raise FormatError(
            f"{path}: expected a MATLAB file of version 7 or older, but reading it failed "
            f"({reason[:200]}); newer ones can be saved again with save(..., '-v7')"
        ) from error

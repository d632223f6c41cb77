"""Tables over time: OpenSim's storage of coordinates (.mot), and angles as CSV."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from jaxtyping import Float
from torch import Tensor

from recon.body.angles.isb import ISB_ANGLES, isb_angles
from recon.body.angles.opensim import MODEL_NAMES, OpenSimModel, opensim_coordinates
from recon.body.model import BodyModel
from recon.core.motion import Motion
from recon.formats.files.opening import replacing


def write_mot(path: Path, motion: Motion, body: BodyModel, model: OpenSimModel) -> None:
    """Write the coordinates of an OpenSim model: degrees, metres, on the motion's own clock.

    Args:
        path: file to write.
        motion: one clip without a batch axis.
        body: whose motion it is; the bundled one.
        model: whose coordinates are written.

    Raises:
        ValueError: when the body is another one.
    """
    columns = opensim_coordinates(motion, body, model)
    header = [
        f"Coordinates of {MODEL_NAMES[model]}",
        "version=1",
        f"nRows={motion.frames}",
        f"nColumns={len(columns) + 1}",
        "inDegrees=yes",
        "endheader",
        "\t".join(("time", *columns)),
    ]
    _write(path, header, motion, columns, "\t")


def write_angles(
    path: Path,
    motion: Motion,
    body: BodyModel,
    std: Float[Tensor, "time 42"] | None = None,
) -> None:
    """Write joint angles after the ISB, a row per frame: `time` in seconds, `NAME_deg` in degrees.

    Args:
        path: file to write.
        motion: one clip without a batch axis.
        body: whose motion it is; the bundled one.
        std: standard deviations of the angles in degrees, columns `NAME_std`; None leaves them
            out.

    Raises:
        ValueError: when the body is another one.
    """
    columns = {f"{name}_deg": values for name, values in isb_angles(motion, body).items()}
    if std is not None:
        known = zip(ISB_ANGLES, std.double().cpu().numpy().T, strict=True)
        columns |= {f"{name}_std": values for name, values in known}
    _write(path, [",".join(("time", *columns))], motion, columns, ",")


def _write(
    path: Path,
    header: list[str],
    motion: Motion,
    columns: Mapping[str, Float[np.ndarray, " time"]],
    separator: str,
) -> None:
    times = motion.times.double().cpu().numpy()
    rows = np.stack((times, *columns.values()), -1)
    lines = [separator.join(f"{value:.6f}" for value in row) for row in rows.tolist()]
    with replacing(path) as beside:
        beside.write_text("\n".join((*header, *lines)) + "\n", encoding="utf-8")

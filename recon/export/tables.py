"""Writes tables over time: OpenSim's coordinates (.mot), and joint angles as CSV."""

from collections.abc import Mapping
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float
from torch import Tensor

from observations.correspondences import PLACES, BodyPlace, BodyPoints
from recon.body.angles import ISB_ANGLES, isb_angles
from recon.body.landmarks import landmarks
from recon.body.marker_labels import marker_sets
from recon.body.model import BodyModel
from recon.body.opensim import MODEL_NAMES, OpenSimModel, opensim_coordinates
from recon.core.errors import ReconError
from recon.core.motion import Motion
from recon.core.skeleton import JOINTS
from recon.formats.replacing import write_text
from recon.mocap.recording import MarkerRecording


def write_mot(path: Path, motion: Motion, body: BodyModel, model: OpenSimModel) -> None:
    """Write the coordinates of an OpenSim model in degrees and metres, at the motion's times.

    Args:
        path: file to write.
        motion: one clip without a batch axis.
        body: the body model of the motion; the bundled one.
        model: the OpenSim model whose coordinates are written.

    Raises:
        ValueError: when the body is another one.
    """
    columns = opensim_coordinates(motion, body, model)
    write_storage(path, f"Coordinates of {MODEL_NAMES[model]}", motion, columns, degrees=True)


def write_angles(
    path: Path,
    motion: Motion,
    body: BodyModel,
    std: Float[Tensor, "time 42"] | None = None,
) -> None:
    """Write ISB joint angles, a row per frame: `time` in seconds, `NAME_deg` in degrees.

    Args:
        path: file to write.
        motion: one clip without a batch axis.
        body: the body model of the motion; the bundled one.
        std: standard deviations of the angles in degrees, columns `NAME_std`; None leaves them
            out.

    Raises:
        ValueError: when the body is another one.
    """
    columns = {f"{name}_deg": values for name, values in isb_angles(motion, body).items()}
    if std is not None:
        known = zip(ISB_ANGLES, std.double().cpu().numpy().T, strict=True)
        columns |= {f"{name}_std": values for name, values in known}
    _write_table(path, [",".join(("time", *columns))], motion, columns, ",")


def write_storage(
    path: Path,
    title: str,
    motion: Motion,
    columns: Mapping[str, Float[np.ndarray, " time"]],
    *,
    degrees: bool = False,
) -> None:
    """Write columns over the motion's times as OpenSim's storage, or as CSV to a path of .csv.

    Args:
        path: file to write; .csv has no header but the names of the columns.
        title: first line of a storage.
        motion: the motion whose times the rows have.
        columns: numbers of every frame, by name.
        degrees: whether angles are in degrees.
    """
    if path.suffix.lower() == ".csv":
        _write_table(path, [",".join(("time", *columns))], motion, columns, ",")
        return
    header = [
        title,
        "version=1",
        f"nRows={motion.frames}",
        f"nColumns={len(columns) + 1}",
        f"inDegrees={'yes' if degrees else 'no'}",
        "endheader",
        "\t".join(("time", *columns)),
    ]
    _write_table(path, header, motion, columns, "\t")


def _write_table(
    path: Path,
    header: list[str],
    motion: Motion,
    columns: Mapping[str, Float[np.ndarray, " time"]],
    separator: str,
) -> None:
    times = motion.times.double().cpu().numpy()
    rows = np.stack((times, *columns.values()), -1)
    lines = [separator.join(f"{value:.6f}" for value in row) for row in rows.tolist()]
    write_text(path, "\n".join((*header, *lines)) + "\n")


MarkerSetName = Literal["joints", "halpe26", "opencap", "pig", "cmu", "bsm"]
"""`joints` are the 22 joints of the body; the others stand in `assets/marker_sets.toml`."""


def recorded_markers(
    motion: Motion, body: BodyModel, markers: MarkerSetName, name: str
) -> MarkerRecording:
    """Compute the positions of a marker set on the moving body in every frame of a motion.

    They lie on the skin; real markers stand about a centimetre off it.

    Args:
        motion: one clip without a batch axis.
        body: the body model of the motion.
        markers: the set.
        name: of the recording.

    Raises:
        ValueError: when the set lies on the skin of the bundled body, and the body is another one.
    """
    posed = body.pose(motion)
    if markers == "joints":
        labels, positions = JOINTS, posed.joints
    else:
        points = BodyPoints.of_places(body_places_of_markers(markers), body)
        if not bool(points.known.all()):
            raise ReconError(
                f"markers of {markers!r} lie on the skin of the bundled body; on {body.name!r} "
                "their places are unknown: take --markers joints"
            )
        labels, positions = points.names, points.of(posed)
    places = positions.detach().double().cpu().numpy()
    return MarkerRecording(
        name=name,
        marker_names=labels,
        positions=places,
        visible=np.ones(places.shape[:2], dtype=bool),
        fps=motion.fps,
        decisions=(),
        start_time=motion.start_time,
    )


def body_places_of_markers(markers: str) -> dict[str, BodyPlace]:
    """Return the place on the body of every marker of a marker set, keyed by label."""
    known = landmarks()
    return {
        label: BodyPlace(landmarks=(point,)) if point in known else PLACES[point]
        for label, point in marker_sets()[markers].items()
    }

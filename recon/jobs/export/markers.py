"""Markers on the body, with the labels of marker sets that OpenSim models have."""

import tomllib
from functools import cache
from importlib.resources import files
from typing import Literal, cast

import numpy as np

from observations.correspondences import PLACES, BodyPlace, BodyPoints
from recon.body.landmarks import landmarks
from recon.body.model import BodyModel
from recon.core.errors import ReconError
from recon.core.motion import Motion
from recon.core.skeleton import JOINTS
from recon.formats.mocap.recording import MarkerRecording

MarkerSetName = Literal["joints", "halpe26", "opencap", "pig", "bsm"]
"""`joints` are the 22 joints of the body; the others stand in `assets/marker_sets.toml`."""


def markers_of(
    motion: Motion, body: BodyModel, markers: MarkerSetName, name: str
) -> MarkerRecording:
    """The markers of a set on a moving body, always seen, on the motion's own clock.

    They lie on the skin; real markers stand about a centimetre off it.

    Args:
        motion: one clip without a batch axis.
        body: whose motion it is.
        markers: the set.
        name: of the recording.

    Raises:
        ValueError: when the set lies on the skin of the bundled body, and the body is another one.
    """
    posed = body.pose(motion)
    if markers == "joints":
        labels, positions = JOINTS, posed.joints
    else:
        points = BodyPoints.of_places(places_of(markers), body)
        if not bool(points.known.all()):
            raise ReconError(
                f"markers of {markers!r} lie on the skin of the bundled body; on {body.name!r} "
                "nobody knows where: take --markers joints"
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


def places_of(markers: str) -> dict[str, BodyPlace]:
    """The place on the body of every label of a marker set, in the order of the set."""
    known = landmarks()
    return {
        label: BodyPlace(landmarks=(point,)) if point in known else PLACES[point]
        for label, point in _sets()[markers].items()
    }


@cache
def _sets() -> dict[str, dict[str, str]]:
    text = files("recon").joinpath("assets", "marker_sets.toml").read_text(encoding="utf-8")
    return cast("dict[str, dict[str, str]]", tomllib.loads(text))

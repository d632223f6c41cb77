"""Makes a marker sensor of a recording, for fits under a prior.

A fit of the body to the markers, as for a conversion, gives each marker's offset from the skin and
its standard deviation, since soft tissue moves and no body has exactly the model's surface.
"""

from functools import partial
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float

from observations.markers3d import Markers3D
from observations.noise import LIMITS
from recon.body.model import BodyModel
from recon.core.residuals import geman_mcclure, squared
from recon.core.skeleton import FEET
from recon.core.units import Hand
from recon.diagnosis.findings import listed
from recon.ingest.marker_conversion import FittedMarkers, fitted_markers
from recon.ingest.marker_findings import marker_distances
from recon.ingest.marker_fit import ground_is_zero
from recon.ingest.marker_sets import right_handed_markers
from recon.ingest.marker_unnamed import placed_markers
from recon.mocap.recording import MarkerRecording
from recon.solver.solution import one_thread


def seen_markers(
    recording: MarkerRecording,
    body: BodyModel,
    mapping: Path | None = None,
    robust: float | None = None,
    hand: Hand | None = None,
) -> tuple[Markers3D, tuple[str, ...]]:
    """Return the known markers of a recording as a sensor, and notes on how they were read.

    Their offsets from the skin are those of the best fitting body, and their standard deviations
    its residuals, at least a centimetre: below that, the body errs more than markers.

    Args:
        recording: in metres, z up.
        body: the body model on whose surface the markers sit.
        mapping: JSON or TOML file, marker label = landmark or vertex; None uses known labels. Of
            points without names it is as in `placed_markers`.
        robust: distance in metres beyond which a marker counts ever less; None is least squares.
        hand: handedness of the axes; None finds it by the body.

    Raises:
        FileNotFoundError: when there is no such mapping file.
        ValueError: when the markers are not known, or cover neither legs nor trunk.
    """
    with one_thread():
        recording, markers = placed_markers(recording, body, mapping)
        recording = right_handed_markers(recording, markers, hand)
        found = fitted_markers(recording, body, markers)
    shown, fit = found.recording, found.fit
    offsets = fit.offsets
    grounded = bool(fit.observed[:, list(FEET)].any()) and ground_is_zero(shown)
    seen = Markers3D(
        torch.from_numpy(shown.positions).float()[None],
        torch.from_numpy(shown.visible)[None],
        markers.vertices,
        shown.fps,
        shown.start_time,
        squared if robust is None else partial(geman_mcclure, sigma=robust),
        ground_known=grounded,
        std=_standard_deviations(found),
        offsets=offsets,
        labels=shown.marker_names,
    )
    ground = (
        "ground: z = 0, as the lowest markers are those of feet"
        if grounded
        else "ground: its height is estimated, as no marker of a foot is near z = 0"
    )
    bare = (
        (f"no marker on {listed(markers.bare)}: the prior infers where these parts are",)
        if markers.bare
        else ()
    )
    changed = tuple(finding.message for finding in (*found.warnings, *found.repairs))
    return seen, (*found.decisions, ground, *bare, *changed)


def _standard_deviations(found: FittedMarkers) -> Float[np.ndarray, " markers"]:
    """Return the standard deviation (m) of each marker's coordinates about its fitted position."""
    seen = found.recording.visible
    square = np.where(seen, np.square(marker_distances(found.fit, found.recording)), 0.0).sum(
        0
    ) / seen.sum(0).clip(min=1)
    return np.sqrt(square / 3).clip(*LIMITS)

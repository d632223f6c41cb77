"""Makes findings about markers that are far from the fitted body, stand still or sit elsewhere."""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float

from recon.diagnosis.findings import Finding, listed, stretches
from recon.ingest.marker_fit import MarkerFit
from recon.ingest.marker_sets import MarkerSet
from recon.mocap.recording import MarkerRecording

FAR = 0.15
"""Distance (m) of a marker from its fitted position beyond which it is misplaced in a frame."""
_OFTEN = 0.02
"""Share of a marker's frames in which it must be misplaced for a warning."""
_LARGE = 0.03
"""Mean residual (m) of all markers above which a recording is suspicious."""
_PLACED, _LOOSE = 0.12, 0.20
"""Largest distance (m) of a marker from where its name says, for names of points and of regions;
beyond it there is a warning."""
_STILL = 0.002
"""Largest range (m) of a coordinate of a marker that stands still in the room."""
_MOVED = 0.15
"""Least range (m) of its fitted position meanwhile, which shows that the body moves."""


def marker_residuals(fit: MarkerFit, recording: MarkerRecording) -> Mapping[str, float]:
    """Return each marker's mean distance from its fitted position where visible, millimetres."""
    away, seen = marker_distances(fit, recording), recording.visible
    frames = seen.sum(0)
    mean = (away * seen).sum(0) / frames.clip(min=1)
    return {
        label: 1000 * float(mean[marker])
        for marker, label in enumerate(recording.marker_names)
        if frames[marker] > 0
    }


def marker_findings(
    fit: MarkerFit, recording: MarkerRecording, markers: MarkerSet
) -> list[Finding]:
    """Make findings about markers that stand still, come off, or sit elsewhere than named."""
    away, seen = marker_distances(fit, recording), recording.visible
    constant = _standing_markers(fit, recording)
    far = (away > FAR) & seen
    often = far.sum(0) > _OFTEN * seen.sum(0).clip(min=1)
    offset = (fit.offsets - markers.nominal).norm(dim=-1).numpy()
    limit = np.where(markers.loose, _LOOSE, _PLACED)
    found: list[Finding] = []
    labels = recording.marker_names

    def flagged_labels(flags: np.ndarray) -> tuple[str, ...]:
        return tuple(label for label, flag in zip(labels, flags, strict=True) if flag)

    if constant.any():
        found.append(
            Finding(
                "constant point",
                f"{listed(flagged_labels(constant))} stay in one place in the room while the body "
                "moves; they hardly count, but delete or relabel them",
                flagged_labels(constant),
                value=float(constant.sum()),
            )
        )
    wild = often & ~constant
    if wild.any():
        found.append(
            Finding(
                "outliers",
                f"{listed(flagged_labels(wild))} are more than {100 * FAR:.0f} cm from their "
                f"place in up to {100 * _largest_share_far(far, seen, wild):.0f} % of frames: "
                "look for exchanged labels, ghosts and loose markers",
                flagged_labels(wild),
                stretches(np.any(far[:, wild], axis=1)),
                _largest_share_far(far, seen, wild),
            )
        )
    elsewhere = (offset > limit) & ~wild & ~constant & seen.any(0)
    if elsewhere.any():
        most = float(offset[elsewhere].max())
        found.append(
            Finding(
                "offset point",
                f"{listed(flagged_labels(elsewhere))} sit up to {100 * most:.0f} cm from where "
                "their names say: check the labels, or say where they sit with --mapping",
                flagged_labels(elsewhere),
                value=most,
            )
        )
    mean = float(away[seen].mean())
    if mean > _LARGE:
        found.append(
            Finding(
                "residual",
                f"markers are {1000 * mean:.0f} mm from the body on average: check the unit "
                "(--unit), the axes (--up, --hand) and the labels",
                value=mean,
            )
        )
    return found


def _largest_share_far(far: np.ndarray, seen: np.ndarray, chosen: np.ndarray) -> float:
    return float((far[:, chosen].sum(0) / seen[:, chosen].sum(0).clip(min=1)).max())


def _standing_markers(fit: MarkerFit, recording: MarkerRecording) -> np.ndarray:
    """Return a mask of markers that stay within millimetres while the body under them moves."""
    still = np.zeros(len(recording.marker_names), dtype=bool)
    for marker in range(len(still)):
        seen = recording.visible[:, marker]
        if seen.sum() < 2:
            continue
        x, place = recording.positions[seen, marker], fit.predicted.numpy()[seen, marker]
        still[marker] = np.ptp(x, axis=0).max() < _STILL and np.ptp(place, axis=0).max() > _MOVED
    return still


def marker_distances(
    fit: MarkerFit, recording: MarkerRecording
) -> Float[np.ndarray, "time markers"]:
    """Return each marker's distance (m) from its fitted position; meaningless where hidden."""
    return np.linalg.norm(fit.predicted.numpy() - recording.positions, axis=-1)

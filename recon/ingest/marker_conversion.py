"""Converts a recording of markers to a motion of the body model, with checks before and after."""

import dataclasses
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Bool

from recon.body.model import BodyModel
from recon.body.soles import Soles
from recon.core.errors import ReconError
from recon.core.units import Hand
from recon.diagnosis.findings import Finding, listed
from recon.diagnosis.movement import height_findings
from recon.diagnosis.tracks import identity_changes
from recon.ingest.conversion import Conversion, on_ground
from recon.ingest.marker_exchanges import (
    pair_finding,
    pairs_exchanged_throughout,
    side_pairs,
    with_exchanges_undone,
    with_labels_exchanged,
)
from recon.ingest.marker_findings import (
    FAR,
    marker_distances,
    marker_findings,
    marker_residuals,
)
from recon.ingest.marker_fit import MarkerFit, fit_markers, nominal_positions
from recon.ingest.marker_frames import jump_findings
from recon.ingest.marker_gaps import gap_findings, trimmed_recording
from recon.ingest.marker_sets import (
    MarkerSet,
    keypoint_finding,
    right_handed_markers,
)
from recon.ingest.marker_unnamed import placed_markers
from recon.mocap.recording import MarkerRecording
from recon.solver.solution import one_thread

_BAD = 0.02
"""Mean residual (m) above which other labels are tried."""
_MOSTLY = 0.5
"""Share of a marker's frames in which it must be far from the body to be left out."""
_MOST_OFFSET = 0.043
"""Largest mean distance (m) of guessed markers from usual places that is accepted, without those
that may sit anywhere on a limb: 0.02 to 0.041 where guesses were right."""
_MOST_RESIDUAL = 0.012
"""Largest mean residual (m) of guessed markers that is accepted: at most 0.008 where right."""
_TRIAL_FRAMES = 40
_BETTER = 0.6
"""Largest residual with other labels, over that with the present ones, to take them instead."""


def convert_markers(
    recording: MarkerRecording,
    body: BodyModel,
    *,
    mapping: str | Path | None = None,
    keep_frame: bool = False,
    hand: Hand | None = None,
) -> Conversion:
    """Convert a recording of markers on a body, its legs or its trunk to the model's motion.

    Labels that markers exchange in some frames are corrected first, and labels that fit no body
    after a first fit. Frames before the first and after the last with enough markers are left
    out; frames and limbs without markers in between are interpolated from their neighbours.

    Args:
        recording: in metres, z up.
        body: the body model; marker names are points of the bundled body's mesh.
        mapping: JSON or TOML file, marker label = landmark or vertex; None uses the known labels.
            Of points without names it is as in `placed_markers`.
        keep_frame: whether the motion stays where the laboratory has it instead of standing on
            z = 0.
        hand: handedness of the axes; None finds it by the body.

    Raises:
        FileNotFoundError: when there is no such mapping file.
        ValueError: when the markers are not known, or cover neither legs nor trunk.
    """
    with one_thread():
        recording, markers = placed_markers(recording, body, mapping)
        recording = right_handed_markers(recording, markers, hand)
        return _conversion_of_fit(
            fitted_markers(recording, body, markers), markers, body, keep_frame
        )


@dataclass(frozen=True)
class FittedMarkers:
    """A recording with corrected labels, and the body model's motion fitted to its markers."""

    recording: MarkerRecording
    """The known markers under corrected labels, from the first to the last frame with enough
    markers to place a body."""
    fit: MarkerFit
    repairs: tuple[Finding, ...]
    """Findings about labels that were exchanged."""
    warnings: tuple[Finding, ...]
    """Findings about markers that were left out; they are visible in no frame of `recording`."""
    decisions: tuple[str, ...]
    """What was read, chosen and left out, one sentence each."""


def fitted_markers(
    recording: MarkerRecording, body: BodyModel, markers: MarkerSet
) -> FittedMarkers:
    """Correct the labels of a recording and fit the body to its markers.

    Markers that are farther than `FAR` from the body in most of their frames are left out, and it
    is fitted again: they are virtual points, or not what their labels say.

    Raises:
        ValueError: when no frame shows enough markers to place a body, or points without names lie
            far from the usual places of markers.
    """
    chosen, repairs = with_exchanges_undone(recording.select(markers.labels))
    chosen, cut = trimmed_recording(chosen, markers.bones)
    fit = fit_markers(chosen, markers, body)
    if mean_residual(fit, chosen) > _BAD and (
        other := _with_better_labels(chosen, markers, body, fit)
    ):
        chosen, finding = other
        repairs.append(finding)
        fit = fit_markers(chosen, markers, body)
    lost: list[str] = []
    while (far := _far_markers(fit, chosen)).any() and not far[chosen.visible.any(0)].all():
        lost += [label for label, one in zip(chosen.marker_names, far, strict=True) if one]
        visible = chosen.visible & ~far
        positions = np.where(visible[..., None], chosen.positions, 0.0)
        chosen = dataclasses.replace(chosen, positions=positions, visible=visible)
        fit = fit_markers(chosen, markers, body)
    if markers.guessed:
        _refuse_unusual_places(chosen, markers, fit)
    left = f"; not known: {', '.join(markers.unknown)}" if markers.unknown else ""
    kind = "keypoints" if markers.inside else "markers"
    used = f"{len(markers.labels) - len(lost)} {kind} used{left}"
    said = (*recording.decisions, *markers.decisions, used, *cut)
    return FittedMarkers(chosen, fit, tuple(repairs), _left_out_finding(lost), said)


def _refuse_unusual_places(recording: MarkerRecording, markers: MarkerSet, fit: MarkerFit) -> None:
    """Raise an error if markers of guessed names are far from the usual places of these names."""
    firm = torch.from_numpy(recording.visible).any(0) & ~torch.tensor(markers.loose)
    offset = float((fit.offsets - markers.nominal)[firm].norm(dim=-1).mean())
    residual = mean_residual(fit, recording)
    if offset > _MOST_OFFSET or residual > _MOST_RESIDUAL:
        raise ReconError(
            f"{recording.name}: its points have no names, and on the best fitting body they lie "
            f"{100 * offset:.1f} cm from usual places of markers and move {1000 * residual:.0f} "
            "mm differently from the skin, so the fit is not to be believed: check unit and axis "
            "(--unit, --up), or give with --mapping a recording of the same person and markers "
            "that has names, or the table of the marker set"
        )


def _far_markers(fit: MarkerFit, recording: MarkerRecording) -> Bool[np.ndarray, " markers"]:
    """Return which markers are far from their fitted positions in most of their frames."""
    far = (marker_distances(fit, recording) > FAR) & recording.visible
    return far.sum(0) > _MOSTLY * recording.visible.sum(0).clip(min=1)


def _left_out_finding(labels: list[str]) -> tuple[Finding, ...]:
    if not labels:
        return ()
    said = (
        f"{listed(labels)}: left out, since in most frames they are more than {100 * FAR:.0f} cm "
        "from their places on the body; look for virtual points, exchanged labels and ghosts, or "
        "say where they sit with --mapping"
    )
    return (Finding("outliers", said, tuple(labels), value=float(len(labels))),)


def _conversion_of_fit(
    found: FittedMarkers, markers: MarkerSet, body: BodyModel, keep_frame: bool
) -> Conversion:
    fit, chosen = found.fit, found.recording
    repaired, jumps = jump_findings(fit.unsupported, fit.repaired)
    warnings = [*found.warnings, *gap_findings(fit.observed, chosen.fps), *jumps]
    if markers.inside:
        warnings.append(keypoint_finding(markers.labels))
    warnings += (
        *marker_findings(fit, chosen, markers),
        *identity_changes(chosen.positions, chosen.visible, chosen.fps),
    )
    size = height_findings(
        float(body.height(fit.motion.shape)),
        "the unit (--unit), the axes (--up, --hand) and the labels",
        may_be_child=True,
    )
    converted = on_ground(
        fit.motion,
        marker_residuals(fit, chosen),
        found.decisions,
        body,
        Soles.of(body),
        n_glitch=int(fit.unsupported.any(-1).sum()),
        observed=fit.observed,
        keep_frame=keep_frame,
    )
    return dataclasses.replace(
        converted,
        diagnosis=(*converted.diagnosis, *size.diagnosis, *_residual_findings(fit, chosen)),
        repairs=(*converted.repairs, *found.repairs, *repaired),
        warnings=(*converted.warnings, *size.warnings, *warnings),
    )


def mean_residual(fit: MarkerFit, recording: MarkerRecording) -> float:
    """Return the mean distance of visible markers from their fitted positions, metres."""
    return float(marker_distances(fit, recording)[recording.visible].mean())


def _with_better_labels(
    recording: MarkerRecording, markers: MarkerSet, body: BodyModel, fit: MarkerFit
) -> tuple[MarkerRecording, Finding] | None:
    """Return the recording with labels that fit better, and a finding; None if none do."""
    labels = recording.marker_names
    pairs = pairs_exchanged_throughout(
        labels,
        recording.positions,
        recording.visible,
        nominal_positions(fit, markers, body).numpy(),
    )
    sides = side_pairs(list(labels))
    choices = [
        (with_labels_exchanged(recording, pairs), pair_finding(labels, pairs)) if pairs else None,
        (with_labels_exchanged(recording, sides), _sides_finding()) if sides else None,
    ]
    sample = recording.evenly_spread(_TRIAL_FRAMES)
    limit = _BETTER * mean_residual(fit_markers(sample, markers, body), sample)
    best = None
    for choice in choices:
        if choice is None:
            continue
        some = choice[0].evenly_spread(_TRIAL_FRAMES)
        left = mean_residual(fit_markers(some, markers, body), some)
        if left < limit:
            best, limit = choice, left
    return best


def _sides_finding() -> Finding:
    return Finding(
        "sides exchanged",
        "the markers fit a body only when left and right are exchanged: all labels were "
        "exchanged. If the recording is mirrored instead, this result is its mirror image",
    )


def _residual_findings(fit: MarkerFit, recording: MarkerRecording) -> tuple[Finding, ...]:
    """Return one finding for each second of the recording with its mean residual."""
    away = marker_distances(fit, recording)
    step = max(1, round(recording.fps))
    found: list[Finding] = []
    for first in range(0, recording.frames, step):
        part = slice(first, first + step)
        seen = recording.visible[part]
        if seen.any():
            mean = float(away[part][seen].mean())
            last = min(first + step, recording.frames) - 1
            found.append(
                Finding(
                    "residual",
                    f"frames {first}-{last}: markers {1000 * mean:.1f} mm from their places",
                    (),
                    ((first, last),),
                    mean,
                )
            )
    return tuple(found)

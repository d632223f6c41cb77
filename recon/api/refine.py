"""`recon.refine`: a motion that a network estimated from video, fitted anew under a prior."""

from dataclasses import replace
from pathlib import Path
from typing import Any

from recon.api.estimates import LEAST_FRAMES, estimate_given
from recon.api.fit import fit
from recon.api.given import BodyLike, MotionLike, ShapeLike, body_given
from recon.api.observations import GroundChoice
from recon.api.pipeline import observations_to_fit
from recon.api.result import Result
from recon.core.errors import FormatError, ReconError
from recon.core.units import Hand, Unit, Up
from recon.diagnosis.estimates import as_measurement
from recon.diagnosis.findings import Findings
from recon.fitting.settings import ReadOptions
from recon.method.priors import PriorLike
from recon.reading.estimate_in_film import people_of_film, view_of_estimate

_OF_FILMS = ("camera", "camera_unit", "image_size", "layout", "detector", "fingers", "detections")
"""Options of reading that concern the film."""


def refine(
    motion: MotionLike,
    prior: str | PriorLike = "humor",
    *,
    body: BodyLike = None,
    shape: ShapeLike | None = None,
    frame_rate: float | None = None,
    unit: Unit | None = None,
    up: Up | None = None,
    hand: Hand | None = None,
    person: int | None = None,
    ground: GroundChoice | str = "unknown",
    film: Path | str | None = None,
    **how: Any,
) -> Result:
    """Refine a motion that a network estimated from video.

    In the result feet stand still and nothing jitters, while impacts are kept.

    Errors of such networks last for seconds in single limbs, and their path drifts. Residuals are
    therefore weighted by the inverse of their covariance over time: fast changes are kept, lasting
    deviations cost little. Exchanged limbs are put right, errors before and after a jump are taken
    as independent, and frames that were left out are filled.

    Args:
        motion: a motion, a result, a motion file, or a file of per-frame SMPL parameters: GVHMR
            (.pt), WHAM (.pkl), SLAHMR, SMPL-X or AMASS (.npz); keypoints of SAM 3D Body are
            fitted. Nothing in it is run.
        prior: as in `recon.fit`.
        body: the body that the estimate is of, a SMPL-family file of which the shape coefficients
            are then taken; or None for the bundled body.
        shape: of the person, as `recon.retarget` takes it ("height=1.80"), on the bundled body,
            for which coefficients of another body model mean nothing; None is the average shape.
        frame_rate: frames per second of an estimate, or of 2D detections, that do not say it; an
            estimate of a film has the film's unless given.
        unit: of the estimate's translation; None infers it from standing feet.
        up: axis of the estimate's world that points up, or down; None infers it from the body.
        hand: handedness of the estimate's coordinates; None is right; of keypoints, it is inferred
            from the body.
        person: which of several people in a file, from 0 on; None takes the one of most frames.
        ground: `unknown`, to be found; or `known` at height zero of the estimate's world.
        film: that the network saw, or 2D detections in it with their frame rate: a second
            observation, by which the body is where the image shows it. The estimate's world must
            be that of a camera, or of one that stands still.
        how: others of `recon.fit`; with a film also options of reading it, `camera`, `detector`.

    Raises:
        ReconError: when the file is damaged or holds no estimate, the estimate has fewer than four
            frames or no frame rate, or nobody in the film moves like it.
        FileNotFoundError: when there is no such file.
    """
    if ground not in ("known", "unknown"):
        raise ReconError(f"ground: expected known or unknown, got {ground!r}")
    people, model = [], body_given(body)
    if film is not None:
        given = {name: how.pop(name) for name in _OF_FILMS if name in how}
        try:
            people = people_of_film(Path(film), ReadOptions.of(given))
        except FormatError:  # perhaps of detections that do not say their rate
            if frame_rate is None:
                raise
            given["frame_rate"] = frame_rate
            people = people_of_film(Path(film), ReadOptions.of(given))
    shown = people[0].files[0] if people else None
    if isinstance(motion, str | Path) and _holds_3d_keypoints(Path(motion)):
        names = ("frame_rate", "unit", "up", "hand", "person")
        values = (frame_rate or (shown and shown.fps), unit, up, hand, person)
        reading: dict[str, Any] = dict(zip(names, values, strict=True))
        if not people:
            return fit([motion], prior, body=body, shape=shape, ground=ground, **reading, **how)  # pyright: ignore[reportArgumentType]
        clip = observations_to_fit([motion], model, ReadOptions.of(reading)).clip
        points: Any = clip.observations[0]
        view, said, doubts = view_of_estimate(people, points, model)
        result = fit([points, view], prior, body=model, shape=shape, ground=ground, **how)
        notes, warnings = (*clip.notes, *said, *result.notes), (*doubts, *result.warnings)
        return replace(result, notes=notes, warnings=warnings)
    own = body is not None
    given, known, notes = estimate_given(
        motion, model, own, shape, frame_rate, unit, up, hand, person, shown
    )
    if given.frames < LEAST_FRAMES:
        raise ReconError(
            f"expected an estimate of at least {LEAST_FRAMES} frames, got {given.frames}"
        )
    views, doubts = [], ()
    if people:
        view, said, doubts = view_of_estimate(people, given, model)
        views, notes = [view], (*notes, *said)
    seen, start, found = as_measurement(given, known, model)
    found += Findings(warnings=doubts)
    seen = seen.replace(ground_known=ground == "known")
    how |= {"body": model, "shape": given.shape, "start": start, "repair": False}
    result = fit([seen, *views], prior, **how)
    examined = replace(result.examined, found=found + result.examined.found)
    warnings = (*found.warnings, *result.warnings)
    return replace(result, notes=(*notes, *result.notes), examined=examined, warnings=warnings)


def _holds_3d_keypoints(path: Path) -> bool:
    """Whether an estimate's file holds 3D keypoints; raise an error if it holds no motion."""
    from recon.formats.producers import holds_sam3d_body, refuse_unsupported

    refuse_unsupported(path, "refine")
    return holds_sam3d_body(path)

"""`load_people` and `recon.fit_people`: fits all people in a recording, in one world."""

import logging
from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

from observations.keypoints2d import Keypoints2D
from recon.api.fit import fit
from recon.api.given import BodyLike, body_given, paths_given
from recon.api.observations import ObservationsLike
from recon.api.result import Result
from recon.body.model import BodyModel
from recon.core.errors import ReconError
from recon.core.motion import Motion
from recon.fitting.records import Clip
from recon.fitting.settings import FitSettings, ReadOptions
from recon.method.priors import PriorLike
from recon.method.sensor import views_of
from recon.people.camera import SharedCamera, shared_camera
from recon.people.everyone import PersonClip, people_in
from recon.people.results import People

_LOG = logging.getLogger("recon")
_ALONE = (
    "body", "noise", "robust", "ground", "between", "device", "callback", "repair", "weights",
    "method",
)  # fmt: skip
"""Arguments of a fit that concern the first fits as well."""


def load_people(
    path: Path | str | Sequence[Path | str], *, body: BodyModel | None = None, **reading: Any
) -> list[PersonClip]:
    """Read 2D keypoints of one or several views; return a clip for each person in them.

    People are followed past each other by where and how they move. Where who is who cannot be
    told, a person ends and another one begins. Who is seen for less than half a second, or a
    tenth as completely as who is seen best, is left out. All decisions are logged.

    Args:
        path: files and folders of one recording.
        body: that is to be fitted; default: the bundled one.
        reading: how to read files, by the names of `recon.fitting.settings.ReadOptions`:
            `frame_rate`, `camera`, `layout`, ...

    Raises:
        FileNotFoundError: when there is no such file.
        FormatError: when something cannot be read, or options are missing; says what to do.
        TypeError: when there is no option of a name.
    """
    paths = [path] if isinstance(path, Path | str) else path
    model = BodyModel.load() if body is None else body
    people, notes = people_in([Path(one) for one in paths], FitSettings.of(reading), model)
    for note in notes:
        _LOG.info("%s", note)
    return list(people)


def fit_people(
    people: Sequence[PersonClip],
    prior: str | PriorLike = "humor",
    *,
    body: BodyLike = None,
    notes: Sequence[str] = (),
    **arguments: Any,
) -> People:
    """Fit the motions of several people in a recording, placed in one world.

    Where all were seen by one fixed camera of unknown pose, each is fitted alone first. These fits
    locate the ground below the camera and find its focal length; the best for all of them is
    given to a second fit of each, which keeps the shape of the first, made larger or smaller by a
    few per cent where that puts all on one floor. So everybody is about as tall as alone, and all
    stand at their distances from each other. People before calibrated
    cameras are in one world anyway. With a carried camera everybody's ground is found for itself.

    Args:
        people: of one recording, as `load_people` returns them.
        prior: as of `recon.fit`.
        body: as of `recon.fit`.
        notes: what was decided before, for the report.
        arguments: others of `recon.fit`, the same for all people.

    Raises:
        ReconError: as `recon.fit`, naming the person; when there is nobody.
        FileNotFoundError: as `recon.fit`.
    """
    if len(people) == 0:
        raise ReconError("people: nobody to fit: expected at least one person, got none")
    model = body_given(body)
    arguments = arguments | {"body": model}
    numbers = tuple(one.number for one in people)
    clips = [one.clip for one in people]
    starts: list[Motion | None] = [None] * len(clips)
    shared: SharedCamera | None = None
    if len(clips) > 1 and arguments.get("ground", "auto") in ("auto", "unknown"):
        views = [_only_view(clip) for clip in clips]
        if all(view is not None for view in views):
            alone = {name: value for name, value in arguments.items() if name in _ALONE}
            first = _fit_each(numbers, clips, prior, [alone] * len(clips))
            shared = shared_camera(first)
            clips = [_with_shared_camera(clip, shared) for clip in clips]
            starts = list(shared.starts)
            arguments = arguments | {"ground": "auto"}
            notes = (*notes, shared.description)
    each = [
        arguments if start is None else arguments | {"start": start} | {"shape": start.shape}
        for start in starts
    ]
    results = _fit_each(numbers, clips, prior, each)
    if shared is not None:
        results = [_with_common_floor(one) for one in results]
    return People(tuple(results), numbers, shared is not None, tuple(notes))


def fit_files(
    observations: ObservationsLike,
    *,
    body: BodyLike = None,
    shape: Any = None,
    noise: float | Mapping[str, float | None] | None = None,
    ground: Any = "auto",
    robust: float | str = "auto",
    **how: Any,
) -> People:
    """Reconstruct everybody in files of 2D detections, all in one world.

    OUT is a folder with `person_0.npz` and so on, by the numbers that --person takes, and
    report.json.

    Args:
        observations: files and folders of 2D detections of one recording.
        body: as of `recon.fit`.
        shape: None; a shape is of one person.
        noise: of keypoints, pixels, or {"pixels": 3.0}.
        ground: as of `recon.fit`.
        robust: as of `recon.fit`.
        how: options of reading files (`recon.fitting.settings.ReadOptions`), and others of
            `recon.fit`, the same for all people.

    Raises:
        ReconError: as `load_people` and `fit_people`, and when a shape is given.
        FileNotFoundError: when there is no such file.
    """
    if shape is not None:
        raise ReconError("--shape describes one person; leave it out with --person all")
    model, plane = body_given(body), ground if isinstance(ground, tuple) else None
    names = ["between", *(one.name for one in fields(ReadOptions))]
    reading = {name: how.pop(name) for name in names if name in how}
    reading |= {"person": "all", "ground": plane, "robust": None if robust == "auto" else robust}
    people, notes = people_in(paths_given(observations), FitSettings.of(reading), model)
    if isinstance(noise, Mapping):
        noise = noise.get("pixels")
    # data that were read with a given ground plane have it at z = 0: it must not be applied again
    ground_of_fit = "auto" if plane is not None else ground
    return fit_people(people, body=model, notes=notes, noise=noise, ground=ground_of_fit, **how)


def _with_common_floor(result: Result) -> Result:
    """Replace a result's warning about the ground by one for a ground that people share."""
    return replace(
        result,
        warnings=tuple(
            replace(
                finding,
                message=f"the soles stand at {finding.value:.2f} m above the floor that was found "
                "for all people together: what each shows of the ground does not agree. Give the "
                "ground (--ground), or a calibration (--camera)",
            )
            if finding.code == "floor" and finding.value is not None
            else finding
            for finding in result.warnings
        ),
    )


def _only_view(clip: Clip) -> Keypoints2D | None:
    """Return a clip's keypoints if all are of one fixed camera without a pose, else None."""
    views = views_of(clip.observations)
    if len(views) != 1 or len(clip.observations) != 1 or clip.ground_given:
        return None
    (view,) = views
    fixed = view.camera.T_camera_world.shape[-3] == 1
    return view if fixed and not view.ground_known else None


def _with_shared_camera(clip: Clip, shared: SharedCamera) -> Clip:
    """Return a person's clip with pose and lens of the shared camera as known values."""
    (view,) = views_of(clip.observations)
    camera = view.camera.derived(
        camera_matrix=shared.matrix.to(view.camera.camera_matrix)[None, None],
        T_camera_world=shared.T_camera_world.to(view.camera.T_camera_world)[None, None],
    )
    posed = view.derived(camera=camera, ground_known=True, focal_std=0.0)
    T = shared.T_camera_world.double().inverse().numpy()
    return replace(clip, observations=(posed,), T_recording_camera=T)


def _fit_each(
    numbers: Sequence[int],
    clips: Sequence[Clip],
    prior: str | PriorLike,
    arguments: Sequence[dict[str, Any]],
) -> list[Result]:
    results: list[Result] = []
    for number, clip, own in zip(numbers, clips, arguments, strict=True):
        try:
            results.append(fit(clip, prior, **own))
        except ReconError as error:
            raise type(error)(f"person {number}: {error}") from error
    return results

"""Observation files in, motion files and a report out: what `fit` and `batch` do to one clip."""

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from jaxtyping import Bool, Float
from torch import Tensor

from recon.api.fit import fit
from recon.api.result import Result, described
from recon.body.model import BodyModel
from recon.core.motion import Motion
from recon.fitting.observed import Clip
from recon.fitting.settings import FitSettings
from recon.formats.motions import save_motion
from recon.formats.outputs import Kind, Output, check_outputs, paths_in
from recon.formats.writing import writing_file
from recon.method.stages import Watch
from recon.people.everyone import people_in
from recon.people.together import fit_people
from recon.reading.clip import load_clip
from recon.reading.inputs import input_checksums


def fit_files(
    paths: Sequence[Path],
    out: Path,
    settings: FitSettings,
    watch: Watch | None = None,
    *,
    shape: Sequence[float] | None = None,
    overwrite: bool = False,
) -> dict[str, Any]:
    """Fit one clip's observation files by `recon.fit` and write OUT and OUT.json.

    The prior `anchor` completes them to one cycle of gait; the report then has `cycle`.
    A `shape` that is given is held, as clips of one subject share it. Returns the report; its
    `failed` says whether the fit met nan or inf, in which case the last finite estimate was
    written.

    Raises:
        FileNotFoundError, ValueError: for bad input; nothing is written then.
        FileExistsError: when OUT or OUT.json is there and recon did not write it, unless
            `overwrite`.
    """
    check_outputs([Output(out)], paths_in((*paths, settings)), overwrite=overwrite)
    # before anything is read: what changes from now on must not pass for what was fitted
    inputs = input_checksums(paths, settings)
    result = fitted(paths, settings, watch, shape)
    said = asdict(settings) | ({} if shape is None else {"shape": list(shape)})
    report = result.report(inputs, said)
    result.save(out, overwrite=overwrite, report=report)
    return report


def fit_people_files(
    paths: Sequence[Path],
    out: Path,
    settings: FitSettings,
    watch: Watch | None = None,
    *,
    overwrite: bool = False,
) -> dict[str, Any]:
    """Fit everybody in files of 2D detections by `recon.fit_people` and write the folder OUT.

    It holds `person_0.npz` and so on, by the numbers that `--person` takes, and `report.json`.
    Returns the report.

    Raises:
        FileNotFoundError, ValueError: for bad input; nothing is written then.
        FileExistsError: when something is there that recon did not write, unless `overwrite`.
    """
    output = Output(out, Kind.FOLDER)
    check_outputs([output], paths_in((*paths, settings)), overwrite=overwrite)
    inputs = input_checksums(paths, settings)
    body = BodyModel.load(settings.body)
    people, notes = people_in(paths, settings, body)
    arguments = _arguments(settings, body, watch)
    if settings.noise_pixels is not None:
        arguments["noise"] = settings.noise_pixels
    found = fit_people(people, settings.prior, notes=notes, **arguments)
    report = found.report(inputs, asdict(settings))
    found.save(out, overwrite=overwrite, report=report)
    return report


def fitted(
    paths: Sequence[Path],
    settings: FitSettings,
    watch: Watch | None = None,
    shape: Sequence[float] | None = None,
) -> Result:
    """What `recon.fit` makes of one clip's observation files.

    Args:
        paths: files and folders of one clip.
        settings: how to read and to fit them.
        watch: told about every iteration.
        shape: coefficients that are held; None estimates them.

    Raises:
        FileNotFoundError, ValueError: for bad input.
    """
    body = BodyModel.load(settings.body)
    clip = load_clip(paths, settings, body)
    return fit(
        clip,
        settings.prior,
        noise=_noise(clip, settings),
        shape=shape,
        **_arguments(settings, body, watch),
    )


def _arguments(settings: FitSettings, body: BodyModel, watch: Watch | None) -> dict[str, Any]:
    """What settings say to every fit."""
    return {
        "weights": settings.weights,
        "method": settings.method,
        "body": body,
        "physics": settings.physics,
        "ground": None if settings.ground == "none" else "auto",
        "between": settings.between,
        "fps": settings.fps,
        "device": settings.device,
        "callback": watch,
        "repair": settings.repair,
    }


def _noise(clip: Clip, settings: FitSettings) -> list[float | None]:
    """What --noise and --noise-pixels say of every observation."""
    given = {"metres": settings.noise, "pixels": settings.noise_pixels}
    return [given.get(one.unit) for one in clip.observations]


def write_result(
    out: Path,
    motion: Motion,
    body: BodyModel,
    report: dict[str, Any],
    ground: float = 0.0,
    T_world_camera: Float[Tensor, "4 4"] | None = None,
    observed: Bool[Tensor, "time 22"] | None = None,
    *,
    overwrite: bool = False,
) -> None:
    """Write the motion file with joints, contacts and ground (its height), and its report.

    Where a camera's pose was found, the file has it and the root in the camera's frame besides.
    The two are put in place together, the report first.

    Raises:
        FileExistsError: when either is there and recon did not write it, unless `overwrite`.
    """
    file = described(motion, body, ground, T_world_camera, observed)
    with writing_file(out, report, overwrite=overwrite) as staged:
        save_motion(staged, file)

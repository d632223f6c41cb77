"""Motions out of nothing, or after the end of a motion file: what `sample` and `predict` do."""

import math
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import torch

from priors.humor.generation import predict, sample
from priors.humor.prior import Humor
from priors.humos.prior import Humos
from recon.body.contacts import contact_labels, rest_heights
from recon.body.identities import doubts, identity
from recon.body.model import BodyModel
from recon.body.motion_files import load_motion_of
from recon.formats.motions import MotionFile, save_motion
from recon.formats.results.outputs import Kind, Output
from recon.formats.results.reports import checksums, versions
from recon.formats.results.writing import writing
from recon.method.protocols import REFERENCE_FPS, Decoded
from recon.metrics.generation import stays_on_its_feet


@dataclass(frozen=True)
class GenerationSettings:
    """How to make motions."""

    seconds: float
    """Of every motion, counted from its first frame."""
    seed: int = 0
    """Of everything random."""
    weights: str | None = None
    """As the prior's `load` takes them."""
    body: Path | None = None
    """A SMPL-family file; None is the bundled body."""
    device: Literal["cpu", "cuda"] = "cpu"
    """Where to compute."""
    temperature: float = 1.0
    """Factor on the standard deviations of the prior; above 1 motions vary more."""


@dataclass(frozen=True)
class BodySettings:
    """Whose motions HUMOS makes."""

    shape: str | None = None
    """As `recon.body.identities.identity` takes it; None is the average body."""
    fps: float = REFERENCE_FPS
    """Of the files; the prior itself has 20."""


def sample_files(
    out: Path, count: int, settings: GenerationSettings, *, overwrite: bool = False
) -> dict[str, Any]:
    """Write motions that begin anywhere, drawn from HuMoR; returns the report, written too.

    OUT is one motion file (.npz), or a folder for `sample_000.npz` and so on; the report is
    OUT.json, or `report.json` in the folder.

    Raises:
        FileNotFoundError: when there are no such weights, or no such body.
        ValueError: for several motions in one file, no motions, or no time; nothing is written.
        FileExistsError: when something is there that recon did not write, unless `overwrite`.
    """
    frames = _frames(settings.seconds)
    names = _names(out, count, "sample")
    temperature = _temperature(settings)
    humor = _humor(settings)
    random = torch.Generator().manual_seed(settings.seed)
    made = sample(humor, frames, count, random, temperature=temperature)
    about = {"settings": asdict(settings)}
    return _write(out, names, made, humor.body, about, overwrite=overwrite)


def sample_of_body_files(
    out: Path,
    count: int,
    settings: GenerationSettings,
    whose: BodySettings,
    *,
    overwrite: bool = False,
) -> dict[str, Any]:
    """Write motions of one body, drawn from HUMOS; files and report are as in `sample_files`.

    The report's `warnings` say why the body may be nobody's.

    Raises:
        FileNotFoundError: when there are no such weights, no such body, or no such motion file.
        ValueError: as in `sample_files`; when the shape is not understood, for a rate that is
            none, and where the prior cannot do as asked.
        FileExistsError: when something is there that recon did not write, unless `overwrite`.
    """
    _frames(settings.seconds)
    names = _names(out, count, "sample")
    if settings.temperature != 1:
        raise ValueError(f"--temperature is HuMoR's; HUMOS has none, got {settings.temperature}")
    if settings.device != "cpu":
        raise ValueError(f"HUMOS makes motions on the processor, got --device {settings.device}")
    if not (math.isfinite(whose.fps) and whose.fps > 0):
        raise ValueError(f"--fps is a positive rate, got {whose.fps}")
    body = BodyModel.load(settings.body)
    shape = identity("0" if whose.shape is None else whose.shape, body)
    random = torch.Generator().manual_seed(settings.seed)
    prior = _humos(settings, body)
    motion = prior.sample(shape.expand(count, -1), settings.seconds, random).resample(whose.fps)
    labels = contact_labels(body.pose(motion).joints, rest_heights(body, motion.shape), motion.fps)
    about = {
        "settings": asdict(settings) | asdict(whose),
        "warnings": [f"--shape {whose.shape}: {doubt}" for doubt in doubts(body, shape)],
    }
    made = Decoded(motion, contacts=labels.to(shape))
    return _write(out, names, made, body, about, overwrite=overwrite)


def predict_files(
    motion: Path,
    out: Path,
    samples: int,
    at: float | None,
    settings: GenerationSettings,
    *,
    overwrite: bool = False,
) -> dict[str, Any]:
    """Write what may follow a motion's last frame; returns the report, which is written too.

    Every file begins with the frame that it continues, at that frame's time. OUT is one motion
    file, or a folder for `prediction_000.npz` and so on, as in `sample_files`.

    Args:
        motion: what is known.
        out: file or folder.
        samples: how many continuations.
        at: seconds after the motion's first frame from which on it is not known; None is its end.
        settings: how to go on.
        overwrite: whether files that recon did not write may be replaced.

    Raises:
        FileNotFoundError: when a file does not exist.
        ValueError: when the motion is damaged, has less than two frames up to there, or is on
            another body; or as in `sample_files`.
        FileExistsError: as in `sample_files`.
    """
    frames = _frames(settings.seconds)
    names = _names(out, samples, "prediction")
    temperature = _temperature(settings)
    humor = _humor(settings)
    body = humor.body
    known = load_motion_of(motion, body).motion
    if at is not None:
        last = round(at * known.fps) if math.isfinite(at) else -1
        if not 0 < last < known.frames:
            raise ValueError(
                f"{motion}: --at is after its first frame and not after its last, "
                f"{(known.frames - 1) / known.fps:.3f} s; got {at}"
            )
        known = known.window(0, last + 1)
    if known.frames < 2:
        raise ValueError(f"{motion}: one frame does not tell how it moves; expected two or more")
    random = torch.Generator().manual_seed(settings.seed)
    known = known.to(device=settings.device)
    one = known.map(lambda t: t[None])
    made = predict(humor, one, frames, samples, random, temperature=temperature)
    about = {
        "settings": asdict(settings),
        "motion": str(motion),
        "at": at,
        "inputs": checksums([motion]),
    }
    return _write(out, names, made, body, about, overwrite=overwrite)


def _humor(settings: GenerationSettings) -> Humor:
    body = BodyModel.load(settings.body)
    return Humor.load(settings.weights, body).to(device=settings.device)


def _humos(settings: GenerationSettings, body: BodyModel) -> Humos:
    return Humos.load(settings.weights or "open", body)


def _frames(seconds: float) -> int:
    if not (math.isfinite(seconds) and seconds >= 1 / REFERENCE_FPS):
        raise ValueError(f"--seconds is a frame (1/30 s) or longer, got {seconds}")
    return round(seconds * REFERENCE_FPS) + 1


def _temperature(settings: GenerationSettings) -> float:
    if not (math.isfinite(settings.temperature) and settings.temperature >= 0):
        raise ValueError(f"--temperature is zero or more, got {settings.temperature}")
    return settings.temperature


def _names(out: Path, count: int, name: str) -> list[str]:
    """Of one file, or of several in a folder."""
    if count < 1:
        raise ValueError(f"nothing to write: expected one motion or more, got {count}")
    if out.suffix != ".npz":
        return [f"{name}_{k:03d}.npz" for k in range(count)]
    if count > 1:
        raise ValueError(f"{out} is one file, but {count} motions were asked for; give a folder")
    return [out.name]


def _write(
    out: Path,
    names: list[str],
    made: Decoded,
    body: BodyModel,
    about: dict[str, Any],
    *,
    overwrite: bool,
) -> dict[str, Any]:
    """Write motions as OUT or into it, and the report."""
    joints = body.pose(made.motion).joints
    stays = stays_on_its_feet(joints, rest_heights(body, made.motion.shape), made.motion.fps)
    contacts = made.contacts
    assert contacts is not None
    one = out.suffix == ".npz"
    paths = [out] if one else [out / name for name in names]
    files = {str(p): {"stays on its feet": bool(s)} for p, s in zip(paths, stays, strict=True)}
    report = {"files": files, **about, "versions": versions()}
    output = Output(out, Kind.FILE if one else Kind.FOLDER)
    with writing(output, report=report, overwrite=overwrite) as (staged,):
        for k, name in enumerate(names):
            save_motion(
                staged if one else staged / name,
                MotionFile(
                    made.motion[k],
                    body=body.name,
                    checksum=body.checksum,
                    joints=joints[k],
                    contacts=contacts[k],
                    ground=torch.tensor([0.0, 0.0, 1.0, 0.0]),
                ),
            )
    return report

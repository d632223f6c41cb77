"""Motions out of nothing, or after the end of a motion file: what `sample` and `predict` do."""

from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal

from priors.humor.generation import TEMPERATURE
from recon.api.generate import predict, sample
from recon.api.results import MotionResults, file_names
from recon.formats.reports import checksums, versions
from recon.method.protocols import REFERENCE_FPS


@dataclass(frozen=True)
class GenerationSettings:
    """How to make motions."""

    seconds: float
    """Duration of every motion, counted from its first frame."""
    seed: int = 0
    """Seed of everything random."""
    weights: str | None = None
    """Weights of the prior: `open`, `nc` or a file."""
    body: Path | None = None
    """A SMPL-family file; None is the bundled body."""
    device: Literal["cpu", "cuda"] = "cpu"
    """Device that computes."""
    temperature: float | None = None
    """Factor on the standard deviations of the prior; None is 0.9, and all that HUMOS takes."""

    def of_humor(self) -> "GenerationSettings":
        """The settings with HuMoR's usual temperature where none is asked for."""
        return self if self.temperature is not None else replace(self, temperature=TEMPERATURE)

    def arguments(self) -> dict[str, Any]:
        """The settings as arguments of `recon.sample` and `recon.predict`."""
        return asdict(self) | {"weights": self.weights or "open"}


@dataclass(frozen=True)
class BodySettings:
    """The body whose motions HUMOS generates."""

    shape: str | None = None
    """Description of a shape (`recon.body.identities.identity`); None is the average body."""
    fps: float = REFERENCE_FPS
    """Frame rate of the files; the prior itself has 20."""


def sample_files(
    out: Path, count: int, settings: GenerationSettings, *, overwrite: bool = False
) -> dict[str, Any]:
    """Write motions drawn by `recon.sample` from HuMoR; returns the report, written too.

    OUT is one motion file (.npz), or a folder for `sample_000.npz` and so on; the report is
    OUT.json, or `report.json` in the folder.

    Raises:
        FileNotFoundError: when there are no such weights, or no such body.
        ValueError: for several motions in one file, no motions, or no time; nothing is written.
        FileExistsError: when something is there that recon did not write, unless `overwrite`.
    """
    file_names(out, count, "sample")
    settings = settings.of_humor()
    made = sample(count=count, **settings.arguments())
    return _write(out, made, {"settings": asdict(settings)}, overwrite=overwrite)


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
    file_names(out, count, "sample")
    made = sample("humos", count=count, shape=whose.shape, fps=whose.fps, **settings.arguments())
    about = {
        "settings": asdict(settings) | asdict(whose),
        "warnings": [finding.message for finding in made.warnings],
    }
    return _write(out, made, about, overwrite=overwrite)


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
    file_names(out, samples, "prediction")
    settings = settings.of_humor()
    made = predict(motion, samples=samples, at=at, **settings.arguments())
    about = {
        "settings": asdict(settings),
        "motion": str(motion),
        "at": at,
        "inputs": checksums([motion]),
    }
    return _write(out, made, about, overwrite=overwrite)


def _write(
    out: Path, made: MotionResults, about: dict[str, Any], *, overwrite: bool
) -> dict[str, Any]:
    """Write motions as OUT or into it, and the report."""
    report = {"files": made.report(out)["files"], **about, "versions": versions()}
    made.save(out, overwrite=overwrite, report=report)
    return report

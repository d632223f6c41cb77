"""`recon sample`: motions out of nothing."""

from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import arg

from recon.cli.places import Overwrite, Place, Quiet, several_or_npz, writes


@writes(Place("out", several_or_npz))
def sample(
    out: Path,
    count: int = 1,
    seconds: float = 5.0,
    prior: Literal["humor", "humos"] = "humor",
    shape: str | None = None,
    fps: float | None = None,
    seed: int = 0,
    weights: str | None = None,
    body: Path | None = None,
    device: Literal["cpu", "cuda"] = "cpu",
    temperature: float | None = None,
    json: Annotated[bool, arg(help="Print the report as JSON on stdout.")] = False,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
) -> None:
    """Make up motions that a prior finds likely.

    Of HuMoR, where they begin is drawn from the mixture of first states, every step after it from
    the transition prior. Of HUMOS, the whole motion of a body of your choice is drawn at once.

    Args:
        out: motion file (.npz) for one motion, or a folder for several.
        count: motions.
        seconds: of every motion.
        prior: `humor`, or `humos` for a body of your choice.
        shape: humos: the body, as `recon retarget` takes it; default: the average body.
        fps: humos: of the files; default: 30.
        seed: of everything random.
        weights: `open`, `nc` or a file; default: the bundled ones.
        body: a SMPL-family file of your own; default: the bundled body.
        device: humor: where to compute.
        temperature: humor: factor on the spread of every step; default: 0.9.
        json: print the report as JSON on stdout.
        overwrite: replace files that are there and recon did not write.
        quiet: say nothing but errors and, last, where the result is.
    """
    del quiet  # heeded by `writes`
    from recon.cli import console
    from recon.jobs.generate import (
        BodySettings,
        GenerationSettings,
        sample_files,
        sample_of_body_files,
    )

    settings = GenerationSettings(seconds, seed, weights, body, device, temperature)
    if prior == "humos":
        whose = BodySettings(shape) if fps is None else BodySettings(shape, fps)
        report = sample_of_body_files(out, count, settings, whose, overwrite=overwrite)
    else:
        if shape is not None or fps is not None:
            raise ValueError("--shape and --fps are of --prior humos")
        report = sample_files(out, count, settings, overwrite=overwrite)
    console.table(f"{count} motions of {seconds:g} s", report["files"])
    for warning in report.get("warnings", []):
        console.warn(warning)
    console.last(str(out))
    if json:
        console.answer(report)

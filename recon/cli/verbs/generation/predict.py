"""`recon predict`: what may follow a motion."""

from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import Positional, arg

from recon.cli.places import Overwrite, Place, Quiet, several_or_npz, writes


@writes(Place("out", several_or_npz))
def predict(
    motion: Positional[Path],
    out: Path,
    seconds: float = 2.0,
    samples: int = 1,
    at: float | None = None,
    seed: int = 0,
    weights: str | None = None,
    body: Path | None = None,
    device: Literal["cpu", "cuda"] = "cpu",
    temperature: float | None = None,
    json: Annotated[bool, arg(help="Print the report as JSON on stdout.")] = False,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
) -> None:
    """Go on from the last frame of a motion, in one way or in several.

    Every file begins with the frame that it continues.

    Args:
        motion: motion file (.npz).
        out: motion file (.npz) for one continuation, or a folder for several.
        seconds: to come.
        samples: continuations.
        at: seconds after the first frame from which to go on; default: the end.
        seed: of everything random.
        weights: `open`, `nc` or a file; default: the bundled ones.
        body: the SMPL-family file of the motion's body; default: the bundled body.
        device: where to compute.
        temperature: factor on the spread of every step; default: 0.9.
        json: print the report as JSON on stdout.
        overwrite: replace files that are there and recon did not write.
        quiet: say nothing but errors and, last, where the result is.
    """
    del quiet  # heeded by `writes`
    from recon.cli import console
    from recon.jobs.generate import GenerationSettings, predict_files

    settings = GenerationSettings(seconds, seed, weights, body, device, temperature)
    report = predict_files(motion, out, samples, at, settings, overwrite=overwrite)
    console.table(f"{motion}, {seconds:g} s more", report["files"])
    console.last(str(out))
    if json:
        console.answer(report)

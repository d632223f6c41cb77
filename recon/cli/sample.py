"""`recon sample`: motions out of nothing."""

from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import arg


def sample(
    out: Path,
    count: int = 1,
    seconds: float = 5.0,
    seed: int = 0,
    weights: str | None = None,
    body: Path | None = None,
    device: Literal["cpu", "cuda"] = "cpu",
    temperature: float = 1.0,
    json: Annotated[bool, arg(help="Print the report as JSON on stdout.")] = False,
) -> None:
    """Make up motions that HuMoR finds likely.

    Where they begin is drawn from the mixture of first states, every step after it from the
    transition prior.

    Args:
        out: motion file (.npz) for one motion, or a folder for several.
        count: motions.
        seconds: of every motion.
        seed: of everything random.
        weights: `open`, `nc` or a file; default: the bundled ones.
        body: a SMPL-family file of your own; default: the bundled body.
        device: where to compute.
        temperature: above 1 draws more varied motions, below 1 more usual ones.
        json: print the report as JSON on stdout.
    """
    from recon.cli import console
    from recon.generate_files import GenerationSettings, sample_files

    settings = GenerationSettings(seconds, seed, weights, body, device, temperature)
    report = sample_files(out, count, settings)
    console.table(f"{count} motions of {seconds:g} s", report["files"])
    if json:
        console.answer(report)

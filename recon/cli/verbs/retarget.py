"""`recon retarget`: the same motion on another body."""

from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import Positional, arg

from recon.cli.places import Overwrite, Place, Quiet, writes


@writes(Place("out"))
def retarget(
    motion: Positional[Path],
    out: Path,
    shape: str,
    method: Literal["physics", "network"] = "physics",
    weights: str = "open",
    body: Path | None = None,
    fps: float | None = None,
    ground: float | None = None,
    json: Annotated[bool, arg(help="Print the report as JSON on stdout.")] = False,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
) -> None:
    """Show a motion as another body would do it.

    SHAPE is coefficients (0.5,-1,2; write --shape=-1,2 where the first is negative), measures
    (height=1.80,weight=75: metres and kilograms, one or both), words (man or woman, tall or
    short, heavy or slim), words and measures (woman,height=1.65), or a motion file of somebody.
    Measures mean the shape with them that is nearest to the average, or to that of men or women.

    Writes OUT (AMASS .npz with joints, contacts and ground) and OUT.json (both bodies, and the
    physics of the motion, of its copy on the other body, and of the result).

    Args:
        motion: motion file (.npz) of a second or longer, at any rate.
        out: motion file to write.
        shape: the other body.
        method: what is settled on the ground: the scaled copy of the motion (`physics`), or what
            a network that knows the body proposes (`network`), which is no better in anything
            that was measured (docs/retargeting.md).
        weights: of the network: `open`, `nc` or a file.
        body: the SMPL-family file of the motion's body; default: the bundled body.
        fps: of the result; default: the motion's rate.
        ground: height of the ground in the motion, metres; default: what the file says, else 0.
        json: print the report as JSON on stdout.
        overwrite: replace files that are there and recon did not write.
        quiet: say nothing but errors and, last, where the result is.
    """
    del quiet  # heeded by `writes`
    from recon.cli import console
    from recon.jobs.retarget import RetargetSettings, retarget_files

    settings = RetargetSettings(shape, method, weights, body, fps, ground)
    report = retarget_files(motion, out, settings, overwrite=overwrite)
    bodies = {
        name: {
            "height, m": round(report[name]["height"], 3),
            "weight, kg": round(report[name]["weight"], 1),
        }
        for name in ("source", "target")
    }
    console.table("bodies", bodies)
    console.table("physics at 20 Hz", {n: _shown(row) for n, row in report["physics"].items()})
    for warning in report["warnings"]:
        console.warn(warning)
    console.last(str(out))
    if json:
        console.answer(report)


def _shown(row: dict[str, float | None]) -> dict[str, float | None]:
    """Some metrics, in the units of HUMOS's table."""
    columns = {
        "penetrate, cm": ("penetrate", 100),
        "float, cm": ("float", 100),
        "slip, m/s": ("slip_in_contact", 1),
        "stable, %": ("dynamic_stability", 100),
    }
    return {
        name: None if (value := row[key]) is None else factor * value
        for name, (key, factor) in columns.items()
    }

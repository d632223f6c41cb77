"""`recon demo`: see it work."""

from pathlib import Path

from recon.cli.places import Overwrite, Place, Quiet, folder, writes


@writes(Place("out", folder))
def demo(out: Path = Path("demo"), overwrite: Overwrite = False, quiet: Quiet = False) -> None:
    """Spoil a real recording in two ways and give it back.

    Writes demo.json (all metrics), demo.html and noisy.html (pages to play), demo.png and the
    motions.

    Args:
        out: folder to write into.
        overwrite: replace files that are there and recon did not write.
        quiet: say nothing but errors and, last, where the result is.
    """
    del quiet  # heeded by `writes`
    from recon.cli import console
    from recon.jobs import demo as work

    table = work.demo(out, overwrite=overwrite)
    console.table("mean errors of the reconstruction, centimetres", work.summary(table))
    console.last(f"open {out / 'demo.html'} in a browser; the picture is {out / 'demo.png'}")

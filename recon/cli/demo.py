"""`recon demo`: see it work."""

from pathlib import Path


def demo(out: Path = Path("demo")) -> None:
    """Spoil a real recording in two ways and give it back.

    Writes demo.json (all metrics), demo.html and noisy.html (pages to play), demo.png and the
    motions.

    Args:
        out: folder to write into.
    """
    from recon import demo as work
    from recon.cli import console

    table = work.demo(out)
    console.table("mean errors of the reconstruction, centimetres", work.summary(table))
    console.say(f"open {out / 'demo.html'} in a browser; the picture is {out / 'demo.png'}")

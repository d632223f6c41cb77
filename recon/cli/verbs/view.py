"""`recon view`: look at a result."""

from pathlib import Path

from tyro.conf import Positional

from recon.cli.places import Overwrite, Place, writes


@writes(Place("html"), Place("png"), Place("mp4"), Place("rrd"))
def view(
    motion: Positional[Path],
    html: Path | None = None,
    png: Path | None = None,
    mp4: Path | None = None,
    rrd: Path | None = None,
    obs: tuple[Path, ...] = (),
    compare: Path | None = None,
    beside: Path | None = None,
    body: Path | None = None,
    std: bool = False,
    overwrite: Overwrite = False,
) -> None:
    """Draw a motion as a page to play, a picture or a film.

    The page is one file that needs no network. Observations from cameras add the cameras, and to
    the picture and the film what each of them sees.

    Args:
        motion: motion file.
        html: page to write.
        png: picture to write: frames side by side.
        mp4: film to write.
        rrd: file for the Rerun viewer to write, everything on a timeline; needs rerun-sdk.
        obs: observations of the motion, of any kind: their points, clouds and cameras are drawn;
            missing points where the motion has them.
        compare: a second motion, for example the truth, in the same place at the same times.
        beside: a motion to play side by side with this one, for example the same motion on
            another body; both play from their first frames on.
        std: draw a sphere of one standard deviation around every joint. A page has these spheres
            in any case, as a layer to switch on.
        body: the SMPL-family file of the motions' body; default: the bundled body.
        overwrite: replace files that are there and recon did not write.
    """
    from recon.jobs.view import view_files

    if all(target is None for target in (html, png, mp4, rrd)):
        raise ValueError("nothing to draw: give --html, --png, --mp4 or --rrd FILE")
    view_files(
        motion, obs=obs, compare=compare, side=beside, html=html, png=png, mp4=mp4, rrd=rrd,
        body=body, certainty=std, overwrite=overwrite,
    )  # fmt: skip

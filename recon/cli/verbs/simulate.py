"""`recon simulate`: a known motion as a sensor would have seen it."""

from pathlib import Path

from tyro.conf import OmitArgPrefixes, Positional

from recon.cli.places import Arguments, Overwrite, Place, writes
from recon.formats.outputs import Kind, Output
from recon.simulation.settings import (
    FILM_DEFAULTS,
    SURFACE_DEFAULTS,
    FilmSettings,
    SensorKind,
    SurfaceSettings,
)


def _file_or_folder(out: Path, given: Arguments) -> tuple[Output, ...]:
    """One file; a folder of scans or of several cameras, of which a calibration may tell."""
    several = given["kind"] == "scans" or given["film"].views > 1 or out.is_dir()
    return (Output(out, Kind.FOLDER if several and out.suffix != ".npz" else Kind.FILE),)


@writes(Place("out", _file_or_folder))
def simulate(
    motion: Positional[Path],
    out: Positional[Path],
    kind: SensorKind,
    film: OmitArgPrefixes[FilmSettings] = FILM_DEFAULTS,
    surface: OmitArgPrefixes[SurfaceSettings] = SURFACE_DEFAULTS,
    noise: float = 0.0,
    hide_below: float | None = None,
    occluder: tuple[float, float, float, float, float, float] | None = None,
    during: tuple[float, float] | None = None,
    missing_points: float = 0.0,
    missing_frames: float = 0.0,
    outliers: float = 0.0,
    frames: str | None = None,
    fps: float | None = None,
    unknown_ground: bool = False,
    seed: int = 0,
    overwrite: Overwrite = False,
) -> None:
    """Make observation files from a motion.

    Args:
        motion: motion file (.npz).
        out: observation file to write; a folder for several cameras. Of scans, .npz is one file
            and all else a folder of .ply files.
        kind: what the sensor tracks: the 22 joints, 43 points of the skin, 16 markers placed
            beside the skin's landmarks, keypoints in images, or points of the surface, of a depth
            camera or of scanners all around.
        film: the cameras.
        surface: what is seen of the surface.
        noise: standard deviation of every coordinate, metres; of keypoints2d in pixels; of depth
            in metres, beside the sensor's own.
        hide_below: points lower than this are hidden, metres.
        occluder: corners of a box that hides points, x0 y0 z0 x1 y1 z1, metres; from cameras what
            lies behind it, too.
        during: seconds of the motion's clock from which and up to which things are hidden;
            default: always.
        missing_points: share of points missing at random.
        missing_frames: share of frames in which nothing is seen.
        outliers: share of points that are wildly off.
        frames: part of the motion, A:B, in its own frames.
        fps: rate of the sensor; default: that of the motion.
        unknown_ground: do not say that the ground is at z = 0, nor where the camera stands.
        seed: of everything random.
        overwrite: replace files that are there and recon did not write.
    """
    from recon.cli import console
    from recon.jobs.simulate import simulate_file
    from recon.simulation.points import Corruption

    box = None if occluder is None else (occluder[:3], occluder[3:])
    corruption = Corruption(
        noise=noise,
        hide_below=hide_below,
        hide_box=box,
        during=during,
        missing_points=missing_points,
        missing_frames=missing_frames,
        outliers=outliers,
    )
    written = simulate_file(
        motion, out, kind, corruption, seed=seed, fps=fps, frames=_frames(frames),
        unknown_ground=unknown_ground, film=film, surface=surface, overwrite=overwrite,
    )  # fmt: skip
    console.last(", ".join(map(str, written)))


def _frames(text: str | None) -> tuple[int, int] | None:
    if text is None:
        return None
    first, colon, last = text.partition(":")
    if not (colon and first.isdigit() and last.isdigit() and int(first) < int(last)):
        raise ValueError(f"--frames is A:B with A < B, for example 0:90; got {text!r}")
    return int(first), int(last)

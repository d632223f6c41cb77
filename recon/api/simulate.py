"""`recon.simulate`: simulated observations of a known motion."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

from recon.api.given import MotionLike, motion_given
from recon.api.results import Tables, closing_fields, in_ten_lines
from recon.body.model import BodyModel
from recon.core.arrays import positive_number
from recon.core.errors import ReconError
from recon.core.motion import Motion
from recon.fitting.records import Clip
from recon.fitting.settings import DEFAULTS
from recon.formats.observations import ObservationFile, PointsFile, save_observation
from recon.formats.outputs import Output, OutputKind
from recon.formats.scans import write_scans
from recon.formats.writing import writing
from recon.method.sensor import Sensor
from recon.reading.clip import clip_of_files
from recon.simulation.points import Corner, Corruption
from recon.simulation.sensors import simulated_files
from recon.simulation.settings import (
    FilmSettings,
    FurnitureName,
    LeftOver,
    SensorKind,
    SurfaceSettings,
)


@dataclass(frozen=True, repr=False)
class Simulated:
    """Simulated observations of a known motion: one, or one per camera; iterates over them."""

    kind: SensorKind
    """What the sensor gives."""
    files: Mapping[str, ObservationFile]
    """The content of each observation file, by camera name (empty without a camera)."""
    truth: Motion
    """The motion at the sensor's moments."""
    body: BodyModel
    """The body that moves."""
    tables: ClassVar[Tables] = {}
    """Nothing that a person at the terminal should be shown."""

    @cached_property
    def clip(self) -> Clip:
        """The observations in the form that a fit takes, as if read from files."""
        named = [(name or self.kind, file) for name, file in self.files.items()]
        return clip_of_files(named, (), DEFAULTS, self.body)

    @property
    def observations(self) -> tuple[Sensor, ...]:
        """The simulated observations as sensors, each with a batch axis of length one."""
        return self.clip.observations

    def __iter__(self) -> Iterator[Sensor]:
        """One observation after the other."""
        return iter(self.observations)

    def __len__(self) -> int:
        """The number of observations."""
        return len(self.files)

    def report(
        self, inputs: Mapping[str, str] | None = None, settings: Mapping[str, Any] | None = None
    ) -> dict[str, Any]:
        """The JSON report saved beside the files; see `MotionResult.report`."""
        return {"kind": self.kind, **closing_fields(inputs, settings)}

    def save(
        self,
        out: Path | str,
        *,
        overwrite: bool = False,
        report: Mapping[str, Any] | None = None,
    ) -> tuple[Path, ...]:
        """Write observation files; returns their paths.

        Args:
            out: file (.npz) of one observation; a folder for several cameras, which get
                OUT/CAMERA.npz. Of scans, .npz is one file, and all else a folder of PLY files
                with times.csv.
            overwrite: replace what is there and recon did not write.
            report: what to write beside them instead of `report()`.

        Raises:
            ReconError: when there are several cameras for one file.
            FileExistsError: when something is there that recon did not write, unless `overwrite`.
        """
        path, several = Path(out), len(self.files) > 1
        if several and path.suffix == ".npz":
            raise ReconError(
                f"{path} is one file, but there are {len(self.files)} cameras; give a folder"
            )
        scans = self.kind == "scans" and path.suffix != ".npz"
        output = Output(path, OutputKind.FOLDER if scans or several else OutputKind.FILE)
        with writing(output, report=report or self.report(), overwrite=overwrite) as (staged,):
            for name, file in self.files.items():
                if scans:
                    assert isinstance(file, PointsFile)
                    write_scans(staged, file)
                else:
                    save_observation(staged / f"{name}.npz" if several else staged, file)
        return tuple(path / f"{name}.npz" for name in self.files) if several else (path,)

    def __repr__(self) -> str:
        """A summary of at most ten lines: what was simulated, how long, and by which cameras."""
        first = (
            f"Simulated {self.kind}: {self.truth.frames} moments, "
            f"{self.truth.duration:.2f} s at {self.truth.fps:g} per second"
        )
        return in_ten_lines(first, [f"camera {name}" for name in self.files if name], [])


_BUNDLED_ONLY = "sensors are simulated of motions of the bundled body only, such as fits of it"
"""What to do about a motion of another body."""


def simulate(
    motion: MotionLike,
    kind: SensorKind,
    *,
    noise: float = 0.0,
    hide_below: float | None = None,
    hide_box: tuple[Corner, Corner] | None = None,
    during: tuple[float, float] | None = None,
    missing_points: float = 0.0,
    missing_frames: float = 0.0,
    outliers: float = 0.0,
    camera: str | Path = "front",
    views: int = 1,
    orbit: float = 0.0,
    layout: str = "openpose25",
    points: int = 4096,
    clothed: int | None = None,
    skin_offset: float = 0.01,
    furniture: tuple[FurnitureName, ...] = (),
    left_over: tuple[LeftOver, ...] = (),
    frames: tuple[int, int] | None = None,
    fps: float | None = None,
    unknown_ground: bool = False,
    seed: int = 0,
) -> Simulated:
    """Make observations of a motion of the bundled body, as a sensor would have seen it.

    The result holds observations as `recon.fit` takes them, and can be given to it as it is.

    Args:
        motion: a motion of one clip: a record, a result, a motion file or its arrays.
        kind: what the sensor gives: `joints3d` (the 22 joints), `markers3d` (43 points of the
            skin), `landmarks` (16 markers beside the skin), `keypoints2d` (in images), `depth`
            (points that a depth camera sees) or `scans` (points all over the skin).
        noise: standard deviation of every coordinate, metres; of keypoints2d in pixels; of depth
            beside the sensor's own.
        hide_below: points lower than this are hidden, metres.
        hide_box: two corners of a box that hides points, metres; from cameras what lies behind
            it, too.
        during: seconds of the motion's clock from which and up to which things are hidden;
            default: always.
        missing_points: share of points missing at random, 0 to 1.
        missing_frames: share of frames in which nothing is seen.
        outliers: share of points that are up to half a metre off in a random direction.
        camera: of keypoints2d and depth: `front` or `side` of the body, near enough to fill the
            image, or a calibration.
        views: cameras evenly around the body, the first as `camera` says.
        orbit: angle that the cameras are carried around the body by, radians.
        layout: which keypoints: openpose25, coco17, ...
        points: most points of a frame of depth and scans.
        clothed: seed of the clothes that depth and scans see; default: bare skin.
        skin_offset: standard deviation per axis of how far landmarks are placed from where they
            should be, metres.
        furniture: what stands around the body in the view of a depth sensor: `chair` (behind),
            `table` (at the left), `box` (at the right), `board` (before the shins).
        left_over: what remains in clouds of depth beside the body: `ground`, `furniture`.
        frames: part of the motion, from which frame up to which, in its own frames; A:B on a
            command line.
        fps: rate of the sensor, frames per second; default: that of the motion.
        unknown_ground: leave out where the ground is and where the camera stands.
        seed: of everything random.

    Raises:
        ReconError: when the motion is damaged, of another body or has fewer frames than asked
            for, or options contradict each other.
        FileNotFoundError: when there is no such motion or calibration.
    """
    corruption = Corruption(
        noise, hide_below, hide_box, during, missing_points, missing_frames, outliers
    )
    film = FilmSettings(str(camera), views, orbit, layout)
    surface = SurfaceSettings(points, clothed, skin_offset, furniture, left_over)
    body = BodyModel.load()
    given = motion_given(motion, body, remedy=_BUNDLED_ONLY)
    truth = given.motion
    if frames is not None:
        if not 0 <= frames[0] < frames[1] <= truth.frames:
            raise ReconError(
                f"{given.name}: expected frames within 0 to {truth.frames}, got {frames}"
            )
        truth = truth.window(*frames)
    truth = truth if fps is None else truth.resample(positive_number(fps, "fps"))
    files = simulated_files(
        truth, body, kind, corruption, seed, film, surface, unknown_ground=unknown_ground
    )
    return Simulated(kind, files, truth, body)

"""`recon.simulate`: a known motion as a sensor would have seen it."""

from pathlib import Path

from recon.api.given import MotionLike, motion_given
from recon.api.results.simulated import Simulated
from recon.body.model import BodyModel
from recon.core.arrays import positive
from recon.core.errors import ReconError
from recon.simulation.points import Corner, Corruption
from recon.simulation.sensors import seen_by
from recon.simulation.settings import (
    FilmSettings,
    FurnitureName,
    LeftOver,
    SensorKind,
    SurfaceSettings,
)

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
    """What a sensor would have seen of a motion of the bundled body.

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
        during: seconds of the motion's clock from which and up to which things are hidden; None
            is always.
        missing_points: share of points missing at random, 0 to 1.
        missing_frames: share of frames in which nothing is seen.
        outliers: share of points that are up to half a metre off in a random direction.
        camera: of keypoints2d and depth: `front` or `side` of the body, near enough to fill the
            image, or a calibration.
        views: cameras evenly around the body, the first as `camera` says.
        orbit: angle that the cameras are carried around the body by, radians.
        layout: which keypoints: openpose25, coco17, ...
        points: most points of a frame of depth and scans.
        clothed: seed of the clothes that depth and scans see; None is bare skin.
        skin_offset: standard deviation per axis of how far landmarks are placed from where they
            should be, metres.
        furniture: what stands around the body in the view of a depth sensor: `chair` (behind),
            `table` (at the left), `box` (at the right), `board` (before the shins).
        left_over: what remains in clouds of depth beside the body: `ground`, `furniture`.
        frames: part of the motion, from which frame up to which, in its own frames.
        fps: rate of the sensor, frames per second; None is that of the motion.
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
            raise ReconError(f"{given.name}: has {truth.frames} frames, asked for {frames}")
        truth = truth.window(*frames)
    truth = truth if fps is None else truth.resample(positive(fps, "fps"))
    files = seen_by(
        truth, body, kind, corruption, seed, film, surface, unknown_ground=unknown_ground
    )
    return Simulated(kind, files, truth, body)

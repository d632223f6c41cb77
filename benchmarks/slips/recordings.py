"""Simulates clean recordings of true motions by each kind of sensor."""

from dataclasses import dataclass
from typing import Literal

from benchmarks.cameras import filmed
from recon.benchmark.windows import TrueWindows
from recon.body.model import BodyModel
from recon.core.camera import Camera, full_hd_camera
from recon.core.motion import Motion
from recon.core.struct import stack
from recon.method.sensor import Sensor as Seen
from recon.simulation.images import camera_ring
from recon.simulation.points import Corruption, joints3d, markers3d

Sensor = Literal["joints3d", "markers3d", "camera", "cameras"]
"""Kinds of sensors: 22 joints; 43 points of the skin; one camera of unknown pose; three calibrated
cameras."""
SENSORS: tuple[Sensor, ...] = ("joints3d", "markers3d", "camera", "cameras")
CLEAN: dict[Sensor, Corruption] = {
    "joints3d": Corruption(noise=0.02),
    "markers3d": Corruption(noise=0.01),
    "camera": Corruption(noise=3.0),
    "cameras": Corruption(noise=3.0),
}
"""Noise of good recordings: metres, and pixels of images of 1920 x 1080."""
_CAMERAS: dict[Sensor, int] = {"joints3d": 0, "markers3d": 0, "camera": 1, "cameras": 3}


@dataclass(frozen=True)
class Recording:
    """One clip with its clean observations, and the data from which mistakes are made."""

    name: str
    sensor: Sensor
    truth: Motion
    """True motion in the world, without a batch axis."""
    stranger: Motion
    """Motion of another person, of the same length, wherever it was recorded."""
    body: BodyModel
    cameras: tuple[Camera, ...]
    """Cameras at their true poses; none for points in space."""
    corruption: Corruption
    seed: int
    clean: tuple[Seen, ...]
    """Observations without the mistake, with a batch axis of length one."""

    def of(self, motion: Motion, seed: int) -> tuple[Seen, ...]:
        """Simulate the sensors' observations of another motion."""
        return observed(self.sensor, motion, self.body, self.cameras, self.corruption, seed)


def observed(
    sensor: Sensor,
    motion: Motion,
    body: BodyModel,
    cameras: tuple[Camera, ...],
    corruption: Corruption,
    seed: int,
) -> tuple[Seen, ...]:
    """Simulate the observations of one clip by a kind of sensor, with a batch axis."""
    if sensor == "joints3d":
        return (stack([joints3d(motion, body, corruption, seed)]),)
    if sensor == "markers3d":
        return (stack([markers3d(motion, body, corruption, seed)]),)
    posed = sensor == "cameras"
    return filmed(list(cameras), motion, body, corruption, seed, posed=posed)[0]


def cameras_of(sensor: Sensor, truth: Motion, body: BodyModel, seed: int) -> tuple[Camera, ...]:
    """Return one or three cameras around a clip, from a direction that depends on the seed."""
    count = _CAMERAS[sensor]
    return camera_ring(truth, body, full_hd_camera(), count, first=2.4 * seed) if count else ()


def recording_of(
    windows: TrueWindows,
    number: int,
    sensor: Sensor,
    body: BodyModel,
    corruption: Corruption | None = None,
) -> Recording:
    """Simulate one window's recording by a kind of sensor; default noise is that of `CLEAN`."""
    truth, corruption = windows.truth[number], corruption or CLEAN[sensor]
    cameras = cameras_of(sensor, truth, body, number)
    return Recording(
        name=windows.names[number],
        sensor=sensor,
        truth=truth,
        stranger=windows.truth[_somebody_else(windows, number)],
        body=body,
        cameras=cameras,
        corruption=corruption,
        seed=number,
        clean=observed(sensor, truth, body, cameras, corruption, number),
    )


def _somebody_else(windows: TrueWindows, number: int) -> int:
    """Return the index of the next window of another person."""
    count = len(windows.names)
    others = [(number + k) % count for k in range(1, count)]
    return next(o for o in others if windows.subjects[o] != windows.subjects[number])

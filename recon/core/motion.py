"""The records of a body's motion: `Motion` on a clock, and `MotionFile` with what a file adds."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from recon.core import rotations as so3
from recon.core.arrays import usable_frame_rate
from recon.core.errors import ReconError
from recon.core.struct import TensorStruct

if TYPE_CHECKING:
    from recon.core.camera import Camera
    from recon.core.fingers import Hands
else:  # only annotations use these: Any at run time saves importing their modules
    from typing import Any as Camera
    from typing import Any as Hands

MOTION_FORMAT = 1
"""Version of the layout of motion files."""


@dataclass(frozen=True)
class Motion(TensorStruct):
    """One body moving through the world (z up, the ground at z = 0), sampled evenly in time."""

    translation: Float[Tensor, "*batch time 3"]
    """SMPL translation in metres: the pelvis is at translation + rest pelvis (never rotated)."""
    rotations: Float[Tensor, "*batch time 22 3 3"]
    """Rotation of every joint relative to its parent; the first is the root in the world."""
    shape: Float[Tensor, "*batch shape"]
    """Coefficients of the body's shape directions, unit variance."""
    valid: Bool[Tensor, "*batch time"]
    """Whether a frame exists; the shorter clips of a batch are padded at the end."""
    fps: float
    """Frames per second."""
    start_time: float = 0.0
    """Time of the first frame, in seconds of the recording's clock."""
    hands: Hands | None = None
    """Fingers, where they are known; batches of clips have none."""

    @classmethod
    def create(
        cls,
        translation: Float[Tensor, "*batch time 3"],
        rotations: Float[Tensor, "*batch time 22 3 3"],
        shape: Float[Tensor, "*batch shape"],
        fps: float,
        start_time: float = 0.0,
    ) -> "Motion":
        """Make a motion from arrays, in which all frames are valid (no padding)."""
        valid = torch.ones(translation.shape[:-1], dtype=torch.bool, device=translation.device)
        return cls(translation, rotations, shape, valid, float(fps), float(start_time))

    @property
    def frames(self) -> int:
        """Number of frames, padding included."""
        return self.translation.shape[-2]

    def inner(self, step: int = 1) -> Bool[Tensor, "*batch inner"]:
        """Mask of frames valid with both neighbours `step` frames away; the ends are left out."""
        stop = max(self.frames - step, step)
        before, after = self.valid[..., : stop - step], self.valid[..., 2 * step :]
        return before & self.valid[..., step:stop] & after

    @property
    def pairs(self) -> Bool[Tensor, "*batch steps"]:
        """Mask of the steps between neighbouring frames that are both valid."""
        return self.valid[..., 1:] & self.valid[..., :-1]

    @property
    def times(self) -> Float[Tensor, " time"]:
        """Time of every frame, seconds."""
        count = torch.arange(self.frames, dtype=torch.float64, device=self.translation.device)
        return self.start_time + count / self.fps

    @property
    def duration(self) -> float:
        """Time from the first frame to the last one, seconds."""
        return (self.frames - 1) / self.fps

    @property
    def stop_time(self) -> float:
        """Time of the last frame, seconds."""
        return self.start_time + self.duration

    def window(self, start: int, stop: int) -> "Motion":
        """Return frames start, ..., stop - 1 as a motion that keeps their times.

        Raises:
            ReconError: when it reaches outside the motion, or ends before it begins.
        """
        if not 0 <= start <= stop <= self.frames:
            raise ReconError(
                f"expected a window within frames 0 to {self.frames}, from the earlier to the "
                f"later, got {start} to {stop}; frames are not counted from the end"
            )
        return self.replace(
            translation=self.translation[..., start:stop, :],
            rotations=self.rotations[..., start:stop, :, :, :],
            valid=self.valid[..., start:stop],
            start_time=self.start_time + start / self.fps,
            hands=self.hands and self.hands.window(start, stop),
        )

    def at(self, times: Float[Tensor, " moments"], fps: float) -> "Motion":
        """Interpolate at other times: positions linearly, rotations along the shortest arc.

        A moment between an existing and a padded frame is not valid.

        Raises:
            ValueError: when a moment lies outside the motion by more than a microsecond.
        """
        start, stop, slack = self.start_time, self.stop_time, 1e-6
        if len(times) > 0 and (times.min() < start - slack or times.max() > stop + slack):
            raise ReconError(
                f"the motion lasts from {start:.4f} s to {stop:.4f} s, but was "
                f"asked for {times.min():.4f} s to {times.max():.4f} s; ask for times within these"
            )
        return self.continued_at(times, fps)

    def continued_at(self, times: Float[Tensor, " moments"], fps: float) -> "Motion":
        """Interpolate as `at` does; after the last frame, go on at the velocities before it."""
        start, last, slack = self.start_time, self.frames - 1, 1e-6 * self.fps
        frame = (times.double() - start) * self.fps
        frame = torch.where((frame - frame.round()).abs() < slack, frame.round(), frame)
        before = frame.floor().long().clamp(max=max(last - 1, 0))
        after = (before + 1).clamp(max=last)
        fraction = (frame - before).to(self.translation)
        a, b = self.rotations[..., before, :, :, :], self.rotations[..., after, :, :, :]
        exists_after = self.valid[..., after] | (fraction == 0)
        return Motion(
            translation=self.translation[..., before, :].lerp(
                self.translation[..., after, :], fraction[:, None]
            ),
            rotations=so3.interpolate(a, b, fraction[:, None].expand(len(times), a.shape[-3])),
            shape=self.shape,
            valid=self.valid[..., before] & exists_after,
            fps=fps,
            start_time=float(times[0]) if len(times) > 0 else start,
            hands=self.hands and self.hands.interpolated(before, after, fraction),
        )

    def carried(
        self, T: Float[Tensor, "*batch 4 4"], pelvis: Float[Tensor, "*batch 3"]
    ) -> "Motion":
        """Apply a rigid transform T of the world; `pelvis` is its place in the unposed body, m."""
        root = T[..., None, None, :3, :3] @ self.rotations[..., :1, :, :]
        return self.replace(
            translation=carried_translation(self.translation, T, pelvis),
            rotations=torch.cat((root, self.rotations[..., 1:, :, :]), -3),
        )

    def resample(self, fps: float, duration: float | None = None) -> "Motion":
        """Interpolate the motion at another frame rate (Hz), from the same start time.

        The last frame is at most `duration` (s) after the first, by default the motion's duration.

        Raises:
            ValueError: when the rate is none.
        """
        fps = usable_frame_rate(fps, "fps")
        count = int((self.duration if duration is None else duration) * fps + 1e-6) + 1
        if fps == self.fps and count == self.frames:
            return self
        steps = torch.arange(count, dtype=torch.float64, device=self.translation.device)
        return self.continued_at(self.start_time + steps / fps, fps)


def carried_translation(
    translation: Float[Tensor, "*batch time 3"],
    T: Float[Tensor, "*batch 4 4"],
    pelvis: Float[Tensor, "*batch 3"],
) -> Float[Tensor, "*batch time 3"]:
    """Return translations t after a rigid transform R, s: R (t + p) + s - p, p the rest pelvis."""
    rest = pelvis[..., None, :]
    return (translation + rest) @ T[..., :3, :3].mT + T[..., None, :3, 3] - rest


def padded_batch(motions: list[Motion]) -> Motion:
    """Join clips to one batch; shorter clips repeat their last frame, marked as not valid.

    Raises:
        ValueError: when rates differ (resample first) or there is no clip.
    """
    rates = {m.fps for m in motions}
    if len(rates) != 1:
        raise ReconError(f"clips of one batch need one frame rate, got {sorted(rates)}")
    longest = max(m.frames for m in motions)

    def lengthen(m: Motion) -> Motion:
        index = torch.arange(longest, device=m.translation.device)
        held = index.clamp(max=m.frames - 1)
        return m.replace(
            translation=m.translation[held],
            rotations=m.rotations[held],
            valid=m.valid[held] & (index < m.frames),
            hands=None,
        )[None]

    rows = [lengthen(m) for m in motions]
    return Motion(
        translation=torch.cat([r.translation for r in rows]),
        rotations=torch.cat([r.rotations for r in rows]),
        shape=torch.cat([r.shape for r in rows]),
        valid=torch.cat([r.valid for r in rows]),
        fps=motions[0].fps,
        start_time=motions[0].start_time,
    )


@dataclass(frozen=True)
class FilmingCamera:
    """A camera that filmed a motion, in the motion's world."""

    name: str
    camera: Camera
    """With the distortion of its lens; poses (1, 4, 4), or one per frame of the motion."""
    start_time: float = 0.0
    """Time of the first picture, seconds of the motion's clock."""


@dataclass(frozen=True)
class MotionFile:
    """The contents of a motion file; optional ones are None where the file lacks them."""

    motion: Motion
    """One clip, no batch axis; padded frames are not written."""
    body: str | None = None
    """Name of the body model whose shape coefficients the motion has."""
    checksum: str | None = None
    """`BodyModel.checksum` of that body model."""
    gender: str = "neutral"
    joints: Float[Tensor, "time 22 3"] | None = None
    """Joint positions in the world, metres."""
    contacts: Float[Tensor, "time 22"] | None = None
    """Probability, from 0 to 1, that a joint touches the ground; a fit writes labels, 0 or 1."""
    contact_probability: Float[Tensor, "time 22"] | None = None
    """Probability of contact, by height, speed and standard deviation of the joint."""
    ground: Float[Tensor, "4"] | None = None
    """(nx, ny, nz, d): the points x of the ground have n·x = d, metres."""
    ground_std: Float[Tensor, "2"] | None = None
    """Standard deviations of a ground that was found: of its normal about each horizontal axis,
    radians, and of its height below the origin of the recording's frame, metres."""
    joint_std: Float[Tensor, "time 22"] | None = None
    """Standard deviation of every joint, metres."""
    angle_std: Float[Tensor, "time 42"] | None = None
    """Standard deviations of joint angles after the ISB, degrees, in the order of
    `recon.body.angles.ISB_ANGLES`."""
    observed: Bool[Tensor, "time 22"] | None = None
    """False where a joint was inferred rather than seen."""
    truth_visible: Bool[Tensor, "time 22"] | None = None
    """Joints that a simulated sensor could see; only files of simulated truth have it."""
    T_world_camera: Float[Tensor, "poses 4 4"] | None = None
    """Pose of the camera, metres: one for the clip, or one per frame."""
    in_camera: Float[Tensor, "time 6"] | None = None
    """SMPL translation (metres) and root rotation vector (radians) in that camera's frame."""
    cameras: tuple[FilmingCamera, ...] = ()
    """The cameras that a fit to 2D keypoints took or found."""
    format_version: int = MOTION_FORMAT
    """Version of the layout; 0 for files that other programs wrote, such as those of AMASS."""

"""Overlapping windows of a long recording, and their results joined without a seam."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from recon.core import rotations as so3
from recon.core.motion import Motion
from recon.method.timing import SAME_MOMENT


@dataclass(frozen=True)
class Windows:
    """Windows of equal length that cover a recording; each overlaps only with its neighbours."""

    starts: tuple[int, ...]
    """First frame of every window."""
    frames: int
    """Number of frames of a window."""

    @classmethod
    def cover(cls, total: int, longest: int, overlap: int, step: int = 1) -> "Windows":
        """Return the fewest, and then shortest, windows that cover a recording.

        Args:
            total: frames of the recording.
            longest: frames that a window may have, up to one `step` more.
            overlap: frames that neighbours share, up to two `step`s more or less.
            step: starts are multiples of it.

        Raises:
            ValueError: when the overlap is shorter than a step or longer than about 40 % of a
                window, so that three windows could meet.
        """
        most = (2 * longest - 6 * step + 3) // 5
        if not step <= overlap <= most:
            raise ValueError(
                f"windows of {longest} frames may share {step} to {most} of them, got {overlap}; "
                "choose an overlap below 40 % of the window"
            )
        if total <= longest:
            return cls((0,), total)
        count = math.ceil((total - overlap) / (longest - overlap))
        frames = math.ceil((total + (count - 1) * overlap) / count)
        frames += (total - frames) % step
        last = (total - frames) // step
        return cls(tuple(step * round(last * k / (count - 1)) for k in range(count)), frames)


def smooth_ramp(
    times: Float[Tensor, " time"], start: float, stop: float
) -> Float[Tensor, " time"]:
    """Return 3 u² - 2 u³, where u rises linearly from 0 at time `start` to 1 at `stop`."""
    share = ((times - start) / max(stop - start, 1e-9)).clamp(0, 1)
    return share.square() * (3 - 2 * share)


def joined_windows(motions: Sequence[Motion]) -> Motion:
    """Join the motions of overlapping windows, in order of time, to the motion of one clip.

    Where two windows overlap, the later one fades in: positions linearly, rotations along the
    shortest arc, so that position and speed are continuous. Motions have no batch axis. All are
    resampled to the frames of the first, whose shape the result has.

    Raises:
        ValueError: when rates differ, or a window shares no frame with the window before.
    """
    rates = {motion.fps for motion in motions}
    if len(rates) != 1:
        raise ValueError(f"windows of one clip need one frame rate, got {sorted(rates)}")
    origin = motions[0].start_time
    (first, held), *others = [_on_grid(motion, origin) for motion in motions]
    done: list[Motion] = []
    for start, motion in others:
        own = start - first
        shared = held.frames - own
        if not 0 < shared <= motion.frames or own < 0:
            raise ValueError(
                f"the window from {motion.start_time:.3f} s on has no frame in common with "
                f"the one before, which ends at {held.stop_time:.3f} s"
            )
        done += [
            held.window(0, own),
            _crossfaded(held.window(own, own + shared), motion.window(0, shared)),
        ]
        first, held = start + shared, motion.window(shared, motion.frames)
    parts = [*done, held]
    return parts[0].replace(
        translation=torch.cat([part.translation for part in parts]),
        rotations=torch.cat([part.rotations for part in parts]),
        valid=torch.cat([part.valid for part in parts]),
    )


def _on_grid(motion: Motion, origin: float) -> tuple[int, Motion]:
    """Resample a motion to frames numbered from time `origin`; return the first number, too.

    The last frame is the first one at or after the motion's end.
    """
    place = (motion.start_time - origin) * motion.fps
    first = math.ceil(place - SAME_MOMENT)
    last = math.ceil(place + motion.frames - 1 - SAME_MOMENT)
    numbers = torch.arange(first, last + 1, dtype=torch.float64, device=motion.translation.device)
    return first, motion.continued_at(origin + numbers / motion.fps, motion.fps)


def _crossfaded(before: Motion, after: Motion) -> Motion:
    weight = smooth_ramp(before.times, before.start_time, before.stop_time).to(before.translation)
    return before.replace(
        translation=before.translation.lerp(after.translation, weight[:, None]),
        rotations=so3.interpolate(
            before.rotations, after.rotations, weight[:, None].expand(-1, 22)
        ),
        valid=before.valid & after.valid,
    )


def interpolated_poses(
    translation: Float[Tensor, "known 3"],
    rotations: Float[Tensor, "known 22 3 3"],
    known: Int[Tensor, " known"],
    wanted: Int[Tensor, " wanted"],
) -> tuple[Float[Tensor, "wanted 3"], Float[Tensor, "wanted 22 3 3"]]:
    """Interpolate poses at the frames `wanted`; outside `known`, repeat the nearest pose."""
    after = torch.searchsorted(known, wanted).clamp(max=len(known) - 1)
    before = (after - (known[after] > wanted).long()).clamp(min=0)
    gap = (known[after] - known[before]).clamp(min=1)
    share = ((wanted - known[before]) / gap).clamp(0, 1).to(translation)[:, None]
    return translation[before].lerp(translation[after], share), so3.interpolate(
        rotations[before], rotations[after], share.expand(-1, rotations.shape[1])
    )

"""Overlapping windows of a long recording, and their results joined without a seam."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from recon.core import rotations as so3
from recon.core.motion import Motion
from recon.core.struct import TensorStruct

_SAME_MOMENT = 1e-4
"""Frames; moments closer than this are the same."""


@dataclass(frozen=True)
class Windows:
    """Stretches of equal length that cover a recording; each shares frames with the next only."""

    starts: tuple[int, ...]
    """First frame of each."""
    frames: int
    """Length of each."""

    @classmethod
    def cover(cls, total: int, longest: int, overlap: int, step: int = 1) -> "Windows":
        """The fewest and shortest windows that cover a recording.

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


@dataclass(frozen=True)
class Piece(TensorStruct):
    """What is kept of one window's fit."""

    motion: Motion
    contacts: Float[Tensor, "*batch time 22"] | None = None
    """Probability of contact where the prior predicts it."""

    @property
    def stop_time(self) -> float:
        """Time of the last frame, seconds."""
        return self.motion.start_time + (self.motion.frames - 1) / self.motion.fps

    def window(self, start: int, stop: int) -> "Piece":
        """Frames start, ..., stop - 1; the clock goes on."""
        contacts = None if self.contacts is None else self.contacts[..., start:stop, :]
        return Piece(self.motion.window(start, stop), contacts)


def fade(times: Float[Tensor, " time"], start: float, stop: float) -> Float[Tensor, " time"]:
    """3 u² - 2 u³ of the share u of the way from `start` to `stop`: 0 before, 1 after, no kink."""
    share = ((times - start) / max(stop - start, 1e-9)).clamp(0, 1)
    return share.square() * (3 - 2 * share)


def join(pieces: Sequence[Piece]) -> Piece:
    """One clip from the windows' (no batch axes), in order of time, the first one's clock.

    Where two windows overlap, the later one fades in: positions linearly, rotations along the
    shortest arc, so that position and speed are continuous. Windows off the first one's frames are
    brought onto them. The shape is the first one's.

    Raises:
        ValueError: when rates differ, or a window has no frame in common with the one before.
    """
    rates = {piece.motion.fps for piece in pieces}
    if len(rates) != 1:
        raise ValueError(f"windows of one clip need one frame rate, got {sorted(rates)}")
    origin = pieces[0].motion.start_time
    (first, held), *others = [_on_grid(piece, origin) for piece in pieces]
    done: list[Piece] = []
    for start, piece in others:
        own = start - first
        shared = held.motion.frames - own
        if not 0 < shared <= piece.motion.frames or own < 0:
            raise ValueError(
                f"the window from {piece.motion.start_time:.3f} s on has no frame in common with "
                f"the one before, which ends at {held.stop_time:.3f} s"
            )
        done += [
            held.window(0, own),
            _faded(held.window(own, own + shared), piece.window(0, shared)),
        ]
        first, held = start + shared, piece.window(shared, piece.motion.frames)
    return _end_to_end([*done, held])


def _on_grid(piece: Piece, origin: float) -> tuple[int, Piece]:
    """The piece at the frames of a clock that began at `origin`, and its first one's number."""
    motion = piece.motion
    place = (motion.start_time - origin) * motion.fps
    first = math.ceil(place - _SAME_MOMENT)
    last = math.floor(place + motion.frames - 1 + _SAME_MOMENT)
    numbers = torch.arange(first, last + 1, dtype=torch.float64, device=motion.translation.device)
    contacts = piece.contacts
    if contacts is not None:
        nearest = (numbers - place).round().long().clamp(0, motion.frames - 1)
        contacts = contacts[nearest]
    return first, Piece(motion.at(origin + numbers / motion.fps, motion.fps), contacts)


def _faded(before: Piece, after: Piece) -> Piece:
    a, b = before.motion, after.motion
    weight = fade(a.times, a.start_time, before.stop_time).to(a.translation)
    motion = a.replace(
        translation=a.translation.lerp(b.translation, weight[:, None]),
        rotations=so3.interpolate(a.rotations, b.rotations, weight[:, None].expand(-1, 22)),
        valid=a.valid & b.valid,
    )
    if before.contacts is None or after.contacts is None:
        return Piece(motion)
    return Piece(motion, before.contacts.lerp(after.contacts, weight[:, None]))


def _end_to_end(pieces: Sequence[Piece]) -> Piece:
    motions = [piece.motion for piece in pieces]
    contacts = [piece.contacts for piece in pieces if piece.contacts is not None]
    motion = motions[0].replace(
        translation=torch.cat([m.translation for m in motions]),
        rotations=torch.cat([m.rotations for m in motions]),
        valid=torch.cat([m.valid for m in motions]),
    )
    return Piece(motion, torch.cat(contacts) if len(contacts) == len(pieces) else None)

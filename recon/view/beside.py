"""Two motions side by side on one ground, played together."""

import dataclasses

import torch

from recon.core.motion import Motion
from recon.formats.motions import MotionFile
from recon.view.scene import Figure
from recon.view.viewpoint import across

_GAP_M = 0.2
"""Metres left between two bodies where they come nearest."""


def common(file: MotionFile, other: MotionFile) -> tuple[MotionFile, Motion]:
    """A motion and another from their own first frames on, as long as both last.

    The other takes the rate and the clock of the first.
    """
    motion, second = file.motion, other.motion.replace(start_time=file.motion.start_time)
    lasts = min((m.frames - 1) / m.fps for m in (motion, second))
    count = int(lasts * motion.fps + 1e-6) + 1
    motion = motion.window(0, count)
    per_frame = (
        "joints", "contacts", "contact_probability", "joint_std", "observed", "truth_visible",
        "in_camera",
    )  # fmt: skip
    known = {key: value for key in per_frame if (value := getattr(file, key)) is not None}
    cut = {key: value[:count] for key, value in known.items()}
    return dataclasses.replace(file, motion=motion, **cut), second.at(motion.times, motion.fps)


def beside(figure: Figure, other: Figure) -> Figure:
    """Another figure, moved to the right of the first as pictures show it, clear of it.

    Their first pelvises are level with each other; nothing else about the other changes.
    """
    right = torch.from_numpy(across(figure)).float()
    first, second = figure.posed.joints[..., :2], other.posed.joints[..., :2]
    level = first[0, 0] - second[0, 0]
    second = second + level
    needed = (first @ right[:2]).amax(-1) - (second @ right[:2]).amin(-1)
    shift = torch.nn.functional.pad(level, (0, 1)) + (float(needed.max()) + _GAP_M) * right
    motion = other.motion
    moved = motion.replace(translation=motion.translation + shift.to(motion.translation))
    return dataclasses.replace(other, motion=moved)

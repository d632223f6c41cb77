"""Heels, toes and pelvis of a motion over time, as gait is told from them."""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from recon.body.contacts import contact_labels, rest_heights
from recon.body.landmarks import landmark
from recon.body.model import BodyModel
from recon.core.errors import ReconError
from recon.core.motion import Motion
from recon.core.skeleton import joint_index

SIDES = ("left", "right")
"""Order of the sides wherever an axis has two."""
CUTOFF = 12.0
"""Hertz above which the paths of feet are noise. Lower limits, which are common for coordinates of
walking, blur the moment of the strike: 7 Hz tripled the deviation from marked events."""

_HIPS = tuple(joint_index(f"{side}_hip") for side in SIDES)
_SOLES = tuple((joint_index(f"{side}_ankle"), joint_index(f"{side}_foot")) for side in SIDES)


@dataclass(frozen=True)
class Feet:
    """Feet and pelvis of one clip in the frame of the ground that they stand on, metres, z up.

    On a treadmill that is the belt, in whose frame the person walks ahead.
    """

    heels: Float[np.ndarray, "time 2 3"]
    """Back of the left and of the right heel."""
    toes: Float[np.ndarray, "time 2 3"]
    """Base of the second toe, left and right."""
    pelvis: Float[np.ndarray, "time 3"]
    """Joint in the middle of the pelvis."""
    forward: Float[np.ndarray, "time 2"]
    """Horizontal direction that the pelvis faces, a unit vector."""
    bearing: Bool[np.ndarray, "time 2"] | None
    """Whether a foot is in contact with the ground; None where there is no ground."""
    times: Float[np.ndarray, " time"]
    """Seconds of the recording's clock."""
    fps: float

    @classmethod
    def of(
        cls,
        motion: Motion,
        body: BodyModel,
        ground: float | None = 0.0,
        belt: Float[Tensor, " 2"] | None = None,
    ) -> "Feet":
        """The feet of a motion, filtered at 12 Hz without delay.

        Args:
            motion: one clip without a batch axis.
            body: whose motion it is; the bundled one, whose heels and toes are known.
            ground: height of the ground, metres; None where there is none.
            belt: velocity of a treadmill's belt in the room, m/s; None where the ground rests.

        Raises:
            ReconError: when the body is another one.
        """
        if body.checksum != BodyModel.load().checksum:
            raise ReconError(
                f"gait is told from heels and toes, which are known of the bundled body only, not "
                f"of {body.name!r}: give a motion of the bundled body"
            )
        posed = body.pose(motion.detach())
        times = motion.times.double().cpu()
        path = torch.zeros(len(times), 3, dtype=torch.float64)
        if belt is not None:
            path[:, :2] = (times - times[0])[:, None] * belt.double().cpu()
        joints = posed.joints.double().cpu() - path[:, None]
        points = torch.tensor([landmark(f"{s}_{n}") for n in ("heel", "toe2_base") for s in SIDES])
        skin = posed.points(points).double().cpu() - path[:, None]
        bearing = None
        if ground is not None:
            above = joints - joints.new_tensor([0.0, 0.0, ground])
            heights = rest_heights(body, motion.shape).double().cpu()
            labels = contact_labels(above, heights, motion.fps).numpy()
            bearing = np.stack([labels[:, list(sole)].any(-1) for sole in _SOLES], -1)
        smooth = low_passed(skin.numpy(), motion.fps)
        return cls(
            heels=smooth[:, :2],
            toes=smooth[:, 2:],
            pelvis=low_passed(joints[:, 0].numpy(), motion.fps),
            forward=_forward(low_passed(joints.numpy(), motion.fps)),
            bearing=bearing,
            times=times.numpy(),
            fps=motion.fps,
        )


def low_passed(values: Float[np.ndarray, "time ..."], fps: float) -> Float[np.ndarray, "time ..."]:
    """Values over time without what is faster than 12 Hz: Butterworth, second order, both ways.

    Values at too low a rate to hold anything faster, or too few, are returned as they are.
    """
    from scipy.signal import butter, sosfiltfilt

    if fps <= 2 * CUTOFF or len(values) <= 12:
        return values
    sections = butter(2, CUTOFF, fs=fps, output="sos")
    return sosfiltfilt(sections, values, axis=0, padlen=min(len(values) - 1, round(fps / 2)))


def _forward(joints: Float[np.ndarray, "time 22 3"]) -> Float[np.ndarray, "time 2"]:
    across = (joints[:, _HIPS[0]] - joints[:, _HIPS[1]])[:, :2]
    across = across / np.linalg.norm(across, axis=-1, keepdims=True).clip(min=1e-9)
    return np.stack((across[:, 1], -across[:, 0]), -1)

"""Fingers: names and order of joints and points, and `Hands`, the record of their motion."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from recon.core import rotations as so3
from recon.core.errors import FormatError
from recon.core.skeleton import JOINTS
from recon.core.struct import TensorStruct

SIDES = ("left", "right")
FINGERS = ("thumb", "index", "middle", "ring", "pinky")
"""In the order of a hand's points."""
_STORED = ("index", "middle", "pinky", "ring", "thumb")
HAND_JOINTS = tuple(f"{s}_{finger}{k}" for s in SIDES for finger in _STORED for k in (1, 2, 3))
"""The joints of SMPL-H that follow our 22, in its order: 1 is the knuckle (of the thumb, the joint
at the wrist), 3 is the one nearest to the tip."""
TIPS = tuple(f"{s}_{finger}_tip" for s in SIDES for finger in _STORED)
_ALL = (*JOINTS, *HAND_JOINTS, *TIPS)


def _parent_index(name: str) -> int:
    side, _, rest = name.partition("_")
    if rest.endswith("_tip"):
        return _ALL.index(f"{side}_{rest.removesuffix('_tip')}3")
    order = int(rest[-1])
    return _ALL.index(f"{side}_wrist" if order == 1 else f"{side}_{rest[:-1]}{order - 1}")


HAND_PARENTS = tuple(_parent_index(name) for name in (*HAND_JOINTS, *TIPS))
"""Number of the parent of every finger joint and then of every tip, among JOINTS + HAND_JOINTS."""
OF_HAND = tuple(
    name.format(finger) for finger in FINGERS for name in ("{}1", "{}2", "{}3", "{}_tip")
)
FINGER_POINTS = tuple(f"{s}_{name}" for s in SIDES for name in ("hand_wrist", *OF_HAND))
"""The 21 points of each hand, the left one's first, in the order of MediaPipe, OpenPose and
COCO-WholeBody: the wrist, then of every finger three joints and the tip, thumb first."""
ROWS: Int[Tensor, "2 20"] = torch.tensor([
    [(*HAND_JOINTS, *TIPS).index(f"{side}_{name}") for name in OF_HAND] for side in SIDES
])  # fmt: skip
"""Number among HAND_JOINTS + TIPS of every point of a hand but the wrist."""
HANDS = "+hands"
"""Ending of a layout's name with which FINGER_POINTS follow its keypoints."""


@dataclass(frozen=True)
class Hands(TensorStruct):
    """Finger rotations of one body in the frames of its motion, and lengths of finger bones."""

    rotations: Float[Tensor, "*batch time 30 3 3"]
    """Rotation of every joint of HAND_JOINTS relative to its parent; the identity is a straight
    finger of a flat hand, as in SMPL-H."""
    lengths: Float[Tensor, "*batch 40"] | None = None
    """Metres from the parent to every joint of HAND_JOINTS, then to every one of TIPS; None takes
    those of the body's shape."""

    def window(self, start: int, stop: int) -> "Hands":
        """Return the finger rotations of frames start, ..., stop - 1."""
        return self.replace(rotations=self.rotations[..., start:stop, :, :, :])

    def interpolated(
        self, before: Int[Tensor, " times"], after: Int[Tensor, " times"], fraction: Tensor
    ) -> "Hands":
        """Interpolate finger rotations between pairs of frames, along the shortest arcs."""
        a, b = (self.rotations[..., k, :, :, :] for k in (before, after))
        share = fraction.to(a)[:, None].expand(len(before), a.shape[-3])
        return self.replace(rotations=so3.interpolate(a, b, share))

    def arrays(self) -> dict[str, np.ndarray]:
        """Arrays for a motion file: rotation vectors (time, 90) as of SMPL-H, and lengths."""
        turns = so3.log(self.rotations.detach().double().cpu()).to(self.rotations.dtype)
        found = {"pose_hand": turns.flatten(-2).numpy()}
        if self.lengths is not None:
            found["finger_lengths"] = self.lengths.detach().cpu().numpy()
        return found


_FIRST = {156: 66, 165: 75}
"""Columns of `poses` of SMPL-H and SMPL-X, and the first one of the fingers."""


def hands_of_arrays(
    arrays: Mapping[str, np.ndarray], path: object, dtype: torch.dtype
) -> Hands | None:
    """Read finger rotations from a motion file's arrays (AMASS with SMPL-H or SMPL-X, or ours).

    None where it has none: other layouts, and fingers all of whose rotations are zero.

    Raises:
        ValueError: when arrays have the wrong shape, or NaN or infinity in them.
    """
    poses, turns = arrays.get("poses"), arrays.get("pose_hand")
    frames = len(arrays["trans"])
    if turns is None and poses is not None:
        poses = poses.reshape(frames, -1)
        first = _FIRST.get(poses.shape[1])
        turns = None if first is None else poses[:, first : first + 90]
    if turns is None or not np.any(turns):
        return None
    lengths = arrays.get("finger_lengths")
    for name, value, shape in (
        ("pose_hand", turns, (frames, 90)), ("finger_lengths", lengths, (40,))
    ):  # fmt: skip
        if value is not None and (value.shape != shape or not np.isfinite(value).all()):
            raise FormatError(
                f"{path}: expected finite numbers of shape {shape} in {name}, got {value.shape}"
            )
    if lengths is not None and not ((lengths > 0) & (lengths < _LONGEST)).all():
        raise FormatError(f"{path}: expected finger_lengths between 0 and {_LONGEST} m")
    rotations = so3.exp(torch.from_numpy(turns.reshape(frames, 30, 3)).double()).to(dtype)
    return Hands(rotations, None if lengths is None else torch.from_numpy(lengths).to(dtype))


_LONGEST = 0.3
"""Metres that no bone of a hand has."""

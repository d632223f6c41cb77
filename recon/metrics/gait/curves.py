"""Joint angles over the cycles of gait, with the signs that both sides share."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from recon.core.skeleton import joint_index
from recon.metrics.gait.cycles import GaitCycle, normalised
from recon.metrics.gait.events import Side


@dataclass(frozen=True)
class GaitCurve:
    """An angle that is drawn over the cycle of either side."""

    name: str
    """Its name among the angles; `_l` and `_r` follow where it belongs to a side."""
    title: str
    """What it is, and what a positive angle means."""
    sided: bool = True
    """Whether each side has its own."""
    mirrored: Side | None = None
    """Side whose cycles have the opposite sign."""
    from_heading: bool = False
    """Whether it is a direction in the world, told from the direction of the stride here."""
    joints: tuple[str, ...] = ()
    """Joints of the side that must be seen for the angle to be seen."""

    def angle(self, side: Side) -> str:
        """Name of the angle of a side."""
        return f"{self.name}_{side[0]}" if self.sided else self.name

    def seen_joints(self, side: Side) -> list[int]:
        """Numbers of the joints that the angle of a side is told from."""
        return [joint_index(f"{side}_{name}") for name in self.joints]


CURVES: tuple[GaitCurve, ...] = (
    GaitCurve("pelvis_anterior_tilt", "Pelvic tilt, anterior +", False, joints=("hip",)),
    GaitCurve("pelvis_left_up_obliquity", "Pelvic obliquity, own side up +", False, "right",
              joints=("hip",)),
    GaitCurve("pelvis_left_rotation", "Pelvic rotation, own side forward +", False, "left", True,
              joints=("hip",)),
    GaitCurve("hip_flexion", "Hip flexion +", joints=("hip", "knee")),
    GaitCurve("hip_adduction", "Hip adduction +", joints=("hip", "knee")),
    GaitCurve("hip_internal_rotation", "Hip internal rotation +",
              joints=("hip", "knee", "ankle")),
    GaitCurve("knee_flexion", "Knee flexion +", joints=("hip", "knee", "ankle")),
    GaitCurve("ankle_dorsiflexion", "Ankle dorsiflexion +", joints=("knee", "ankle", "foot")),
    GaitCurve("ankle_internal_rotation", "Foot internal rotation +",
              joints=("knee", "ankle", "foot")),
    GaitCurve("trunk_flexion", "Trunk flexion to pelvis +", False, joints=("hip", "shoulder")),
    GaitCurve("trunk_right_bending", "Trunk bending to own side +", False, "left",
              joints=("hip", "shoulder")),
    GaitCurve("trunk_left_rotation", "Trunk rotation, own side forward +", False, "left",
              joints=("hip", "shoulder")),
)  # fmt: skip
"""What the page shows, row by row: pelvis, hip, knee and ankle, trunk."""

_CHAINS: Mapping[str, tuple[str, str, str]] = {
    "knee_flexion": ("hip", "knee", "ankle"),
    "ankle_dorsiflexion": ("knee", "ankle", "foot"),
    "elbow_flexion": ("shoulder", "elbow", "wrist"),
}
"""Angles between two bones whose three joints tell them."""


def over_cycle(
    curve: GaitCurve,
    angles: Mapping[str, Float[np.ndarray, " time"]],
    times: Float[np.ndarray, " time"],
    cycle: GaitCycle,
) -> Float[np.ndarray, " percent"]:
    """The angle of the cycle's side at every percent of it, degrees."""
    values = angles[curve.angle(cycle.side)]
    if curve.from_heading:
        values = values - np.rad2deg(cycle.heading)
    found = normalised(values, times, cycle)
    if curve.from_heading:
        found = found - 360 * np.round(found.mean() / 360)
    return -found if cycle.side == curve.mirrored else found


def flexion_std(
    joints: Float[np.ndarray, "time 22 3"], std: Float[np.ndarray, "time 22"]
) -> dict[str, Float[np.ndarray, " time"]]:
    """Standard deviations of the angles of knees, ankles and elbows, degrees, by name.

    First-order propagation of the standard deviations of the three joints in the plane of the two
    bones, taken as independent of each other. Errors that neighbouring joints have in common
    would make it smaller, so it is rather too large. Other angles depend on turns about bones or
    on the trunk, of which positions of joints say too little.

    Args:
        joints: positions in the world, metres.
        std: standard deviation of a coordinate of every joint, metres.
    """
    found: dict[str, np.ndarray] = {}
    for name, chain in _CHAINS.items():
        for side in ("left", "right"):
            a, b, c = (joint_index(f"{side}_{joint}") for joint in chain)
            upper, lower = joints[:, a] - joints[:, b], joints[:, c] - joints[:, b]
            long, short = np.linalg.norm(upper, axis=-1), np.linalg.norm(lower, axis=-1)
            cosine = ((upper * lower).sum(-1) / (long * short)).clip(-1, 1)
            # the middle joint moves both lines, in opposite senses where the limb is straight
            middle = 1 / long**2 + 1 / short**2 - 2 * cosine / (long * short)
            variance = (std[:, a] / long) ** 2 + (std[:, c] / short) ** 2 + std[:, b] ** 2 * middle
            found[f"{name}_{side[0]}"] = np.rad2deg(np.sqrt(variance))
    return found

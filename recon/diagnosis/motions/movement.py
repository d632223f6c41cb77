"""What laws of movement are judged on: the centre of mass and the feet of a body over time."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from torch import Tensor

from recon.body.model import BodyModel
from recon.core.motion import Motion
from recon.core.skeleton import joint_index
from recon.physics.mass import centre_of_mass, vertex_masses_of_segments

_HIPS = (joint_index("left_hip"), joint_index("right_hip"))
_KNEES = (joint_index("left_knee"), joint_index("right_knee"))
_ANKLES = (joint_index("left_ankle"), joint_index("right_ankle"))
_TOES = (joint_index("left_foot"), joint_index("right_foot"))
_ASKED = (joint_index("pelvis"), *_HIPS, *_KNEES, *_ANKLES)
_SELDOM = 0.1
"""Share of the frames in which the lower sole may be below the ground."""
_HEEL, _TIP = 0.4, 0.5
"""How far the sole reaches behind the ankle and beyond the toe joint, in lengths of the line
between the two."""


@dataclass(frozen=True)
class Movement:
    """One stretch of a motion in which the pelvis and both legs were seen; metres, z up."""

    joints: Float[np.ndarray, "time 22 3"]
    centre: Float[np.ndarray, "time 3"]
    """Centre of mass."""
    leg: float
    """Length of a leg from the hip joint over the knee to the ankle."""
    sole_drop: Float[np.ndarray, " 2"]
    """Height of the ankle and of the toe joint above the sole of a standing foot."""
    fps: float

    @classmethod
    def of(
        cls, motion: Motion, body: BodyModel, observed: Bool[Tensor, "time 22"] | None = None
    ) -> "Movement":
        """The longest stretch of one clip in which the pelvis and both legs were observed.

        Args:
            motion: one clip, z up, without a batch axis.
            body: whose motion it is.
            observed: joints that the data shows; None means all.
        """
        seen = motion.valid.cpu()
        if observed is not None:
            seen = seen & observed[:, list(_ASKED)].cpu().all(-1)
        first, last = _longest(seen.numpy())
        posed = body.pose(motion.window(first, last).detach())
        centre = centre_of_mass(posed, vertex_masses_of_segments(body))
        rest = posed.rest.double().cpu().numpy()
        sole = float(body.rest_vertices(motion.shape)[..., 1].amin())
        thigh = np.linalg.norm(rest[list(_HIPS)] - rest[list(_KNEES)], axis=-1).mean()
        shank = np.linalg.norm(rest[list(_KNEES)] - rest[list(_ANKLES)], axis=-1).mean()
        return cls(
            joints=posed.joints.double().cpu().numpy(),
            centre=centre.double().cpu().numpy(),
            leg=float(thigh + shank),
            sole_drop=np.array([rest[list(group), 1].mean() - sole for group in (_ANKLES, _TOES)]),
            fps=motion.fps,
        )

    @property
    def frames(self) -> int:
        """Number of frames."""
        return len(self.joints)

    @property
    def seconds(self) -> float:
        """Length of the stretch by the declared rate."""
        return self.frames / self.fps

    @property
    def ankles(self) -> Float[np.ndarray, "time 2 3"]:
        """Left and right ankle."""
        return self.joints[:, list(_ANKLES)]

    @property
    def toes(self) -> Float[np.ndarray, "time 2 3"]:
        """Left and right toe joint."""
        return self.joints[:, list(_TOES)]

    @property
    def forward(self) -> Float[np.ndarray, "time 2"]:
        """Horizontal direction in which the pelvis faces."""
        across = (self.joints[:, _HIPS[0]] - self.joints[:, _HIPS[1]])[:, :2]
        across = across / np.linalg.norm(across, axis=-1, keepdims=True).clip(min=1e-9)
        return np.stack((across[:, 1], -across[:, 0]), -1)

    @property
    def sole_heights(self) -> Float[np.ndarray, "time 2"]:
        """Height of the lowest part of the left and the right foot."""
        both = np.stack((self.ankles[..., 2], self.toes[..., 2]), -1) - self.sole_drop
        return both.min(-1)

    @property
    def ground(self) -> float:
        """Height of the ground: the soles are seldom lower."""
        return float(np.quantile(self.sole_heights.min(1), _SELDOM))

    @property
    def soles(self) -> Float[np.ndarray, "time 2 2 3"]:
        """Heel and tip of the left and the right foot, at the height of the joints."""
        along = self.toes - self.ankles
        return np.stack((self.ankles - _HEEL * along, self.toes + _TIP * along), -2)


def _longest(seen: Bool[np.ndarray, " time"]) -> tuple[int, int]:
    """First frame and last + 1 of the longest run of true values; (0, 0) where there is none."""
    best, first = (0, 0), 0
    for index, here in enumerate([*seen.tolist(), False]):
        if here:
            continue
        if index - first > best[1] - best[0]:
            best = (first, index)
        first = index + 1
    return best

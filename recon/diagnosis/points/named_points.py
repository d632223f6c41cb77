"""Tracked points in space with their names and their places on the body, for one clip."""

from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Bool, Float

from observations.keypoints3d import Keypoints3D
from observations.together.kinds import Tracked
from recon.body.model import BodyModel
from recon.core.skeleton import MIRROR

Points = Tracked
"""Sensors that give the places of named points in space."""

_MIRRORED_WITHIN = 0.04
"""Metres between a point's mirror image at rest and its counterpart on the other side; markers
are not placed more alike than this."""


@dataclass(frozen=True)
class NamedPoints:
    """Positions of named points of one clip, in arrays that checks can work on."""

    positions: Float[np.ndarray, "moments points 3"]
    """Frame of the recording, metres; zero where not visible."""
    visible: Bool[np.ndarray, "moments points"]
    names: tuple[str, ...]
    bones: tuple[int, ...]
    """The body joint whose bone carries each point."""
    rest: Float[np.ndarray, "points 3"]
    """Positions of the points on the average body in its rest pose, metres."""
    fps: float
    are_joints: bool
    """Whether the points are joints and keypoints rather than markers on the skin."""
    rigid: tuple[tuple[int, int], ...] | None = None
    """Pairs of points whose distance no pose changes; None where the bones alone tell them."""
    std: Float[np.ndarray, "moments points"] | None = None
    """Standard deviation of the coordinates, metres; None where none are given."""

    @classmethod
    def of(cls, observation: Points, body: BodyModel) -> "NamedPoints":
        """The points of an observation of one clip, whose batch axis has length one."""
        return cls(
            positions=observation.positions[0].double().cpu().numpy(),
            visible=observation.visible[0].cpu().numpy(),
            names=observation.point_names(body),
            bones=observation.bones(body),
            rest=observation.at_rest(body).double().cpu().numpy(),
            fps=observation.fps,
            are_joints=not observation.on_skin,
            rigid=(
                observation.points.rigid_pairs(body)
                if isinstance(observation, Keypoints3D)
                else None
            ),
            std=None if observation.std is None else observation.std[0].double().cpu().numpy(),
        )

    def into(self, observation: Points) -> Points:
        """The observation with these positions instead of its own, zero where not visible."""
        positions = self.positions * self.visible[..., None]
        std = None if self.std is None else torch.from_numpy(self.std.copy())[None]
        return observation.replace(
            positions=torch.from_numpy(positions)[None].to(observation.positions),
            visible=torch.from_numpy(self.visible.copy())[None].to(observation.visible.device),
            std=std,
        )

    def without(self, hidden: Bool[np.ndarray, "moments points"]) -> "NamedPoints":
        """The points with some of them no longer visible."""
        return replace(self, visible=self.visible & ~hidden)

    def permuted(
        self, order: tuple[int, ...], moments: Bool[np.ndarray, " moments"]
    ) -> "NamedPoints":
        """The points with names exchanged at some moments: point k gets data of point order[k]."""
        index = list(order)
        positions, visible = self.positions.copy(), self.visible.copy()
        positions[moments] = self.positions[moments][:, index]
        visible[moments] = self.visible[moments][:, index]
        std = self.std
        if std is not None:
            std = std.copy()
            std[moments] = std[moments][:, index]
        return replace(self, positions=positions, visible=visible, std=std)

    @property
    def counterparts(self) -> tuple[int, ...]:
        """Index of every point's mirror image on the body; its own index where there is none.

        Joints and landmarks of the bundled body come in pairs; the rest pose is symmetric.
        """
        image = self.rest * np.array([-1.0, 1.0, 1.0])
        image[:, 0] += 2 * self._middle
        away = np.linalg.norm(image[:, None] - self.rest[None], axis=-1)
        bones_match = np.array([[MIRROR[a] == b for b in self.bones] for a in self.bones])
        away[~bones_match] = np.inf
        nearest = away.argmin(1)
        return tuple(
            int(j) if away[k, j] < _MIRRORED_WITHIN and nearest[j] == k else k
            for k, j in enumerate(nearest)
        )

    @property
    def _middle(self) -> float:
        """The x coordinate of the body's plane of symmetry at rest, metres."""
        central = [k for k, bone in enumerate(self.bones) if MIRROR[bone] == bone]
        return float(np.median(self.rest[central, 0])) if central else 0.0

    @property
    def centre(self) -> Float[np.ndarray, "moments 3"]:
        """Median of the visible points at every moment; NaN where there is none."""
        shown = np.where(self.visible[..., None], self.positions, np.nan)
        empty = ~self.visible.any(1)
        shown[empty] = 0.0
        middle = np.nanmedian(shown, axis=1)
        middle[empty] = np.nan
        return middle

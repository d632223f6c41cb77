"""3D keypoints: points of the body measured in space, as by triangulation or depth cameras."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from observations.correspondences import TRUNK, BodyPoints
from observations.fingers import body_points_only, checked_fingers, split_off_fingers
from observations.points import TrackedPoints
from observations.start.rigid import rigid_start
from observations.start.standing import planted_translations
from recon.body.model import BodyModel
from recon.core import rotations as so3
from recon.core.arrays import Numbers
from recon.core.fingers import HANDS
from recon.core.motion import Motion
from recon.core.residuals import squared


@dataclass(frozen=True, init=False)
class Keypoints3D(TrackedPoints):
    """Measured 3D positions of a detector's keypoints, which lie in the body or on its skin.

    The energy is half the squared distance of every visible keypoint from the same point of the
    body, in metres². Keypoints without a place in the world (`placed` is false) are compared after
    the translation of every moment that brings them nearest.
    """

    points: BodyPoints
    """The points of the body that the keypoints are measurements of."""
    level: bool = True
    """Whether the z axis points up. Where it does not, as in the frame of a tilted camera, the
    direction of gravity is estimated with the motion."""
    placed: bool = True
    """Whether positions are places in the world; false where every moment is relative to the
    body, for example to its pelvis."""
    timed = (*TrackedPoints.timed, "fingers")
    fingers: Float[Tensor, "*batch moments 42 4"] | None = None
    """Position (metres) and confidence of `recon.core.fingers.FINGER_POINTS`, to which fingers are
    fitted after the body; zero where not seen. Names that `points` lists may be among these."""

    def __init__(
        self,
        positions: Numbers,
        visible: Numbers,
        points: BodyPoints | str | Sequence[str],
        fps: float,
        start_time: float = 0.0,
        kernel: Callable[[Tensor], Tensor] = squared,
        ground_known: bool = True,
        offset_rows: tuple[int, int] | None = None,
        std: Numbers | float | None = None,
        level: bool = True,
        placed: bool = True,
        fingers: Numbers | None = None,
    ) -> None:
        """Takes positions (moments, keypoints, 3) and `std`, both in metres.

        `visible` is (moments, keypoints); `fps` is in Hz. Positions that are not visible become
        zero. Arrays of numpy become float32 tensors.

        `points` may be the name of a layout (`recon.core.layouts.LAYOUTS`) or the names of the
        keypoints in their order, which are then points of the bundled body. `std` may have any
        shape that broadcasts to (moments, points).

        Raises:
            ValueError: naming the array, what was expected and what came.
        """
        names = () if isinstance(points, BodyPoints) else points
        if names.endswith(HANDS) if isinstance(names, str) else not body_points_only(names):
            points, positions, visible, std, fingers = split_off_fingers(
                points, positions, visible, std
            )
        if isinstance(points, str):
            points = BodyPoints.of_layout(points, BodyModel.load())
        elif not isinstance(points, BodyPoints):
            points = BodyPoints.of_names(tuple(points), BodyModel.load())
        if fingers is not None:
            fingers = checked_fingers(fingers, positions, 4)
        # only the bundled mesh has places for keypoints on the skin; on others they are unseen
        self._set_measured(
            positions, visible, (fps, start_time), std, ("points", points.bones), points.known,
            kernel=kernel, ground_known=ground_known, offset_rows=offset_rows, points=points,
            level=level, placed=placed, fingers=fingers,
        )  # fmt: skip

    def transformed(self, T_new_old: Float[np.ndarray, "4 4"]) -> "Keypoints3D":
        """Return the sensor with its keypoints moved to another frame of coordinates, metres."""
        moved = super().transformed(T_new_old)
        if self.fingers is None:
            return moved
        T, places = torch.from_numpy(T_new_old).to(self.fingers), self.fingers[..., :3]
        places = so3.transform(T, places).where(self.fingers[..., 3:] > 0, 0.0)
        return moved.derived(fingers=torch.cat((places, self.fingers[..., 3:]), -1))

    def bones(self, body: BodyModel) -> tuple[int, ...]:
        """Joint index of the bone that moves each keypoint.

        Means of joints of both sides belong to the trunk.
        """
        del body
        named = zip(self.points.names, self.points.bones, strict=True)
        return tuple(TRUNK.get(name, bone) for name, bone in named)

    def rigid_pairs(self, body: BodyModel) -> tuple[tuple[int, int], ...] | None:
        """Pairs of keypoints on the same bone, whose distance is constant."""
        return self.points.rigid_pairs(body)

    def start(self, body: BodyModel) -> Motion:
        """The rest pose, aligned with the points of the torso in every frame.

        Keypoints without a place in the world are first moved so that the foot that stands stays.
        """
        placed = self.positions if self.placed else self.positions + self._planted_translations()
        return rigid_start(
            body, self.at_rest(body).to(placed), self.bones(body), placed, self.visible,
            fps=self.fps, start_time=self.start_time,
        )  # fmt: skip

    def _planted_translations(self) -> Float[Tensor, "*batch moments 1 3"]:
        """Translations of the keypoints, per frame, metres, so that standing feet do not slide."""
        moments, count = self.visible.shape[-2:]
        every = zip(
            self.positions.detach().double().cpu().reshape(-1, moments, count, 3).numpy(),
            self.visible.cpu().reshape(-1, moments, count).numpy(),
            strict=True,
        )
        paths = np.stack([
            planted_translations(self.points.names, positions, visible, self.fps)
            for positions, visible in every
        ])  # fmt: skip
        return torch.from_numpy(paths).to(self.positions).reshape(*self.clips, moments, 1, 3)

"""3D keypoints: points of the body where triangulations and depth cameras see them in space."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from observations.checks import checked_clock, checked_places, checked_positions, checked_std
from observations.correspondences import TRUNK, BodyPoints
from observations.records.tracked import TrackedPoints
from observations.start.rigid import rigid_start
from observations.start.standing import planted_path
from recon.body.derivatives import CarriedPoints
from recon.body.model import BodyModel, PosedBody
from recon.core.arrays import Numbers
from recon.core.motion import Motion
from recon.core.robust import squared


@dataclass(frozen=True, init=False)
class Keypoints3D(TrackedPoints):
    """Measured 3D positions of a detector's keypoints, which lie in the body or on its skin.

    The energy is half the squared distance of every visible keypoint from the same point of the
    body, in metres². Keypoints without a place in the world (`placed` is false) are compared after
    the translation of every moment that brings them nearest.
    """

    sees = "points"
    on_skin: ClassVar[bool] = False
    positions: Float[Tensor, "*batch moments points 3"]
    """Positions in metres, in the frame of the recording; zero where not visible."""
    visible: Bool[Tensor, "*batch moments points"]
    """Whether a keypoint was seen at a moment."""
    points: BodyPoints
    """The points of the body that the keypoints are measurements of."""
    fps: float
    """Rate of the moments in Hz."""
    start_time: float = 0.0
    """Time of the first moment, in seconds of the clock that all observations of a clip share."""
    kernel: Callable[[Tensor], Tensor] = squared
    """Robust kernel that is applied to squared distances in metres²; see `recon.core.robust`."""
    ground_known: bool = True
    """Whether the plane z = 0 of the recording is the ground."""
    offset_rows: tuple[int, int] | None = None
    """First row, and the row after the last, of `Scene.offsets` that these keypoints own:
    constant offsets from the body model that are estimated with the motion. None estimates none.
    """
    std: Float[Tensor, "*batch moments points"] | None = None
    """Standard deviation of the coordinates of every keypoint at every moment, metres; zero where
    it was not visible. None counts all keypoints alike and estimates the noise."""
    level: bool = True
    """Whether the z axis points up. Where it does not, as in the frame of a tilted camera, the
    direction of gravity is estimated with the motion."""
    placed: bool = True
    """Whether positions are places in the world; false where every moment is relative to the
    body, for example to its pelvis."""
    rms_std: float | None = field(init=False, default=None)
    """Root mean square of `std` over the visible keypoints of the whole recording, metres. Its
    parts keep it, so that a keypoint weighs the same in every window."""

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
    ) -> None:
        """Arrays of numpy become tensors in single precision; what is not visible becomes zero.

        `points` may be the name of a layout (`recon.core.skeleton.LAYOUTS`) or the names of the
        keypoints in their order, which are then points of the bundled body. `std` may have any
        shape that broadcasts to (moments, points).

        Raises:
            ValueError: naming the array, what was expected and what came.
        """
        if isinstance(points, str):
            points = BodyPoints.of_layout(points, BodyModel.load())
        elif not isinstance(points, BodyPoints):
            points = BodyPoints.of_names(tuple(points), BodyModel.load())
        positions, visible = checked_positions(
            "Keypoints3D", "positions", positions, "visible", visible
        )
        checked_places("Keypoints3D", "points", points.bones, positions.shape[-2])
        fps, start_time = checked_clock("Keypoints3D", fps, start_time)
        # a body with another mesh has no places for what lies on the skin
        visible = visible & points.known.to(visible.device)
        positions = positions.where(visible[..., None], 0.0)
        std, rms_std = checked_std("Keypoints3D", std, visible, positions)
        self._settle(
            positions=positions, visible=visible, points=points, fps=fps, start_time=start_time,
            kernel=kernel, ground_known=ground_known, offset_rows=offset_rows, std=std,
            level=level, placed=placed, rms_std=rms_std,
        )  # fmt: skip

    def on(self, posed: PosedBody) -> Float[Tensor, "*batch time points 3"]:
        """The keypoints of a posed body, world, metres."""
        return self.points.of(posed)

    def on_bones(self, body: BodyModel, shape: Float[Tensor, " shape"]) -> CarriedPoints:
        """The keypoints on a body of some shape."""
        points = self.points
        return CarriedPoints.create(
            body, shape, points.of_joints, points.of_vertices, points.vertices
        )

    def at_rest(self, body: BodyModel) -> Float[Tensor, "points 3"]:
        """The keypoints of the average body in its rest pose, metres."""
        return self.points.at_rest(body, body.template.new_zeros(body.shape_size))

    def bones(self, body: BodyModel) -> tuple[int, ...]:
        """The bone that carries each keypoint; the trunk carries means of joints of both sides."""
        del body
        named = zip(self.points.names, self.points.bones, strict=True)
        return tuple(TRUNK.get(name, bone) for name, bone in named)

    def rigid_pairs(self, body: BodyModel) -> tuple[tuple[int, int], ...] | None:
        """Pairs of keypoints of one bone."""
        return self.points.rigid_pairs(body)

    def point_names(self, body: BodyModel) -> tuple[str, ...]:
        """Names of the keypoints."""
        del body
        return self.points.names

    def start(self, body: BodyModel) -> Motion:
        """The rest pose, aligned with the points of the torso in every frame.

        Keypoints without a place in the world are first moved so that the foot that stands stays.
        """
        placed = self.positions if self.placed else self.positions + self._path()
        return rigid_start(
            body, self.at_rest(body).to(placed), self.bones(body), placed, self.visible,
            fps=self.fps, start_time=self.start_time,
        )  # fmt: skip

    def _path(self) -> Float[Tensor, "*batch moments 1 3"]:
        """Translations of every moment that plant the feet, metres."""
        moments, count = self.visible.shape[-2:]
        every = zip(
            self.positions.detach().double().cpu().reshape(-1, moments, count, 3).numpy(),
            self.visible.cpu().reshape(-1, moments, count).numpy(),
            strict=True,
        )
        paths = np.stack([
            planted_path(self.points.names, positions, visible, self.fps)
            for positions, visible in every
        ])  # fmt: skip
        return torch.from_numpy(paths).to(self.positions).reshape(*self.clips, moments, 1, 3)

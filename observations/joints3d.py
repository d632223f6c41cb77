"""3D joints: positions of body joints in the world, noisy and partly missing."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import ClassVar

from jaxtyping import Bool, Float
from torch import Tensor

from observations.checks import (
    checked_clock,
    checked_places,
    checked_positions,
    checked_std,
)
from observations.records.tracked import TrackedPoints
from recon.body.derivatives import CarriedPoints
from recon.body.model import BodyModel, PosedBody
from recon.core.arrays import Numbers
from recon.core.errors import ObservationError
from recon.core.robust import squared
from recon.core.skeleton import JOINTS


@dataclass(frozen=True, init=False)
class Joints3D(TrackedPoints):
    """Measured 3D positions of body joints.

    The energy is half the squared distance of every visible joint from the body's joint, in
    metres².
    """

    sees = "points"
    on_skin: ClassVar[bool] = False
    positions: Float[Tensor, "*batch moments points 3"]
    """Positions in metres, in the frame of the recording (z up); zero where not visible."""
    visible: Bool[Tensor, "*batch moments points"]
    """Whether a point was seen at a moment."""
    joints: tuple[int, ...]
    """Number of the body joint that each point measures; see `recon.core.skeleton.JOINTS`."""
    fps: float
    """Rate of the moments in Hz."""
    start_time: float = 0.0
    """Time of the first moment, in seconds of the clock that all observations of a clip share."""
    kernel: Callable[[Tensor], Tensor] = squared
    """Robust kernel that is applied to squared distances in metres²; see `recon.core.robust`."""
    ground_known: bool = True
    """Whether the plane z = 0 of the recording is the ground."""
    offset_rows: tuple[int, int] | None = None
    """First row, and the row after the last, of `Scene.offsets` that these points own: constant
    offsets from the body model that are estimated with the motion. None estimates none."""
    std: Float[Tensor, "*batch moments points"] | None = None
    """Standard deviation of the coordinates of every point at every moment, metres; zero where it
    was not visible. Weights go with the inverse square, and their root mean square is the noise
    where a fit is given none. None counts all points alike and estimates the noise."""
    rms_std: float | None = field(init=False, default=None)
    """Root mean square of `std` over the visible points of the whole recording, metres. Its
    parts keep it, so that a point weighs the same in every window."""

    def __init__(
        self,
        positions: Numbers,
        visible: Numbers,
        joints: Numbers,
        fps: float,
        start_time: float = 0.0,
        kernel: Callable[[Tensor], Tensor] = squared,
        ground_known: bool = True,
        offset_rows: tuple[int, int] | None = None,
        std: Numbers | float | None = None,
    ) -> None:
        """Arrays of numpy become tensors in single precision; what is not visible becomes zero.

        `std` may have any shape that broadcasts to (moments, points).

        Raises:
            ValueError: naming the array, what was expected and what came.
        """
        positions, visible = checked_positions(
            "Joints3D", "positions", positions, "visible", visible
        )
        places = checked_places("Joints3D", "joints", joints, positions.shape[-2])
        if places and max(places) >= len(JOINTS):
            raise ObservationError(f"Joints3D.joints: expected numbers from 0 to 21, got {places}")
        fps, start_time = checked_clock("Joints3D", fps, start_time)
        std, rms_std = checked_std("Joints3D", std, visible, positions)
        self._settle(
            positions=positions, visible=visible, joints=places, fps=fps, start_time=start_time,
            kernel=kernel, ground_known=ground_known, offset_rows=offset_rows,
            std=std, rms_std=rms_std,
        )  # fmt: skip

    def on(self, posed: PosedBody) -> Float[Tensor, "*batch time points 3"]:
        """The joints of a posed body, world, metres."""
        return posed.joints[..., list(self.joints), :]

    def on_bones(self, body: BodyModel, shape: Float[Tensor, " shape"]) -> CarriedPoints:
        """The joints on a body of some shape."""
        return CarriedPoints.joints(body, shape).some(self.joints)

    def at_rest(self, body: BodyModel) -> Float[Tensor, "points 3"]:
        """The joints of the average body in its rest pose, metres."""
        return body.joint_template[list(self.joints)]

    def bones(self, body: BodyModel) -> tuple[int, ...]:
        """Every joint carries itself."""
        del body
        return self.joints

    def point_names(self, body: BodyModel) -> tuple[str, ...]:
        """Names of the joints."""
        del body
        return tuple(JOINTS[joint] for joint in self.joints)

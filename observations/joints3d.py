"""3D joints: positions of body joints in the world, noisy and partly missing."""

from collections.abc import Callable
from dataclasses import dataclass

from jaxtyping import Float
from torch import Tensor

from observations.points import TrackedPoints
from recon.body.derivatives import BonePoints
from recon.body.model import BodyModel, PosedBody
from recon.core.arrays import Numbers, cached_constant
from recon.core.errors import ObservationError
from recon.core.residuals import squared
from recon.core.skeleton import JOINTS


@dataclass(frozen=True, init=False)
class Joints3D(TrackedPoints):
    """Measured 3D positions of body joints.

    The energy is half the squared distance of every visible joint from the body's joint, in
    metres².
    """

    joints: tuple[int, ...]
    """Number of the body joint that each point measures; see `recon.core.skeleton.JOINTS`."""

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
        """Takes positions (moments, joints, 3), z up, and `std`, both in metres.

        `visible` is (moments, joints); `joints` are numbers in `recon.core.skeleton.JOINTS`; `fps`
        is in Hz. Positions that are not visible become zero. `std` may have any shape that
        broadcasts to (moments, joints). Arrays of numpy become float32 tensors.

        Raises:
            ValueError: naming the array, what was expected and what came.
        """
        places = self._set_measured(
            positions, visible, (fps, start_time), std, ("joints", joints),
            kernel=kernel, ground_known=ground_known, offset_rows=offset_rows,
        )  # fmt: skip
        if places and (max(places) >= len(JOINTS) or len(set(places)) < len(places)):
            raise ObservationError(
                f"Joints3D.joints: expected numbers from 0 to 21, each only once, got {places}"
            )
        self._set_fields(joints=places)

    def predict(self, body: PosedBody) -> Float[Tensor, "*batch time points 3"]:
        """Positions of the measured joints on a posed body, world, metres."""
        return body.joints[..., cached_constant(self.joints, body.joints.device), :]

    @property
    def point_ids(self) -> tuple[int, ...]:
        """SMPL joint indices of the measured points."""
        return self.joints

    def on_bones(self, body: BodyModel, shape: Float[Tensor, " shape"]) -> BonePoints:
        """Return the measured joints as points that the bones of a body of given shape move."""
        return BonePoints.of_joints(body, shape).selected(self.joints)

    def at_rest(self, body: BodyModel) -> Float[Tensor, "points 3"]:
        """Positions of the measured joints on the average body in its rest pose, metres."""
        return body.joint_template[list(self.joints)]

    def bones(self, body: BodyModel) -> tuple[int, ...]:
        """Joint index of the bone that moves each point, which is the measured joint itself."""
        del body
        return self.joints

    def point_names(self, body: BodyModel) -> tuple[str, ...]:
        """Names of the measured joints, for reports."""
        del body
        return tuple(JOINTS[joint] for joint in self.joints)

"""3D joints: positions of body joints in the world, noisy and partly missing."""

from collections.abc import Callable
from dataclasses import dataclass

from jaxtyping import Bool, Float
from torch import Tensor

from observations.checks import checked_clock, checked_places, checked_positions
from observations.offsets import displaced
from observations.start.rigid import rigid_start
from observations.timing import moments_between, point_misfit, point_residuals
from recon.body.model import BodyModel
from recon.core.arrays import Numbers
from recon.core.errors import ObservationError
from recon.core.motion import Motion
from recon.core.residuals import Residuals
from recon.core.robust import squared
from recon.core.skeleton import JOINTS
from recon.core.struct import TensorStruct
from recon.method.protocols import Estimate


@dataclass(frozen=True, init=False)
class Joints3D(TensorStruct):
    """Measured 3D positions of body joints.

    The energy is half the squared distance of every visible joint from the body's joint, in
    metres².
    """

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
    ) -> None:
        """Arrays of numpy become tensors in single precision; what is not visible becomes zero.

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
        self._settle(
            positions=positions, visible=visible, joints=places, fps=fps, start_time=start_time,
            kernel=kernel, ground_known=ground_known, offset_rows=offset_rows,
        )  # fmt: skip

    @property
    def clips(self) -> tuple[int, ...]:
        """Sizes of the leading axes; one axis of clips, or none."""
        return tuple(self.positions.shape[:-3])

    @property
    def moments(self) -> int:
        """Number of moments of a clip."""
        return self.positions.shape[-3]

    def predict(self, estimate: Estimate) -> Float[Tensor, "*batch time points 3"]:
        """Positions of these points on the estimated body, in the world, metres."""
        points = estimate.body.joints[..., list(self.joints), :]
        return displaced(points, estimate, self.joints, self.offset_rows)

    def __call__(self, estimate: Estimate) -> Float[Tensor, "*batch"]:
        """½ Σ kernel(|observed - predicted|²) over visible points, taken at 30 Hz.

        HuMoR section 6.5: joints3d.
        """
        return point_misfit(
            estimate.scene.to_recording(self.predict(estimate)), estimate.motion,
            self.positions, self.visible,
            fps=self.fps, start_time=self.start_time, kernel=self.kernel,
        )  # fmt: skip

    def residuals(self, estimate: Estimate) -> Residuals:
        """Observed minus predicted position of every joint at every moment, metres."""
        return point_residuals(
            estimate.scene.to_recording(self.predict(estimate)), estimate.motion,
            self.positions, self.visible, fps=self.fps, start_time=self.start_time,
        )  # fmt: skip

    def window(self, start: float, stop: float) -> "Joints3D":
        """The part of the observation from one time to another, both included, in seconds."""
        positions, visible, first = moments_between(
            self.positions, self.visible,
            fps=self.fps, start_time=self.start_time, start=start, stop=stop,
        )  # fmt: skip
        return self.derived(positions=positions, visible=visible, start_time=first)

    def start(self, body: BodyModel) -> Motion:
        """A first guess: the rest pose, aligned with the points of the torso in every frame."""
        rest = body.joint_template.to(self.positions)[list(self.joints)]
        return rigid_start(
            body, rest, self.joints, self.positions, self.visible,
            fps=self.fps, start_time=self.start_time,
        )  # fmt: skip

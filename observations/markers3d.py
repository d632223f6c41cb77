"""3D markers: positions of points on the body's surface, noisy and partly missing."""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from observations.checks import checked_clock, checked_places, checked_positions
from observations.offsets import displaced
from observations.start.rigid import rigid_start
from observations.timing import moments_between, point_misfit, point_residuals
from recon.body.model import BodyModel
from recon.core.arrays import Numbers
from recon.core.motion import Motion
from recon.core.residuals import Residuals
from recon.core.robust import squared
from recon.core.struct import TensorStruct
from recon.method.protocols import Estimate


@dataclass(frozen=True, init=False)
class Markers3D(TensorStruct):
    """Measured 3D positions of markers on the skin.

    The energy is half the squared distance of every visible marker from its vertex of the body,
    in metres².
    """

    positions: Float[Tensor, "*batch moments points 3"]
    """Positions in metres, in the frame of the recording (z up); zero where not visible."""
    visible: Bool[Tensor, "*batch moments points"]
    """Whether a marker was seen at a moment."""
    vertices: tuple[int, ...]
    """Number of the vertex of the body that each marker sits on."""
    fps: float
    """Rate of the moments in Hz."""
    start_time: float = 0.0
    """Time of the first moment, in seconds of the clock that all observations of a clip share."""
    kernel: Callable[[Tensor], Tensor] = squared
    """Robust kernel that is applied to squared distances in metres²; see `recon.core.robust`."""
    ground_known: bool = True
    """Whether the plane z = 0 of the recording is the ground."""
    offset_rows: tuple[int, int] | None = None
    """First row, and the row after the last, of `Scene.offsets` that these markers own: constant
    offsets from the body model that are estimated with the motion. None estimates none."""

    def __init__(
        self,
        positions: Numbers,
        visible: Numbers,
        vertices: Numbers,
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
            "Markers3D", "positions", positions, "visible", visible
        )
        places = checked_places("Markers3D", "vertices", vertices, positions.shape[-2])
        fps, start_time = checked_clock("Markers3D", fps, start_time)
        self._settle(
            positions=positions, visible=visible, vertices=places, fps=fps, start_time=start_time,
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
        """Where the estimate has the markers, world, in its own frames."""
        index = torch.tensor(self.vertices, device=self.positions.device)
        points = estimate.body.points(index)
        if self.offset_rows is None:
            return points
        bones = self.bones(estimate.body.model)
        return displaced(points, estimate, bones, self.offset_rows)

    def __call__(self, estimate: Estimate) -> Float[Tensor, "*batch"]:
        """½ Σ kernel(|observed - predicted|²) over visible markers, taken at 30 Hz.

        HuMoR section 6.5: verts3d.
        """
        return point_misfit(
            estimate.scene.to_recording(self.predict(estimate)), estimate.motion,
            self.positions, self.visible,
            fps=self.fps, start_time=self.start_time, kernel=self.kernel,
        )  # fmt: skip

    def residuals(self, estimate: Estimate) -> Residuals:
        """Observed minus predicted position of every marker at every moment, metres."""
        return point_residuals(
            estimate.scene.to_recording(self.predict(estimate)), estimate.motion,
            self.positions, self.visible, fps=self.fps, start_time=self.start_time,
        )  # fmt: skip

    def window(self, start: float, stop: float) -> "Markers3D":
        """The part of the observation from one time to another, both included, in seconds."""
        positions, visible, first = moments_between(
            self.positions, self.visible,
            fps=self.fps, start_time=self.start_time, start=start, stop=stop,
        )  # fmt: skip
        return self.derived(positions=positions, visible=visible, start_time=first)

    def start(self, body: BodyModel) -> Motion:
        """The rest pose laid on the torso, frame by frame."""
        rest = body.template.to(self.positions)[list(self.vertices)]
        return rigid_start(
            body, rest, self.bones(body), self.positions, self.visible,
            fps=self.fps, start_time=self.start_time,
        )  # fmt: skip

    def bones(self, body: BodyModel) -> tuple[int, ...]:
        """The bone that moves each marker most."""
        return tuple(body.weights[list(self.vertices)].argmax(-1).tolist())

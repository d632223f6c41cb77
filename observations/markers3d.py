"""3D markers: positions of points on the body's surface, noisy and partly missing."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from jaxtyping import Bool, Float
from torch import Tensor

from observations.checks import (
    checked_clock,
    checked_offsets,
    checked_places,
    checked_positions,
    checked_std,
)
from observations.records.tracked import Offset, VertexPoints
from recon.core.arrays import Numbers
from recon.core.robust import squared


@dataclass(frozen=True, init=False)
class Markers3D(VertexPoints):
    """Measured 3D positions of markers on the skin.

    The energy is half the squared distance of every visible marker from its vertex of the body,
    in metres².
    """

    sees = "points"
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
    std: Float[Tensor, "*batch moments points"] | None = None
    """Standard deviation of the coordinates of every marker at every moment, metres; zero where it
    was not visible. Weights go with the inverse square, and their root mean square is the noise
    where a fit is given none. None counts all markers alike and estimates the noise."""
    offsets: tuple[Offset, ...] | None = None
    """Constant offset of every marker from its vertex, in the frame of the bone that moves it
    most, metres: how far off the landmark it was taped. None puts it on the vertex."""
    labels: tuple[str, ...] | None = None
    """What the recording calls every marker; None where landmarks name them."""
    rms_std: float | None = field(init=False, default=None)
    """Root mean square of `std` over the visible markers of the whole recording, metres. Its
    parts keep it, so that a marker weighs the same in every window."""

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
        std: Numbers | float | None = None,
        offsets: Numbers | None = None,
        labels: Sequence[str] | None = None,
    ) -> None:
        """Arrays of numpy become tensors in single precision; what is not visible becomes zero.

        `std` may have any shape that broadcasts to (moments, points); `offsets` have the shape
        (points, 3).

        Raises:
            ValueError: naming the array, what was expected and what came.
        """
        positions, visible = checked_positions(
            "Markers3D", "positions", positions, "visible", visible
        )
        places = checked_places("Markers3D", "vertices", vertices, positions.shape[-2])
        fps, start_time = checked_clock("Markers3D", fps, start_time)
        std, rms_std = checked_std("Markers3D", std, visible, positions)
        self._settle(
            positions=positions, visible=visible, vertices=places, fps=fps, start_time=start_time,
            kernel=kernel, ground_known=ground_known, offset_rows=offset_rows,
            std=std, rms_std=rms_std, offsets=checked_offsets("Markers3D", offsets, len(places)),
            labels=None if labels is None else tuple(labels),
        )  # fmt: skip

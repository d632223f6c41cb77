"""3D markers: positions of points on the body's surface, noisy and partly missing."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import ClassVar

import torch
from jaxtyping import Float
from torch import Tensor

from observations.points import TrackedPoints
from recon.body.derivatives import BonePoints
from recon.body.landmarks import landmarks
from recon.body.model import BodyModel, PosedBody
from recon.core.arrays import Numbers, cached_constant, float_tensor
from recon.core.errors import ObservationError
from recon.core.residuals import squared
from recon.core.skeleton import JOINTS

Offset = tuple[float, float, float]
"""A vector in the frame of a bone, metres."""
_FARTHEST_OFFSET = 0.5
"""Metres from its landmark that no marker sits; wands are 10 cm long."""


@dataclass(frozen=True, init=False)
class Markers3D(TrackedPoints):
    """Measured 3D positions of markers on the skin.

    The energy is half the squared distance of every visible marker from its vertex of the body,
    in metres².
    """

    on_skin: ClassVar[bool] = True
    vertices: tuple[int, ...] = field(kw_only=True)
    """Number of the vertex of the body that each marker sits on."""
    offsets: tuple[Offset, ...] | None = None
    """Constant offset of every marker from its vertex, in the frame of the bone that moves it
    most, metres: how far off the landmark it was taped. None puts it on the vertex."""
    labels: tuple[str, ...] | None = None
    """What the recording calls every marker; None where landmarks name them."""

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
        """Takes positions (moments, markers, 3), `std` and `offsets` (markers, 3), all in metres.

        `visible` is (moments, markers); `vertices` are numbers of the body's vertices; `fps` is in
        Hz. Positions that are not visible become zero. `std` may have any shape that broadcasts
        to (moments, markers). Arrays of numpy become float32 tensors.

        Raises:
            ValueError: naming the array, what was expected and what came.
        """
        places = self._set_measured(
            positions, visible, (fps, start_time), std, ("vertices", vertices),
            kernel=kernel, ground_known=ground_known, offset_rows=offset_rows,
        )  # fmt: skip
        if labels is not None and len(labels) != len(places):
            raise ObservationError(
                f"Markers3D.labels: expected a label for each of the {len(places)} points, got "
                f"{len(labels)}"
            )
        self._set_fields(
            vertices=places, offsets=_checked_offsets(offsets, len(places)),
            labels=None if labels is None else tuple(labels),
        )  # fmt: skip

    def predict(self, body: PosedBody) -> Float[Tensor, "*batch time points 3"]:
        """Positions of the markers on a posed body, world, metres."""
        points = body.points(cached_constant(self._vertices_of(body.model), body.joints.device))
        if self.offsets is None:
            return points
        turns = body.orientations[
            ..., cached_constant(self.bones(body.model), points.device), :, :
        ]
        offsets = cached_constant(self.offsets, points.device, points.dtype)
        return points + (turns @ offsets[..., None])[..., 0]

    @property
    def point_ids(self) -> tuple[int, ...]:
        """Indices of the vertices that the markers sit on."""
        return self.vertices

    def on_bones(self, body: BodyModel, shape: Float[Tensor, " shape"]) -> BonePoints:
        """Return the markers as points that the bones of a body of given shape move."""
        vertices = cached_constant(self._vertices_of(body), shape.device)
        identity = torch.eye(len(vertices), dtype=shape.dtype, device=shape.device)
        none = shape.new_zeros(len(vertices), len(JOINTS))
        found = BonePoints.create(body, shape, none, identity, vertices)
        if self.offsets is None:
            return found
        offsets = cached_constant(self.offsets, shape.device, shape.dtype)
        return found.displaced(self.bones(body), offsets)

    def at_rest(self, body: BodyModel) -> Float[Tensor, "points 3"]:
        """Positions of the markers on the average body in its rest pose, metres."""
        rest = body.template[list(self._vertices_of(body))]
        return rest if self.offsets is None else rest + rest.new_tensor(self.offsets)

    def bones(self, body: BodyModel) -> tuple[int, ...]:
        """Joint index of the bone that moves each marker most, by skinning weight."""
        return _bones_of_vertices(self._vertices_of(body), body.weights)

    def _vertices_of(self, body: BodyModel) -> tuple[int, ...]:
        """Return the vertices that the markers sit on; refuse those that the body lacks."""
        if (last := max(self.vertices, default=0)) >= len(body.template):
            raise ObservationError(
                f"Markers3D.vertices: expected vertices of the body, 0 to "
                f"{len(body.template) - 1}, got {last}; give the body that has them"
            )
        return self.vertices

    def point_names(self, body: BodyModel) -> tuple[str, ...]:
        """Names of the markers: the recording's labels, else landmarks or vertex indices."""
        del body
        if self.labels is not None:
            return self.labels
        named = {vertex: name for name, vertex in landmarks().items()}
        return tuple(named.get(vertex, f"vertex {vertex}") for vertex in self.vertices)


@lru_cache(maxsize=16)
def _bones_of_vertices(vertices: tuple[int, ...], weights: Tensor) -> tuple[int, ...]:
    """Joint index of the largest skinning weight of each vertex; cached, as GPUs wait for it."""
    return tuple(weights[list(vertices)].argmax(-1).tolist())


def _checked_offsets(offsets: Numbers | None, points: int) -> tuple[Offset, ...] | None:
    """Check offsets of markers from their vertices, metres; None if none are given.

    Raises:
        ValueError: when these are no finite vectors, not one for each point, or no offsets of
            markers.
    """
    if offsets is None:
        return None
    values = float_tensor(offsets, "Markers3D.offsets").detach().double().cpu()
    if values.shape != (points, 3) or not bool(values.isfinite().all()):
        raise ObservationError(
            f"Markers3D.offsets: expected a finite vector for each of the {points} points, shape "
            f"({points}, 3); got the shape {tuple(values.shape)}"
        )
    if bool((values.norm(dim=-1) > _FARTHEST_OFFSET).any()):
        raise ObservationError(
            "Markers3D.offsets: expected vectors in metres from points of the skin, got one of "
            f"length {float(values.norm(dim=-1).max()):.3g}; divide millimetres by 1000"
        )
    return tuple((x, y, z) for x, y, z in values.tolist())

"""What markers and estimates of them have in common: points that are vertices of the skin."""

from typing import ClassVar

import torch
from jaxtyping import Float
from torch import Tensor

from observations.records.tracked import TrackedPoints
from recon.body.derivatives import CarriedPoints
from recon.body.landmarks import landmarks
from recon.body.model import BodyModel, PosedBody
from recon.core.skeleton import JOINTS

Offset = tuple[float, float, float]
"""A vector in the frame of a bone, metres."""


class VertexPoints(TrackedPoints):
    """Points that are vertices of the body, or that its bones carry at known offsets from them."""

    on_skin: ClassVar[bool] = True
    vertices: tuple[int, ...]
    offsets: tuple[Offset, ...] | None = None
    """Constant offset of every point from its vertex, in the frame of the bone that moves it
    most, metres; None where the points are the vertices."""
    labels: tuple[str, ...] | None = None
    """What the recording calls every point; None where landmarks name them."""

    def on(self, posed: PosedBody) -> Float[Tensor, "*batch time points 3"]:
        """The points on a posed body, world, metres."""
        points = posed.points(torch.tensor(self.vertices, device=self.positions.device))
        if self.offsets is None:
            return points
        turns = posed.orientations[..., list(self.bones(posed.model)), :, :]
        return points + (turns @ points.new_tensor(self.offsets)[..., None])[..., 0]

    def on_bones(self, body: BodyModel, shape: Float[Tensor, " shape"]) -> CarriedPoints:
        """The points on a body of some shape."""
        vertices = torch.tensor(self.vertices, device=shape.device)
        identity = torch.eye(len(vertices), dtype=shape.dtype, device=shape.device)
        none = shape.new_zeros(len(vertices), len(JOINTS))
        found = CarriedPoints.create(body, shape, none, identity, vertices)
        if self.offsets is None:
            return found
        return found.displaced(self.bones(body), shape.new_tensor(self.offsets))

    def at_rest(self, body: BodyModel) -> Float[Tensor, "points 3"]:
        """The points on the average body in its rest pose, metres."""
        rest = body.template[list(self.vertices)]
        return rest if self.offsets is None else rest + rest.new_tensor(self.offsets)

    def bones(self, body: BodyModel) -> tuple[int, ...]:
        """The bone that moves each marker most."""
        return tuple(body.weights[list(self.vertices)].argmax(-1).tolist())

    def point_names(self, body: BodyModel) -> tuple[str, ...]:
        """Labels of the recording, or landmarks that points sit on, or numbers of vertices."""
        del body
        if self.labels is not None:
            return self.labels
        named = {vertex: name for name, vertex in landmarks().items()}
        return tuple(named.get(vertex, f"vertex {vertex}") for vertex in self.vertices)

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


class VertexPoints(TrackedPoints):
    """Points that are vertices of the body."""

    on_skin: ClassVar[bool] = True
    vertices: tuple[int, ...]

    def on(self, posed: PosedBody) -> Float[Tensor, "*batch time points 3"]:
        """The vertices of a posed body, world, metres."""
        return posed.points(torch.tensor(self.vertices, device=self.positions.device))

    def on_bones(self, body: BodyModel, shape: Float[Tensor, " shape"]) -> CarriedPoints:
        """The vertices on a body of some shape."""
        vertices = torch.tensor(self.vertices, device=shape.device)
        identity = torch.eye(len(vertices), dtype=shape.dtype, device=shape.device)
        none = shape.new_zeros(len(vertices), len(JOINTS))
        return CarriedPoints.create(body, shape, none, identity, vertices)

    def at_rest(self, body: BodyModel) -> Float[Tensor, "points 3"]:
        """The vertices of the average body in its rest pose, metres."""
        return body.template[list(self.vertices)]

    def bones(self, body: BodyModel) -> tuple[int, ...]:
        """The bone that moves each marker most."""
        return tuple(body.weights[list(self.vertices)].argmax(-1).tolist())

    def point_names(self, body: BodyModel) -> tuple[str, ...]:
        """Names of the landmarks that the markers sit on; numbers of vertices elsewhere."""
        del body
        named = {vertex: name for name, vertex in landmarks().items()}
        return tuple(named.get(vertex, f"vertex {vertex}") for vertex in self.vertices)

"""The body's surface as small discs: sparse enough to search, flat enough to be exact."""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from recon.body.model import BodyModel, PosedBody
from recon.body.spread import spread_vertices
from recon.core.geometry.normals import vertex_normals

SURFELS = 1500
"""Discs a body is covered with; some three centimetres apart on an adult."""
_NEIGHBOURS = 6


@dataclass(frozen=True)
class Surfels:
    """A disc at each of some vertices, evenly spread; plain arrays, shared by all clips.

    The normals are those of the unposed average body. They turn with the bones that move the
    vertex; what the shape changes of them (a few degrees) is left out.
    """

    vertices: Int[np.ndarray, " surfels"]
    """Vertex of the body in the middle of every disc."""
    normals: Float[np.ndarray, "surfels 3"]
    """Outward unit normals of the unposed body; zero where the mesh has no face."""
    radii: Float[np.ndarray, " surfels"]
    """Mean distance of a disc's six nearest neighbours, metres: discs overlap, without gaps."""

    @classmethod
    def of(cls, body: BodyModel, count: int = SURFELS) -> "Surfels":
        """Vertices that are farthest from each other, one after the other."""
        from scipy.spatial import KDTree

        template = body.template.detach().cpu().double().numpy()
        normals = vertex_normals(template, body.faces.cpu().numpy())
        chosen = spread_vertices(body, count).cpu().numpy()
        near = min(_NEIGHBOURS, len(chosen) - 1) + 1
        distance = KDTree(template[chosen]).query(template[chosen], near)[0]
        radii = distance.reshape(len(chosen), near)[:, 1:].sum(-1) / max(near - 1, 1)
        return cls(chosen, normals[chosen], radii)

    def at(
        self,
        body: PosedBody,
        bones: Float[Tensor, "*batch moments 22 4 3"],
        pairs: Int[Tensor, "*batch moments points"],
    ) -> tuple[Float[Tensor, "*batch moments points 3"], Float[Tensor, "*batch moments points 3"]]:
        """Middles (metres) and unit normals of some discs, others at every moment.

        Only these are skinned: far fewer than all where few points are seen. The offsets that
        follow the pose (SMPL) are left out.

        Args:
            body: whose surface it is.
            bones: its bones at these moments, as `PosedBody.bones`.
            pairs: the discs.
        """
        index = torch.from_numpy(self.vertices).to(pairs.device)
        rest = body.model.rest_vertices(body.shape, index)
        pick = pairs.flatten(-2)
        middles = rest.take_along_dim(pick[..., None], -2).unflatten(-2, pairs.shape[-2:])
        normals = torch.from_numpy(self.normals).to(rest)[pairs]
        blended = body.model.weights[index][pairs] @ bones.flatten(-2)
        rows = blended.unflatten(-1, (4, 3))
        turned = (normals[..., None] * rows[..., :3, :]).sum(-2)
        placed = (middles[..., None] * rows[..., :3, :]).sum(-2) + rows[..., 3, :]
        return placed, torch.nn.functional.normalize(turned, dim=-1, eps=1e-6)

    def posed(self, body: PosedBody) -> tuple[Tensor, Tensor]:
        """Middles (metres) and unit normals of the discs in a posed body, world frame."""
        index = torch.from_numpy(self.vertices).to(body.joints.device)
        weights = body.model.weights[index]
        rest = torch.from_numpy(self.normals).to(body.joints)
        # one product for all frames, as in `PosedBody.points`
        left = (weights[:, :, None] * rest[:, None]).flatten(-2)
        right = body.orientations.mT.movedim(-4, -2).flatten(-4, -3).flatten(-2)
        frames = body.joints.shape[-3]
        normals = (left @ right).unflatten(-1, (frames, 3)).movedim(-2, -3)
        return body.points(index), torch.nn.functional.normalize(normals, dim=-1, eps=1e-6)

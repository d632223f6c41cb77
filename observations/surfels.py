"""The surface of a body as discs, and robust distances of points from them."""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from recon.body.model import BodyModel, PosedBody
from recon.body.sampled import spread_vertices
from recon.core.raster import vertex_normals
from recon.core.residuals import (
    NORMAL_MAD,
    TUNING,
    geman_mcclure,
    lower_median,
)

LEAST_SCALE = 0.005
"""Metres; surfaces are not taken for nearer to each other than this."""


def tukey(
    squared: Float[Tensor, "*batch samples"], present: Bool[Tensor, "*batch samples"]
) -> Float[Tensor, "*batch samples"]:
    """Tukey's robust kernel c²/3 (1 - (1 - e²/c²)³) of distances e, constant beyond c = 4.6851 s.

    The gradient is that of HuMoR's bisquare weights at equal scale. The scale is
    median(e) / 0.67449: of distances, which are zero at best, it is the deviation from zero that
    matters. At least half of the points always pull, also those of a body that is off as a whole,
    which deviations from the median cut off altogether.
    """
    return tukey_kernel(squared, tukey_scale(squared, present))


def tukey_scale(
    squared: Float[Tensor, "*batch samples"], present: Bool[Tensor, "*batch samples"]
) -> Float[Tensor, "*batch"]:
    """Robust standard deviation of distances about zero, metres; no gradient."""
    residual = squared.detach().sqrt()
    return (lower_median(residual, present) / NORMAL_MAD).clamp(min=LEAST_SCALE)


def tukey_kernel(
    squared: Float[Tensor, "*batch samples"], scale: Float[Tensor, "*batch"]
) -> Float[Tensor, "*batch samples"]:
    """Tukey's robust kernel c²/3 (1 - (1 - e²/c²)³), constant beyond c = 4.6851 scale."""
    cutoff = (TUNING * scale).square()[..., None]
    return cutoff / 3 * (1 - (1 - (squared / cutoff).clamp(max=1)) ** 3)


def fixed_scale_kernel(
    squared: Float[Tensor, "*batch samples"],
    present: Bool[Tensor, "*batch samples"],
    sigma: float = 0.1,
) -> Float[Tensor, "*batch samples"]:
    """Geman and McClure's kernel with a fixed scale, metres; `tukey` estimates its scale."""
    del present
    return geman_mcclure(squared, sigma)


SURFELS = 1500
"""Discs a body is covered with; some three centimetres apart on an adult."""
_NEIGHBOURS = 6


@dataclass(frozen=True)
class Surfels:
    """Discs at evenly spread vertices that approximate the surface; shared by all clips.

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
        """Make `count` discs at vertices of the average body (farthest point sampling)."""
        from scipy.spatial import KDTree

        template = body.template.detach().cpu().double().numpy()
        normals = vertex_normals(template, body.faces.cpu().numpy())
        chosen = spread_vertices(body, count).cpu().numpy()
        near = min(_NEIGHBOURS, len(chosen) - 1) + 1
        distance = KDTree(template[chosen]).query(template[chosen], near)[0]
        radii = distance.reshape(len(chosen), near)[:, 1:].sum(-1) / max(near - 1, 1)
        return cls(chosen, normals[chosen], radii)

    def posed(self, body: PosedBody) -> tuple[Tensor, Tensor]:
        """Centres (metres) and unit normals of the discs on a posed body, world frame."""
        index = torch.from_numpy(self.vertices).to(body.joints.device)
        weights = body.model.weights[index]
        rest = torch.from_numpy(self.normals).to(body.joints)
        # one matrix product for all frames, as in `PosedBody.points`
        left = (weights[:, :, None] * rest[:, None]).flatten(-2)
        right = body.orientations.mT.movedim(-4, -2).flatten(-4, -3).flatten(-2)
        frames = body.joints.shape[-3]
        normals = (left @ right).unflatten(-1, (frames, 3)).movedim(-2, -3)
        return body.points(index), torch.nn.functional.normalize(normals, dim=-1, eps=1e-6)

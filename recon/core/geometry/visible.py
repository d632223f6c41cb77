"""Which parts of a surface a sensor sees: those that face it and that nothing else hides."""

import torch
from jaxtyping import Bool, Float
from torch import Tensor

_CELL = 0.03
"""Metres, at the distance of the surface, of the cells in which depths are compared."""
_CELLS = 256
"""Cells to a side, at most."""


def facing(
    middles: Float[Tensor, "*batch discs 3"],
    normals: Float[Tensor, "*batch discs 3"],
    eye: Float[Tensor, "*batch 3"],
) -> Bool[Tensor, "*batch discs"]:
    """Whether the outer side of a disc is turned towards the eye."""
    return ((eye[..., None, :] - middles) * normals).sum(-1) >= 0


def unhidden(
    middles: Float[Tensor, "*batch discs 3"],
    front: Bool[Tensor, "*batch discs"],
    eye: Float[Tensor, "*batch 3"],
    slack: float,
) -> Bool[Tensor, "*batch discs"]:
    """Discs that face the eye and have no other one of these before them; no gradient.

    The discs are drawn into an image of coarse cells, each into the nine cells around its own, so
    that they leave no gaps where they are less than two cells apart.

    Args:
        middles: of the discs, metres.
        front: which of them face the eye.
        eye: the place of the sensor, metres.
        slack: metres behind the nearest disc of a cell up to which another one counts as seen.
    """
    shape = front.shape
    away = (middles.detach() - eye.detach()[..., None, :]).reshape(-1, *middles.shape[-2:])
    front = front.reshape(-1, shape[-1])
    depth = away.norm(dim=-1)
    typical = depth.mean(-1, keepdim=True)
    ahead = torch.nn.functional.normalize(away.mean(-2), dim=-1)
    side = torch.nn.functional.normalize(torch.linalg.cross(ahead, _across(ahead)), dim=-1)
    up = torch.linalg.cross(side, ahead)
    forward = (away * ahead[:, None]).sum(-1).clamp(min=1e-3)
    columns = [
        ((away * axis[:, None]).sum(-1) / forward * typical / _CELL).floor().long() + _CELLS // 2
        for axis in (side, up)
    ]
    u, v = (column.clamp(1, _CELLS - 2) for column in columns)
    far = depth.masked_fill(~front, torch.inf)
    nearest = depth.new_full((len(depth), _CELLS * _CELLS), torch.inf)
    for du in (-1, 0, 1):
        for dv in (-1, 0, 1):
            nearest.scatter_reduce_(1, (u + du) * _CELLS + v + dv, far, "amin")
    first = nearest.gather(1, u * _CELLS + v)
    return (front & (depth <= first + slack)).reshape(shape)


def _across(ahead: Float[Tensor, "rows 3"]) -> Float[Tensor, "rows 3"]:
    """The axis of the frame that is most across each direction."""
    return torch.nn.functional.one_hot(ahead.abs().argmin(-1), 3).to(ahead)

"""A few hundred vertices that represent the whole skin in energies of height and pressure."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor
from torch.utils.weak import WeakTensorKeyDictionary

from recon.body.model import BodyModel
from recon.body.parts import PARTS, Parts, farthest_points, vertex_areas
from recon.core.skeleton import FEET, JOINTS
from recon.core.struct import TensorStruct

POINTS_PER_FOOT_BONE = 110
POINTS_PER_BONE = 40
"""Vertices kept of the skin that each joint carries most of."""

_SOLE = 0.015
"""Metres above the lowest point of a standing body, of the vertices called its soles."""


@dataclass(frozen=True)
class SampledSurface(TensorStruct):
    """Sampled vertices, grouped by body part, with the area of skin that each stands for."""

    vertices: Int[Tensor, " points"]
    areas: Float[Tensor, " points"]
    """Area of skin that is nearest to this point of its bone, on the average body, m²."""
    part: Int[Tensor, " points"]
    sole: Bool[Tensor, " points"]
    """Points that touch the ground when the body stands in its rest pose."""

    @classmethod
    def of(cls, body: BodyModel) -> "SampledSurface":
        """Choose the sampled vertices of a body; cached per body."""
        if body.template not in _KNOWN:
            _KNOWN[body.template] = _sample_of_surface(body)
        return _KNOWN[body.template]

    def rows_of(self, part: int) -> slice:
        """Return the range of the sampled vertices that belong to one body part."""
        first = int(torch.searchsorted(self.part, part))
        return slice(first, int(torch.searchsorted(self.part, part, right=True)))

    @property
    def soles(self) -> tuple[slice, slice]:
        """Row ranges of the left and of the right sole among the points where `sole` is true."""
        left = int((self.part[self.sole] == PARTS.index("left_lower_leg")).sum())
        return slice(0, left), slice(left, int(self.sole.sum()))


_KNOWN: WeakTensorKeyDictionary = WeakTensorKeyDictionary()


def _sample_of_surface(body: BodyModel) -> SampledSurface:
    """Choose the extreme vertices of every bone, then those farthest from all chosen ones.

    Bones are nearly rigid: whatever the pose, the lowest vertex of one is extreme in some
    direction.
    """
    rest, owner = body.template, body.weights.argmax(-1)
    part = Parts.of(body).of_vertex
    all_areas = vertex_areas(rest, body.faces)
    chosen, areas = [], []
    for joint in range(len(JOINTS)):
        bone = (owner == joint).nonzero()[:, 0]
        if len(bone) == 0:
            continue
        count = POINTS_PER_FOOT_BONE if joint in FEET else POINTS_PER_BONE
        seeds = (rest[bone] @ _even_directions(count).to(rest).T).argmax(0).unique()
        points = farthest_points(rest[bone], seeds, min(count, len(bone)))
        nearest = torch.cdist(rest[bone], rest[bone][points]).argmin(-1)
        areas.append(rest.new_zeros(len(points)).index_add(0, nearest, all_areas[bone]))
        chosen.append(bone[points])
    vertices = torch.cat(chosen)
    order = part[vertices].argsort(stable=True)
    vertices = vertices[order]
    feet = torch.isin(owner[vertices], owner.new_tensor(FEET))
    low = rest[vertices, 1] < rest[:, 1].amin() + _SOLE
    return SampledSurface(vertices, torch.cat(areas)[order], part[vertices], feet & low)


def _even_directions(count: int) -> Tensor:
    """Return `count` unit vectors spread evenly over the sphere (Fibonacci's spiral)."""
    index = torch.arange(count, dtype=torch.float64) + 0.5
    up = 1 - 2 * index / count
    turn = index * torch.pi * (3 - 5**0.5)
    across = (1 - up.square()).sqrt()
    return torch.stack((across * turn.cos(), across * turn.sin(), up), -1)


_ALWAYS = 1500
"""Vertices that are found in any case: fewer ones are the first of these."""


def spread_vertices(body: BodyModel, count: int) -> Int[Tensor, " points"]:
    """Return sorted indices of `count` vertices spread evenly over the unposed average body."""
    template = body.template.detach().cpu().double().contiguous().numpy()
    wanted = min(count, len(template))
    found = _farthest_point_order(template.tobytes(), min(max(wanted, _ALWAYS), len(template)))
    return torch.from_numpy(np.sort(found[:wanted])).to(body.template.device)


@lru_cache(maxsize=4)
def _farthest_point_order(template: bytes, count: int) -> Int[np.ndarray, " count"]:
    """Return vertex indices in the order of farthest point sampling; cached per mesh."""
    points = torch.from_numpy(np.frombuffer(template).reshape(-1, 3).copy())
    return farthest_points(points, torch.tensor([0]), count).numpy()

"""Twelve regions of a body's surface, derived from the skinning weights.

They are those that a network tells apart in a cloud of points. The ten parts of
`recon.body.parts` have volumes; regions need none and divide the trunk in three.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.utils.weak import WeakTensorKeyDictionary

from recon.body.model import BodyModel
from recon.core.skeleton import JOINTS
from recon.core.struct import TensorStruct

REGIONS = (
    "head", "chest", "belly", "pelvis",
    "left_upper_arm", "right_upper_arm", "left_forearm", "right_forearm",
    "left_thigh", "right_thigh", "left_lower_leg", "right_lower_leg",
)  # fmt: skip
"""A forearm includes its hand, a lower leg its foot, the head its neck."""

MIRRORED_REGIONS = (0, 1, 2, 3, 5, 4, 7, 6, 9, 8, 11, 10)
"""Index of every region's counterpart on the other side of the body."""

_REGION_OF = {
    "pelvis": "pelvis", "spine1": "belly", "spine2": "belly", "spine3": "chest",
    "neck": "head", "head": "head", "collar": "chest", "shoulder": "upper_arm",
    "elbow": "forearm", "wrist": "forearm", "hip": "thigh", "knee": "lower_leg",
    "ankle": "lower_leg", "foot": "lower_leg",
}  # fmt: skip


def _region_of(joint: str) -> int:
    """Index in `REGIONS` of the body region that the joint named `joint` moves."""
    side, _, name = joint.rpartition("_")
    region = _REGION_OF[name]
    return REGIONS.index(f"{side}_{region}" if f"{side}_{region}" in REGIONS else region)


REGION_OF_JOINT = tuple(_region_of(name) for name in JOINTS)
"""Number of the region that each of the 22 joints moves."""


def mirrored_places(places: Float[Tensor, "*shape 3"]) -> Float[Tensor, "*shape 3"]:
    """Mirror rest-pose positions (metres) from the left to the right side and vice versa."""
    return places * places.new_tensor([-1.0, 1.0, 1.0])


@dataclass(frozen=True)
class Regions(TensorStruct):
    """The region and the rest-pose position of every vertex of a body."""

    of_vertex: Int[Tensor, " vertices"]
    """The region whose joints carry most of the vertex."""
    places: Float[Tensor, "vertices 3"]
    """Place of the vertex on the unposed body of average shape, metres: y points up, the body
    faces z, its left is +x. Bodies of every shape and posture have the places of the average."""

    @classmethod
    def of(cls, body: BodyModel) -> "Regions":
        """Return the regions of a body's vertices; cached per body."""
        if body.template not in _KNOWN:
            region = torch.tensor(REGION_OF_JOINT, device=body.template.device)
            belonging = torch.nn.functional.one_hot(region, len(REGIONS)).to(body.weights)
            _KNOWN[body.template] = cls((body.weights @ belonging).argmax(-1), body.template)
        return _KNOWN[body.template]


_KNOWN: WeakTensorKeyDictionary = WeakTensorKeyDictionary()

"""Recordings whose points are keypoints of detectors, triangulated: joint centres, not markers.

Pose2Sim, OpenCap and others write RHip, LKnee, Neck, Nose, ... as .trc. Such points lie inside the
body; on the skin, where markers of the same names would be, they make a body that is 7 cm off.
"""

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from observations.correspondences import PLACES, BodyPlace
from recon.body.landmarks import landmark
from recon.body.model import BodyModel
from recon.core.errors import ReconError
from recon.core.skeleton import JOINTS, joint_index
from recon.diagnosis.findings import Finding, listed
from recon.formats.detections.deeplabcut import normalised

_CORE = tuple(f"{side}_{name}" for side in ("left", "right") for name in ("hip", "knee", "ankle"))
"""Keypoints that every detector of bodies finds, and whose names together no marker set has."""
_MOST = 0.6
"""Share of the labels that are names of keypoints."""
_NAMES = {"hip": "mid_hip", "pelvis": "mid_hip", "c_hip": "mid_hip", "chip": "mid_hip",
          "head": "head_top", "top_head": "head_top"}  # fmt: skip
"""Spellings of Pose2Sim and OpenSim's models beside those of `recon.core.layouts`."""
_TRUNK = {"neck": "spine3", "thorax": "spine3", "spine": "spine2", "mid_hip": "pelvis"}
"""Bones that carry points between joints of both sides."""


def keypoint_of(label: str) -> str | None:
    """The keypoint that a label means, or None."""
    name = normalised(label.rsplit(":", 1)[-1])
    name = _NAMES.get(name, name)
    return name if name in PLACES else None


def are_keypoints(labels: Sequence[str]) -> bool:
    """Whether most labels mean keypoints, with hips, knees and ankles among them."""
    found = [keypoint_of(label) for label in labels]
    return set(_CORE) <= set(found) and sum(f is not None for f in found) > _MOST * len(labels)


def keypoint_places(
    labels: Sequence[str], body: BodyModel
) -> tuple[tuple[int, ...], Float[Tensor, "points 3"]]:
    """A vertex that moves rigidly with each keypoint's bone, and the keypoint's place from it.

    The places are those of the average body at rest, metres.
    """
    vertices: list[int] = []
    offsets: list[Tensor] = []
    for label in labels:
        name = keypoint_of(label)
        if name is None:
            raise ReconError(f"{label!r} is no keypoint; there are {', '.join(PLACES)}")
        place = _at_rest(PLACES[name], body)
        bone = _bone(name, PLACES[name], body)
        rigid = body.weights[:, bone] > body.weights[:, bone].max() - 1e-3
        away = (body.template - place).norm(dim=-1).where(rigid, torch.inf)
        vertex = int(away.argmin())
        vertices.append(vertex)
        offsets.append(place - body.template[vertex])
    return tuple(vertices), torch.stack(offsets)


def keypoint_finding(labels: Sequence[str]) -> Finding:
    """What is said of such recordings."""
    return Finding(
        "joint centres",
        f"the points are joint centres by their names ({listed(labels)}), as detectors of "
        "keypoints give them: they lie inside the body and are no markers on the skin. With the "
        "images' keypoints and calibrated cameras, `recon fit` is more accurate",
        value=float(len(labels)),
    )


def _at_rest(place: BodyPlace, body: BodyModel) -> Float[Tensor, " 3"]:
    points = [body.joint_template[joint_index(joint)] for joint in place.joints]
    points += [body.template[landmark(name)] for name in place.landmarks]
    return torch.stack(points).mean(0)


def _bone(name: str, place: BodyPlace, body: BodyModel) -> int:
    if name in _TRUNK:
        return JOINTS.index(_TRUNK[name])
    if place.joints:
        return joint_index(place.joints[0])
    return int(body.weights[[landmark(name) for name in place.landmarks]].sum(0).argmax())

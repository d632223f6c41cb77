"""Our body in the terms of an OpenSim model: sizes, markers, and segments in OpenSim's ground."""

import numpy as np
import torch

from recon.body.landmarks import landmark
from recon.body.model import BodyModel
from recon.body.opensim import opensim_axes
from recon.body.segments import carried
from recon.core.motion import Motion
from recon.core.skeleton import joint_index
from recon.core.units import to_z_up
from recon.export.tables import places_of

_ABOVE = {
    "femur": ("pelvis", "hip"), "tibia": ("femur", "knee"), "foot": ("tibia", "ankle"),
    "toes": ("foot", "foot"), "humerus": ("thorax", "shoulder"), "forearm": ("humerus", "elbow"),
    "hand": ("forearm", "wrist"),
}  # fmt: skip
"""Parent of every segment, and the joint at which it begins."""
_JOINTS = {
    "femur": "hip", "tibia": "knee", "foot": "ankle", "toes": "foot", "humerus": "shoulder",
    "forearm": "elbow", "hand": "wrist",
}  # fmt: skip
_FOLLOWED = {"pelvis": "pelvis", "femur": "femur", "tibia": "tibia", "foot": "calcn"}
"""Segments whose markers inverse kinematics follows, and what the model calls them."""


def turned_segments(motion: Motion, body: BodyModel) -> dict[str, np.ndarray]:
    """Axes of every segment in every frame, in OpenSim's ground (y up)."""
    axes = carried(opensim_axes(body, motion.shape), body, motion)
    return {name: to_z_up("y").T @ turn for name, turn in axes.items()}


def segment_sizes(motion: Motion, body: BodyModel) -> dict[str, list[float]]:
    """Places where segments begin in their parents' axes, metres."""
    axes = opensim_axes(body, motion.shape)
    rest = body.rest_joints(motion.shape).numpy()

    def begin(segment: str) -> np.ndarray:
        if segment == "pelvis":
            return spines(motion, body)
        if segment == "thorax":
            return rest[joint_index("spine1")]
        name, end = segment.split("_")
        return rest[joint_index(f"{'right' if end == 'r' else 'left'}_{_JOINTS[name]}")]

    found = {"torso": (axes["pelvis"].T @ (begin("thorax") - begin("pelvis"))).tolist()}
    for end in "rl":
        for name, (above, _) in _ABOVE.items():
            parent = above if above in ("pelvis", "thorax") else f"{above}_{end}"
            step = begin(f"{name}_{end}") - begin(parent)
            found[f"{name}_{end}"] = (axes[parent].T @ step).tolist()
    return found


def marker_sizes(motion: Motion, body: BodyModel) -> dict[str, tuple[str, list[float]]]:
    """BSM's markers on pelvis and legs: the model's body, and the place in its axes, metres."""
    axes = opensim_axes(body, motion.shape)
    rest = body.rest_joints(motion.shape).numpy()
    segments = {"pelvis": "pelvis"} | {
        f"{side}_{joint}": f"{name}_{side[0]}"
        for side in ("right", "left")
        for name, joint in (("femur", "hip"), ("tibia", "knee"), ("foot", "ankle"))
    }
    found = {}
    for label, place in places_of("bsm").items():
        vertex = torch.tensor([landmark(place.landmarks[0])])
        shares = body.weights[vertex[0]]
        bone = int(shares.argmax())
        # markers that the skin carries with two bones are no points of either
        if float(shares[bone]) < 0.9:
            continue
        for joint, segment in segments.items():
            if joint_index(joint) != bone:
                continue
            begin = spines(motion, body) if segment == "pelvis" else rest[bone]
            point = body.rest_vertices(motion.shape, vertex).numpy()[0]
            name = _FOLLOWED[segment.split("_")[0]] + segment.removeprefix(segment.split("_")[0])
            found[label] = (name, (axes[segment].T @ (point - begin)).tolist())
    return found


def spines(motion: Motion, body: BodyModel) -> np.ndarray:
    """The middle of the frontal iliac spines of the unposed body, metres."""
    index = torch.tensor([landmark("left_asis"), landmark("right_asis")])
    return body.rest_vertices(motion.shape, index).numpy().mean(0)

"""Correspondences of detected points to the body: one table for all layouts of keypoints."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from recon.body.landmarks import landmark
from recon.body.model import BodyModel, PosedBody
from recon.core.errors import ObservationError
from recon.core.layouts import JOINT, keypoint_names
from recon.core.skeleton import JOINTS, PARENTS, joint_index

_MIN_REST_DISTANCE_M = 0.03
"""Metres at rest between two points whose distance tells something."""


@dataclass(frozen=True)
class BodyPlace:
    """A point of the body, defined as the mean of some joints and landmarks of the skin."""

    joints: tuple[str, ...] = ()
    landmarks: tuple[str, ...] = ()


def _places_of_both_sides(places: Mapping[str, BodyPlace]) -> dict[str, BodyPlace]:
    """Copy each place to both sides, with "left_" and "right_" before all names."""
    return {
        f"{side}_{name}": BodyPlace(
            tuple(f"{side}_{joint}" for joint in place.joints),
            tuple(f"{side}_{point}" for point in place.landmarks),
        )
        for name, place in places.items()
        for side in ("left", "right")
    }


PLACES: Mapping[str, BodyPlace] = {
    **_places_of_both_sides(
        {
            "eye": BodyPlace(landmarks=("eye",)),
            "eye_inner": BodyPlace(landmarks=("eye",)),
            "eye_outer": BodyPlace(landmarks=("eye", "temple")),
            "ear": BodyPlace(landmarks=("ear",)),
            "shoulder": BodyPlace(joints=("shoulder",)),
            "elbow": BodyPlace(joints=("elbow",)),
            "wrist": BodyPlace(joints=("wrist",)),
            "pinky": BodyPlace(landmarks=("pinky_knuckle",)),
            "index": BodyPlace(landmarks=("index_knuckle",)),
            "thumb": BodyPlace(landmarks=("hand", "wrist_radial")),
            "hip": BodyPlace(joints=("hip",)),
            "knee": BodyPlace(joints=("knee",)),
            "ankle": BodyPlace(joints=("ankle",)),
            "heel": BodyPlace(landmarks=("heel",)),
            "big_toe": BodyPlace(landmarks=("big_toe",)),
            "small_toe": BodyPlace(landmarks=("small_toe",)),
        }
    ),
    "nose": BodyPlace(landmarks=("nose",)),
    "left_mouth": BodyPlace(landmarks=("nose", "chin")),
    "right_mouth": BodyPlace(landmarks=("nose", "chin")),
    "head_centre": BodyPlace(landmarks=("left_ear", "right_ear")),
    "head_top": BodyPlace(landmarks=("head_top", "left_front_head", "right_front_head")),
    "neck": BodyPlace(joints=("left_shoulder", "right_shoulder")),
    "upper_neck": BodyPlace(joints=("neck",)),
    "mid_hip": BodyPlace(joints=("left_hip", "right_hip")),
    "spine": BodyPlace(joints=("spine1", "spine2")),
    "thorax": BodyPlace(joints=("left_shoulder", "right_shoulder")),
    "spine_navel": BodyPlace(joints=("spine1",)),
    "spine_chest": BodyPlace(joints=("spine3",)),
    **_places_of_both_sides(
        {
            "clavicle": BodyPlace(joints=("collar",)),
            "hand": BodyPlace(landmarks=("hand", "index_knuckle", "pinky_knuckle")),
            "fingertip": BodyPlace(landmarks=("fingertip",)),
        }
    ),
    **{f"{joint}{JOINT}": BodyPlace((joint,)) for joint in JOINTS},
}
"""Every keypoint of `recon.core.skeleton` but those of `smpl22`, which are the joints themselves.

Two places follow what detectors mean more than the words: the top of the head is found where the
hair begins, the upper neck at its base (triangulated BODY_25B detections of a person at rest).
"""


_OF_BLAZEPOSE: Mapping[str, BodyPlace] = _places_of_both_sides(
    {
        "wrist": BodyPlace(joints=("wrist",) * 5, landmarks=("hand",)),
        "ankle": BodyPlace(joints=(*("ankle",) * 15, "knee")),
        "heel": BodyPlace(landmarks=("heel", "heel", "ankle_lateral")),
    }
)
"""Places that BlazePose means by these names: wrists 1 to 2 cm nearer to the hand, ankles 2 to
3 cm above the joint, heels 2 cm farther forward and outwards. Rendered films of people of the
validation part and films of a real person agree on these to 1.6 cm
(e067421b: `benchmarks/films/places.py`); where they do not, the usual places are taken."""
_OF_LAYOUT: Mapping[str, Mapping[str, BodyPlace]] = {
    "mediapipe33": {**PLACES, **_OF_BLAZEPOSE},
    "smpl22": {name: BodyPlace((name,)) for name in JOINTS},
}
"""Places of the keypoints of layouts whose names mean others than `PLACES`."""

TRUNK: Mapping[str, int] = {
    name: joint_index(bone)
    for name, bone in {
        "neck": "spine3", "thorax": "spine3", "spine": "spine2", "mid_hip": "pelvis"
    }.items()
}  # fmt: skip
"""Bones that carry means of joints of both sides."""


@dataclass(frozen=True, eq=False)
class BodyPoints:
    """Points of the body as weighted means of joints and vertices: p = A joints + B vertices."""

    of_joints: Float[Tensor, "points 22"]
    of_vertices: Float[Tensor, "points vertices"]
    vertices: Int[Tensor, " vertices"]
    """The vertices that are needed."""
    names: tuple[str, ...]
    bones: tuple[int, ...]
    """The joint whose bone each point mostly sits on."""
    known: Bool[Tensor, " points"]
    """Points that this body has; landmarks are vertices of the bundled mesh only."""

    @classmethod
    def of_layout(cls, layout: str, body: BodyModel) -> "BodyPoints":
        """Find the places on a body of all keypoints of a layout, in the order of the layout.

        Raises:
            ValueError: when there is no such layout.
        """
        names = keypoint_names(layout)
        places = _OF_LAYOUT.get(layout, PLACES)
        return cls._at_places([places[name] for name in names], names, body)

    @classmethod
    def of_names(cls, names: Sequence[str], body: BodyModel) -> "BodyPoints":
        """Make the points on a body of given keypoint names; `<joint>_joint` is a body joint.

        Raises:
            ValueError: naming the keypoints that are not known.
        """
        if unknown := [name for name in names if name not in PLACES]:
            raise ObservationError(
                f"no keypoint is called {', '.join(unknown)}; there are {', '.join(PLACES)}"
            )
        return cls._at_places([PLACES[name] for name in names], tuple(names), body)

    @classmethod
    def of_places(cls, places: Mapping[str, BodyPlace], body: BodyModel) -> "BodyPoints":
        """Make points at given places of a body; the mapping's keys name them."""
        return cls._at_places(list(places.values()), tuple(places), body)

    @classmethod
    def _at_places(
        cls, places: Sequence[BodyPlace], names: tuple[str, ...], body: BodyModel
    ) -> "BodyPoints":
        bundled = body.checksum == BodyModel.load().checksum
        known = [bundled or not place.landmarks for place in places]
        found = [place if k else BodyPlace() for place, k in zip(places, known, strict=True)]
        vertices = sorted({landmark(name) for place in found for name in place.landmarks})
        of_joints = torch.zeros(len(names), len(JOINTS))
        of_vertices = torch.zeros(len(names), len(vertices))
        for row, place in enumerate(found):
            share = 1 / max(len(place.joints) + len(place.landmarks), 1)
            for name in place.joints:
                of_joints[row, joint_index(name)] += share
            for name in place.landmarks:
                of_vertices[row, vertices.index(landmark(name))] += share
        index = torch.tensor(vertices, dtype=torch.long)
        skin = of_vertices @ body.weights[index].to(of_vertices)
        bones = tuple((of_joints + skin).argmax(-1).tolist())
        return cls(of_joints, of_vertices, index, names, bones, torch.tensor(known))

    def rigid_pairs(self, body: BodyModel) -> tuple[tuple[int, int], ...]:
        """Index pairs of points that lie on the same bone, so that their distance is constant.

        A joint does so on the bone that begins and on the one that ends there; a mean of joints
        on a bone that all of them do so on.
        """
        bones = [self._bones_rigid_with_point(row, body) for row in range(len(self.names))]
        rest = self.at_rest(body, body.template.new_zeros(body.shape_size))
        distances = torch.cdist(rest, rest)
        count = range(len(bones))
        return tuple(
            (a, b) for a in count for b in count
            if a < b and bones[a] & bones[b] and float(distances[a, b]) > _MIN_REST_DISTANCE_M
        )  # fmt: skip

    def _bones_rigid_with_point(self, row: int, body: BodyModel) -> frozenset[int]:
        joints = self.of_joints[row].nonzero()[:, 0].tolist()
        rows = self.vertices[self.of_vertices[row] > 0]
        bones = [frozenset((joint, PARENTS[joint])) for joint in joints]
        bones += [frozenset((bone,)) for bone in body.weights[rows].argmax(-1).tolist()]
        return frozenset.intersection(*bones) - {-1} if bones else frozenset()

    def of(self, posed: PosedBody) -> Float[Tensor, "*batch time points 3"]:
        """Points on a posed body, world, metres; zero for points that the body lacks."""
        own = self.on(posed.joints.device, posed.joints.dtype)
        points = own.of_joints @ posed.joints
        if len(own.vertices) == 0:
            return points
        return points + own.of_vertices @ posed.points(own.vertices)

    def at_rest(
        self, body: BodyModel, shape: Float[Tensor, "*batch shape"]
    ) -> Float[Tensor, "*batch points 3"]:
        """Positions of the points on a body of given shape in its rest pose, metres."""
        own = self.on(shape.device, shape.dtype)
        points = own.of_joints @ body.rest_joints(shape)
        if len(own.vertices) == 0:
            return points
        return points + own.of_vertices @ body.rest_vertices(shape, own.vertices)

    def on(self, device: torch.device, dtype: torch.dtype) -> "BodyPoints":
        """Return the points with all tensors on a device and in a precision; cached."""
        return _on_device(self, device, dtype)


@lru_cache(maxsize=32)
def _on_device(points: BodyPoints, device: torch.device, dtype: torch.dtype) -> BodyPoints:
    with torch.inference_mode(False):
        return replace(
            points,
            of_joints=points.of_joints.to(device=device, dtype=dtype),
            of_vertices=points.of_vertices.to(device=device, dtype=dtype),
            vertices=points.vertices.to(device),
        )

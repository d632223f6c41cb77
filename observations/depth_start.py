"""A first guess from points of a body's surface: the rest body, upright, where they lie."""

import math

import numpy as np
import torch
from jaxtyping import Bool, Float
from scipy.spatial import KDTree
from torch import Tensor

from observations.image_start import UPRIGHT, smooth_path
from observations.rigid import nearest_placed
from observations.surfels import Surfels
from recon import rotations as so3
from recon.body import BodyModel
from recon.motion import Motion
from recon.skeleton import joint_index

HEADINGS = 24
"""Directions the body may face, evenly spread."""
RATE = 10.0
"""Moments per second at which headings are tried."""
_LEAST_POINTS = 20
_SAMPLE = 200
"""Points of a moment that are looked at."""
_STEPS = 5
_POINTWISE = 0.02
"""Share of the pull towards points, beside that towards planes."""
_REACH = 0.15
"""Metres from the rest body beyond which a point says little about where it is."""
_TOWARDS_SENSOR, _AHEAD = 0.05, 0.3
"""What it costs to turn one's back to the sensor, and to walk backwards; a misfit is at most 1."""
_WALKING = 0.8
"""Metres per second at which somebody surely walks."""
_LOWERED = 1.0
"""Radians that the arms hang below those of the rest pose, which are stretched out sideways:
points of a hanging arm would pull the hip towards them, as that is nearer."""


def depth_start(
    body: BodyModel,
    surfels: Surfels,
    points: Float[Tensor, "*batch moments points 3"],
    present: Bool[Tensor, "*batch moments points"],
    eye: Float[Tensor, "*batch moments 3"] | None,
    *,
    fps: float,
    start_time: float,
) -> Motion:
    """The rest pose upright in the recording, at the place and heading that suit the points best.

    For each of `HEADINGS`, the body, arms lowered, is moved onto the points (closest points,
    translation only, only what faces the sensor at `eye`). A back looks much like a chest, so
    bodies rather face the sensor, and walk ahead; headings of all moments are chosen together
    (Viterbi's algorithm). Between the moments tried the body follows the median of the points;
    moments that show too little take the place of the nearest one that does not.
    """
    batch = points.shape[:-3]
    clips = [tensor.flatten(0, -4) for tensor in (points[None], present[None, ..., None])]
    eyes = [None] * len(clips[0]) if eye is None else list(eye[None].flatten(0, -3).cpu())
    angles = torch.arange(HEADINGS, dtype=points.dtype) * math.tau / HEADINGS
    turns = so3.about_z(angles) @ so3.exp(points.new_tensor(UPRIGHT).cpu())
    lowered = _lowered(body.shape_size)
    middles, normals = surfels.posed(body.to(device="cpu", dtype=torch.float64).pose(lowered))
    pelvis = body.joint_template[0].cpu().double().numpy()
    model = _Model(middles[0].numpy() - pelvis, normals[0].numpy(), turns.double().numpy())
    placed = [
        _place(cloud, here[..., 0], at, model, angles, fps)
        for cloud, here, at in zip(clips[0].cpu(), clips[1].cpu(), eyes, strict=True)
    ]
    place = torch.stack([place for place, _ in placed]).to(points)
    root = torch.stack([turns[heading] for _, heading in placed]).to(points)
    others = lowered.rotations[0, 1:].to(points).expand(*root.shape[:-2], 21, 3, 3)
    translation = place - body.joint_template[0].to(points)
    return Motion(
        translation=translation.reshape(*batch, *translation.shape[1:]),
        rotations=torch.cat((root[..., None, :, :], others), -3).reshape(*batch, -1, 22, 3, 3),
        shape=points.new_zeros(*batch, body.shape_size),
        valid=torch.ones_like(present[..., 0]),
        fps=fps,
        start_time=start_time,
    )


def _lowered(shape_size: int) -> Motion:
    """One frame of the rest body, y up, with its arms hanging; double precision."""
    rotations = torch.eye(3, dtype=torch.float64).repeat(1, 22, 1, 1)
    for side, sign in (("left", -1.0), ("right", 1.0)):
        turn = torch.tensor([0.0, 0.0, sign * _LOWERED], dtype=torch.float64)
        rotations[0, joint_index(f"{side}_shoulder")] = so3.exp(turn)
    zero = torch.zeros(1, 3, dtype=torch.float64)
    return Motion.create(zero, rotations, torch.zeros(shape_size, dtype=torch.float64), fps=30.0)


class _Model:
    """The rest body turned into every heading, pelvis at the origin."""

    def __init__(self, rest: np.ndarray, normals: np.ndarray, turns: np.ndarray) -> None:
        self.middles = np.einsum("hij,sj->hsi", turns, rest)
        self.normals = np.einsum("hij,sj->hsi", turns, normals)
        self.front = turns[:, :, 2]

    def fit(self, cloud: np.ndarray, heading: int, eye: np.ndarray | None) -> np.ndarray:
        """Pelvis of the best translation and, last, its misfit from 0 to 1.

        Steps are those of closest tangent planes (with a little of the closest points): bodies
        are long, and points slide along them slowly.
        """
        middles, normals = self.middles[heading], self.normals[heading]
        if eye is not None:
            facing = normals @ (eye - np.median(cloud, 0)) >= 0
            if facing.any():
                middles, normals = middles[facing], normals[facing]
        tree = KDTree(middles)
        place = np.median(cloud, 0) - np.median(middles, 0)
        misfit = 1.0
        for _ in range(_STEPS):
            distance, index = tree.query(cloud - place)
            ratio = np.square(distance / _REACH)
            weight = 1 / np.square(1 + ratio)
            misfit = float((ratio / (1 + ratio)).mean())
            plane = normals[index]
            matrix = (plane * weight[:, None]).T @ plane + _POINTWISE * weight.sum() * np.eye(3)
            offset = cloud - place - middles[index]
            along = plane * (plane * offset).sum(1, keepdims=True) + _POINTWISE * offset
            place = place + np.linalg.solve(matrix, (weight[:, None] * along).sum(0))
        return np.append(place, misfit)


def _place(
    cloud: Float[Tensor, "moments points 3"],
    present: Bool[Tensor, "moments points"],
    eye: Float[Tensor, "moments 3"] | None,
    model: _Model,
    angles: Float[Tensor, " headings"],
    fps: float,
) -> tuple[Float[Tensor, "moments 3"], Tensor]:
    """Pelvis and heading of one clip in every moment."""
    moments = len(cloud)
    enough = present.sum(-1) >= _LEAST_POINTS
    if not enough.any():
        upright = model.middles[0][:, 2].min()
        return cloud.new_tensor([0.0, 0.0, -upright]).expand(moments, 3), torch.zeros(
            moments, dtype=torch.long
        )
    middle = torch.zeros(moments, 3, dtype=torch.float64)
    samples: dict[int, np.ndarray] = {}
    stride = max(1, round(fps / RATE))
    tried = torch.arange(0, moments, stride)
    for k in enough.nonzero()[:, 0].tolist():
        seen = cloud[k, present[k]].double()
        middle[k] = seen.median(0).values
        if k % stride == 0:
            samples[k] = seen[:: max(1, len(seen) // _SAMPLE)].numpy()
    if not samples:
        first = int(enough.nonzero()[0, 0])
        tried = torch.tensor([first])
        samples[first] = cloud[first, present[first]].double().numpy()
    middle = middle[nearest_placed(enough)]
    fits = torch.zeros(len(tried), len(angles), 4, dtype=torch.float64)
    for row, k in enumerate(tried.tolist()):
        if k in samples:
            at = None if eye is None else eye[k].double().numpy()
            fits[row] = torch.from_numpy(
                np.stack([model.fit(samples[k], h, at) for h in range(len(angles))])
            )
    known = torch.tensor([k in samples for k in tried.tolist()])
    cost = fits[..., 3] + _habits(middle, eye, tried, torch.from_numpy(model.front), fps)
    cost = cost.where(known[:, None], 0.0)
    heading = smooth_path(cost[None], angles.double(), fps / stride)[0]
    rows = nearest_placed(known)
    heading = heading[rows]
    shift = fits[rows, heading, :3] - middle[tried[rows]]
    row = (torch.arange(moments) / stride).round().long().clamp(max=len(tried) - 1)
    return middle + shift[row], heading[row]


def _habits(
    middle: Float[Tensor, "moments 3"],
    eye: Float[Tensor, "moments 3"] | None,
    tried: Tensor,
    front: Float[Tensor, "headings 3"],
    fps: float,
) -> Float[Tensor, "tried headings"]:
    """What unusual headings cost: the back to the sensor, walking backwards."""
    reach = max(1, round(fps / 4))
    later = (tried + reach).clamp(max=len(middle) - 1)
    earlier = (tried - reach).clamp(min=0)
    pace = (middle[later] - middle[earlier])[:, :2]
    pace = pace * fps / (later - earlier).clamp(min=1)[:, None] / _WALKING
    pace = pace / pace.norm(dim=-1, keepdim=True).clamp(min=1)
    cost = _AHEAD * (pace.norm(dim=-1, keepdim=True) - pace @ front[:, :2].mT) / 2
    if eye is not None:
        way = torch.nn.functional.normalize((eye.double()[tried] - middle[tried])[:, :2], dim=-1)
        cost = cost + _TOWARDS_SENSOR * (1 - way @ front[:, :2].mT) / 2
    return cost

"""A first guess from points of a body's surface: a plain posture, upright, where they lie."""

import math
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from observations.start.images import smooth_path
from observations.start.rigid import nearest_placed
from observations.surfels import Surfels
from priors.labels.networks import squared_distances
from recon.body.model import BodyModel
from recon.core import rotations as so3
from recon.core.motion import Motion
from recon.core.raster import facing
from recon.core.skeleton import joint_index
from recon.method.sensor import UPRIGHT

HEADINGS = 24
"""Directions the body may face, evenly spread."""
RATE = 10.0
"""Moments per second at which headings are tried."""
_LEAST_POINTS = 20
_SAMPLE = 200
"""Points of a moment that are looked at."""
_STEPS, _MORE_STEPS = 5, 3
"""Iterations of closest points: for the first posture, and for each other one from there on."""
_STEADY = 5.0
"""How much more than an image's headings those of points are held together: points of a stride
look like those of a turned body."""
_POINTWISE = 0.02
"""Share of the pull towards points, beside that towards planes."""
_REACH = 0.15
"""Metres from the rest body beyond which a point says little about where it is."""
_TOWARDS_SENSOR, _AHEAD = 0.05, 0.3
"""What it costs to turn one's back to the sensor, and to walk backwards; a misfit is at most 1."""
_WALKING = 0.8
"""Metres per second at which somebody surely walks."""
_HANGING, _STRETCHED, _RAISED = -1.2, 0.0, 0.4
"""Radians that arms are above those of the rest pose, which are stretched out sideways. Points of
a hanging arm would pull a stretched one's hip towards them, as that is nearer; points on a raised
arm that begins below would stretch the trunk."""
_BENT = 1.0
"""Radians that the elbows of raised arms are bent upwards."""
_STRIDE = 0.4
"""Radians that one leg is ahead, and the other one behind with its knee bent."""
_POSTURES = (
    (0, _HANGING, _HANGING),
    (1, _HANGING, _HANGING),
    (-1, _HANGING, _HANGING),
    (0, _STRETCHED, _STRETCHED),
    (0, _RAISED, _RAISED),
)
"""Postures to try: the leg that is ahead (1 left, -1 right), left arm, right arm. One raised
arm is not among them: seen from behind it is the other one, and turning the whole body mends
nothing."""


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
    """Plain postures upright in the recording, at the place and heading that suit the points best.

    For each of `HEADINGS`, the body stands, strides or raises its arms, and is moved onto the
    points (closest points, translation only, only what faces the sensor at `eye`). A back looks
    much like a chest, so bodies rather face the sensor, and walk ahead; headings of all moments
    are chosen together (Viterbi's algorithm), then postures, each with its neighbours in time.
    Between the moments tried the body follows the median of the points;
    moments that show too little take the place of the nearest one that does not.
    """
    batch = points.shape[:-3]
    clips = [tensor.flatten(0, -4) for tensor in (points[None], present[None, ..., None])]
    eyes = [None] * len(clips[0]) if eye is None else list(eye[None].flatten(0, -3).cpu())
    angles = torch.arange(HEADINGS, dtype=points.dtype) * math.tau / HEADINGS
    turns = so3.about_z(angles) @ so3.exp(points.new_tensor(UPRIGHT).cpu())
    postures = _postures(body.shape_size)
    middles, normals = surfels.posed(body.to(device="cpu", dtype=torch.float64).pose(postures))
    pelvis = body.joint_template[0].cpu().double().numpy()
    model = _Model(middles.numpy() - pelvis, normals.numpy(), turns.double().numpy())
    placed = [
        _place(cloud, here[..., 0], at, model, angles, fps)
        for cloud, here, at in zip(clips[0].cpu(), clips[1].cpu(), eyes, strict=True)
    ]
    place = torch.stack([place for place, _, _ in placed]).to(points)
    root = torch.stack([turns[heading] for _, heading, _ in placed]).to(points)
    others = torch.stack([postures.rotations[posture, 1:] for *_, posture in placed]).to(points)
    translation = place - body.joint_template[0].to(points)
    return Motion(
        translation=translation.reshape(*batch, *translation.shape[1:]),
        rotations=torch.cat((root[..., None, :, :], others), -3).reshape(*batch, -1, 22, 3, 3),
        shape=points.new_zeros(*batch, body.shape_size),
        valid=torch.ones_like(present[..., 0]),
        fps=fps,
        start_time=start_time,
    )


def _postures(shape_size: int) -> Motion:
    """One frame of the body, y up, for every posture; double precision."""
    rotations = torch.eye(3, dtype=torch.float64).repeat(len(_POSTURES), 22, 1, 1)
    for frame, (ahead, *arms) in zip(rotations, _POSTURES, strict=True):
        for side, sign, up in zip(("left", "right"), (1, -1), arms, strict=True):
            arm = so3.exp(frame.new_tensor([0.0, 0.0, sign * up]))
            elbow = so3.exp(frame.new_tensor([0.0, 0.0, sign * _BENT * (up > 0)]))
            swing = so3.exp(frame.new_tensor([sign * ahead * _STRIDE, 0.0, 0.0]))
            frame[joint_index(f"{side}_shoulder")] = swing @ arm
            frame[joint_index(f"{side}_elbow")] = elbow
            frame[joint_index(f"{side}_hip")] = swing.mT
            if sign * ahead < 0:
                frame[joint_index(f"{side}_knee")] = swing.mT
    zero = torch.zeros(len(_POSTURES), 3, dtype=torch.float64)
    return Motion.create(zero, rotations, torch.zeros(shape_size, dtype=torch.float64), fps=30.0)


class _Model:
    """The body in every posture and heading, pelvis at the origin."""

    def __init__(self, rest: np.ndarray, normals: np.ndarray, turns: np.ndarray) -> None:
        self.middles = np.einsum("hij,psj->hpsi", turns, rest)
        self.normals = np.einsum("hij,psj->hpsi", turns, normals)
        self.front = turns[:, :, 2]

    def fit(self, cloud: np.ndarray, heading: int, eye: np.ndarray | None) -> np.ndarray:
        """The pelvis of the best translation for every posture and, last, its residual, 0 to 1."""
        fits: list[np.ndarray] = []
        for middles, normals in zip(self.middles[heading], self.normals[heading], strict=True):
            if eye is not None:
                facing = normals @ (eye - np.median(cloud, 0)) >= 0
                if facing.any():
                    middles, normals = middles[facing], normals[facing]
            place = fits[0][:3] if fits else np.median(cloud, 0) - np.median(middles, 0)
            steps = _MORE_STEPS if fits else _STEPS
            fits.append(_closest(cloud, middles, normals, place, steps))
        return np.stack(fits)


def _closest(
    cloud: np.ndarray, middles: np.ndarray, normals: np.ndarray, place: np.ndarray, steps: int
) -> np.ndarray:
    """The body's place after some steps and, last, its misfit.

    Steps are those of closest tangent planes (with a little of the closest points): bodies
    are long, and points slide along them slowly.
    """
    from scipy.spatial import KDTree

    tree = KDTree(middles)
    misfit = 1.0
    for _ in range(steps):
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
) -> tuple[Float[Tensor, "moments 3"], Tensor, Tensor]:
    """Pelvis, heading and posture of one clip in every moment."""
    moments = len(cloud)
    enough = present.sum(-1) >= _LEAST_POINTS
    if not enough.any():
        upright = model.middles[0, 0, :, 2].min()
        none = torch.zeros(moments, dtype=torch.long)
        return cloud.new_tensor([0.0, 0.0, -upright]).expand(moments, 3), none, none
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
    fits = torch.zeros(len(tried), len(angles), len(_POSTURES), 4, dtype=torch.float64)
    for row, k in enumerate(tried.tolist()):
        if k in samples:
            at = None if eye is None else eye[k].double().numpy()
            fits[row] = torch.from_numpy(
                np.stack([model.fit(samples[k], h, at) for h in range(len(angles))])
            )
    known = torch.tensor([k in samples for k in tried.tolist()])
    cost = fits[..., 3].amin(-1) + _habits(middle, eye, tried, torch.from_numpy(model.front), fps)
    cost = cost.where(known[:, None], 0.0)
    heading = smooth_path(cost[None] / _STEADY, angles.double(), fps / stride)[0]
    rows = nearest_placed(known)
    heading = heading[rows]
    fits = fits[rows, heading]
    posture = _steady(fits[..., 3]).argmin(-1)
    shift = fits[torch.arange(len(rows)), posture, :3] - middle[tried[rows]]
    row = (torch.arange(moments) / stride).round().long().clamp(max=len(tried) - 1)
    return middle + shift[row], heading[row], posture[row]


def _steady(misfit: Float[Tensor, "tried postures"]) -> Float[Tensor, "tried postures"]:
    """Mean of a moment and its neighbours."""
    ends = torch.cat((misfit[:1], misfit, misfit[-1:]))
    return (ends[:-2] + ends[1:-1] + ends[2:]) / 3


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


_HALF_COUNTED = 0.1
"""Scale in metres of the distance of a point from the surface: at this one, half counts."""
_BESIDE = 0.08
"""Metres at the body within which a point stands for a line of sight."""
_BEFORE = 0.12
"""Metres that a surface may be nearer to the sensor than the points along its line of sight."""


@dataclass(frozen=True)
class Evidence:
    """What speaks against poses: shares from 0 to 1, one of every row."""

    misfit: Float[Tensor, " rows"]
    """Mean of d² / (d² + 0.1²) over the distances d of points from the facing surface, metres."""
    contradicted: Float[Tensor, " rows"]
    """Share of the facing surface where the sensor saw past it or through it; 0 without one."""


def evidence(
    motion: Motion,
    body: BodyModel,
    surfels: Surfels,
    points: Float[Tensor, "rows points 3"],
    present: Bool[Tensor, "rows points"],
    eye: Float[Tensor, "rows 3"] | None,
) -> Evidence:
    """Evidence against every frame of a motion.

    Args:
        motion: one clip, whose frames are the rows.
        body: whose motion it is.
        surfels: a sparse cover of its surface.
        points: seen in every row, metres.
        present: which of them exist.
        eye: the sensor's place in every row; None where points come from all sides.
    """
    middles, normals = surfels.posed(body.pose(motion))
    shown = torch.ones_like(present[:, :1]).expand(middles.shape[:2])
    if eye is not None:
        shown = facing(middles, normals, eye)
    centre = points.mean(1, keepdim=True)  # far from the origin, products of places lose digits
    squared = squared_distances(points - centre, middles - centre)
    nearest = squared.masked_fill(~shown[:, None], torch.inf).amin(-1)
    share = (nearest / (nearest + _HALF_COUNTED**2)).nan_to_num(1.0).where(present, 0.0)
    misfit = share.sum(-1) / present.sum(-1).clamp(min=1)
    if eye is None:
        return Evidence(misfit, torch.zeros_like(misfit))
    away = torch.where(present[..., None], points - eye[:, None], 0.0)
    far = away.norm(dim=-1)
    ray = away / far.clamp(min=1e-6)[..., None]
    towards = middles - eye[:, None]
    depth = towards.norm(dim=-1)
    cosine = (towards / depth.clamp(min=1e-6)[..., None]) @ ray.mT
    cosine = cosine.masked_fill(~present[:, None], -1.0)
    best = cosine.max(-1)
    lateral = (2 - 2 * best.values.clamp(max=1)).sqrt() * depth
    before = far.gather(-1, best.indices) - depth > _BEFORE
    against = shown & ((lateral > _BESIDE) | before)
    share = against.sum(-1) / shown.sum(-1).clamp(min=1)
    return Evidence(misfit, share.to(misfit))

"""The first guess of a fit from the keypoints of one camera.

The rest body turned and scaled to fit the keypoints of every frame.
"""

import math
from collections.abc import Sequence

import torch
from jaxtyping import Float, Int
from torch import Tensor

from observations.correspondences import BodyPoints
from observations.start.rigid import TORSO, nearest_placed_frames, rest_pose_at
from recon.body.model import BodyModel
from recon.core import rotations as so3
from recon.core.camera import Camera
from recon.core.motion import Motion
from recon.core.skeleton import joint_index
from recon.method.sensor import UPRIGHT
from recon.solver.viterbi import cheapest_path

HEADINGS = 36
"""Directions the body may face, evenly spread."""
_TURNING = 4.0
"""Radians per second that a body turns at now and then."""
_LEG_WEIGHT = 0.3
"""Weight of knees, ankles and feet, which move against the torso, but tell how far away a body
is."""
_SMOOTHING = 0.5
"""Seconds to either side over which the median of the distance is taken."""
_STRETCHED = 0.8
"""Share of the bones of a frame that look shorter in the image than those that tell its distance.
A bone seen from its end looks shorter, noise and a near hand make it longer."""
_BONES = (
    ("shoulder", "elbow"), ("elbow", "wrist"), ("hip", "knee"), ("knee", "ankle"),
    ("shoulder", "hip"),
)  # fmt: skip
_LEAST_POINTS = 4
_LEGS = frozenset(
    joint_index(f"{side}_{name}")
    for side in ("left", "right")
    for name in ("knee", "ankle", "foot")
)


def image_start(
    body: BodyModel,
    points: BodyPoints,
    pixels: Float[Tensor, "batch moments points 2"],
    confidence: Float[Tensor, "batch moments points"],
    camera: Camera,
    *,
    fps: float,
    start_time: float,
) -> Motion:
    """First guess from one camera: upright rest body, placed and turned to fit torso and legs.

    For every heading of the body, scale and place in the image follow by least squares (weak
    perspective). The headings of all frames are chosen together, as a body does not spin
    (Viterbi's algorithm). The distance is that of `bone_distance`. Frames that show too little
    take the place of the nearest one that does not.
    """
    # the rest pose predicts the place of the torso well, of the legs less, of the arms not at all
    trust = [1.0 if b in TORSO else _LEG_WEIGHT if b in _LEGS else 0.0 for b in points.bones]
    weight = confidence.square() * (torch.tensor(trust) * points.known).to(confidence)
    placed = (weight > 0).sum(-1) >= _LEAST_POINTS
    angles = torch.arange(HEADINGS, dtype=pixels.dtype, device=pixels.device) * math.tau / HEADINGS
    upright = so3.exp(pixels.new_tensor(UPRIGHT))
    turns = so3.about_z(angles) @ upright
    shape = pixels.new_zeros(len(pixels), body.shape_size)
    rest = points.at_rest(body, shape[0]).to(pixels) - body.joint_template[0].to(pixels)
    look = camera.T_camera_world[..., None, :3, :3] @ turns
    seen = (rest @ look.mT)[..., :2].expand(*pixels.shape[:2], -1, -1, -1)

    misfit, centre = _weak_perspective(pixels, weight, seen)
    chosen = smooth_path(misfit.where(placed[..., None], 0.0), angles, fps)
    nearest = nearest_placed_frames(placed)
    chosen = chosen.gather(-1, nearest)
    pick = chosen[..., None]
    distance = bone_distance(points, rest, pixels, confidence, camera)
    distance = _running_median(distance.gather(-1, nearest), round(_SMOOTHING * fps))
    own = nearest[..., None]
    centre = centre.gather(-3, own[..., None].expand(*own.shape[:-1], HEADINGS, 2))
    centre = centre.gather(-2, pick[..., None].expand(*pick.shape, 2))
    pelvis = camera.unproject(centre, distance[..., None])[..., 0, :]
    translation = pelvis - body.joint_template[0].to(pixels)
    return rest_pose_at(body, translation, turns[chosen], fps=fps, start_time=start_time)


def bone_distance(
    points: BodyPoints,
    rest: Float[Tensor, "points 3"],
    pixels: Float[Tensor, "batch time points 2"],
    confidence: Float[Tensor, "batch time points"],
    camera: Camera,
) -> Float[Tensor, "batch time"]:
    """Distance of an average body from the camera in each frame, from its bones' image, metres.

    Focal length times a high quantile over the visible bones of length in the image over length
    at rest. HuMoR takes means, in which foreshortened bones, and missing ones as bones of no
    length, push the body away (section 6.2). Where no bone is seen, the median of the others.
    """
    scale = pixels_per_metre(points.names, rest, pixels, confidence)
    focal = camera.camera_matrix[..., [0, 1], [0, 1]].mean(-1)
    return focal.expand(scale.shape) / scale


def pixels_per_metre(
    names: Sequence[str],
    rest: Float[Tensor, "points 3"],
    pixels: Float[Tensor, "batch time points 2"],
    confidence: Float[Tensor, "batch time points"],
) -> Float[Tensor, "batch time"]:
    """Image scale at the body in every frame, pixels per metre, from lengths of bones."""
    ends = [
        (names.index(f"{side}_{a}"), names.index(f"{side}_{b}"))
        for side in ("left", "right")
        for a, b in _BONES
        if {f"{side}_{a}", f"{side}_{b}"} <= set(names)
    ]
    first, second = torch.tensor(ends, device=pixels.device).unbind(-1)
    length = (rest[first] - rest[second]).norm(dim=-1)
    ratio = (pixels[..., first, :] - pixels[..., second, :]).norm(dim=-1) / length
    seen = (confidence[..., first] > 0) & (confidence[..., second] > 0)
    scale = ratio.where(seen, torch.nan).nanquantile(_STRETCHED, dim=-1)
    usual = scale.nanmedian(-1, keepdim=True).values.nan_to_num(1.0)
    return torch.where(scale.isnan(), usual, scale).clamp(min=1e-3)


def _weak_perspective(
    pixels: Float[Tensor, "batch time points 2"],
    weight: Float[Tensor, "batch time points"],
    body_points: Float[Tensor, "batch time headings points 2"],
) -> tuple[Float[Tensor, "batch time headings"], Float[Tensor, "batch time headings 2"]]:
    """Fit body points q to pixels u by centre c and scale s: least Σ w |u - c - s q|².

    Returns:
        What remains, 0 to 1, for every frame and heading, and c, the pelvis' pixels.
    """
    share = (weight / weight.sum(-1, keepdim=True).clamp(min=1e-12))[..., None, :, None]
    image = pixels[..., None, :, :]
    image_middle = (share * image).sum(-2, keepdim=True)
    body_middle = (share * body_points).sum(-2, keepdim=True)
    u, q = image - image_middle, body_points - body_middle
    size = (share * q.square()).sum((-1, -2)).clamp(min=1e-12)
    scale = ((share * u * q).sum((-1, -2)) / size).clamp(min=0)
    total = (share * u.square()).sum((-1, -2)).clamp(min=1e-12)
    centre = (image_middle - scale[..., None, None] * body_middle)[..., 0, :]
    return 1 - scale.square() * size / total, centre


def smooth_path(
    misfit: Float[Tensor, "batch time headings"], angles: Float[Tensor, " headings"], fps: float
) -> Int[Tensor, "batch time"]:
    """Choose each frame's heading (index) for least total misfit and turning (Viterbi)."""
    away = (angles[:, None] - angles + math.pi).remainder(math.tau) - math.pi
    turning = 0.1 * (away * fps / _TURNING).square() / fps
    return cheapest_path(misfit, turning.expand(misfit.shape[1] - 1, -1, -1))


def _running_median(
    values: Float[Tensor, "batch time"], reach: int
) -> Float[Tensor, "batch time"]:
    """Running median over 2 `reach` + 1 frames; first and last values are repeated."""
    reach = min(reach, values.shape[-1] - 1)
    padded = torch.nn.functional.pad(values[:, None], (reach, reach), mode="replicate")[:, 0]
    return padded.unfold(-1, 2 * reach + 1, 1).median(-1).values

"""What a sensor sees of true motions: noisy joints, joints with a gap, points above a height."""

import torch
from jaxtyping import Float
from torch import Tensor

from observations.joints3d import Joints3D
from observations.markers3d import Markers3D
from recon.body.landmarks import KEYPOINTS_43, landmark
from recon.body.model import BodyModel
from recon.core.motion import Motion
from recon.core.skeleton import JOINTS, descendants, joint_index
from recon.formats.observations import PositionsFile

_LEGS = descendants(joint_index("left_hip")) + descendants(joint_index("right_hip"))
UPPER_BODY = tuple(joint for joint in range(len(JOINTS)) if joint not in _LEGS)
"""Numbers of the joints from the pelvis up."""


def noisy_joints(
    truth: Motion,
    body: BodyModel,
    seed: int,
    noise: float = 0.04,
    joints: tuple[int, ...] = tuple(range(len(JOINTS))),
) -> Joints3D:
    """Joints, all 22 unless said, with Gaussian noise, metres per coordinate."""
    positions = body.pose(truth).joints
    random = torch.Generator().manual_seed(seed)
    errors = torch.randn(positions.shape, generator=random, dtype=torch.float64)
    seen = (positions + noise * errors.to(positions))[..., list(joints), :]
    return Joints3D(
        positions=seen,
        visible=torch.ones(seen.shape[:-1], dtype=torch.bool),
        joints=joints,
        fps=truth.fps,
    )


def with_gap(observed: Joints3D, gap: slice) -> Joints3D:
    """Joints of which nothing is seen in some frames: in-betweening."""
    positions, visible = observed.positions.clone(), observed.visible.clone()
    positions[:, gap], visible[:, gap] = 0.0, False
    return observed.replace(positions=positions, visible=visible)


def occluded_points(
    truth: Motion, body: BodyModel, height: float = 0.9
) -> tuple[Markers3D, Float[Tensor, "clips time 43 3"]]:
    """43 points of the skin without noise, those below `height` metres hidden; and all of them."""
    vertices = tuple(landmark(name) for name in KEYPOINTS_43)
    points = body.pose(truth).points(torch.tensor(vertices))
    visible = points[..., 2] >= height
    return (
        Markers3D(
            positions=points.where(visible[..., None], 0.0),
            visible=visible,
            vertices=vertices,
            fps=truth.fps,
        ),
        points,
    )


def sensor_of(seen: PositionsFile) -> Joints3D | Markers3D:
    """A record of joints or points of the skin as an observation with one leading axis."""
    positions = torch.from_numpy(seen.positions).float()[None]
    visible = torch.from_numpy(seen.visible)[None]
    if seen.kind == "joints3d":
        joints = tuple(joint_index(name) for name in seen.names)
        return Joints3D(positions, visible, joints, seen.fps)
    vertices = tuple(landmark(name) for name in seen.names)
    return Markers3D(positions, visible, vertices, seen.fps)

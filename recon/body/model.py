"""Body models: a shape space, forward kinematics of 22 joints, and linear blend skinning.

Vertices are computed only on demand.
"""

import hashlib
import io
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from recon.core.arrays import cached_constant
from recon.core.motion import Motion
from recon.core.skeleton import FAMILIES, JOINTS, PARENTS
from recon.core.struct import TensorStruct

SHORTEST_BODY, TALLEST_BODY = 1.42, 1.96
"""Metres; body models know adults alone, of whom one in a hundred is smaller or taller."""
ODDEST = 4.0
"""Standard deviations that no coefficient of a real person's shape is away from the mean."""


@dataclass(frozen=True)
class BodyModel(TensorStruct):
    """A linear body of the SMPL family, reduced to its 22 body joints.

    rest vertices = template + shape_directions · shape; the rest pose has y up, faces z, and
    the body's left is +x. Weights of further joints (hands, jaw, eyes) are added to their
    nearest body ancestor, which is exact while those joints keep their rest rotation.
    """

    name: str
    checksum: str
    """First 16 hexadecimal digits of the file's SHA-256."""
    template: Float[Tensor, "vertices 3"]
    shape_directions: Float[Tensor, "vertices 3 shape"]
    pose_directions: Float[Tensor, "features vertices 3"] | None
    """Vertex offsets per entry of the 21 body rotations minus identity, row-major (SMPL)."""
    joint_template: Float[Tensor, "22 3"]
    joint_directions: Float[Tensor, "22 3 shape"]
    weights: Float[Tensor, "vertices 22"]
    faces: Int[Tensor, "faces 3"]
    male: Float[Tensor, " shape"]
    """Shape of the average man (zero where a file holds one sex)."""
    female: Float[Tensor, " shape"]

    @classmethod
    def load(cls, path: str | Path | None = None) -> "BodyModel":
        """Load the bundled body, or a SMPL, SMPL-H or SMPL-X file (.npz or .pkl).

        Raises:
            FileNotFoundError: when there is no such file.
            ValueError: when the file is no body model; the message says what is missing.
        """
        if path is None:
            return _bundled_body()
        from recon.formats.smpl import load_smpl  # imported only when a file is given

        path = Path(path)
        arrays = load_smpl(path).body_model_arrays()
        return _model_from_arrays(path.stem, path.read_bytes(), arrays)

    @property
    def shape_size(self) -> int:
        """Number of shape coefficients the body has."""
        return self.shape_directions.shape[-1]

    def same_as(self, other: "BodyModel") -> bool:
        """Whether both are the same body, in the same precision and on the same device."""
        own, its = self.template, other.template
        alike = self.checksum == other.checksum and self.shape_size == other.shape_size
        return alike and own.dtype == its.dtype and own.device == its.device

    def rest_joints(self, shape: Float[Tensor, "*batch shape"]) -> Float[Tensor, "*batch 22 3"]:
        """Joints of the unposed body, metres; missing trailing coefficients are zero."""
        directions = self.joint_directions[..., : self._coefficient_count(shape)].flatten(0, 1)
        return self.joint_template + (shape @ directions.mT).unflatten(-1, (-1, 3))

    def rest_vertices(
        self,
        shape: Float[Tensor, "*batch shape"],
        vertices: Int[Tensor, " points"] | None = None,
    ) -> Float[Tensor, "*batch points 3"]:
        """Surface of the unposed body, or some of its vertices, metres."""
        template, directions = self.template, self.shape_directions
        if vertices is not None:
            template, directions = template[vertices], directions[vertices]
        return template + torch.einsum(
            "vdk,...k->...vd", directions[..., : self._coefficient_count(shape)], shape
        )

    def height(self, shape: Float[Tensor, "*batch shape"]) -> Float[Tensor, "*batch"]:
        """Height of the unposed body from the soles to the crown, metres."""
        vertex_heights = self.rest_vertices(shape)[..., 1]
        return vertex_heights.amax(-1) - vertex_heights.amin(-1)

    def pose(self, motion: Motion) -> "PosedBody":
        """Pose the body by a motion; joints are computed now, vertices when they are asked for."""
        rest = self.rest_joints(motion.shape)
        orientations, joints = forward_kinematics(motion.rotations, rest)
        return PosedBody(
            model=self,
            shape=motion.shape,
            rest=rest,
            local=motion.rotations,
            joints=joints + motion.translation[..., None, :],
            orientations=orientations,
        )

    def _coefficient_count(self, shape: Tensor) -> int:
        if shape.shape[-1] > self.shape_size:
            raise ValueError(
                f"body {self.name!r} has {self.shape_size} shape coefficients, "
                f"got {shape.shape[-1]}; fit the shape to this body first"
            )
        return shape.shape[-1]


@dataclass(frozen=True)
class PosedBody:
    """A body model posed by a motion; vertices are computed on first use."""

    model: BodyModel
    shape: Float[Tensor, "*batch shape"]
    rest: Float[Tensor, "*batch 22 3"]
    local: Float[Tensor, "*batch time 22 3 3"]
    joints: Float[Tensor, "*batch time 22 3"]
    """World frame, metres."""
    orientations: Float[Tensor, "*batch time 22 3 3"]
    """Rotation of every bone from the rest pose to the world."""

    @cached_property
    def vertices(self) -> Float[Tensor, "*batch time vertices 3"]:
        """All vertices, metres; computed on first use and cached."""
        return self.points(torch.arange(len(self.model.template), device=self.joints.device))

    @property
    def bones(self) -> Float[Tensor, "*batch time 22 4 3"]:
        """Affine maps from unposed to posed points, for every bone j: rows of R_jᵀ, then t_j."""
        shift = self.joints - (self.orientations @ self.rest[..., None, :, :, None])[..., 0]
        return torch.cat((self.orientations.transpose(-1, -2), shift[..., None, :]), -2)

    def points(self, vertices: Int[Tensor, " points"]) -> Float[Tensor, "*batch time points 3"]:
        """Positions of the given vertices in every frame, metres, without computing others.

        A shape is shared by all frames of a clip, so skinning is one matrix product: the rows
        w_vj (x_v, 1) of all vertices v and joints j (points x 4·22) times the stacked matrices
        `bones` (4·22 x 3·time).
        """
        weights = self.model.weights[vertices]
        unposed = self.model.rest_vertices(self.shape, vertices)
        homogeneous = torch.cat((unposed, torch.ones_like(unposed[..., :1])), -1)
        left = (weights[:, :, None] * homogeneous[..., :, None, :]).flatten(-2)
        # reshape (*batch time joints 4 3) to (*batch joints·4 time·3), for one matrix product
        right = self.bones.movedim(-4, -2).flatten(-4, -3).flatten(-2)
        skinned = (left @ right).unflatten(-1, (self.joints.shape[-3], 3)).movedim(-2, -3)
        if self.model.pose_directions is None:
            return skinned
        return skinned + self._pose_corrections(vertices, weights)

    def _pose_corrections(self, vertices: Tensor, weights: Tensor) -> Tensor:
        """SMPL's pose-dependent vertex offsets, rotated to the posed skin, metres."""
        turns = torch.einsum("vj,...jab->...vab", weights, self.orientations)
        return (turns @ self.pose_offsets(vertices)[..., None])[..., 0]

    def pose_offsets(self, vertices: Int[Tensor, " points"]) -> Tensor:
        """Offsets (*batch, time, points, 3) that SMPL's pose adds to unposed vertices, metres."""
        directions = self.model.pose_directions
        assert directions is not None
        identity = torch.eye(3, dtype=self.local.dtype, device=self.local.device)
        features = (self.local[..., 1:, :, :] - identity).flatten(-3)
        return (features @ directions[:, vertices].flatten(1)).unflatten(-1, (-1, 3))


@lru_cache(maxsize=1)
def _bundled_body() -> BodyModel:
    data = (resources.files("recon") / "assets" / "body.npz").read_bytes()
    with np.load(io.BytesIO(data), allow_pickle=False) as file:
        arrays = {key: file[key] for key in file.files}
    index = arrays["weight_index"].astype(int)
    weights = np.zeros((len(index), len(JOINTS)))
    np.add.at(weights, (np.arange(len(index))[:, None], index), arrays["weight_value"])
    arrays["weights"] = weights / weights.sum(1, keepdims=True)
    return _model_from_arrays("recon", data, arrays)


def _model_from_arrays(name: str, data: bytes, arrays: Mapping[str, np.ndarray]) -> BodyModel:
    """Build a body model from arrays named like its fields; `data` are hashed."""
    tensors = {
        key: torch.from_numpy(np.ascontiguousarray(arrays[key], np.float32))
        for key in (
            "template", "shape_directions", "pose_directions", "joint_template",
            "joint_directions", "weights", "male", "female",
        )
        if key in arrays
    }  # fmt: skip
    return BodyModel(
        name=name,
        checksum=hashlib.sha256(data).hexdigest()[:16],
        faces=torch.from_numpy(arrays["faces"].astype(np.int64)),
        pose_directions=tensors.pop("pose_directions", None),
        **tensors,
    )


def forward_kinematics(
    rotations: Float[Tensor, "*batch time 22 3 3"], rest: Float[Tensor, "*batch 22 3"]
) -> tuple[Float[Tensor, "*batch time 22 3 3"], Float[Tensor, "*batch time 22 3"]]:
    """Return world rotations and positions of all joints; the root is at its rest position.

    Child c of parent p: O_c = O_p R_c and x_c = x_p + O_p b_c with b_c the bone from p to c at
    rest. The derivative walks the same tree backwards, which is cheaper than recording each
    small product; joints come first in memory, so that a level is one block.
    """
    parents = cached_constant(tuple(PARENTS[1:]), rest.device)
    bones = torch.cat((rest[..., :1, :], rest[..., 1:, :] - rest[..., parents, :]), -2)
    bones = bones[..., None, :, :].expand(rotations.shape[:-1])
    return _KinematicChain.apply(rotations, bones)


class _KinematicChain(torch.autograd.Function):
    """Forward kinematics with a hand-written derivative: local to world joint transforms."""

    @staticmethod
    def forward(ctx: Any, rotations: Tensor, bones: Tensor) -> tuple[Tensor, Tensor]:
        shape = rotations.shape[:-2]
        local = torch.cat((rotations, bones[..., None]), -1).reshape(-1, 22, 3, 4)
        local = local.transpose(0, 1).contiguous()
        world = torch.empty_like(local)
        world[0] = local[0]
        for children, parents in FAMILIES:
            torch.matmul(world[parents][..., :3], local[children], out=world[children])
            world[children][..., 3] += world[parents][..., 3]
        ctx.save_for_backward(local, world)
        out = world.transpose(0, 1).unflatten(0, shape[:-1])
        return out[..., :3], out[..., 3]

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor, Tensor]:
        local, world = ctx.saved_tensors
        shape = gradients[0].shape[:-2]
        g_world = torch.cat((gradients[0], gradients[1][..., None]), -1).reshape(-1, 22, 3, 4)
        g_world = g_world.transpose(0, 1).contiguous()
        g_local = torch.empty_like(local)
        for children, parents in reversed(FAMILIES):
            g = g_world[children]
            torch.matmul(world[parents][..., :3].mT, g, out=g_local[children])
            up = torch.matmul(g, local[children].mT)
            moved = g[..., 3]
            if isinstance(parents, int):
                up, moved = up.sum(0), moved.sum(0)
            g_world[parents][..., :3] += up
            g_world[parents][..., 3] += moved
        g_local[0] = g_world[0]
        out = g_local.transpose(0, 1).unflatten(0, shape[:-1])
        return out[..., :3], out[..., 3]

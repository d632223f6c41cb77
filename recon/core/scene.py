"""Unknowns of a clip besides the prior's variables: ground, lens, offsets of tracked points."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import torch
from jaxtyping import Float
from torch import Tensor

from recon.core import rotations as so3
from recon.core.struct import TensorStruct

if TYPE_CHECKING:
    from recon.core.camera import Camera, Ground
else:  # only annotations use these: Any at run time saves importing their module
    from typing import Any as Camera
    from typing import Any as Ground

TILT = 0.2
"""Radians that one unit of `UnknownGround.tilt` turns the ground by."""
ZOOM = 0.3
"""Change of the focal length's logarithm by one unit of `UnknownLens.zoom`."""

OFFSETS = frozenset({"scene.offsets"})
"""Optimised variables of the offsets of tracked points."""
HEIGHT = frozenset({"scene.ground.lift"})
"""Optimised variables of a ground of which only the height is unknown."""
GROUND = frozenset({"scene.ground.tilt", "scene.ground.lift"})
"""Optimised variables of an unknown ground."""
LENS = frozenset({"scene.lens.zoom"})
"""Optimised variables of a camera whose focal length is not known."""


@dataclass(frozen=True)
class UnknownGround(TensorStruct):
    """The rigid transform from the frame of a recording to the world (z up, the ground at z = 0).

    The recording's frame is a first guess of the world. The world follows from it by a small turn
    R about a horizontal axis through a point p near the body, and a lift l along the vertical z:
    x_world = R (x - p) + p + l z. Observations do not depend on R and l, only terms of gravity and
    contact do; so the variables of the motion stay in the recording's frame, where another ground
    changes no residual.
    """

    tilt: Float[Tensor, "*batch 2"]
    """Turn about the recording's x and y axes, in units of `TILT`."""
    lift: Float[Tensor, "*batch"]
    """Height of the recording's z = 0 above the ground at the pivot, metres."""
    pivot: Float[Tensor, "*batch 3"]
    """The fixed point of the tilt, in the recording's frame, metres."""

    @classmethod
    def create(cls, pivot: Float[Tensor, "*batch 3"]) -> "UnknownGround":
        """Initialise with the ground at z = 0 of the recording."""
        return cls(torch.zeros_like(pivot[..., :2]), torch.zeros_like(pivot[..., 0]), pivot)

    @property
    def T_world_recording(self) -> Float[Tensor, "*batch 4 4"]:
        """Transform from the recording's coordinates to the world with the ground at z = 0."""
        vector = torch.nn.functional.pad(TILT * self.tilt, (0, 1))
        turn = so3.exp(vector)
        up = torch.nn.functional.pad(self.lift[..., None], (2, 0))
        shift = self.pivot - (turn @ self.pivot[..., None])[..., 0] + up
        return so3.rigid(turn, shift)

    @property
    def plane(self) -> Ground:
        """The ground plane in the coordinates of the recording."""
        from recon.core.camera import Ground  # imported only when the ground is unknown

        T = self.T_world_recording
        return Ground(T[..., 2, :3], -T[..., 2, 3])


@dataclass(frozen=True)
class UnknownLens(TensorStruct):
    """The unknown focal length of an uncalibrated camera of unknown pose.

    A camera farther away with a longer lens shows almost the same. So the camera moves back along
    its viewing axis while its focal length grows (a dolly zoom): the person keeps the size in the
    image, and what changes is perspective alone.
    """

    zoom: Float[Tensor, "*batch"]
    """Logarithm of the focal length over the guessed one, in units of `ZOOM`."""
    distance: Float[Tensor, "*batch"]
    """Depth at which things keep their size in the image, metres, for the guessed focal length."""

    @classmethod
    def create(cls, distance: Float[Tensor, "*batch"]) -> "UnknownLens":
        """Initialise with the guessed focal length (zoom of zero)."""
        return cls(torch.zeros_like(distance), distance)

    @property
    def factor(self) -> Float[Tensor, "*batch"]:
        """Ratio of the present focal length to the guessed one."""
        return (ZOOM * self.zoom).exp()

    def applied_to(self, camera: Camera) -> Camera:
        """The camera with this focal length, moved so that the person's image keeps its size."""
        factor = self.factor[..., None]
        back = (factor - 1) * self.distance[..., None]
        longer = camera.camera_matrix[..., :2] * factor[..., None, None]
        matrix = torch.cat((longer, camera.camera_matrix[..., 2:]), -1)
        pose = camera.T_camera_world
        shift = torch.nn.functional.pad(back[..., None], (2, 0))
        place = torch.cat((pose[..., :3, 3] + shift, pose[..., 3:, 3]), -1)
        pose = torch.cat((pose[..., :3], place[..., None]), -1)
        return camera.derived(camera_matrix=matrix, T_camera_world=pose)


@dataclass(frozen=True)
class Scene(TensorStruct):
    """Unknowns of a clip that all frames share, optimised with the prior's variables."""

    offsets: Float[Tensor, "*batch offsets 3"]
    """Constant offsets of tracked points from their place on the model, metres, in the frame of
    their bone. Markers stand off the skin and joints of another skeleton lie elsewhere; an
    observation that allows for that names its rows here (MoSh's latent markers).
    """
    ground: UnknownGround | None = None
    """The ground in the recording's frame; None where the recording's z = 0 is the ground."""
    lens: UnknownLens | None = None
    """The focal length of the one camera; None where all are known."""

    @classmethod
    def create(cls, clips: int, offsets: int = 0, *, like: Tensor) -> "Scene":
        """A scene with offsets of zero and a known ground."""
        return cls(offsets=torch.zeros(clips, offsets, 3, dtype=like.dtype, device=like.device))

    def to_recording(
        self, points: Float[Tensor, "*batch time points 3"]
    ) -> Float[Tensor, "*batch time points 3"]:
        """Transform points from the world to the coordinates of the recording, metres."""
        if self.ground is None:
            return points
        T = self.ground.T_world_recording[..., None, :, :]
        return (points - T[..., None, :3, 3]) @ T[..., :3, :3]

    def to_recording_directions(
        self, directions: Float[Tensor, "*batch time points 3"]
    ) -> Float[Tensor, "*batch time points 3"]:
        """Rotate directions (normals) from the world to the coordinates of the recording."""
        if self.ground is None:
            return directions
        return directions @ self.ground.T_world_recording[..., None, :3, :3]

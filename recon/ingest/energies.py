"""Energies of the conversion: bones turn as recorded, standing feet lie flat."""

from dataclasses import dataclass

from jaxtyping import Bool, Float, Int
from torch import Tensor

from recon.core.struct import TensorStruct
from recon.method.protocols import REFERENCE_FPS, Estimate


@dataclass(frozen=True)
class BoneOrientations(TensorStruct):
    """How far the bones are turned away from recorded orientations."""

    orientations: Float[Tensor, "*batch time bones 3 3"]
    """Rotation of each bone from its rest pose to the world."""
    bones: tuple[int, ...]
    """The joints whose bones they are."""

    def __call__(self, estimate: Estimate) -> Float[Tensor, "*batch"]:
        """Σ (1 - cos angle) over bones and existing frames, at 30 Hz: ½ angle² for small ones.

        It shows what joint positions leave open: turns about a bone, the head, hands and toes.
        """
        motion = estimate.motion
        ours = estimate.body.orientations[..., list(self.bones), :, :]
        angles = (3.0 - (ours * self.orientations).sum((-1, -2))) / 2
        total = angles.sum(-1).where(motion.valid, 0.0).sum(-1)
        return total * (REFERENCE_FPS / motion.fps)


@dataclass(frozen=True)
class FlatSoles(TensorStruct):
    """Half the squared height of the heel above the ball of every standing foot; metres²."""

    standing: Bool[Tensor, "*batch time 2"]
    """Frames in which the left and the right foot stand flat."""
    heels: Int[Tensor, "2 points"]
    """Vertices under the left and the right heel."""
    balls: Int[Tensor, "2 points"]
    """Vertices under the balls of the feet."""

    def __getitem__(self, index: Tensor) -> "FlatSoles":
        """Some clips of the batch; the vertices are common to all."""
        return self.replace(standing=self.standing[index])

    def __call__(self, estimate: Estimate) -> Float[Tensor, "*batch"]:
        """½ Σ (z_heel - z_ball)² over standing feet, at 30 Hz."""
        motion, body = estimate.motion, estimate.body
        shape = self.heels.shape
        heels = body.points(self.heels.flatten())[..., 2].unflatten(-1, shape).mean(-1)
        balls = body.points(self.balls.flatten())[..., 2].unflatten(-1, shape).mean(-1)
        tilt = (heels - balls).square().where(self.standing & motion.valid[..., None], 0.0)
        return 0.5 * tilt.sum((-1, -2)) * (REFERENCE_FPS / motion.fps)

"""Training the pose density: gather poses, fit one Gaussian, measure it on held-out people.

The fit has a closed form, so there is nothing to resume: a run takes seconds, writes its file in
one step at the end, and gives the same file for the same corpus and settings.
"""

import math
from dataclasses import dataclass
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor

from priors.pose.prior import COORDINATES, ROTATIONS, PoseDensity
from recon.body.model import BodyModel, forward_kinematics
from recon.core import rotations as so3
from training.recordings import poses_of
from training.run import LOG
from training.settings import CorpusSettings, settings_to_store
from training.weights import save_checkpoint


@dataclass(frozen=True)
class PoseTraining(CorpusSettings):
    """Settings of a run that fits the pose density."""

    floor: float = 0.05
    """Standard deviation added to every direction of pose space, radians."""
    rate: float = 10.0
    """Poses per second taken from each clip; neighbours in time teach nothing new."""
    most: int = 500
    """Poses of one subject at most."""


def export_weights(settings: PoseTraining, path: Path) -> None:
    """Fit the density and write it.

    Raises:
        FileNotFoundError: when there is no corpus, splits file or folder for the output.
        ValueError: when no clip of the corpus may be learned from.
    """
    learned, held_out = settings.load_clips("train"), settings.load_clips("validation")
    if len(learned) == 0:
        raise ValueError(f"{settings.corpus}: holds no clip to learn from")

    rotations = poses_of(learned, settings.rate, settings.most)[:, 1:]
    density = fit_density(rotations, settings.floor, BodyModel.load())
    LOG.info("trained on %d poses: %.2f nats per pose", len(rotations), score(density, rotations))
    if len(held_out) > 0:
        unseen = poses_of(held_out, settings.rate, settings.most)[:, 1:]
        LOG.info("%d poses of held-out people: %.2f nats", len(unseen), score(density, unseen))

    tensors = {name: tensor.float() for name, tensor in density.tensors().items()}
    subjects = sorted({clip.subject for clip in learned})
    about = settings_to_store(settings) | {"poses": len(rotations), "subjects": subjects}
    save_checkpoint(path, "pose", tensors, about)


def score(density: PoseDensity, rotations: Float[Tensor, "poses 21 3 3"]) -> float:
    """Mean log-density of poses in nats, over tangent vectors in radians."""
    coordinates = density.coordinates(rotations.to(density.basis))
    normaliser = density.basis.slogdet().logabsdet + COORDINATES / 2 * math.log(2 * math.pi)
    return (-0.5 * coordinates.square().sum(-1).mean() - normaliser).item()


def frechet_mean(
    rotations: Float[Tensor, "poses 21 3 3"], rounds: int = 10
) -> Float[Tensor, "21 3 3"]:
    """The rotation of each joint about which the tangent vectors of all poses average to zero."""
    mean = so3.nearest_rotation(rotations.mean(0))
    for _ in range(rounds):
        mean = mean @ so3.exp(so3.log(mean.mT @ rotations).mean(0))
    return mean


def fit_density(
    rotations: Float[Tensor, "poses 21 3 3"], floor: float, body: BodyModel
) -> PoseDensity:
    """Fit the Gaussian pose density to the given poses, all with equal weights.

    Args:
        rotations: of the 21 body joints, each relative to its parent.
        floor: standard deviation in radians added to every direction; without it, directions in
            which the recorded skeletons cannot move would be forbidden to everybody.
        body: whose joints the stiffness is of.
    """
    rotations = rotations.double()
    mean = frechet_mean(rotations)
    steps = so3.log(mean.mT @ rotations).flatten(-2)
    covariance = steps.mT @ steps / len(steps)
    covariance = covariance + floor**2 * torch.eye(COORDINATES, dtype=covariance.dtype)
    variances, directions = torch.linalg.eigh(covariance)
    basis = directions * variances.sqrt()
    return PoseDensity(mean, basis, _stiffness_of_joints(mean, basis, body))


def _stiffness_of_joints(
    mean: Float[Tensor, "21 3 3"], basis: Float[Tensor, "63 63"], body: BodyModel
) -> Float[Tensor, "66 66"]:
    rest = body.joint_template.to(mean)

    def joints(x: Tensor) -> Tensor:
        root = so3.exp(x[:3])[None]
        pose = mean @ so3.exp((basis @ x[3:]).unflatten(0, (ROTATIONS, 3)))
        return forward_kinematics(torch.cat((root, pose))[None], rest)[1].flatten()

    jacobian = torch.autograd.functional.jacobian(joints, basis.new_zeros(3 + COORDINATES))
    assert isinstance(jacobian, Tensor)
    return jacobian.mT @ jacobian

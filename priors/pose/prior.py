"""The pose prior and the method of HuMoR's stages 1 and 2 built on it."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn.functional import avg_pool1d

from priors.checkpoints import named_checkpoint
from recon.body.derivatives import inverse_right_jacobian, right_jacobian
from recon.body.model import BodyModel
from recon.core import rotations as so3
from recon.core.motion import Motion, carried_translation
from recon.core.skeleton import JOINTS
from recon.core.struct import TensorStruct
from recon.method.free import FreeMotion
from recon.method.marquardt import marquardt
from recon.method.priors import MODEL_NOISE, SHAPE_WEIGHT, SMOOTHNESS, USUAL_NOISE, Density, Prior
from recon.method.protocols import REFERENCE_FPS, Decoded
from recon.method.quadratic import ClipModel
from recon.method.stages import Stage
from recon.method.terms import (
    PriorEnergy,
    Term,
    joint_acceleration,
    joint_velocity,
    prior_energy,
    shape,
)
from recon.solver.lbfgs import LBFGS

ROTATIONS = 21
"""Body joints: all but the root."""

COORDINATES = 3 * ROTATIONS


@dataclass(frozen=True)
class PoseDensity(TensorStruct):
    """Gaussian density of poses: joint rotations R_j = M_j Exp(v_j), v = B z and z ~ N(0, I).

    Tangent vectors about the mean rotation of every joint stay far from half a turn, unlike those
    about the rest pose. The whole covariance B Bᵀ is kept, so joints that move together hold each
    other in place where the data sees only some of them. Every pose has coordinates, and exact
    ones: nothing is lost in a code narrower than the data.
    """

    mean: Float[Tensor, "21 3 3"]
    """M: the Fréchet mean of each joint's rotation."""
    basis: Float[Tensor, "63 63"]
    """B: eigenvectors of the covariance, each as long as its standard deviation in radians."""
    stiffness: Float[Tensor, "66 66"]
    """Σ (∂p/∂x)ᵀ (∂p/∂x) over the 22 joints p of the mean pose, metres², where x is the turn of
    the root (radians) and z. Scales the variables of a fit; no energy depends on it."""

    def coordinates(self, rotations: Float[Tensor, "*shape 21 3 3"]) -> Float[Tensor, "*shape 63"]:
        """The coordinates z of a pose: |z|² is its squared Mahalanobis distance from the mean."""
        steps = so3.log(self.mean.mT @ rotations).flatten(-2)
        return steps @ torch.linalg.inv(self.basis).mT

    def rotations(self, coordinates: Float[Tensor, "*shape 63"]) -> Float[Tensor, "*shape 21 3 3"]:
        """Return the joint rotations of pose coordinates z; the inverse of `coordinates`."""
        steps = (coordinates @ self.basis.mT).unflatten(-1, (ROTATIONS, 3))
        return self.mean @ so3.exp(steps)

    def turns(self, coordinates: Float[Tensor, "time 63"]) -> Float[Tensor, "time 63 63"]:
        """Derivatives of the joints' rotation steps R Exp(w) by pose coordinates z, radians."""
        steps = (coordinates @ self.basis.mT).unflatten(-1, (ROTATIONS, 3))
        return (right_jacobian(steps) @ self.basis.unflatten(0, (ROTATIONS, 3))).flatten(1, 2)

    def jacobian_by_rotations(
        self, rotations: Float[Tensor, "*shape 21 3 3"]
    ) -> Float[Tensor, "*shape 63 63"]:
        """Derivatives of pose coordinates z by steps R_j Exp(w_j) of the joints, per radian."""
        steps = so3.log(self.mean.mT @ rotations)
        slopes = inverse_right_jacobian(steps)
        inverse = torch.linalg.inv(self.basis).unflatten(-1, (ROTATIONS, 3))
        return torch.einsum("zja,...jab->...zjb", inverse, slopes).flatten(-2)


_SHAPES = {
    "mean": (ROTATIONS, 3, 3),
    "basis": (COORDINATES, COORDINATES),
    "stiffness": (3 + COORDINATES, 3 + COORDINATES),
}

_SOFTEST = 0.02
"""Stiffness below which directions of pose space are not scaled up further, metres². Where neither
data nor prior hold a direction, a unit of its variable would be many standard deviations, and the
first steps of a fit would twist the body into knots."""


_COMMON = 0.1
"""Rarity of poses at which half of the weights is a density: its share is 1 / (1 + rarity /
`_COMMON`). Rarity is the mean square of the 63 coordinates of the poses of a second: 0.2 in fits
of walks, 1 of cartwheels. Chosen on validation and training people so that about 90 % of each
person's errors of hidden joints lie within 1.645 standard deviations."""
_AROUND_S = 1.0
"""Seconds over which rarity is averaged."""


@dataclass(frozen=True)
class PoseWeights:
    """Weights by which the prior's energies are multiplied, for observations of weight one.

    An observation counts ½ |error|² in metres²; so for errors of standard deviation s per
    coordinate, a weight is s² times the one that a negative log-probability would have.
    """

    pose: float
    """Weight of |z|², the squared Mahalanobis distance of every pose, summed over frames."""
    shape: float
    """Weight of |betas|² times the number of frames."""
    velocity: float = 0.0
    """Weight of ½ |step|² of the 22 joints from frame to frame, metres²."""
    acceleration: float = 0.0
    """Weight of ½ |second difference|² of the 22 joints, metres². Unlike `velocity`, it does not
    slow the motion down."""

    def __post_init__(self) -> None:
        """Refuse negative weights."""
        for name in ("pose", "shape", "velocity", "acceleration"):
            if not getattr(self, name) >= 0:
                raise ValueError(f"weight {name} must be at least 0, got {getattr(self, name)}")

    @classmethod
    def for_noise(cls, noise: float) -> "PoseWeights":
        """Weights for observations of a standard deviation of `noise` metres per coordinate.

        Both tuned presets lie on this curve: pose and acceleration weights grow with the square
        of the noise, the shape's matters little. Even perfect points need the 8 mm by which a
        body differs from its model.
        """
        variance = max(noise, MODEL_NOISE) ** 2
        return cls(0.125 * variance, SHAPE_WEIGHT, acceleration=SMOOTHNESS * variance)


@dataclass(frozen=True)
class PoseVariables(TensorStruct):
    """Variables of a motion: changes of a start motion as coefficients of cosines in time.

    Every step is a sum of cosines over the clip, slow ones first, each divided by the square root
    of how strongly the smoothness term holds it; and the directions of pose space are turned and
    divided by how far they move the joints. In these variables all directions are about
    equally stiff, which is what a first-order minimiser needs: it takes tens of iterations where
    it takes many hundreds in joint angles frame by frame.
    """

    translation: Float[Tensor, "*batch time 3"]
    root: Float[Tensor, "*batch time 3"]
    pose: Float[Tensor, "*batch time 63"]
    shape: Float[Tensor, "*batch shape"]
    start_translation: Float[Tensor, "*batch time 3"]
    """Metres."""
    start_root: Float[Tensor, "*batch time 3 3"]
    start_pose: Float[Tensor, "*batch time 63"]
    """Coordinates z of `PoseDensity`."""
    synthesis: Float[Tensor, "*batch time time"]
    """Column k: the k-th scaled cosine at every frame."""
    valid: Bool[Tensor, "*batch time"]
    fps: float
    start_time: float

    def carried(self, T: Float[Tensor, "*batch 4 4"], body: BodyModel) -> "PoseVariables":
        """Return the variables of the motion after the rigid transform `T` of the world."""
        turn, pelvis = T[..., None, :3, :3], body.rest_joints(self.shape)[..., 0, :]
        return self.replace(
            translation=self.translation @ T[..., :3, :3].mT,
            start_translation=carried_translation(self.start_translation, T, pelvis),
            start_root=turn @ self.start_root,
        )


@dataclass(frozen=True)
class PosePrior(TensorStruct, Prior[PoseVariables]):
    """Prior with a Gaussian density of single poses and smoothness (HuMoR's stages 1 and 2).

    It is an exact change of variables: every motion has variables, `decode(encode(m))` is m.
    """

    knows_gravity: ClassVar[bool] = False
    reach: ClassVar[int] = 2
    density: PoseDensity
    weights: PoseWeights | None = None
    """Weights of its energies; None takes those for the noise of the data."""

    @classmethod
    def load(
        cls,
        path: str | Path | None = None,
        body: BodyModel | None = None,
        *,
        weights: PoseWeights | None = None,
    ) -> "PosePrior":
        """Load the bundled density, or one made by `python -m training pose`.

        Args:
            path: `open` or None for the bundled density, or a file.
            body: whose poses they are: any body's.
            weights: of its energies; None takes those for the noise of the data.

        Raises:
            FileNotFoundError: when there is no such file.
            ValueError: when it holds no pose density; the message names the layer.
        """
        del body
        tensors = named_checkpoint("open" if path is None else path, "pose").require(_SHAPES)
        return cls(PoseDensity(**tensors), weights)

    @property
    def effective_weights(self) -> PoseWeights:
        """The weights of the energies: as given to the constructor, or those for 4 cm of noise."""
        return PoseWeights.for_noise(USUAL_NOISE) if self.weights is None else self.weights

    def belief(self, noise: float) -> Density:
        """Return a Gaussian density that approximates this prior, for data of a given noise.

        An objective of weights w beside ½ |residual|² is noise² times a -log p, were frames
        independent; they repeat each other, so only a share of it is believed, 1 / (1 + rarity /
        `_COMMON`): the less, the rarer poses are.
        """
        w, precision = self.effective_weights, noise**-2
        scale = (2 * w.pose * precision) ** 0.5

        def by_rotations(motion: Motion) -> Float[Tensor, "*batch time 63 63"]:
            like = motion.translation
            density = self.density.to(dtype=like.dtype, device=like.device)
            return density.jacobian_by_rotations(motion.rotations[..., 1:, :, :]) * scale

        def share(motion: Motion) -> Float[Tensor, "*batch time"]:
            like = motion.translation
            density = self.density.to(dtype=like.dtype, device=like.device)
            rarity = density.coordinates(motion.rotations[..., 1:, :, :]).square().mean(-1)
            reach = round(0.5 * _AROUND_S * motion.fps)
            around = avg_pool1d(rarity, 2 * reach + 1, 1, reach, count_include_pad=False)
            return 1 / (1 + around / _COMMON)

        return Density(by_rotations, w.acceleration * precision, 2 * w.shape * precision, share)

    def encode(self, motion: Motion) -> PoseVariables:
        """Return variables with the motion as start and zero steps; they decode to it exactly."""
        density = self.density.to(dtype=torch.float64, device=motion.translation.device)
        start = density.coordinates(motion.rotations[..., 1:, :, :].double())
        zero = torch.zeros_like(motion.translation)
        return PoseVariables(
            translation=zero,
            root=zero,
            pose=torch.zeros_like(start).to(zero),
            shape=motion.shape,
            start_translation=motion.translation,
            start_root=motion.rotations[..., 0, :, :],
            start_pose=start.to(zero),
            synthesis=self._cosine_basis(motion.valid, motion.fps).to(zero),
            valid=motion.valid,
            fps=motion.fps,
            start_time=motion.start_time,
        )

    def decode(self, variables: PoseVariables) -> Decoded:
        """Return the motion after the steps, and its energy `pose`: Σ |z|² at 30 frames/s."""
        x, like = variables, variables.pose
        density, scales = (
            self.density.to(dtype=like.dtype, device=like.device),
            self._scales.to(dtype=like.dtype, device=like.device),
        )
        coordinates = x.start_pose + x.synthesis @ x.pose @ scales.pose
        root = x.start_root @ so3.exp(x.synthesis @ x.root @ scales.root)
        distance = coordinates.square().sum(-1).where(x.valid, 0.0).sum(-1)
        motion = Motion(
            translation=x.start_translation + x.synthesis @ x.translation * scales.translation,
            rotations=torch.cat((root[..., None, :, :], density.rotations(coordinates)), -3),
            shape=x.shape,
            valid=x.valid,
            fps=x.fps,
            start_time=x.start_time,
        )
        return Decoded(motion, {"pose": distance * (REFERENCE_FPS / x.fps)})

    def from_steps(
        self, variables: PoseVariables, steps: Float[Tensor, "*batch time 69"]
    ) -> PoseVariables:
        """Return variables after adding, per frame, steps of translation, root R Exp(w) and z."""
        x, scales = variables, self._scales.to(dtype=steps.dtype, device=steps.device)
        place, turn, pose = steps.split((3, 3, COORDINATES), -1)
        # columns of the synthesis are orthogonal, so its inverse is the scaled transpose
        inverse = (x.synthesis / x.synthesis.square().sum(-2, keepdim=True)).mT
        return x.derived(
            translation=x.translation + inverse @ place / scales.translation,
            root=x.root + inverse @ turn @ scales.root_inverse,
            pose=x.pose + inverse @ pose @ scales.pose_inverse,
        )

    def turns(self, variables: PoseVariables, clip: int) -> Float[Tensor, "time 63 63"]:
        """Derivatives of the joints' rotations R Exp(w) by z, where steps are zero."""
        start = variables.start_pose[clip]
        return self.density.to(dtype=start.dtype, device=start.device).turns(start)

    def add_curvature(self, term: Term, clip: ClipModel) -> bool:
        """Add the Hessian of the energy "pose", which is quadratic in z."""
        if term.energy != PriorEnergy("pose"):
            return False
        motion = clip.motion
        exists = motion.valid.to(motion.translation) * (REFERENCE_FPS / motion.fps)
        diagonal = clip.part.inner[:, 0].diagonal(dim1=-2, dim2=-1)
        diagonal[:, 6:] += 2 * term.weight * exists[:, None]
        return True

    def stages(
        self,
        data: tuple[Term, ...],
        noise: float = USUAL_NOISE,
        body: BodyModel | None = None,
        method: str | None = None,
    ) -> tuple[Stage[Any], ...]:
        """Two stages: root from the data alone; then all variables, with the prior's energies."""
        del method
        fitting = self if self.weights else self.replace(weights=PoseWeights.for_noise(noise))
        fitting = fitting if body is None else fitting.to(device=body.template.device)
        w = fitting.effective_weights
        smooth = (
            Term("velocity", joint_velocity, w.velocity),
            Term("acceleration", joint_acceleration, w.acceleration),
        )
        prior = (Term("pose", prior_energy("pose"), w.pose), Term("shape", shape, w.shape))
        return (
            Stage(
                name="root",
                prior=FreeMotion(),
                terms=data,
                free=frozenset({"translation", "root"}),
                minimiser=LBFGS(max_iterations=30, tolerance_decrease=1e-4),
            ),
            Stage(
                name="pose",
                prior=fitting,
                terms=(*data, *prior, *(term for term in smooth if term.weight > 0)),
                free=frozenset({"translation", "root", "pose", "shape"}),
                minimiser=LBFGS(max_iterations=120, tolerance_decrease=1e-5),
                second_order=marquardt,
            ),
        )

    @cached_property
    def _scales(self) -> "_VariableScales":
        """Scales of the variables: inverse square roots of the curvature of data plus prior."""
        stiffness = self.density.stiffness.double()
        pose = stiffness[3:, 3:] + max(2 * self.effective_weights.pose, _SOFTEST) * torch.eye(
            COORDINATES, dtype=torch.float64, device=stiffness.device
        )
        turn, bend = _inverse_root(stiffness[:3, :3]), _inverse_root(pose)
        return _VariableScales(
            translation=stiffness.new_tensor(len(JOINTS) ** -0.5),
            root=turn,
            pose=bend,
            root_inverse=torch.linalg.inv(turn),
            pose_inverse=torch.linalg.inv(bend),
        )

    def _cosine_basis(
        self, valid: Bool[Tensor, "*batch time"], fps: float
    ) -> Float[Tensor, "*batch time time"]:
        """Orthonormal cosines (DCT-II) over valid frames, divided by the roots of their stiffness.

        A step that varies as cos(w t) has second differences b = 2 - 2 cos w as large, so beside
        data of stiffness one, smoothness adds velocity b + acceleration b².
        Frames that do not exist keep variables of their own, so that padding changes nothing.
        """
        frames = valid.shape[-1]
        count = valid.sum(-1)[..., None, None].double()
        index = torch.arange(frames, dtype=torch.float64, device=valid.device)
        t, k = index[:, None], index
        inside = (t < count) & (k < count)
        amplitude = torch.where(k == 0, 1.0, 2.0).sqrt() / count.clamp(min=1).sqrt()
        cosine = amplitude * (torch.pi * (t + 0.5) * k / count.clamp(min=1)).cos()
        rate = fps / REFERENCE_FPS
        bend = (2 - 2 * (torch.pi * k / count.clamp(min=1)).cos()) * rate**2
        w = self.effective_weights
        stiffness = 1 + w.velocity * bend + w.acceleration * bend.square()
        return torch.where(inside, cosine / stiffness.sqrt(), (t == k).double())


@dataclass(frozen=True)
class _VariableScales(TensorStruct):
    """Metres, radians or coordinates z that one unit of each fit variable stands for."""

    translation: Float[Tensor, ""]
    root: Float[Tensor, "3 3"]
    pose: Float[Tensor, "63 63"]
    root_inverse: Float[Tensor, "3 3"]
    pose_inverse: Float[Tensor, "63 63"]


def _inverse_root(matrix: Float[Tensor, "n n"]) -> Float[Tensor, "n n"]:
    values, vectors = torch.linalg.eigh(matrix)
    return (vectors * values.rsqrt()) @ vectors.mT

"""Fits the HUMOS prior to all frames of a motion at once (collocation), as `Humos` asks.

The motion itself is moved, in the well-scaled variables of the pose prior, and judged by the
networks: how surprising are its codes, and how far from it do they decode. Both together bound
-log p(motion), as in training. Moving codes instead converges slowly.
"""

from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from priors.humos.frames import BodyFrames
from priors.humos.prior import FPS, Humos, count_at_network_rate
from priors.pose.prior import PosePrior, PoseVariables, PoseWeights
from recon.body.model import BodyModel
from recon.core.motion import Motion
from recon.method.priors import MODEL_NOISE, USUAL_NOISE, Prior
from recon.method.protocols import Decoded
from recon.method.stages import Stage
from recon.method.terms import Term, joint_acceleration, prior_energy, shape
from recon.physics import energies as physics
from recon.solver.lbfgs import LBFGS

_ERROR = 0.02
"""Metres by which codes miss a number of a frame."""
_LEAST_NOISE = 0.014
"""Metres; nobody moves just like the people of the corpus, however exact points are."""
_DEPTH, _STEP = 0.002, 0.003
"""Metres by which bodies sink, and soles slide in 1/30 s."""
_FREE = frozenset({"translation", "root", "pose", "shape"})


@dataclass(frozen=True, eq=False)
class CollocatedHumos(Prior[PoseVariables]):
    """The HUMOS density of a whole motion, over the variables of the pose prior."""

    humos: Humos
    poses: PosePrior = field(default_factory=PosePrior.load)

    def encode(self, motion: Motion) -> PoseVariables:
        """Encode a motion exactly in the variables of the pose prior."""
        return self.poses.encode(motion)

    def decode(self, variables: PoseVariables) -> Decoded:
        """Return the variables' motion and its energies under pose prior and HUMOS networks.

        `energies` in nats: those of the pose prior, "codes" -log p of the mean codes, "error"
        ½ Σ |x - D(E(x))|² / (2 cm)² over the numbers of all frames at 20 Hz.
        """
        decoded, humos = self.poses.decode(variables), self.humos
        motion = decoded.motion
        rows = BodyFrames.of(motion, humos.body)[0].pack()
        between = _linear_resampling(motion.frames, motion.fps).to(rows)
        coarse = between @ rows
        exists = humos.exists(motion.valid, motion.fps)
        networks, density = humos.weights.networks, humos.weights.density
        codes, _ = networks.posterior(coarse, motion.shape, exists)
        back = networks.decode(codes, motion.shape, exists, coarse.shape[-2])
        known = between @ motion.valid.to(rows)[..., None] > 0.5
        error = ((back - coarse) / _ERROR).square().where(known, 0.0)
        energies = {
            "codes": density.energy(density.whitened(codes), exists),
            "error": 0.5 * error.sum((-1, -2)),
        }
        return Decoded(motion, {**decoded.energies, **energies})

    def stages(
        self,
        data: tuple[Term, ...],
        noise: float = USUAL_NOISE,
        body: BodyModel | None = None,
        method: str | None = None,
    ) -> tuple[Stage[Any], ...]:
        """Stages: root; smooth poses; the networks' density too; feet kept on the ground as well.

        Weights were chosen on eight validation windows among thirteen settings; a calibrated
        bound would have noise² for all. Errors of neighbouring frames repeat each other, so less
        is better, and codes of 0.4 s do not see trembling: smoothness keeps its weight of the
        poses.
        """
        del body, method
        pose = PoseWeights.for_noise(noise)
        prior = replace(self, poses=self.poses.replace(weights=pose))
        variance, ground = max(noise, _LEAST_NOISE) ** 2, max(noise, MODEL_NOISE) ** 2
        whole = (
            *data,
            Term("pose", prior_energy("pose"), pose.pose),
            Term("shape", shape, pose.shape),
            Term("acceleration", joint_acceleration, pose.acceleration),
            Term("codes", prior_energy("codes"), 0.3 * variance),
            Term("error", prior_energy("error"), 0.1 * variance),
        )
        held = (
            Term("penetration", physics.penetration, ground / _DEPTH**2),
            Term("slide", physics.slide, ground / _STEP**2),
        )
        minimiser = LBFGS(max_iterations=60, tolerance_decrease=1e-5)
        return (
            *prior.poses.stages(data),
            Stage("whole", prior, whole, _FREE, minimiser),
            Stage("ground", prior, (*whole, *held), _FREE, minimiser),
        )


@lru_cache(maxsize=16)
def _linear_resampling(frames: int, fps: float) -> Float[Tensor, "coarse frames"]:
    """Matrix that linearly resamples rows at `fps` to 20 Hz and repeats the last row beyond it."""
    coarse = count_at_network_rate(frames, fps)
    place = (torch.arange(coarse) * (fps / FPS)).clamp(max=frames - 1)
    before = place.floor().long().clamp(max=max(frames - 2, 0))
    share = place - before
    rows, count = torch.zeros(coarse, frames), torch.arange(coarse)
    rows[count, before] = 1 - share
    rows[count, (before + 1).clamp(max=frames - 1)] += share
    return rows

"""Completes gait cycles found in a first fit one by one, and combines them."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import torch

from observations.joints3d import Joints3D
from observations.noise import weights_of
from recon.body.cycles import Cycle
from recon.body.model import BodyModel
from recon.core.motion import Motion
from recon.core.residuals import Noise
from recon.core.scene import Scene
from recon.core.skeleton import JOINTS
from recon.fitting.stages import with_shape_held
from recon.method.cycle_prior import CyclePrior
from recon.method.protocols import Decoded, Estimate
from recon.method.reconstruction import data_terms
from recon.method.running import run_stages
from recon.method.sensor import Sensor

CYCLE_DEVIATION = 0.03
"""Standard deviation (m) of joints of a completed cycle where nothing was seen. Of 3 and 8 cm it
was the better on one validation walk; it was not tuned any further."""
_MAX_GAP_S = 0.1
"""Time (s) between cycles up to which they belong to one stretch of gait."""
_MIN_WEIGHT = 0.1
"""Summed weight of cycles in a frame below which they are not used, near an end of gait."""
_NOISE_ENERGY = 0.5
"""Expected contribution of a coordinate to ½ Σ residual² / noise² if only noise is left."""


@dataclass(frozen=True)
class CompletedCycle:
    """A gait cycle completed by its prior from the data."""

    cycle: Cycle
    motion: Motion
    """Motion from the cycle's start to its end, without a batch axis."""
    energy: float
    """Energy of the data under the completed cycle: ½ Σ residual² / noise²."""
    first_energy: float
    """Energy of the data under the first fit."""
    noise: float
    """Energy that noise alone would leave."""

    @property
    def explains_data(self) -> bool:
        """Whether the cycle explains the data as well as the first fit, within the noise."""
        return self.energy <= self.first_energy + self.noise


def stretches_of_cycles(cycles: Sequence[Cycle]) -> tuple[tuple[Cycle, ...], ...]:
    """Group cycles into stretches, in which each follows or overlaps the one before."""
    found: list[list[Cycle]] = []
    for cycle in sorted(cycles, key=lambda cycle: cycle.start):
        if found and cycle.start <= max(one.stop for one in found[-1]) + _MAX_GAP_S:
            found[-1].append(cycle)
        else:
            found.append([cycle])
    return tuple(tuple(one) for one in found)


@dataclass(frozen=True)
class CycleData:
    """The prior and the observations from which gait cycles are completed."""

    prior: CyclePrior[Any]
    observations: Sequence[Sensor]
    noises: Sequence[Noise]
    body: BodyModel

    def completed_cycle(self, motion: Motion, cycle: Cycle) -> CompletedCycle | None:
        """Fit one cycle, starting from the first fit and keeping its shape; None without data.

        Args:
            motion: the first fit, without a batch axis.
            cycle: gait cycle in the first fit.
        """
        parts = [one.window(cycle.start, cycle.stop) for one in self.observations]
        shown = [k for k, part in enumerate(parts) if bool(part.shown.any())]
        if not shown:
            return None
        # times count from the beginning of the cycle
        seen = [
            parts[k].derived(start_time=round(parts[k].start_time - cycle.start, 6)) for k in shown
        ]
        weights = weights_of(self.noises)
        data = data_terms(seen, [weights[k] for k in shown])
        noise = min(one.metres for one in self.noises)
        frames = max(round(cycle.duration * motion.fps), 2) + 1
        part = cycle.of(motion, frames).replace(start_time=0.0).map(lambda tensor: tensor[None])
        scene = Scene.create(1, like=motion.translation)
        last = self.prior.coded(data, noise)[-1:]
        estimate, _ = run_stages(with_shape_held(last), self.body, part, scene)
        first = Estimate(Decoded(part), self.body.pose(part), scene)
        energies = [
            sum(float(term.weight * term.energy(one)) for term in data) / noise**2
            for one in (estimate, first)
        ]
        made = estimate.motion[0].detach().replace(start_time=cycle.start)
        return CompletedCycle(cycle, made, *energies, noise=self._half_coordinate_count(parts))

    def _half_coordinate_count(self, parts: Sequence[Sensor]) -> float:
        """Return half the number of independent measured coordinates in a cycle."""
        total = 0.0
        for part, noise in zip(parts, self.noises, strict=True):
            coordinates = 1 if not part.point_names(self.body) else part.values.shape[-1]
            share = (noise.metres / noise.own) ** 2 * 30.0 / part.fps
            total += _NOISE_ENERGY * coordinates * share * int(part.shown.sum())
        return total


def joints_of_cycles(
    cycles: Sequence[CompletedCycle], motion: Motion, body: BodyModel
) -> Joints3D:
    """Return joints of completed cycles, as further observations of the first fit's frames.

    Every cycle is weighted by sin² of its phase, so that overlapping cycles fade into each other,
    and the ends of a stretch of gait fade out: standard deviations grow there.

    Args:
        cycles: completed cycles that explain their data.
        motion: the first fit, without a batch axis.
        body: body model of the motion.
    """
    share = torch.zeros(motion.frames)
    total = torch.zeros(motion.frames, len(JOINTS), 3)
    for one in cycles:
        phase = (motion.times - one.cycle.start) / one.cycle.duration
        inside = (phase > 0) & (phase < 1) & (motion.times <= one.motion.times[-1])
        weight = torch.sin(torch.pi * phase[inside]).square().float()
        share[inside] += weight
        joints = body.pose(one.motion.at(motion.times[inside], motion.fps)).joints
        total[inside] += weight[:, None, None] * joints
    told = share > _MIN_WEIGHT
    joints = torch.where(told[:, None, None], total / share.clamp(min=1e-6)[:, None, None], 0.0)
    deviation = CYCLE_DEVIATION / share.clamp(min=_MIN_WEIGHT, max=1.0).sqrt()
    every = (1, motion.frames, len(JOINTS))
    return Joints3D(
        joints[None],
        told[None, :, None].expand(every),
        tuple(range(len(JOINTS))),
        motion.fps,
        motion.start_time,
        std=deviation[None, :, None].expand(every),
    )

"""Contracts that every energy and every prior keeps."""

from typing import Any

import torch
from torch import Tensor

from recon.body.model import BodyModel
from recon.core import rotations as so3
from recon.core.motion import Motion
from recon.core.scene import Scene
from recon.core.struct import TensorStruct
from recon.method.free import FreeMotion
from recon.method.priors import Prior
from recon.method.protocols import Decoded as Decoded
from recon.method.protocols import Energy, Estimate
from recon.method.running import Hypotheses, run_hypotheses
from recon.method.stages import Stage, Watch
from recon.method.unknowns import Unknowns
from recon.solver.lbfgs import Solution


def minimised(
    stage: Stage[Any], body: BodyModel, variables: Any, scene: Scene, watch: Watch | None = None
) -> tuple[Any, Scene, Solution]:
    """Variables and scene that one stage finds, and how it ends."""
    began = Hypotheses(stage.prior, Unknowns(variables, scene))
    found, (report,) = run_hypotheses((stage,), body, began, watch)
    return found.unknowns.variables, found.unknowns.scene, report.solution


def a_motion(body: BodyModel, clips=2, frames=6, fps=30.0, seed=0) -> Motion:
    """Upright bodies that sway and walk."""
    g = torch.Generator().manual_seed(seed)

    def rand(*shape):
        return torch.randn(*shape, generator=g, dtype=torch.float64)

    start, drift = rand(clips, 1, 22, 3), rand(clips, 1, 22, 3)
    time = torch.arange(frames, dtype=torch.float64)[:, None, None] / fps
    steps = 0.2 * start + 0.5 * drift * time
    rotations = so3.exp(steps)
    upright = so3.exp(torch.tensor([torch.pi / 2, 0.0, 0.0], dtype=torch.float64))
    rotations[..., 0, :, :] = rotations[..., 0, :, :] @ upright
    height = torch.tensor([0.0, 0.0, 1.2], dtype=torch.float64)
    translation = height + rand(clips, 1, 3) * 0.3 + 0.5 * rand(clips, 1, 3) * time[:, 0]
    return Motion.create(translation, rotations, 0.5 * rand(clips, body.shape_size), fps)


def estimate_of(body: BodyModel, motion: Motion, scene: Scene | None = None) -> Estimate:
    decoded = FreeMotion().decode(FreeMotion().encode(motion))
    if scene is None:
        scene = Scene.create(len(motion.translation), like=motion.translation)
    return Estimate(decoded, body.pose(motion), scene)


def check_energy(energy: Energy, body: BodyModel, motion: Motion, zero_at: Motion | None) -> None:
    """Batch-shaped, non-negative, finite with its gradient, pure, the same for a clip alone."""
    scene = Scene.create(len(motion.translation), like=motion.translation)
    before = {k: t.clone() for k, t in motion.tensors().items()}
    leaf = motion.translation.clone().requires_grad_()
    turns = torch.zeros_like(motion.rotations[..., 0]).requires_grad_()
    moved = motion.replace(translation=leaf, rotations=motion.rotations @ so3.exp(turns))
    value = energy(estimate_of(body, moved, scene))
    assert value.shape == (len(motion.translation),)
    assert (value >= 0).all()
    if value.requires_grad:
        for gradient in torch.autograd.grad(value.sum(), (leaf, turns), allow_unused=True):
            assert gradient is None or gradient.isfinite().all()
    assert all(torch.equal(before[k], t) for k, t in motion.tensors().items())
    for clip in range(len(motion.translation)):
        row = torch.tensor([clip])
        alone = energy[row] if isinstance(energy, TensorStruct) else energy
        single = alone(estimate_of(body, motion[row], scene[row]))
        assert torch.allclose(single, value[row], rtol=1e-10)
    if zero_at is not None:
        assert torch.allclose(energy(estimate_of(body, zero_at)), value.new_zeros(()), atol=1e-18)


def check_prior(prior: Prior, motion: Motion, tolerance: float) -> None:
    """Round trip within a tolerance (radians, metres); finite energies; a batch is its clips."""
    variables = prior.encode(motion)
    decoded = prior.decode(variables)
    angle = so3.geodesic_angle(decoded.motion.rotations, motion.rotations)
    assert float(angle.mean()) < tolerance
    assert float((decoded.motion.translation - motion.translation).abs().max()) < 1e-6 + tolerance
    assert all(energy.isfinite().all() for energy in decoded.energies.values())
    row = torch.tensor([1])
    alone = prior.decode(variables[row]).motion
    assert torch.allclose(alone.rotations, decoded.motion.rotations[row], atol=1e-6)


def check_heading_invariance(prior: Prior, motion: Motion, angle: float, shift: Tensor) -> None:
    """Turning and moving the world about the vertical changes no energy."""
    turn = so3.about_z(torch.tensor(angle, dtype=motion.translation.dtype))
    roots = turn @ motion.rotations[..., :1, :, :]
    elsewhere = motion.replace(
        translation=motion.translation @ turn.T + shift,
        rotations=torch.cat((roots, motion.rotations[..., 1:, :, :]), -3),
    )
    here, there = prior.decode(prior.encode(motion)), prior.decode(prior.encode(elsewhere))
    for name, energy in here.energies.items():
        assert torch.allclose(energy, there.energies[name], rtol=1e-5)

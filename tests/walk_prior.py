"""An anchor-frame prior that knows one walk and little else, for tests that take no time."""

from functools import cache
from importlib import resources
from pathlib import Path

import torch

from priors.anchor.frames import Anchors, rest_pelvis
from priors.anchor.networks import AnchorNetworks, AnchorWeights
from recon.body.cycles import Cycle, find_cycles
from recon.body.model import BodyModel
from recon.core import rotations as so3
from recon.core.motion import Motion
from recon.formats.motions import load_motion
from training.anchor.train import fitted_basis, fitted_spread
from training.weights import save_anchor

LATENT = 8


@cache
def walk() -> tuple[Motion, Cycle]:
    """The bundled walk, and its most gait-like cycle."""
    with resources.as_file(resources.files("recon") / "assets" / "demo.npz") as path:
        motion = load_motion(path).motion
    return motion, min(find_cycles(motion), key=lambda cycle: cycle.cost)


def one_cycle(fps: float = 30.0) -> Motion:
    """That cycle from zero seconds on."""
    motion, cycle = walk()
    count = int(cycle.duration * fps) + 1
    times = cycle.start + torch.arange(count, dtype=torch.float64) / fps
    return motion.at(times, fps).replace(start_time=0.0)


def tiny_weights(path: Path, *, cycles: int = 40) -> Path:
    """Write weights of a prior of that walk: faster, slower, stiffer and more lively."""
    body, random = BodyModel.load(), torch.Generator().manual_seed(0)
    motion, cycle = walk()
    clip = cycle.of(motion, 100)
    walked = Anchors.of(clip)
    vectors = so3.log(walked.rotations)
    rows: list[torch.Tensor] = []
    for lively, faster in (0.1 * torch.randn(cycles, 2, generator=random)).tolist():
        anchors = walked.replace(
            rotations=so3.exp(torch.cat((vectors[:, :1], (1 + lively) * vectors[:, 1:]), 1)),
            times=walked.times * (1 + faster),
        )
        rows.append(anchors.aligned(rest_pelvis(body, clip.shape))[0].pack())
    basis = fitted_basis(torch.stack(rows), 2 * LATENT)
    networks = AnchorNetworks(basis, LATENT, body.shape_size, 16).eval()
    with torch.no_grad():
        means, log_variances = networks.posterior(torch.stack(rows))
    spread = fitted_spread(means, log_variances.exp(), typical=2)
    save_anchor(path, AnchorWeights(networks, spread), {})
    return path

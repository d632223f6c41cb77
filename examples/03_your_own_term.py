"""A term of your own: an energy is a function of the estimate; a method is a list of stages.

    python examples/03_your_own_term.py

Here: keep the head level, beside the data and the pose prior.
"""

import dataclasses
from importlib import resources

import torch
from jaxtyping import Float
from torch import Tensor

import recon
from priors import PosePrior
from recon.core.skeleton import joint_index
from recon.method.protocols import Estimate
from recon.method.terms import Term
from recon.simulation.points import Corruption, joints3d

HEAD = joint_index("head")


def level_head(estimate: Estimate) -> Float[Tensor, "*batch"]:
    """Σ (1 - cos tilt) of the head's own up axis against the world's."""
    up = estimate.body.orientations[..., HEAD, 2, 1]
    return (1 - up).where(estimate.motion.valid, 0.0).sum(-1)


class LevelHead:
    """The pose prior's own stages with one more term in the last."""

    def __init__(self, prior: PosePrior, weight: float) -> None:
        self.prior, self.weight = prior, weight

    def stages(self, data: tuple[Term, ...]) -> tuple[recon.Stage, ...]:
        *first, last = self.prior.stages(data)
        terms = (*last.terms, Term("level head", level_head, self.weight))
        return (*first, dataclasses.replace(last, terms=terms))


def main() -> None:
    torch.set_num_threads(1)
    body = recon.BodyModel.load()
    with resources.as_file(resources.files("recon") / "assets" / "demo.npz") as path:
        truth = recon.load_motion(path).motion
    seen = joints3d(truth, body, Corruption(noise=0.04), seed=0)[None]
    for weight in (0.0, 10.0):
        result = recon.solve([seen], LevelHead(PosePrior.load(), weight), body)
        print(f"weight {weight}: tilt {float(level_head(result.estimate)):.3f}")


if __name__ == "__main__":
    main()

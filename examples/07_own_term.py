"""An energy of your own: a function of the estimate, beside the data and the prior.

    python examples/07_own_term.py

Here: keep the head level. A term is a name, a function and a weight. The function returns one
number per clip; its weight says how much that counts against ½ |residual|² in metres².
"""

from importlib import resources

from jaxtyping import Float
from torch import Tensor

import recon
from recon.core.skeleton import joint_index
from recon.method import Estimate, Term
from recon.simulation.points import Corruption, joints3d

HEAD = joint_index("head")


def level_head(estimate: Estimate) -> Float[Tensor, "*batch"]:
    """Σ (1 - cos tilt) of the head's own up axis against the world's."""
    up = estimate.body.orientations[..., HEAD, 2, 1]
    return (1 - up).where(estimate.motion.valid, 0.0).sum(-1)


def main() -> None:
    body = recon.BodyModel.load()
    with resources.as_file(resources.files("recon") / "assets" / "demo.npz") as path:
        truth = recon.load_motion(path).motion.window(0, 30)
    seen = joints3d(truth, body, Corruption(noise=0.04), seed=0)
    for weight in (0.0, 10.0):
        result = recon.fit(seen, prior="pose", terms=[Term("level head", level_head, weight)])
        estimate = Estimate.of_clip(result.motion, body)
        print(f"weight {weight}: tilt {float(level_head(estimate)):.3f}")


if __name__ == "__main__":
    main()

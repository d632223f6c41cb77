"""Noisy 3D joints to motion: simulate a sensor, fit, compare, save, look.

    python examples/01_joints3d.py

Uses the bundled clip; put your own arrays in `Joints3D(positions, visible, joints, fps)`.
"""

from importlib import resources
from pathlib import Path

import torch

import recon
from priors import PosePrior
from recon.simulation.points import Corruption, joints3d
from recon.view import Figure, Show
from recon.view.html import write_html


def main() -> None:
    torch.set_num_threads(1)
    body = recon.BodyModel.load()
    with resources.as_file(resources.files("recon") / "assets" / "demo.npz") as path:
        truth = recon.load_motion(path).motion

    seen = joints3d(truth, body, Corruption(noise=0.04, missing_points=0.2), seed=0)
    result = recon.solve([seen[None]], prior=PosePrior.load(), body=body)

    print(result)
    metrics = recon.evaluate(result.clip(0), truth, body)
    print(f"mean joint error: {100 * metrics['joints_all']:.2f} cm")

    out = Path("out")
    out.mkdir(exist_ok=True)
    recon.save_motion(out / "motion.npz", result.clip(0))
    write_html(out / "motion.html", Show("noisy joints", (Figure(body, result.clip(0)),)))


if __name__ == "__main__":
    main()

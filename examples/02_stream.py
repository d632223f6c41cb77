"""A capture pipeline: arrays in chunk by chunk, arrays out, each fit warm from the last.

    python examples/02_stream.py

Every chunk is one second. Its first guess is the end of the previous chunk held still, so the
minimiser starts from the right place and body instead of the rest pose.
"""

from collections.abc import Iterator
from importlib import resources

import numpy as np
import torch

import recon
from observations import Joints3D
from priors import PosePrior
from recon.core.motion import Motion

FPS, CHUNK = 30.0, 30


def sensor() -> Iterator[np.ndarray]:
    """Stands for your capture system: (frames, 22, 3) metres, z up, NaN where nothing was seen."""
    body = recon.BodyModel.load()
    with resources.as_file(resources.files("recon") / "assets" / "demo.npz") as path:
        truth = recon.load_motion(path).motion.resample(FPS)
    random = np.random.default_rng(0)
    joints = body.pose(truth).joints.numpy()
    joints = joints + random.normal(0, 0.02, joints.shape)
    joints[random.random(joints.shape[:2]) < 0.2] = np.nan
    for first in range(0, len(joints) - CHUNK + 1, CHUNK):
        yield joints[first : first + CHUNK]


def hold(motion: Motion, frames: int) -> Motion:
    """The last frame, held."""
    last = motion.window(motion.frames - 1, motion.frames)
    return Motion.create(
        last.translation.expand(-1, frames, -1),
        last.rotations.expand(-1, frames, -1, -1, -1),
        last.shape,
        FPS,
    )


def main() -> None:
    torch.set_num_threads(1)
    prior, last = PosePrior.load(), None
    for number, chunk in enumerate(sensor()):
        visible = np.isfinite(chunk).all(-1)
        observation = Joints3D(chunk[None], visible[None], tuple(range(22)), FPS)
        start = None if last is None else hold(last, len(chunk))
        result = recon.solve([observation], prior, start=start)
        last = result.motion.detach()
        joints = result.body.joints[0].detach().numpy()  # (frames, 22, 3), complete
        steps = int(result.reports[-1].solution.iterations[0])
        print(f"chunk {number}: {steps} iterations, pelvis at {joints[-1, 0].round(2)}")


if __name__ == "__main__":
    main()

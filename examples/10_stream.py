"""A capture pipeline: arrays in second by second, arrays out, each fit warm from the last.

    python examples/10_stream.py

The first guess of a chunk is the end of the chunk before, held still, so that the fit starts from
the right place and body. A recording that is there already needs none of this: `recon.fit` takes
any length, and cuts what is longer than ten seconds into windows that overlap.
"""

from collections.abc import Iterator
from importlib import resources

import numpy as np

import recon

FPS, CHUNK = 30.0, 30


def sensor() -> Iterator[np.ndarray]:
    """Stands for your capture system: (frames, 22, 3) metres, z up, NaN where nothing was seen."""
    with resources.as_file(resources.files("recon") / "assets" / "demo.npz") as path:
        truth = recon.load_motion(path).motion.window(0, 3 * CHUNK)
    random = np.random.default_rng(0)
    joints = recon.BodyModel.load().pose(truth).joints.numpy()
    joints = joints + random.normal(0, 0.02, joints.shape)
    joints[random.random(joints.shape[:2]) < 0.2] = np.nan
    for first in range(0, len(joints) - CHUNK + 1, CHUNK):
        yield joints[first : first + CHUNK]


def held(motion: recon.Motion, frames: int, start_time: float) -> recon.Motion:
    """The last frame of a motion (no clip axis) for a number of frames."""
    last = motion.window(motion.frames - 1, motion.frames)
    return recon.Motion.create(
        last.translation.expand(frames, -1),
        last.rotations.expand(frames, -1, -1, -1),
        last.shape,
        FPS,
        start_time,
    )


def main() -> None:
    last = None
    for number, chunk in enumerate(sensor()):
        time = number * CHUNK / FPS
        seen = recon.Joints3D(chunk, np.isfinite(chunk).all(-1), range(22), FPS, time)
        start = None if last is None else held(last, len(chunk), time)
        # the body is known after the first chunk
        result = recon.fit(seen, prior="pose", start=start, shape=last)
        last = result.motion
        joints = result.joints.numpy()  # (frames, 22, 3), complete
        steps = int(result.reconstruction.reports[-1].solution.iterations[0])
        print(f"second {number}: {steps} iterations, pelvis at {joints[-1, 0].round(2)}")


if __name__ == "__main__":
    main()

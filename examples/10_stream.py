"""A person while being recorded: one moment in, the body half a second before out.

    python examples/10_stream.py

A file is played in real time here; a capture system would call `push` in the same way. Every
estimate is final: it never changes, and there is no seam between one and the next.
"""

import time
from collections.abc import Iterator
from importlib import resources

import numpy as np

import recon

FPS, MOMENTS = 30.0, 90


def sensor() -> Iterator[tuple[float, np.ndarray]]:
    """Stands for your capture system: seconds, and (22, 3) metres, NaN where nothing was seen."""
    with resources.as_file(resources.files("recon") / "assets" / "demo.npz") as path:
        truth = recon.load_motion(path).motion.window(0, MOMENTS)
    random = np.random.default_rng(0)
    joints = recon.BodyModel.load().pose(truth).joints.numpy()
    joints = joints + random.normal(0, 0.02, joints.shape)
    joints[random.random(joints.shape[:2]) < 0.2] = np.nan
    began = time.perf_counter()
    for number, moment in enumerate(joints):
        time.sleep(max(0.0, began + number / FPS - time.perf_counter()))
        yield number / FPS, moment


def main() -> None:
    nothing = np.zeros((1, 22, 3))
    template = recon.Joints3D(nothing, np.zeros((1, 22), dtype=bool), range(22), FPS)
    stream = recon.Stream(lag=15, template=template)
    worked: list[float] = []
    for seconds, moment in sensor():
        began = time.process_time()
        estimate = stream.push(moment, seconds)
        worked.append(time.process_time() - began)
        if estimate is not None and round(estimate.time * FPS) % 15 == 0:
            pelvis = estimate.joints[0].numpy().round(2)
            print(f"at {seconds:.2f} s: at {estimate.time:.2f} s the pelvis was at {pelvis}")
    rest = stream.finish()
    print(f"{len(rest)} moments more; {1000 * np.median(worked):.0f} ms of work per moment")


if __name__ == "__main__":
    main()

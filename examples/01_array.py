"""Noisy 3D joints to motion: an array of positions in, a motion file out.

    python examples/01_array.py

Positions are metres with z up; NaN marks what was not seen. The result is complete, smooth and on
the ground, and says for every joint whether it was seen or inferred.
"""

from importlib import resources

import numpy as np

import recon


def sensor() -> np.ndarray:
    """Stands for your sensor: a walk, (frames, 22, 3), 4 cm of noise, a fifth missing."""
    with resources.as_file(resources.files("recon") / "assets" / "demo.npz") as path:
        truth = recon.load_motion(path).motion.window(0, 30)
    random = np.random.default_rng(0)
    joints = recon.BodyModel.load().pose(truth).joints.numpy()
    joints = joints + random.normal(0, 0.04, joints.shape)
    joints[random.random(joints.shape[:2]) < 0.2] = np.nan
    return joints


def main() -> None:
    positions = sensor()
    visible = np.isfinite(positions).all(-1)
    seen = recon.Joints3D(positions, visible, range(22), fps=30.0)

    result = recon.fit(seen)

    print(result)
    print("joints", tuple(result.joints.shape), "inferred", int((~result.observed).sum()))
    result.save("motion.npz", overwrite=True)


if __name__ == "__main__":
    main()

"""Points of a depth sensor, alone and together with 2D keypoints of the same camera.

    python examples/04_depth.py

Points have no names: each is compared with the nearest place of the body's surface. Depth tells
how far away the body is, keypoints tell which limb is which. Together they are better than either
alone.
"""

from pathlib import Path

import recon

WALK = Path(recon.__file__).parent / "assets" / "demo.npz"


def main() -> None:
    truth = recon.load_motion(WALK).motion.window(0, 20)

    # stands for your sensor: recon.read opens its clouds, depth images and detections
    (cloud,) = recon.simulate(truth, "depth", points=512)
    (view,) = recon.simulate(truth, "keypoints2d", noise=2.0)

    for name, seen in (("depth", [cloud]), ("keypoints", [view]), ("both", [cloud, view])):
        result = recon.fit(seen, prior="pose")
        error = recon.evaluate(result, truth)["joints_all"]
        print(f"{name}: {100 * error:.1f} cm in the world")


if __name__ == "__main__":
    main()

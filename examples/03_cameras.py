"""2D keypoints of several calibrated cameras, and how far three views improve on one.

    python examples/03_cameras.py

Every view is an observation; observations of one clip add up. The poses of the cameras are known
here, so the world is that of the calibration.
"""

from pathlib import Path

import recon

WALK = Path(recon.__file__).parent / "assets" / "demo.npz"


def main() -> None:
    truth = recon.load_motion(WALK).motion.window(0, 30)

    # stands for your detector and your calibration: recon.read opens their files
    views = list(recon.simulate(truth, "keypoints2d", views=3, noise=3.0))

    for count in (1, 3):
        result = recon.fit(views[:count])
        error = recon.evaluate(result, truth)["joints_all"]
        print(f"{count} view(s): {100 * error:.1f} cm in the world")
    print(result)


if __name__ == "__main__":
    main()

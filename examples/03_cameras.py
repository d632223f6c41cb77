"""2D keypoints of several calibrated cameras, and how far three views improve on one.

    python examples/03_cameras.py

Every view is an observation; observations of one clip add up. The poses of the cameras are known
here, so the world is that of the calibration.
"""

from importlib import resources

import recon
from recon.core.camera import full_hd_camera
from recon.reading.images import keypoints_of
from recon.simulation.images import dome, keypoints2d
from recon.simulation.points import Corruption


def main() -> None:
    body = recon.BodyModel.load()
    with resources.as_file(resources.files("recon") / "assets" / "demo.npz") as path:
        truth = recon.load_motion(path).motion.window(0, 30)

    # stands for your detector and your calibration: a KeypointsFile per view
    cameras = dome(truth, body, full_hd_camera(), 3)
    files = [
        keypoints2d(truth, body, camera, Corruption(noise=3.0), seed)
        for seed, camera in enumerate(cameras)
    ]

    views = [keypoints_of(file, body) for file in files]
    for count in (1, 3):
        result = recon.fit(views[:count])
        error = (result.joints - body.pose(truth).joints).norm(dim=-1).mean()
        print(f"{count} view(s): {100 * float(error):.1f} cm in the world")
    print(result)


if __name__ == "__main__":
    main()

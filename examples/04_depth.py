"""Points of a depth sensor, alone and together with 2D keypoints of the same camera.

    python examples/04_depth.py

Points have no names: each is compared with the nearest place of the body's surface. Depth tells
how far away the body is, keypoints tell which limb is which. Together they are better than either
alone.
"""

from importlib import resources

import recon
from recon.core.camera import depth_camera
from recon.reading.clouds import cloud_of
from recon.reading.images import keypoints_of
from recon.simulation.depth import depth_points
from recon.simulation.images import dome, keypoints2d
from recon.simulation.points import Corruption


def main() -> None:
    body = recon.BodyModel.load()
    with resources.as_file(resources.files("recon") / "assets" / "demo.npz") as path:
        truth = recon.load_motion(path).motion.window(0, 20)

    # stands for your sensor: points and keypoints in the files that recon reads
    (camera,) = dome(truth, body, depth_camera(), 1)
    points = depth_points(truth, body, camera, Corruption(), seed=0, points=512)
    pixels = keypoints2d(truth, body, camera, Corruption(noise=2.0), seed=0)

    cloud, view = cloud_of(points, body).cloud, keypoints_of(pixels, body)
    for name, seen in (("depth", [cloud]), ("keypoints", [view]), ("both", [cloud, view])):
        result = recon.fit(seen, prior="pose")
        error = (result.joints - body.pose(truth).joints).norm(dim=-1).mean()
        print(f"{name}: {100 * float(error):.1f} cm in the world")


if __name__ == "__main__":
    main()

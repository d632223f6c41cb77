"""2D keypoints of one camera that does not know where it stands.

    python examples/02_one_camera.py

Needed are the keypoints of a detector, their layout and the lens. The fit finds the ground, and
the pose of the camera above it, from the way people stand.
"""

from importlib import resources

import numpy as np

import recon
from recon.core.camera import full_hd_camera
from recon.formats.observations import CameraArrays, KeypointsFile
from recon.reading.images import keypoints_of
from recon.simulation.images import dome, keypoints2d
from recon.simulation.points import Corruption


def detector() -> KeypointsFile:
    """Stands for your detector: the bundled walk as a camera saw it, with errors of 3 pixels."""
    body = recon.BodyModel.load()
    with resources.as_file(resources.files("recon") / "assets" / "demo.npz") as path:
        truth = recon.load_motion(path).motion.window(0, 30)
    (camera,) = dome(truth, body, full_hd_camera(), 1)
    return keypoints2d(truth, body, camera, Corruption(noise=3.0), seed=0)


def main() -> None:
    found = detector()
    lens = np.asarray(found.camera.camera_matrix)  # (3, 3) pixels
    camera = CameraArrays(lens, (1920, 1080))  # no distortion, no pose
    file = KeypointsFile(found.pixels, found.confidence, "openpose25", 30.0, camera)

    result = recon.fit(keypoints_of(file, recon.BodyModel.load()))

    print(result)
    assert result.T_world_camera is not None
    print(f"the camera is {float(result.T_world_camera[2, 3]):.2f} m above the ground")


if __name__ == "__main__":
    main()

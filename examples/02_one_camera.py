"""2D keypoints of one camera that does not know where it stands.

    python examples/02_one_camera.py

Needed are the keypoints of a detector, their layout and the lens. The fit finds the ground, and
the pose of the camera above it, from the way people stand.
"""

from pathlib import Path

import recon

WALK = Path(recon.__file__).parent / "assets" / "demo.npz"


def main() -> None:
    # stands for your detector, with errors of 3 pixels: recon.read opens its files
    (seen,) = recon.simulate(WALK, "keypoints2d", noise=3.0, frames=(0, 30), unknown_ground=True)

    result = recon.fit(seen)

    print(result)
    assert result.T_world_camera is not None
    print(f"the camera is {float(result.T_world_camera[2, 3]):.2f} m above the ground")


if __name__ == "__main__":
    main()

"""A painted walker in small films, with the true places of the joints in the images."""

import functools

import av
import numpy as np

from recon.core.skeleton import JOINTS
from recon.view.painter import paint
from recon.view.scene import Figure, Show
from recon.view.viewpoint import following_viewpoints
from tests.filmed import bundled, walk

SIZE, FRAMES, RATE = (320, 360), 12, 30
LANDMARKS = {
    "left_shoulder": 11, "right_shoulder": 12, "left_elbow": 13, "right_elbow": 14,
    "left_wrist": 15, "right_wrist": 16, "left_hip": 23, "right_hip": 24, "left_knee": 25,
    "right_knee": 26, "left_ankle": 27, "right_ankle": 28,
}  # fmt: skip
"""Landmarks that lie in joints of the body."""


@functools.cache
def walker() -> tuple[np.ndarray, np.ndarray]:
    """Images (frames, height, width, 3), and pixels (frames, 12, 2) of joints as `LANDMARKS`."""
    show = Show("walk", (Figure(bundled(), walk(FRAMES)),))
    views = following_viewpoints(show.figures, SIZE)
    joints = show.figures[0].posed.joints.numpy()
    names = list(JOINTS)
    columns = [names.index(name) for name in LANDMARKS]
    images = [paint(show, frame, view) for frame, view in enumerate(views)]
    pixels = [
        view.project(joints[frame, columns].astype(float))[0] - 0.5
        for frame, view in enumerate(views)
    ]
    return np.stack(images), np.stack(pixels)


def write(path, images, rate=RATE):
    """Write images as a film with hardly any loss."""
    with av.open(str(path), "w") as film:
        stream = film.add_stream("libx264", rate=rate, options={"crf": "10"})
        stream.height, stream.width = images[0].shape[:2]
        stream.pix_fmt = "yuv420p"
        for image in images:
            film.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="rgb24")))
        film.mux(stream.encode(None))
    return path

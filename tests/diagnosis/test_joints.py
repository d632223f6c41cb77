"""Which joints of which frames some sensor saw."""

import torch

from recon.core.scene import Scene
from recon.diagnosis.certainty import observed_joints
from recon.method.protocols import Decoded, Estimate
from recon.simulation.points import Corruption, joints3d
from tests.filmed import bundled, walk


def test_frames_beyond_a_sensors_recording_were_not_seen_by_it():
    """The last moment of a short recording counted for all frames after it."""
    body, motion = bundled(), walk(24).map(lambda tensor: tensor[None])
    short = joints3d(walk(24).window(4, 16), body, Corruption(), 0).map(lambda t: t[None])
    short = short.replace(start_time=4 / motion.fps)
    estimate = Estimate(
        Decoded(motion), body.pose(motion), Scene.create(1, like=motion.translation)
    )
    seen = observed_joints([short], estimate)
    assert seen[4:16].all()
    assert not seen[:4].any()
    assert not seen[16:].any()
    assert torch.from_numpy(seen).shape == (24, 22)

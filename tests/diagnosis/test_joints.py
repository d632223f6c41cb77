"""Which joints of which frames some sensor saw."""

import torch

from recon.core.scene import Scene
from recon.diagnosis.certainty import observed_joints
from recon.method.protocols import Decoded, Estimate
from recon.simulation.points import Corruption, joints3d
from tests.filmed import bundled, walk


def test_a_slower_motion_sees_the_last_frames_of_the_data():
    """A film of 100 frames at 60 Hz ended with a frame that nobody saw, in the 51 of its fit."""
    body, motion = bundled(), walk(51).map(lambda tensor: tensor[None])
    fast = joints3d(walk(51).resample(60.0).window(0, 100), body, Corruption(), 0)
    estimate = Estimate(
        Decoded(motion), body.pose(motion), Scene.create(1, like=motion.translation)
    )
    assert observed_joints([fast.map(lambda t: t[None])], estimate).all()
    shorter = fast.window(0.0, 97 / 60).map(lambda t: t[None])
    assert observed_joints([shorter], estimate).all(-1).tolist() == [True] * 50 + [False]


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

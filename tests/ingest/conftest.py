"""The body, the motion and the markers that tests of recordings share."""

from importlib import resources
from pathlib import Path

import pytest
import torch

from recon.body.model import BodyModel
from recon.core.motion import Motion
from recon.formats.motions import load_motion
from recon.mocap.recording import MarkerRecording
from tests.ingest.walker import recorded


@pytest.fixture(scope="module")
def single() -> BodyModel:
    """In single precision, as conversions use it; one thread, before any slower fixture."""
    torch.set_num_threads(1)
    return BodyModel.load()


@pytest.fixture(scope="module")
def walk() -> Motion:
    """The first second of the demo's walk."""
    motion = load_motion(Path(str(resources.files("recon") / "assets" / "demo.npz"))).motion
    return motion.window(0, 30)


@pytest.fixture(scope="module")
def markers(walk: Motion, single: BodyModel) -> MarkerRecording:
    """What markers on the skin of the walker show, without noise."""
    return recorded(walk, single)

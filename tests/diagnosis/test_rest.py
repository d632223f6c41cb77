"""A camera that is declared fixed and moves: no part of any foot rests in its image."""

import math
from dataclasses import replace

import pytest
import torch

from observations.keypoints2d import Keypoints2D
from recon.api.pipeline import fit_and_check
from recon.core import rotations as so3
from recon.core.camera import Camera
from recon.diagnosis.cameras import moving_finding, slowest_foot_speeds
from recon.diagnosis.images import Images
from recon.fitting.methods import FitOptions
from recon.reading.images import keypoints_of
from recon.simulation.images import keypoints2d
from recon.simulation.points import Corruption
from tests.filmed import bundled, cameras, walk

FRAMES = 60


def turning(degrees: float, hertz: float = 0.0) -> Camera:
    """A camera that pans by so much per second, or to and fro as often."""
    fixed = cameras(walk(FRAMES), first=0.9)[0]
    seconds = torch.arange(FRAMES) / 30.0
    angle = seconds if hertz == 0 else torch.sin(math.tau * hertz * seconds)
    vectors = torch.zeros(FRAMES, 3)
    vectors[:, 1] = math.radians(degrees) * angle
    turn = so3.rigid(so3.exp(vectors), torch.zeros_like(vectors))
    return fixed.replace(T_camera_world=turn @ fixed.T_camera_world)


def seen(camera: Camera, noise: float = 3.0, layout: str = "openpose25") -> Keypoints2D:
    """The demo's walk before a camera whose pose nobody knows."""
    file = keypoints2d(walk(FRAMES), bundled(), camera, Corruption(noise=noise), 1, layout)
    lost = replace(file.camera, T_camera_world=None)
    return keypoints_of(replace(file, camera=lost), bundled())


def images(view: Keypoints2D) -> Images:
    return Images.of([view], ["phone"], bundled())


@pytest.mark.parametrize("layout", ["openpose25", "coco17"])
@pytest.mark.parametrize("noise", [0.5, 3.0, 8.0])
def test_feet_rest_before_a_fixed_camera(noise: float, layout: str) -> None:
    rest = slowest_foot_speeds(images(seen(cameras(walk(FRAMES), first=0.9)[0], noise, layout)))
    assert rest is not None
    assert not rest.camera_moves


@pytest.mark.parametrize(
    ("degrees", "hertz", "words"), [(15.0, 0.0, "panned"), (0.8, 0.8, "in the hand")]
)
def test_nothing_rests_before_a_camera_that_moves(
    degrees: float, hertz: float, words: str
) -> None:
    """Only cameras that were carried around people by 20 degrees and more were found before."""
    shown = images(seen(turning(degrees, hertz)))
    rest = slowest_foot_speeds(shown)
    assert rest is not None
    assert rest.camera_moves
    finding = moving_finding("phone", shown, rest)
    assert finding.code == "camera moves"
    assert words in finding.message
    assert "--camera-track" in finding.message


def test_feet_that_are_not_seen_tell_nothing() -> None:
    view = seen(turning(15.0))
    feet = [k for k, name in enumerate(view.points.names) if "_" in name and "hip" not in name]
    confidence = view.confidence.clone()
    confidence[..., feet] = 0
    assert slowest_foot_speeds(images(view.replace(confidence=confidence))) is None


def test_a_fit_to_a_panned_phone_is_warned_of() -> None:
    """The fit agrees with the image to the noise: a walker who walks on the spot."""
    panned = seen(turning(15.0))
    examined = fit_and_check([panned], ["phone"], FitOptions(prior="pose"), bundled())
    assert "camera moves" in [found.code for found in examined.warnings]

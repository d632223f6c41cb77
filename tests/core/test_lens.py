"""A camera that nobody calibrated: its guess, what it changes, and that a fit corrects it."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from observations.keypoints2d import Keypoints2D
from recon.api.pipeline import fit_and_check
from recon.core.camera import full_hd_camera
from recon.core.scene import ZOOM, Scene, UnknownLens
from recon.fitting.methods import FitOptions
from recon.fitting.settings import FitSettings
from recon.formats.cameras import guessed_camera, guessed_image_size
from recon.reading.clip import load_clip
from recon.reading.images import keypoints_of
from recon.simulation.images import keypoints2d
from recon.simulation.points import Corruption
from tests.filmed import NOISE, bundled, cameras, view, walk
from tests.keypoint_scene import write_openpose

DISTANCE = 4.0


def test_a_longer_lens_farther_away_keeps_what_is_at_its_distance() -> None:
    """A dolly zoom; what is nearer grows less than with the longer lens alone."""
    lens = UnknownLens(torch.tensor([math.log(1.5) / ZOOM]), torch.tensor([DISTANCE]))
    near = full_hd_camera().map(lambda t: t[None, None])
    far = lens.applied_to(near)
    assert float(far.camera_matrix[0, 0, 0, 0]) == pytest.approx(1.5 * 1500.0)
    assert float(far.camera_matrix[0, 0, 0, 2]) == pytest.approx(960.0)
    points = torch.tensor([[0.5, -0.3, DISTANCE], [0.5, -0.3, DISTANCE - 1]])[None, None]
    before, after = near.project(points), far.project(points)
    torch.testing.assert_close(after.pixels[..., 0, :], before.pixels[..., 0, :])
    torch.testing.assert_close(after.depth, before.depth + 0.5 * DISTANCE)
    centre = torch.tensor([960.0, 540.0])
    ratio = (after.pixels[0, 0, 1] - centre) / (before.pixels[0, 0, 1] - centre)
    torch.testing.assert_close(ratio, torch.full((2,), 1.5 * 3 / 5))


def test_a_known_focal_length_is_left_alone() -> None:
    seen = view(walk(16), cameras(walk(16))[0])
    lens = UnknownLens(torch.tensor([1.0]), torch.tensor([DISTANCE]))
    scene = Scene.create(1, like=lens.zoom).replace(lens=lens)
    assert seen.with_constants_of(scene) is seen
    guessed = seen.derived(focal_std=0.3)
    assert guessed.with_constants_of(scene.replace(lens=None)) is guessed
    settled = guessed.with_constants_of(scene)
    assert settled.focal_std == 0
    torch.testing.assert_close(
        settled.camera.camera_matrix, lens.applied_to(seen.camera).camera_matrix
    )


def test_the_guess_is_a_phone_of_75_degrees() -> None:
    camera = guessed_camera((1080, 1920))
    assert not camera.focal_known
    half = math.atan(math.hypot(540, 960) / camera.camera_matrix[0, 0])
    assert math.degrees(2 * half) == pytest.approx(75.4, abs=0.1)
    assert camera.camera_matrix[:2, 2].tolist() == [540.0, 960.0]


def test_the_size_of_images_is_the_smallest_usual_one() -> None:
    """One wild keypoint in some hundreds does not make the image larger."""
    places = np.full((40, 10, 2), (500.0, 1100.0))
    assert guessed_image_size(places, np.ones((40, 10))) == (720, 1280)
    places[0, 0] = 1900.0
    assert guessed_image_size(places, np.ones((40, 10))) == (720, 1280)
    assert guessed_image_size(np.full((4, 5, 2), 9000.0), np.ones((4, 5))) == (9000, 9000)


def test_keypoints_without_a_calibration_are_read(tmp_path) -> None:
    """They were refused: nobody with a phone has a calibration of it."""
    camera = cameras(walk(16))[0]
    file = keypoints2d(walk(16), bundled(), camera, Corruption(noise=NOISE), 0)
    people = np.concatenate((file.pixels, file.confidence[..., None]), -1)
    for name in ("a", "b"):
        write_openpose(tmp_path / name, [[person] for person in people])
    settings = FitSettings(frame_rate=30.0, layout="openpose25")
    clip = load_clip([tmp_path / "a"], settings, bundled())
    (seen,) = clip.observations
    assert isinstance(seen, Keypoints2D)
    assert seen.focal_std > 0
    assert not seen.ground_known
    assert any("guessed a focal length" in note for note in clip.notes)
    given = replace(settings, image_size=(3840, 2160))
    (large,) = load_clip([tmp_path / "a"], given, bundled()).observations
    assert isinstance(large, Keypoints2D)
    assert large.camera.image_size == (3840, 2160)
    with pytest.raises(ValueError, match="need calibrated cameras"):
        load_clip([tmp_path / "a", tmp_path / "b"], settings, bundled())


def test_a_fit_corrects_a_guessed_focal_length() -> None:
    """A walk past a phone whose focal length is 1500 pixels, guessed as 900."""
    motion = walk(60).resample(6.0)
    file = keypoints2d(motion, bundled(), cameras(motion, 1, 0.6)[0], Corruption(noise=1.0), 0)
    matrix = np.array([[900.0, 0, 960.0], [0, 900.0, 540.0], [0, 0, 1.0]])
    guess = replace(file.camera, camera_matrix=matrix, T_camera_world=None, focal_std=0.3)
    seen = keypoints_of(replace(file, camera=guess), bundled())
    found = fit_and_check([seen], ["phone"], FitOptions(prior="pose"), bundled())
    (said,) = [one for one in found.diagnosis if one.code == "focal"]
    assert said.value is not None
    assert 1100 < said.value < 2100
    (seen,) = found.fit.observations
    assert isinstance(seen, Keypoints2D)
    assert float(seen.camera.camera_matrix[0, 0, 0, 0]) == pytest.approx(said.value)

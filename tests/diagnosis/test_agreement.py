"""Residuals and what they say: in their own units, and warnings where input is doubtful."""

from dataclasses import replace

import torch

from observations.keypoints2d import Keypoints2D
from recon.core.motion import Motion
from recon.diagnosis.cameras import distance_warnings
from recon.diagnosis.checks import body_findings
from recon.diagnosis.findings import Finding
from recon.diagnosis.images import Images
from recon.diagnosis.odds import mirror_warnings
from recon.fitting.records import ClipFit
from recon.method.protocols import Estimate
from recon.method.reconstruction import Reconstruction
from recon.simulation.points import Corruption, joints3d
from tests.filmed import NOISE, bundled, cameras, view, walk
from tests.laws import estimate_of


def batch(motion: Motion) -> Motion:
    return motion.map(lambda t: t[None])


def lengths(seen, estimate) -> torch.Tensor:
    residuals = seen.residuals(estimate)
    return residuals.distances[residuals.seen]


def estimate(motion: Motion) -> Estimate:
    return estimate_of(bundled(), batch(motion))


def views(count: int, noise: float = NOISE) -> list[Keypoints2D]:
    return [view(walk(), c, noise, seed=k) for k, c in enumerate(cameras(walk(), count))]


def mirrored(seen: Keypoints2D) -> Keypoints2D:
    pixels = seen.pixels.clone()
    pixels[..., 0] = 1920 - pixels[..., 0]
    return seen.replace(pixels=pixels)


def as_fit(motion: Motion, ground_known: bool = True) -> ClipFit:
    """A motion as if it had been fitted."""
    return ClipFit(
        result=Reconstruction(estimate(motion), ()),
        noises=(),
        ground_known=ground_known,
        T_world_recording=torch.eye(4)[None],
        observations=(),
    )


def test_residuals_are_in_the_units_of_the_data():
    (seen,) = views(1)
    away = lengths(seen, estimate(walk()))
    assert len(away) == 24 * 25
    # the length of two errors of 3 pixels has a median of 1.18 times that
    assert abs(float(away.median()) / (1.177 * NOISE) - 1) < 0.1
    assert len(lengths(seen.replace(confidence=seen.confidence * 0), estimate(walk()))) == 0
    joints = joints3d(walk(), bundled(), Corruption(noise=0.02), 0).map(lambda t: t[None])
    away = lengths(joints, estimate(walk()))
    assert abs(float(away.median()) / (1.538 * 0.02) - 1) < 0.1  # metres


def test_only_the_moments_that_both_have_are_compared():
    (seen,) = views(1)
    assert len(lengths(seen, estimate(walk().window(4, 14)))) == 10 * 25
    elsewhen = walk().replace(start_time=50.0)
    assert len(lengths(seen, estimate(elsewhen))) == 0


def test_people_are_not_filmed_from_a_hundred_metres():
    (seen,) = views(1)
    assert distance_warnings("a", seen, estimate(walk())) == []
    eye = seen.camera.T_world_camera[0, 0, :3, 3]
    far = walk().replace(translation=eye + 30 * (walk().translation - eye))
    (warning,) = distance_warnings("a", seen, estimate(far))
    assert "m from the camera; check the focal length" in warning.message


def test_bodies_that_nobody_has_and_soles_in_the_air_are_said():
    assert body_findings(as_fit(walk())).warnings == ()
    up = walk().translation.new_tensor([0.0, 0.0, 0.4])
    floating = walk().replace(translation=walk().translation + up)
    (warning,) = body_findings(as_fit(floating)).warnings
    assert "soles stand at 0.40 m" in warning.message
    assert body_findings(as_fit(floating, ground_known=False)).warnings == ()
    shape = torch.zeros_like(walk().shape)
    shape[5] = 6.5
    odd = body_findings(as_fit(walk().replace(shape=shape), ground_known=False)).warnings
    assert "6.5 standard deviations" in odd[0].message


def test_causes_are_those_of_the_sensors_at_hand():
    """Scans were warned of focal lengths and of labels, which they have not."""
    joints = joints3d(walk(), bundled(), Corruption(), 0).map(lambda t: t[None])
    up = walk().translation.new_tensor([0.0, 0.0, 0.4])
    floating = as_fit(walk().replace(translation=walk().translation + up))
    for seen, cause in (((joints,), "--hand"), (tuple(views(1)), "focal lengths")):
        (warning,) = body_findings(replace(floating, observations=seen)).warnings
        assert cause in warning.message
        assert ("camera" in warning.message) == (seen[0].view is not None)


def test_a_child_in_metres_is_no_fault():
    """Four good recordings of children were warned of."""
    small = torch.zeros_like(walk().shape)
    small[0] = -4.0
    child = as_fit(walk().replace(shape=small), ground_known=False)
    tall = float(bundled().height(small))
    assert 0.95 < tall < 1.42
    assert body_findings(child).warnings == ()
    (said,) = body_findings(child).diagnosis
    assert f"{tall:.2f} m tall" in said.message
    assert body_findings(as_fit(walk())).diagnosis == ()


def mirror_findings(seen: list[Keypoints2D]) -> tuple[Finding, ...]:
    return mirror_warnings(Images.of(seen, [str(k) for k in range(len(seen))], bundled()))


def test_mirrored_images_are_told_by_two_views_and_more():
    for count in (2, 3, 4):
        good = views(count)
        assert mirror_findings(good) == ()
        (warning,) = mirror_findings([mirrored(seen) for seen in good])
        assert "mirror the videos back" in warning.message
    assert mirror_findings([mirrored(views(1)[0])]) == ()  # cannot be told
    assert mirror_findings(views(3, noise=0.0)) == ()


def test_noise_alone_does_not_look_mirrored():
    for noise in (10.0, 30.0):
        assert mirror_findings(views(3, noise)) == ()


def test_nobody_seen_is_no_error():
    blind = [seen.replace(confidence=seen.confidence * 0) for seen in views(3)]
    assert mirror_findings(blind) == ()

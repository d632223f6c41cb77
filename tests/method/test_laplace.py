"""Standard deviations from the curvature of the objective."""

from dataclasses import replace

import numpy as np
import pytest
import torch

import recon
from observations.joints3d import Joints3D
from priors.pose.prior import PosePrior, PoseWeights
from recon import cli
from recon.body.angles import ISB_ANGLES, isb_angles
from recon.core.camera import depth_camera
from recon.core.residuals import Noise
from recon.core.scene import UnknownGround
from recon.method import laplace as laplace
from recon.method.derivatives import GroundBelief
from recon.method.laplace import deviations
from recon.method.priors import Density
from recon.method.protocols import Estimate
from recon.reading.clouds import cloud_of
from recon.simulation.depth import depth_points
from recon.simulation.images import camera_ring
from recon.simulation.points import Corruption, joints3d
from recon.view.info import info
from tests.filmed import bundled, cameras, view, walk

FRAMES = 24


def seen(noise: float = 0.02, **hidden) -> Joints3D:
    clip = joints3d(walk(FRAMES), bundled(), Corruption(noise=noise, **hidden), 0)
    return clip.map(lambda tensor: tensor[None])


def at_truth() -> Estimate:
    return Estimate.of_clip(walk(FRAMES), bundled())


def belief(noise: float = 0.02):
    return PosePrior.load(weights=PoseWeights.for_noise(noise)).belief(noise)


def flat() -> Density:
    """A density that holds nothing but the shape, barely."""
    return Density(lambda motion: motion.translation.new_zeros(1, motion.frames, 1, 63), 0.0, 1e4)


def test_twice_the_noise_is_twice_the_deviation_where_only_data_speak():
    exact = seen(noise=0.0)  # residuals of zero are believed whatever the noise
    one, two = (
        deviations(at_truth(), [exact], [Noise(s, s)], flat()).joints for s in (0.01, 0.02)
    )
    assert torch.allclose(two, 2 * one, rtol=0.05)


def test_a_frame_of_points_without_prior_has_the_least_squares_deviation():
    """A root that 22 points see is known to noise / √22 if the body is rigid, less well if not."""
    found = deviations(at_truth(), [seen(noise=0.0)], [Noise(0.01, 0.01)], flat())
    assert (found.joints[:, 0] > 0.01 / 22**0.5).all()
    assert (found.joints[:, 0] < 0.01).all()


def test_joints_that_nobody_saw_are_less_certain():
    hidden = seen(hide_below=0.6)
    found = deviations(at_truth(), [hidden], [Noise(0.02, 0.02)], belief()).joints
    visible = hidden.visible[0]
    assert not visible.all()
    assert float(found[~visible].median()) > 3 * float(found[visible].median())


def test_joints_that_nobody_saw_are_less_certain_where_poses_are_rare():
    hidden, density = seen(hide_below=0.6), belief()
    unseen, noise = ~hidden.visible[0], [Noise(0.02, 0.02)]
    usual, rare = (
        deviations(
            at_truth(),
            [hidden],
            noise,
            replace(density, share=lambda m, k=k: k * density.share(m)),
        ).joints
        for k in (1.0, 0.25)
    )
    ratio = rare / usual
    assert float(ratio[unseen].median()) == pytest.approx(2, rel=0.2)
    assert float(ratio[~unseen].median()) < 1.4  # data hold them


def test_more_sensors_make_surer_and_cuts_change_nothing(monkeypatch):
    noise = Noise(0.02, 0.02)
    one = deviations(at_truth(), [seen()], [noise], belief()).joints
    two = deviations(at_truth(), [seen(), seen()], [noise, noise], belief()).joints
    assert (two < one).all()
    monkeypatch.setattr(laplace, "_CHUNK_FRAMES", 20)
    cut = deviations(at_truth(), [seen()], [noise], belief()).joints
    assert torch.allclose(cut, one, rtol=0.1)


def on_a_ground(noise: float, **belief: float):
    """Deviations of the walk whose recording does not know the ground, which is where it is."""
    estimate = at_truth()
    pivot = torch.zeros(1, 3).to(estimate.motion.translation)
    scene = estimate.scene.replace(ground=UnknownGround.create(pivot))
    known = GroundBelief(**{"stance": 0.03, "upright": 0.05, "coordinates": 3, **belief})
    sensors, noises = [seen(noise=0.0)], [Noise(noise, noise)]
    return deviations(replace(estimate, scene=scene), sensors, noises, flat(), known)


def test_a_ground_is_as_sure_as_feet_stand_on_it():
    """Points tell the feet to millimetres, so what remains is how far feet miss a ground."""
    level = on_a_ground(0.001, coordinates=1).ground
    assert level is not None
    assert level.normal == 0
    assert level.height == pytest.approx(0.03, rel=0.05)
    blurred = on_a_ground(0.2, coordinates=1).ground
    assert blurred is not None
    assert blurred.height > 1.1 * level.height
    found = on_a_ground(0.001).ground
    assert found is not None
    assert 0.04 < found.normal < 0.05  # radians: footprints tell a little, too
    assert found.height > level.height  # where the walk began is far from where it is
    plane = on_a_ground(0.001, shown=1e6).ground
    assert plane is not None
    assert plane.height < 2e-3  # metres: the plane was seen


def test_what_is_believed_of_the_ground_makes_no_joint_less_sure():
    """Joints are those in the recording, which shows them whatever the ground is."""
    known = deviations(at_truth(), [seen(noise=0.0)], [Noise(0.01, 0.01)], flat())
    found = on_a_ground(0.01, upright=1.0, stance=1.0)
    assert known.ground is None
    assert torch.allclose(found.joints, known.joints, rtol=0.02)
    assert torch.allclose(found.root, known.root, rtol=0.02)


def test_a_result_says_how_sure_its_ground_is(tmp_path):
    clip = seen()[0].derived(ground_known=False)
    result = recon.fit(clip, "pose")
    assert result.ground_std is not None
    assert result.ground_std.normal_degrees == 0  # z is up in the recording
    assert 0 < result.ground_std.height < 0.2
    assert result.report()["standard_deviations"]["ground"]["height"] == result.ground_std.height
    result.save(tmp_path / "out.npz")
    loaded = recon.load_motion(tmp_path / "out.npz")
    assert loaded.ground_std is not None
    assert loaded.ground_std.tolist() == pytest.approx([0.0, result.ground_std.height])
    assert info(tmp_path / "out.npz")["ground_height_std"] == pytest.approx(
        result.ground_std.height
    )
    assert recon.fit(seen()[0], "pose").ground_std is None


def test_the_root_s_rotation_as_a_measure_is_as_sure_as_the_root():
    """The covariance of a frame goes into what is measured of it, correlations and all."""

    def root(motion):
        return torch.eye(3, 66).to(motion.translation).expand(motion.frames, 3, 66)

    one = deviations(at_truth(), [seen()], [Noise(0.02, 0.02)], belief(), None, root)
    assert one.measures is not None
    assert torch.allclose(one.measures.square().mean(-1).sqrt(), one.root, rtol=1e-3)


def test_angles_are_as_sure_as_the_fit_is_of_the_pose(tmp_path):
    """Only flexions had standard deviations, of joints taken as independent of each other."""
    result = recon.fit(seen()[0], prior="pose")
    result.save(tmp_path / "out.npz")
    file = recon.load_motion(tmp_path / "out.npz")
    assert file.angle_std is not None
    assert file.angle_std.shape == (FRAMES, len(ISB_ANGLES))
    ours, true = (isb_angles(motion, bundled()) for motion in (result.motion, walk(FRAMES)))
    away = np.stack([ours[name] - true[name] for name in ISB_ANGLES], -1)
    away = np.abs((away + 180) % 360 - 180)
    within = (away < 1.645 * file.angle_std.numpy()).mean()
    assert 0.8 < within <= 1.0
    median = dict(zip(ISB_ANGLES, np.median(file.angle_std.numpy(), 0).tolist(), strict=True))
    assert 0.3 < median["knee_flexion_l"] < 6
    assert median["forearm_pronation_l"] > 2 * median["elbow_flexion_l"]
    table = tmp_path / "angles.csv"
    assert cli.run(["export", str(tmp_path / "out.npz"), "--angles", str(table)]) == cli.OK
    head, first, *_ = table.read_text().splitlines()
    row = dict(zip(head.split(","), map(float, first.split(",")), strict=True))
    known = file.angle_std[0, ISB_ANGLES.index("hip_adduction_r")]
    assert row["hip_adduction_r_std"] == pytest.approx(float(known), abs=1e-3)
    gait = recon.report(tmp_path / "out.npz").gait
    assert np.allclose(gait.angle_std["hip_adduction_r"][0], float(known))


@pytest.mark.parametrize("prior", ["pose", "humor"])
def test_a_result_knows_how_sure_it_is(prior, tmp_path):
    result = recon.fit(seen(hide_below=0.6)[0], prior=prior)
    assert result.joint_std is not None
    assert result.joint_std.shape == (FRAMES, 22)
    away = (result.joints - bundled().pose(walk(FRAMES)).joints).abs()
    error = away / result.joint_std[..., None]
    assert 0.6 < float((error < 1.645).float().mean()) <= 1.0
    result.save(tmp_path / "out.npz")
    loaded = recon.load_motion(tmp_path / "out.npz")
    assert loaded.joint_std is not None
    assert torch.allclose(loaded.joint_std, result.joint_std)
    assert result.report()["standard_deviations"]["joints"]["pelvis"] > 0
    assert loaded.contact_probability is not None
    assert ((loaded.contact_probability >= 0) & (loaded.contact_probability <= 1)).all()
    assert loaded.contacts is not None
    # the file has the motion at the rate of the observation, which the fit may not
    assert ((loaded.contact_probability > 0.5) == (loaded.contacts > 0.5)).float().mean() > 0.98


def test_depth_and_images_say_how_sure_they_are():
    """What a sensor sees of a body is surer than what the body hides from it."""
    truth = walk(FRAMES)
    (camera,) = camera_ring(truth, bundled(), depth_camera(), 1)
    file = depth_points(truth, bundled(), camera, Corruption(), seed=4, points=128)
    cloud = cloud_of(file, bundled()).cloud.coarse(bundled())
    one = deviations(at_truth(), [cloud], [Noise(0.03, 0.01)], belief(0.01)).joints
    assert ((one > 1e-3) & (one < 0.25)).all()
    image = view(truth, cameras(truth)[0], seed=3)
    along = deviations(at_truth(), [image], [Noise(3.0, 0.01)], belief(0.01)).joints
    both = deviations(
        at_truth(), [cloud, image], [Noise(0.03, 0.01), Noise(3.0, 0.01)], belief(0.01)
    ).joints
    assert (both < along).all()
    assert (both < one).all()

"""Points of a surface as an observation: golden values, laws, gradients, first guess, loading."""

import numpy as np
import pytest
import torch

from observations.depth import PointCloud
from observations.surfels import Surfels, fixed_scale_kernel, tukey
from recon.core import rotations as so3
from recon.core.camera import depth_camera
from recon.core.errors import ReconError
from recon.core.nearest import nearest
from recon.core.scene import Scene, UnknownGround
from recon.core.skeleton import joint_index
from recon.formats.observations import PointsFile
from recon.reading.clouds import cloud_of
from recon.simulation.depth import PERFECT, DepthSensor, PixelSurface, depth_points, without_pose
from recon.simulation.points import Corruption, scan_points
from tests import laws
from tests.conftest import GOLDEN

pytestmark = pytest.mark.numerics


@pytest.fixture(scope="module")
def golden():
    with np.load(GOLDEN / "losses.npz", allow_pickle=False) as file:
        return {k: torch.from_numpy(file[k]).double() for k in file.files if k != "names"}


def all_present(points):
    return torch.ones(points.shape[:-1], dtype=torch.bool)


def toy_cloud(toy_body, motion, noise=0.02, **fields):
    g = torch.Generator().manual_seed(3)
    points = toy_body.pose(motion).vertices[..., ::2, :]
    points = points + noise * torch.randn(points.shape, generator=g, dtype=points.dtype)
    surfels = Surfels.of(toy_body)
    return PointCloud(
        points, all_present(points), surfels, motion.fps, motion.start_time, **fields
    )


def still(body, motion):
    """The rest pose in the places of a motion."""
    rest = torch.eye(3).double().expand(*motion.translation.shape[:2], 21, 3, 3)
    rotations = torch.cat((motion.rotations[:, :, :1], rest), 2)
    return motion.replace(rotations=rotations, shape=motion.shape * 0)


def test_golden_gradient(golden, monkeypatch):
    """At equal scale it is that of the published energy, whose bisquare weights are constant."""
    scale = golden["points3d_scale"]
    monkeypatch.setattr("observations.surfels.lower_median", lambda *_: 0.67449 * scale)
    monkeypatch.setattr("observations.surfels.LEAST_SCALE", 0.0)
    vertices = golden["camera_verts"].clone().requires_grad_()
    points = golden["obs_points3d"]
    index = nearest(points, all_present(points), vertices, all_present(vertices))
    offset = points - vertices.gather(-2, index[..., None].expand(*index.shape, 3))
    squared = offset.square().sum(-1).flatten(1)
    torch.testing.assert_close(squared.sqrt(), golden["points3d_residual"].flatten(1))
    value = 0.5 * tukey(squared, torch.ones_like(squared, dtype=torch.bool)).sum()
    gradient = torch.autograd.grad(value, vertices)[0]
    torch.testing.assert_close(
        gradient, golden["grad_points3d_camera_verts"], rtol=1e-6, atol=1e-9
    )


@pytest.mark.parametrize("kernel", [tukey, fixed_scale_kernel])
def test_the_energy_keeps_its_contract(toy_body, kernel):
    motion = laws.a_motion(toy_body)
    cloud = toy_cloud(toy_body, motion, kernel=kernel)
    laws.check_energy(cloud, toy_body, motion, None)
    exact = toy_cloud(toy_body, motion, noise=0.0, kernel=kernel)
    laws.check_energy(exact, toy_body, motion, motion)  # no NaN at distance zero


def test_what_is_not_there_counts_nothing(toy_body):
    motion = laws.a_motion(toy_body)
    cloud = toy_cloud(toy_body, motion)
    none = cloud.replace(present=torch.zeros_like(cloud.present), points=cloud.points * 0)
    laws.check_energy(none, toy_body, motion, motion)
    partly = cloud.present.clone()
    partly[:, 2] = False
    partly[:, :, 5:] = False
    wild = torch.where(partly[..., None], cloud.points, 7.0)
    estimate = laws.estimate_of(toy_body, motion)
    kept = cloud.replace(present=partly)
    assert torch.equal(kept(estimate), kept.replace(points=wild)(estimate))
    fewer = kept.replace(points=cloud.points[:, :, :5], present=partly[:, :, :5])
    assert torch.allclose(kept(estimate), fewer(estimate), rtol=1e-12)


@pytest.mark.parametrize("kernel", [fixed_scale_kernel, tukey])
def test_the_gradient_is_that_of_the_value(body, kernel, monkeypatch):
    monkeypatch.setattr(
        "observations.surfels.lower_median", lambda e, _: e.new_full((len(e),), 0.02)
    )
    motion = laws.a_motion(body, clips=1, frames=2)
    points = body.pose(motion).vertices[:, :, ::40]
    points = points + 0.02 * torch.randn(points.shape, dtype=points.dtype)
    cloud = PointCloud(points, all_present(points), Surfels.of(body, 600), 30.0, kernel=kernel)

    def energy(step):
        turned = motion.rotations @ so3.exp(step)
        return cloud(laws.estimate_of(body, motion.replace(rotations=turned))).sum()

    zero = torch.zeros(1, 2, 22, 3).double().requires_grad_()
    gradient = torch.autograd.grad(energy(zero), zero)[0]
    way = torch.randn(zero.shape, dtype=zero.dtype)
    h = 1e-7 * way  # so small that hardly a pair changes
    numeric = (energy(h) - energy(-h)).item() / 2e-7
    assert numeric == pytest.approx((gradient * way).sum().item(), rel=1e-4)


def test_a_body_that_is_off_as_a_whole_is_still_pulled(toy_body):
    """Bisquare weights about the median cut off residuals that are all large and alike."""
    squared = (0.5 + 0.001 * torch.rand(1, 200, dtype=torch.float64)).square().requires_grad_()
    present = torch.ones(1, 200, dtype=torch.bool)
    pulls = torch.autograd.grad(tukey(squared, present).sum(), squared)[0]
    assert (pulls > 0.9).all()


def test_discs_are_the_surface_where_vertices_are_not(body):
    motion = laws.a_motion(body, clips=1, frames=1)
    corners = body.pose(motion).vertices[:, :, body.faces[::7]]
    points = corners.mean(-2)  # middles of triangles lie on the surface
    cloud = PointCloud(points, all_present(points), Surfels.of(body), 30.0)
    estimate = laws.estimate_of(body, motion)
    to_disc = cloud.residuals(estimate).distances
    vertices = estimate.body.vertices[0, 0]
    to_vertex = torch.cdist(points[0, 0], vertices).amin(-1)
    assert to_disc.median() < 0.003 < 0.006 < to_vertex.median()  # metres
    away = cloud.replace(points=points + torch.tensor([0.0, 0.0, 3.0]).double())
    assert (away.residuals(estimate).distances > 0.7).all()


def test_only_what_faces_the_sensor_is_seen(body):
    motion = still(body, laws.a_motion(body, clips=1, frames=1))
    camera = depth_camera().to(dtype=torch.float64)
    chest = motion.translation[0, 0] + torch.tensor([0.0, 0.0, 1.0]).double()
    front = camera.placed(chest + torch.tensor([3.0, 0.0, 0.0]).double(), chest)
    file = depth_points(motion[0], body, front, Corruption(), 0, sensor=PERFECT, points=500)
    cloud = cloud_of(file, body).cloud
    estimate = laws.estimate_of(body, motion)
    assert cloud.residuals(estimate).distances.median() < 0.004
    back = camera.placed(chest - torch.tensor([3.0, 0.0, 0.0]).double(), chest)
    poses = back.T_camera_world[None, None]
    assert cloud.camera is not None
    behind = cloud.replace(camera=cloud.camera.replace(T_camera_world=poses))
    assert behind.residuals(estimate).distances.median() > 0.03


def test_another_clock_and_windows(toy_body):
    motion = laws.a_motion(toy_body, frames=31)
    fine = laws.a_motion(toy_body, frames=61, fps=60.0)
    cloud = toy_cloud(toy_body, fine, kernel=fixed_scale_kernel)
    slow = cloud(laws.estimate_of(toy_body, motion))
    whole = cloud(laws.estimate_of(toy_body, fine))
    assert torch.allclose(slow, whole, rtol=0.05)
    estimate = laws.estimate_of(toy_body, fine)
    parts = [cloud.window(a, b)(estimate) for a, b in ((-1.0, 0.5), (0.51, 3.0))]
    assert torch.allclose(parts[0] + parts[1], whole, rtol=1e-9)
    elsewhere = cloud.replace(start_time=50.0)(laws.estimate_of(toy_body, motion))
    assert torch.equal(elsewhere, torch.zeros(2).double())


def test_a_tilted_ground_moves_the_body_into_the_recording(toy_body):
    motion = laws.a_motion(toy_body)
    ground = UnknownGround.create(torch.zeros(2, 3).double()).replace(lift=torch.ones(2).double())
    scene = Scene(torch.zeros(2, 0, 3).double(), ground)
    cloud = toy_cloud(toy_body, motion, noise=0.0, kernel=fixed_scale_kernel)
    lower = cloud.replace(points=cloud.points - torch.tensor([0.0, 0.0, 1.0]).double())
    assert lower(laws.estimate_of(toy_body, motion, scene)).max() < 1e-12
    assert cloud(laws.estimate_of(toy_body, motion, scene)).min() > 1e-3


def test_the_first_guess_finds_body_and_heading(body):
    motion = still(body, laws.a_motion(body, clips=1, frames=12))
    standing = so3.exp(torch.tensor([torch.pi / 2, 0.0, 0.0]).double())
    turn = so3.about_z(torch.tensor(1.3).double()) @ standing
    roots = turn.expand(1, 12, 1, 3, 3)
    motion = motion.replace(rotations=torch.cat((roots, motion.rotations[:, :, 1:]), 2))
    camera = depth_camera().to(dtype=torch.float64)
    middle = motion.translation[0, 0]
    sensor = camera.placed(middle + turn[:, 2] * 3.0, middle)
    file = depth_points(motion[0], body, sensor, Corruption(missing_frames=0.3), 1)
    start = cloud_of(file, body).cloud.start(body)
    assert start.translation.shape == (1, 12, 3)
    assert so3.geodesic_angle(start.rotations[0, 0, 0], turn) < 0.3
    error = (body.pose(start).joints[:, :, 0] - body.pose(motion).joints[:, :, 0]).norm(dim=-1)
    assert error.max() < 0.1
    scans = cloud_of(scan_points(motion[0], body, Corruption(noise=0.005), 0), body).cloud
    error = (scans.start(body).translation - motion.translation).norm(dim=-1)
    assert error[:, ::3].max() < 0.05  # moments at which places are tried
    assert error.max() < 0.15  # between them, medians of the points differ by chance


def test_the_first_guess_raises_its_arms(body):
    """From hanging arms, a fit stretched the trunk to where the points of raised arms are."""
    motion = still(body, laws.a_motion(body, clips=1, frames=6))
    rotations = motion.rotations.clone()
    for side, sign in (("left", 1.0), ("right", -1.0)):
        for joint, angle in (("shoulder", 0.6), ("elbow", 0.9)):
            turn = so3.exp(torch.tensor([0.0, 0.0, sign * angle]).double())
            rotations[:, :, joint_index(f"{side}_{joint}")] = turn
    rotations[:, :, 0] = so3.exp(torch.tensor([torch.pi / 2, 0.0, 0.0]).double())
    motion = motion.replace(rotations=rotations)
    middle = motion.translation[0, 0] + torch.tensor([0.0, 0.0, 1.0]).double()
    camera = depth_camera().to(dtype=torch.float64)
    sensor = camera.placed(middle - torch.tensor([0.0, 3.0, 0.0]).double(), middle)
    file = depth_points(motion[0], body, sensor, Corruption(), 1)
    start = cloud_of(file, body).cloud.start(body)
    wrists = [joint_index("left_wrist"), joint_index("right_wrist")]
    there, here = (body.pose(m).joints[..., wrists, :] for m in (start, motion))
    assert (there - here)[..., 2].abs().max() < 0.25  # which way it faces, a fit tells


def test_a_sensor_that_does_not_know_its_place_finds_the_ground(body):
    motion = still(body, laws.a_motion(body, clips=1, frames=2))
    lowest = body.pose(motion).vertices[..., 2].min()
    motion = motion.replace(
        translation=motion.translation - torch.tensor([0.0, 0.0, 1.0]).double() * lowest
    )
    pelvis = body.pose(motion).joints[0, 0, 0]
    camera = depth_camera().to(dtype=torch.float64)
    sensor = camera.placed(pelvis + torch.tensor([3.0, 0.0, 0.9]).double(), pelvis)
    file = depth_points(
        motion[0], body, sensor, Corruption(), 0,
        sensor=DepthSensor(farthest=6.0), points=20000,
        surfaces=(PixelSurface.BODY, PixelSurface.GROUND),
    )  # fmt: skip
    loaded = cloud_of(without_pose(file), body)
    assert loaded.ground.ground is not None
    assert not loaded.cloud.ground_known
    T = torch.from_numpy(loaded.T_recording_file) @ sensor.T_camera_world
    assert T[2, 2] > np.cos(np.radians(1.0))
    seen = loaded.cloud.points[loaded.cloud.present]
    height = T[2, :3] @ pelvis + T[2, 3]
    assert height.item() == pytest.approx(pelvis[2].item(), abs=0.02)
    assert seen[:, 2].min() > 0.03  # the ground is gone
    assert (seen - seen.median(0).values).norm(dim=-1).max() < 1.6
    bodies = without_pose(depth_points(motion[0], body, sensor, Corruption(), 0))
    assert cloud_of(bodies, body).ground.ground is None


@pytest.mark.parametrize(
    ("last", "said"),
    [(10**15, "number of frames of 1 to"), (200_000, "points fitted in the fullest")],
)
def test_frames_that_do_not_fit_into_memory_are_refused_before_any_is_taken(body, last, said):
    """A frame number of 10^15 in a simulated file, whose clock is believed, ended in numpy's
    MemoryError; every frame has as many places as the fullest, however empty it is."""
    frame = np.append(np.zeros(600, int), last)
    file = PointsFile(np.zeros((601, 3)), frame, 30.0, truth_visible=np.ones((1, 22), bool))
    with pytest.raises(ReconError, match=said):
        cloud_of(file, body)

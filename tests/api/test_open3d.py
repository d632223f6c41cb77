"""Geometries of Open3D in place of files, and results as its meshes."""

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

import recon
from recon.api.pipeline import observations_to_fit
from recon.api.results import MotionResult
from recon.core.arrays import geometries_given
from recon.core.errors import ReconError, optional_module
from recon.core.motion import Motion, MotionFile
from recon.fitting.settings import ReadOptions
from recon.formats.depth_images import back_projected
from recon.formats.observations import PointsFile
from recon.formats.scans import thinned_cloud
from recon.reading.clouds import cloud_of

LENS = SimpleNamespace(
    intrinsic_matrix=np.array([[80.0, 0, 31.5], [0, 80.0, 47.5], [0, 0, 1]]), width=64, height=96
)


def person(frame):
    g = np.random.default_rng(frame)
    return g.uniform([-0.3, -0.2, 0.0], [0.3, 0.2, 1.8], (400, 3)) + np.array([0.01 * frame, 0, 0])


def clip(given, body, **reading):
    return observations_to_fit(given, body, ReadOptions.of(reading)).clip


def ours(frames, body):
    generator = np.random.default_rng(0)
    kept = [thinned_cloud(cloud, 4096, 3.0, generator) for cloud in frames]
    frame = np.repeat(np.arange(len(kept)), [len(cloud) for cloud in kept])
    return cloud_of(PointsFile(np.concatenate(kept), frame, 30.0), body).cloud


@pytest.mark.parametrize("name", ["points", "vertices", "point", "vertex"])
def test_clouds_and_meshes_are_what_our_own_arrays_are(name, body):
    frames = [person(k) for k in range(3)]
    held = [{"positions": one} if name in ("point", "vertex") else one for one in frames]
    (seen,) = clip([SimpleNamespace(**{name: one}) for one in held], body, frame_rate=30.0
                   ).observations  # fmt: skip
    own = ours(frames, body)
    assert torch.equal(seen.points, own.points)
    assert torch.equal(seen.present, own.present)


def depth_image():
    depth = np.zeros((96, 64), np.float32)
    depth[10:90, 20:44] = 2.0 + 0.002 * np.arange(24)
    return SimpleNamespace(depth=depth)


def test_depth_images_have_their_camera(body):
    (seen,) = clip([(depth_image(), LENS)] * 2, body, frame_rate=30.0).observations
    assert seen.camera is not None
    depth = seen.camera.T_world_camera[0, 0].inverse()
    inside = seen.points[0, 0][seen.present[0, 0]] @ depth[:3, :3].T + depth[:3, 3]
    assert 1.9 < float(inside[:, 2].min()) < float(inside[:, 2].max()) < 2.1


@pytest.mark.parametrize(
    ("given", "reading", "said"),
    [
        ([SimpleNamespace(points=person(0))], {}, "give frame_rate"),
        ([SimpleNamespace(points=person(0)[:, :2])], {"frame_rate": 30.0}, "expected points"),
        ([SimpleNamespace(points=np.zeros((0, 3)))], {"frame_rate": 30.0}, "in a geometry"),
        ([SimpleNamespace(points=1e9 * person(0))], {"frame_rate": 30.0}, "geometry 0"),
        ([SimpleNamespace(points=person(0)), depth_image()], {"frame_rate": 30.0}, "or only"),
        ([depth_image()], {"frame_rate": 30.0}, "pairs"),
        ([(depth_image(), LENS)], {"frame_rate": 30.0, "up": "y"}, "axes of their camera"),
        ([(SimpleNamespace(depth=np.ones((4, 4))), LENS)], {"frame_rate": 30.0}, "rows"),
        ([SimpleNamespace(points=person(0))], {"frame_rate": 30.0, "layout": "coco17"}, "layout"),
    ],
)
def test_what_cannot_be_taken_is_said(given, reading, said, body):
    with pytest.raises(ReconError, match=said):
        clip(given, body, **reading)


def test_the_constructor_and_the_reader_take_geometries(body):
    frames = [person(0), person(1)[:300]]
    given = [SimpleNamespace(points=one) for one in frames]
    for clouds in (given, frames):
        seen = recon.PointCloud(clouds, fps=30.0)
        assert seen.present.sum(-1).tolist() == [400, 300]
        assert torch.equal(seen.points[0], torch.from_numpy(frames[0]).float())
        assert not seen.points[1, 300:].any()
    given = [SimpleNamespace(points=person(k)) for k in range(3)]
    read = recon.read(given, frame_rate=30.0, body=body)
    assert isinstance(read, recon.PointCloud)
    assert torch.equal(read.points, ours([person(k) for k in range(3)], body).points)
    with pytest.raises(ReconError, match="moment 0: expected points"):
        recon.PointCloud([person(0)[:, :2]], fps=30.0)
    with pytest.raises(ReconError, match="all clouds are empty"):
        recon.PointCloud([np.zeros((0, 3))], fps=30.0)
    with pytest.raises(ReconError, match="fps"):
        recon.PointCloud(frames)


def test_geometries_beside_observations_are_refused_with_the_way_out(body):
    own = ours([person(0)], body)
    with pytest.raises(ReconError, match="make the geometries an observation first"):
        clip([own, SimpleNamespace(points=person(0))], body)


def test_own_observations_are_no_geometries(body):
    assert geometries_given(ours([person(0)], body)) == ()
    assert geometries_given(PointsFile(person(0), np.zeros(400, int), 30.0)) == ()
    assert geometries_given([]) == ()


@dataclass(frozen=True, repr=False)
class _Still(MotionResult):
    def report(self, inputs: Any = None, settings: Any = None) -> dict[str, Any]:
        return {"inputs": inputs, "settings": settings}


def _still(body):
    rotations = torch.eye(3).expand(2, 22, 3, 3)
    zeros = torch.zeros(body.shape_directions.shape[-1])
    motion = Motion.create(torch.zeros(2, 3), rotations, zeros, 30.0).to(dtype=body.template.dtype)
    return _Still(MotionFile(motion), body, ())


def test_frames_that_are_not_there_are_refused(body):
    with pytest.raises(ReconError, match="one of the 2 frames, got 2"):
        _still(body).to_open3d(2)


def test_a_package_that_does_not_load_is_not_called_missing(tmp_path, monkeypatch):
    (tmp_path / "broken_here.py").write_text("raise ImportError('libusb-1.0.so.0')")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(ReconError, match=r"cannot be loaded \(libusb-1.0.so.0\)"):
        optional_module("broken_here", "open3d", "a mesh", "open3d")


@pytest.mark.filterwarnings("ignore")  # of what it imports
def test_with_open3d_itself(body):
    o3d = pytest.importorskip("open3d", exc_type=ImportError)
    frames = [person(k) for k in range(3)]
    vectors = [o3d.utility.Vector3dVector(one) for one in frames]
    own = ours(frames, body)
    tensors = [o3d.t.geometry.PointCloud(o3d.core.Tensor(one)) for one in frames]
    meshes = [o3d.geometry.TriangleMesh(one, o3d.utility.Vector3iVector()) for one in vectors]
    newer = [o3d.t.geometry.TriangleMesh.from_legacy(one) for one in meshes]
    for given in ([o3d.geometry.PointCloud(one) for one in vectors], tensors, meshes, newer):
        (seen,) = clip(given, body, frame_rate=30.0).observations
        assert torch.allclose(seen.points, own.points, atol=1e-5)
    depth = depth_image().depth
    color = o3d.geometry.Image(np.zeros((*depth.shape, 3), np.uint8))
    image = o3d.geometry.RGBDImage.create_from_color_and_depth(
        color, o3d.geometry.Image(depth), depth_scale=1.0
    )
    lens = o3d.camera.PinholeCameraIntrinsic(64, 96, LENS.intrinsic_matrix)
    theirs = np.asarray(o3d.geometry.PointCloud.create_from_rgbd_image(image, lens).points)
    matrix = LENS.intrinsic_matrix + np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])
    camera = recon.Camera.create(torch.from_numpy(matrix), (64, 96))
    assert np.allclose(theirs, back_projected(depth.astype(float), depth > 0, camera), atol=1e-5)
    assert clip((image, lens), body, frame_rate=30.0).observations[0].present.any()
    mesh = _still(body).to_open3d(-1)
    assert np.allclose(mesh.vertices, _still(body).vertices[-1], atol=1e-6)
    assert len(_still(body).to_open3d()) == 2

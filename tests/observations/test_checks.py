"""Observations at the door: what is converted, what is refused, and what has no influence."""

import numpy as np
import pytest
import torch

from observations.correspondences import BodyPoints
from observations.depth import PointCloud
from observations.joints3d import Joints3D
from observations.keypoints2d import Keypoints2D
from observations.markers3d import Markers3D
from observations.surfels import Surfels
from recon.body.model import BodyModel
from recon.core.camera import Camera, pose_looking_at
from recon.core.errors import ObservationError
from recon.core.motion import Motion
from recon.method.protocols import Estimate

BODY = BodyModel.load()
MATRIX = np.array([[1000.0, 0, 500], [0, 1000, 400], [0, 0, 1]])
VERTICES = (10, 200, 900, 1500, 3000)


def _motion(frames: int = 6) -> Motion:
    rotations = torch.eye(3).expand(1, frames, 22, 3, 3)
    place = torch.zeros(1, frames, 3)
    place[..., 0] = torch.linspace(0, 0.1, frames)
    return Motion.create(place, rotations, torch.zeros(1, BODY.shape_size), 30.0)


def _camera() -> Camera:
    pose = pose_looking_at(torch.tensor([0.0, -4.0, 1.0]), torch.tensor([0.0, 0.0, 0.0]))
    return Camera.create(torch.from_numpy(MATRIX).float(), (1000, 800), None, pose)


def _joints(values, seen) -> Joints3D:
    return Joints3D(values, seen, tuple(range(22)), 30.0)


def _markers(values, seen) -> Markers3D:
    return Markers3D(values, seen, VERTICES, 30.0)


def _cloud(values, seen) -> PointCloud:
    return PointCloud(values, seen, Surfels.of(BODY, 100), 30.0, camera=_camera())


def _keypoints(values, seen) -> Keypoints2D:
    points = BodyPoints.of_layout("smpl22", BODY)
    return Keypoints2D(values, seen * 0.9, points, _camera(), 30.0)


def _truth(build) -> np.ndarray:
    posed = BODY.pose(_motion())
    if build is _joints:
        return posed.joints.numpy() + 0.01
    if build is _keypoints:
        return _camera().project(posed.joints).pixels.numpy() + 2.0
    chosen = VERTICES if build is _markers else tuple(range(0, 4000, 50))
    return posed.points(torch.tensor(chosen)).numpy() + 0.01


KINDS = [_joints, _markers, _keypoints, _cloud]


def _hidden(values: np.ndarray) -> np.ndarray:
    seen = np.ones(values.shape[:-1], bool)
    seen[:, ::2, ::3] = False
    return seen


def _evaluated(observation) -> list[torch.Tensor]:
    motion = _motion()
    wider = motion.replace(translation=motion.translation.clone().requires_grad_())
    estimate = Estimate.of_clip(motion[0], BODY)
    decoded = estimate.decoded.__class__(wider)
    value = observation(Estimate(decoded, BODY.pose(wider), estimate.scene))
    (gradient,) = torch.autograd.grad(value.sum(), wider.translation)
    start = observation.start(BODY)
    return [value.detach(), gradient, *start.tensors().values()]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("garbage", [np.nan, np.inf, -np.inf, 1e30, -7.25, "random"])
def test_what_is_invisible_has_no_influence(kind, garbage):
    """NaN in an invisible place spoiled the clip, and the motion returned was not finite."""
    values = _truth(kind)
    seen = _hidden(values)
    spoilt = values.copy()
    random = np.random.default_rng(0).normal(0, 100, values[~seen].shape)
    spoilt[~seen] = random if garbage == "random" else garbage
    clean, other = kind(values, seen), kind(spoilt, seen)
    for a, b in zip(clean.tensors().values(), other.tensors().values(), strict=True):
        assert torch.equal(a, b)
    for a, b in zip(_evaluated(clean), _evaluated(other), strict=True):
        assert bool(a.isfinite().all())
        assert torch.equal(a, b)


@pytest.mark.parametrize("kind", KINDS)
def test_arrays_of_numpy_become_tensors_in_single_precision(kind):
    """Arrays failed in the middle of the fit: `to() received an invalid combination`."""
    values = _truth(kind).astype(np.float64)
    seen = _hidden(values)
    ours = kind(values, seen)
    assert {t.dtype for t in ours.tensors().values()} <= {torch.float32, torch.bool}
    tensors = kind(torch.from_numpy(values).float(), torch.from_numpy(seen))
    for a, b in zip(ours.tensors().values(), tensors.tensors().values(), strict=True):
        assert torch.equal(a, b)
    as_lists = next(iter(kind(values.tolist(), seen.astype(int)).tensors().values()))
    assert torch.equal(next(iter(ours.tensors().values())), as_lists)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_numbers_that_are_none_are_refused_where_visible(kind, bad):
    values = _truth(kind)
    seen = _hidden(values)
    values[0, 1, 2, 1] = bad
    with pytest.raises(
        ValueError, match=r"NaN or infinity in 1 places, the first at .*\[0, 1, 2\]"
    ):
        kind(values, seen)


@pytest.mark.parametrize("kind", KINDS)
def test_wrong_shapes_are_refused_by_name(kind):
    values = _truth(kind)
    seen = _hidden(values)
    with pytest.raises(
        ValueError, match=r"expected the shape \(\.\.\., moments, points, \d\), got"
    ):
        kind(values[..., :1], seen)
    with pytest.raises(ValueError, match=r"expected the shape \(1, 6, \d+\).*got \(1, 5, \d+\)"):
        kind(values, seen[:, :5])
    with pytest.raises(ValueError, match="at least one clip, moment and point"):
        kind(values[:, :0], seen[:, :0])


@pytest.mark.parametrize("kind", [_joints, _markers, _cloud])
@pytest.mark.parametrize("factor", [1000.0, 100.0, 1 / 0.0254])
def test_other_units_are_refused(kind, factor):
    """Millimetres gave a shape of 4,264 standard deviations and no word of it."""
    values = _truth(kind)
    with pytest.raises(ValueError, match=r"expected metres|expected a position"):
        kind(values * factor, _hidden(values))
    kind(values + 3000.0, _hidden(values))  # far away, but metres


@pytest.mark.parametrize("kind", [_joints, _markers, _cloud])
def test_outliers_are_no_other_unit(kind):
    values = _truth(kind)
    random = np.random.default_rng(0)
    wrong = random.random(values.shape[:-1]) < 0.4
    values[wrong] += random.normal(0, 20, values[wrong].shape)
    kind(values, np.ones(values.shape[:-1], bool))


def test_places_and_clocks_are_refused_by_name():
    values = _truth(_joints)
    seen = _hidden(values)
    with pytest.raises(
        ValueError, match=r"Joints3D\.joints: expected one entry for each of the 22"
    ):
        Joints3D(values, seen, tuple(range(21)), 30.0)
    with pytest.raises(ValueError, match=r"Joints3D\.joints: expected numbers from 0 to 21"):
        Joints3D(values, seen, tuple(range(1, 23)), 30.0)
    with pytest.raises(ValueError, match="whole numbers from 0 on"):
        Joints3D(values, seen, (*range(21), -1), 30.0)
    for fps in (0.0, -30.0, np.nan, np.inf, 1e300):
        with pytest.raises(ValueError, match="fps"):
            Joints3D(values, seen, tuple(range(22)), fps)
    with pytest.raises(ValueError, match="start_time"):
        Joints3D(values, seen, tuple(range(22)), 30.0, start_time=np.nan)
    with pytest.raises(ValueError, match=r"visible: expected true and false or 1 and 0"):
        Joints3D(values, seen * 0.5, tuple(range(22)), 30.0)


def test_keypoints_are_refused_by_name():
    values = _truth(_keypoints)
    seen = _hidden(values)
    points = BodyPoints.of_layout("smpl22", BODY)
    with pytest.raises(ValueError, match="confidence"):
        Keypoints2D(values, seen * 90.0, points, _camera(), 30.0)
    with pytest.raises(ValueError, match="confidence"):
        Keypoints2D(values, np.where(seen, 1.0, np.nan), points, _camera(), 30.0)
    with pytest.raises(ValueError, match="pixel"):
        Keypoints2D(values * 1e6, seen * 1.0, points, _camera(), 30.0)
    bent = _camera().replace(distortion=torch.tensor([0.1, 0.0, 0.0, 0.0]))
    with pytest.raises(ValueError, match="without distortion"):
        Keypoints2D(values, seen * 1.0, points, bent, 30.0)
    two = _camera().map(lambda t: t.expand(2, 1, *t.shape))
    with pytest.raises(ValueError, match=r"camera\.camera_matrix: expected leading axes"):
        Keypoints2D(values, seen * 1.0, points, two, 30.0)


def test_a_camera_without_axes_stands_still():
    lone = _keypoints(_truth(_keypoints), _hidden(_truth(_keypoints)))
    posed = lone.replace(camera=_camera().map(lambda t: t[None, None]))
    for a, b in zip(_evaluated(lone), _evaluated(posed), strict=True):
        assert torch.equal(a, b)


def test_cameras_are_checked_when_built():
    good = {"camera_matrix": MATRIX, "image_size": (1000, 800), "T_camera_world": np.eye(4)}
    camera = Camera.create(**good)
    assert camera.camera_matrix.dtype == camera.T_camera_world.dtype == torch.float32
    for wrong, said in (
        ({"camera_matrix": np.full((3, 3), np.nan)}, "focal lengths"),
        ({"camera_matrix": MATRIX[:2]}, r"\(\.\.\., 3, 3\)"),
        ({"camera_matrix": MATRIX * [[1], [1], [2]]}, "camera matrix"),
        ({"T_camera_world": np.full((4, 4), np.nan)}, "expected"),
        ({"T_camera_world": np.diag([2.0, 2, 2, 1])}, "identity"),
        ({"T_camera_world": np.diag([1.0, 1, -1, 1])}, "rigid"),
        ({"image_size": (1000, 0)}, "width, height"),
        ({"distortion": np.zeros(3)}, "coefficients"),
    ):
        with pytest.raises(ValueError, match=said):
            Camera.create(**(good | wrong))


def test_derived_records_are_not_checked_again(monkeypatch):
    observation = _keypoints(_truth(_keypoints), _hidden(_truth(_keypoints)))
    called = []
    monkeypatch.setattr(Keypoints2D, "__init__", lambda *_, **__: called.append("keypoints"))
    monkeypatch.setattr(Camera, "__post_init__", lambda _: called.append("camera"))
    _evaluated(observation[[0]].to(dtype=torch.float32).window(0.0, 0.1))
    assert called == []


def test_markers_on_vertices_that_no_body_has_are_refused():
    """A fit ended in an IndexError."""
    values, seen = np.zeros((2, 2, 3)), np.ones((2, 2), bool)
    last = len(BODY.template) - 1
    assert len(Markers3D(values, seen, (0, last), 30.0).bones(BODY)) == 2
    strange = Markers3D(values, seen, (0, last + 1), 30.0)
    shape = torch.zeros(BODY.shape_size)
    for use in (strange.bones, strange.at_rest, lambda body: strange.on_bones(body, shape)):
        with pytest.raises(ObservationError, match=f"vertices.* 0 to {last}, got {last + 1}"):
            use(BODY)
    with pytest.raises(ObservationError, match="labels: expected a label for each of the 2"):
        Markers3D(values, seen, (0, 1), 30.0, labels=("a",))

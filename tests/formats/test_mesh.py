"""glTF and PLY: what a reader makes of the file is the body that was written."""

from pathlib import Path
from typing import Any

import numpy as np
import pygltflib
import pytest
import torch

from recon.body.model import BodyModel
from recon.core import rotations as so3
from recon.core.motion import Motion
from recon.core.raster import differentiable_normals
from recon.core.skeleton import JOINTS, PARENTS
from recon.export.gltf import write_glb
from recon.export.skeleton import quaternions
from recon.formats.scans import read_ply, write_ply, write_ply_sequence


def make_motion(body: BodyModel, frames: int = 5) -> Motion:
    vectors = 0.4 * torch.randn(frames, 22, 3, dtype=torch.float64)
    shape = 0.3 * torch.randn(body.shape_size, dtype=torch.float64)
    walk = torch.randn(frames, 3, dtype=torch.float64)
    return Motion.create(walk, so3.exp(vectors), shape, 30.0, 2.5)


def array(file: pygltflib.GLTF2, number: int) -> np.ndarray:
    """An accessor's rows, as a reader of the format would take them."""
    accessor = file.accessors[number]
    view = file.bufferViews[accessor.bufferView]
    dtype = {5126: np.float32, 5125: np.uint32, 5123: np.uint16}[accessor.componentType]
    width = {"SCALAR": 1, "VEC3": 3, "VEC4": 4, "MAT4": 16}[accessor.type]
    blob = file.binary_blob()
    assert blob is not None
    assert view.byteOffset % 4 == 0
    assert view.byteOffset + view.byteLength <= file.buffers[0].byteLength
    flat = np.frombuffer(blob, dtype, accessor.count * width, view.byteOffset)
    assert flat.nbytes == view.byteLength
    if accessor.min:
        rows = flat.reshape(accessor.count, width)
        assert np.array_equal(rows.min(0), np.float32(accessor.min))
        assert np.array_equal(rows.max(0), np.float32(accessor.max))
    return flat.reshape(accessor.count, width)


def matrices(quaternion: np.ndarray) -> np.ndarray:
    from scipy.spatial.transform import Rotation

    return Rotation.from_quat(quaternion).as_matrix()


@pytest.fixture
def written(body: BodyModel, tmp_path: Path) -> tuple[pygltflib.GLTF2, Motion]:
    motion = make_motion(body)
    write_glb(tmp_path / "m.glb", motion, body)
    assert list(tmp_path.iterdir()) == [tmp_path / "m.glb"]
    file = pygltflib.GLTF2().load_binary(str(tmp_path / "m.glb"))
    assert file is not None
    return file, motion


def tracks(file: pygltflib.GLTF2) -> dict[tuple[str, str], np.ndarray]:
    animation = file.animations[0]
    found: dict[tuple[str, str], np.ndarray] = {}
    for channel in animation.channels:
        key = (file.nodes[channel.target.node].name, channel.target.path)
        found[key] = array(file, animation.samplers[channel.sampler].output)
    return found


def test_structure_follows_the_rules_of_the_format(written: Any) -> None:
    file, motion = written
    primitive = file.meshes[0].primitives[0]
    weights = array(file, primitive.attributes.WEIGHTS_0)
    joints = array(file, primitive.attributes.JOINTS_0)
    assert np.abs(weights.sum(1) - 1).max() < 1e-6
    assert (joints[weights == 0] == 0).all()
    assert joints.max() < len(JOINTS)
    normals = array(file, primitive.attributes.NORMAL)
    assert np.abs(np.linalg.norm(normals, axis=1) - 1).max() < 1e-5
    inverse = array(file, file.skins[0].inverseBindMatrices).reshape(-1, 4, 4)
    # stored by columns: the last row of the matrix is the last column here
    assert np.array_equal(inverse[:, :, 3], np.tile([0, 0, 0, 1], (22, 1)))
    assert file.scenes[0].nodes == [22, 23]
    assert file.nodes[22].skin == 0
    assert file.asset.extras == {"start_time": motion.start_time}
    clock = array(file, file.animations[0].samplers[0].input)[:, 0]
    assert np.abs(clock - np.arange(motion.frames) / 30).max() < 1e-6  # s
    for (_, path), values in tracks(file).items():
        if path == "rotation":
            assert np.abs(np.linalg.norm(values, axis=1) - 1).max() < 1e-6
            assert ((values[1:] * values[:-1]).sum(1) >= 0).all()


def test_skinning_the_file_gives_the_body_with_y_up(written: Any, body: BodyModel) -> None:
    file, motion = written
    found, primitive = tracks(file), file.meshes[0].primitives[0]
    world: list[np.ndarray] = []
    top = np.eye(4)
    top[:3, :3] = matrices(np.array(file.nodes[23].rotation))
    for joint, name in enumerate(JOINTS):
        local = np.tile(np.eye(4), (motion.frames, 1, 1))
        local[:, :3, :3] = matrices(found[name, "rotation"])
        local[:, :3, 3] = found.get((name, "translation"), file.nodes[joint].translation)
        world.append((world[PARENTS[joint]] if joint else top) @ local)
    inverse = array(file, file.skins[0].inverseBindMatrices).reshape(-1, 4, 4).swapaxes(1, 2)
    skin = np.stack(world) @ inverse[:, None]
    vertices = array(file, primitive.attributes.POSITION)
    weights = array(file, primitive.attributes.WEIGHTS_0)
    joints = array(file, primitive.attributes.JOINTS_0)
    blended = np.einsum("vk,vktab->tvab", weights, skin[joints])
    placed = np.einsum("tvab,vb->tva", blended[..., :3, :3], vertices) + blended[..., :3, 3]
    truth = body.pose(motion).vertices.numpy() @ np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0.0]])
    error = np.linalg.norm(placed - truth, axis=-1)
    assert np.median(error) < 1e-5  # m, float32 in the file
    assert error.max() < 0.02  # m, where a vertex has more than four joints


def test_quaternions_take_the_short_way_and_mean_the_same_rotation() -> None:
    angle = torch.linspace(0, 12, 60, dtype=torch.float64)[:, None, None]
    axis = torch.nn.functional.normalize(torch.randn(1, 22, 3, dtype=torch.float64), dim=-1)
    rotations = so3.exp(angle * axis)
    q = quaternions(rotations)
    assert ((q[1:] * q[:-1]).sum(-1) > 0.9).all()
    assert np.abs(matrices(q.numpy().reshape(-1, 4)).reshape(60, 22, 3, 3)
                  - rotations.numpy()).max() < 1e-7  # fmt: skip


def test_normals_point_outwards() -> None:
    corners = torch.tensor([[0, 0, 0], [1, 0, 0], [0, 1, 0], [5, 5, 5]], dtype=torch.float64)
    normals = differentiable_normals(corners, torch.tensor([[0, 1, 2]]))
    assert np.allclose(normals[:3].numpy(), [0, 0, 1])
    assert np.allclose(normals[3].numpy(), [0, 1, 0])


def test_a_batch_is_refused(body: BodyModel, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="batch"):
        write_glb(tmp_path / "m.glb", make_motion(body).map(lambda t: t[None]), body)


def test_ply_round_trip(tmp_path: Path) -> None:
    vertices = np.random.default_rng(0).standard_normal((2, 5, 3))
    faces = np.array([[0, 1, 2], [2, 3, 4]])
    paths = write_ply_sequence(tmp_path / "frames", vertices, faces)
    assert [path.name for path in paths] == ["frame_000000.ply", "frame_000001.ply"]
    for path, frame in zip(paths, vertices, strict=True):
        assert np.abs(read_ply(path) - frame).max() < 1e-6  # m, float32 in the file
    write_ply(tmp_path / "cloud.ply", vertices[0])
    assert np.abs(read_ply(tmp_path / "cloud.ply") - vertices[0]).max() < 1e-6  # m

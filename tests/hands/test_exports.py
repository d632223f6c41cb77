"""Exported files have fingers where motions have, and none where they have none."""

import numpy as np
import pygltflib
import torch

from recon.body.hands import pose_fingers, skin_weights_with_fingers
from recon.core.fingers import HAND_JOINTS
from recon.core.skeleton import JOINTS
from recon.export.bvh import skeleton_of, write_bvh
from recon.export.gltf import write_glb
from recon.export.robots import write_robot, write_smpl
from recon.export.skeleton import Skeleton
from recon.mocap.reader import read_recording
from tests.export.smplx_stand_in import write_smplx
from tests.hands.made import person


def test_bvh_gives_fingers_back(tmp_path):
    somebody = person(6, 2)
    path = tmp_path / "hands.bvh"
    write_bvh(path, skeleton_of(somebody.motion, somebody.body, "hands"))
    read = read_recording(path)
    rows = [read.joint_names.index(name) for name in HAND_JOINTS]
    places, _ = pose_fingers(somebody.motion, somebody.body)
    assert np.abs(read.positions[:, rows] - places[:, :30].numpy()).max() < 1e-3
    alone = skeleton_of(somebody.motion.replace(hands=None), somebody.body, "alone")
    assert len(alone.joint_names) == 27


def test_glb_skins_fingers(tmp_path):
    """The posed skin of a relaxed hand is the unposed one, and nodes are the 52 joints."""
    somebody = person(6, 2)
    path = tmp_path / "hands.glb"
    write_glb(path, somebody.motion, somebody.body)
    document = pygltflib.GLTF2().load(path)
    assert [node.name for node in document.nodes[:52]] == [*JOINTS, *HAND_JOINTS]
    assert len(document.skins[0].joints) == 52
    skeleton = Skeleton.of(somebody.motion, somebody.body)
    root = somebody.motion.translation + torch.from_numpy(skeleton.offsets[0])
    turns, places = [skeleton.rotations[:, 0]], [root]
    for k, parent in enumerate(skeleton.parents[1:], 1):
        turns.append(turns[parent] @ skeleton.rotations[:, k])
        places.append(places[parent] + turns[parent] @ torch.from_numpy(skeleton.offsets[k]))
    fingers, _ = pose_fingers(somebody.motion, somebody.body)
    assert torch.allclose(torch.stack(places[22:], 1), fingers[:, :30], atol=1e-5)
    weights, binds = skin_weights_with_fingers(somebody.motion, somebody.body)
    assert torch.allclose(weights.sum(-1), torch.ones(len(weights)), atol=1e-5)
    assert torch.allclose(weights[:, 20] + weights[:, 22:37].sum(-1), somebody.body.weights[:, 20],
                          atol=1e-4)  # fmt: skip
    tip = somebody.body.template[1049]
    away = (binds @ torch.cat((tip, torch.ones(1))))[:, :3].norm(dim=-1)
    assert HAND_JOINTS[int(away.argmin())].endswith("3")


def test_smplx_files_have_fingers(tmp_path):
    """Robots' loaders find them in `pose_hand`, those of AMASS at the end of `poses`."""
    somebody = person(6, 1)
    smplx = write_smplx(tmp_path / "SMPLX_NEUTRAL.npz", somebody.body.to(dtype=torch.float64))
    write_robot(tmp_path / "robot.npz", somebody.motion, somebody.body, smplx)
    write_smpl(tmp_path / "smplx.npz", somebody.motion, somebody.body, smplx)
    own = somebody.motion.hands.arrays()["pose_hand"]
    with np.load(tmp_path / "robot.npz") as robot, np.load(tmp_path / "smplx.npz") as amass:
        assert np.allclose(robot["pose_hand"], own, atol=1e-5)
        assert np.allclose(amass["poses"][:, 75:], own, atol=1e-5)
        assert not amass["poses"][:, 66:75].any()

"""Names of other programs for bones: complete, different, and in the files."""

import json
import struct
from importlib.resources import files

import numpy as np
import pytest

from recon.body.model import BodyModel
from recon.core.bone_names import joint_names_in, names_of_joints
from recon.core.errors import ReconError
from recon.core.fingers import HAND_JOINTS
from recon.core.skeleton import JOINTS
from recon.core.units import to_z_up
from recon.export.bvh import skeleton_of, write_bvh
from recon.export.gltf import write_glb
from recon.export.usd import joint_paths
from recon.formats.motions import load_motion
from recon.mocap.bvh import read_bvh

PROGRAMS = ("mixamo", "unreal", "vrm", "rigify", "xsens")


@pytest.fixture(scope="module")
def motion():
    return load_motion(files("recon").joinpath("assets", "demo.npz")).motion.window(0, 8)


def test_every_program_names_every_joint_of_body_and_fingers_differently():
    assert tuple(names_of_joints()) == PROGRAMS
    for program, names in names_of_joints().items():
        assert sorted(names) == sorted((*JOINTS, *HAND_JOINTS)), program
        assert len(set(names.values())) == 52, program
        for joint, theirs in names.items():
            assert joint.startswith(("left_", "right_")) or theirs not in joint_names_in(
                HAND_JOINTS, program
            )


def test_names_of_vrm_are_those_that_its_specification_requires():
    needed = {"hips", "spine", "head"} | {
        f"{side}{bone}"
        for side in ("left", "right")
        for bone in ("UpperLeg", "LowerLeg", "Foot", "UpperArm", "LowerArm", "Hand")
    }
    assert needed <= set(names_of_joints()["vrm"].values())


def test_an_unknown_program_is_refused_with_the_known_ones():
    with pytest.raises(ReconError, match="smpl, mixamo, unreal, vrm, rigify, xsens, got 'maya'"):
        joint_names_in(JOINTS, "maya")


def test_a_vrm_has_the_humanoid_and_our_joints_with_y_up(motion, tmp_path):
    body = BodyModel.load()
    path = tmp_path / "m.glb"
    write_glb(path, motion, body, "vrm")
    data = path.read_bytes()
    size = struct.unpack("<I", data[12:16])[0]
    document = json.loads(data[20 : 20 + size])
    bones = document["extensions"]["VRMC_vrm"]["humanoid"]["humanBones"]
    assert {name: document["nodes"][one["node"]]["name"] for name, one in bones.items()} == {
        name: name for name in joint_names_in(JOINTS, "vrm")
    }
    assert document["extensionsUsed"] == ["VRMC_vrm", "VRMC_vrm_animation"]
    assert document["scenes"][0]["nodes"] == [22, 0]
    # the first track is the path of the root
    view = document["bufferViews"][
        document["accessors"][document["animations"][0]["samplers"][0]["output"]]["bufferView"]
    ]
    start = 20 + size + 8 + view["byteOffset"]
    hips = np.frombuffer(data[start : start + view["byteLength"]], "<f4").reshape(-1, 3)
    expected = body.pose(motion).joints[:, 0].numpy() @ to_z_up("y")
    np.testing.assert_allclose(hips, expected, atol=1e-5)


@pytest.mark.parametrize("program", PROGRAMS)
def test_bvh_with_their_names_reads_back_to_our_places(program, motion, tmp_path):
    path = tmp_path / "m.bvh"
    skeleton = skeleton_of(motion, BodyModel.load(), "m")
    write_bvh(path, skeleton, bones=program)
    read = read_bvh(path)
    theirs = [name.removeprefix("mixamorig:") for name in joint_names_in(JOINTS, program)]
    assert set(theirs) <= set(read.joint_names)
    rows = [read.joint_names.index(name) for name in theirs]
    np.testing.assert_allclose(read.positions[:, rows], skeleton.positions[:, :22], atol=1e-4)


def test_paths_of_usd_have_no_characters_that_usd_refuses():
    assert joint_paths("mixamo")[1] == "mixamorig_Hips/mixamorig_LeftUpLeg"
    assert joint_paths("rigify")[-1].endswith("/forearm_R/hand_R")
    assert joint_paths()[0] == "pelvis"

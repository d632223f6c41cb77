"""Motions on characters of other proportions: contacts kept, files kept, bones found."""

import json
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest
import torch

from recon.body.hands import RELAXED, HandModel
from recon.body.model import BodyModel
from recon.core.bone_names import names_of_joints, side_and_words_of
from recon.core.errors import ReconError
from recon.core.fingers import HAND_JOINTS
from recon.core.skeleton import JOINTS
from recon.export.bone_map import _finger_joints, map_bones
from recon.export.bone_tree import Tree
from recon.export.character import Character
from recon.export.gltf import write_glb
from recon.export.motion import export_file
from recon.export.onto_character import write_character
from recon.formats.motions import load_motion
from tests.export.characters import (
    CHILD,
    GIANT,
    Look,
    array_of,
    make_character,
    play,
    read_glb_of,
    slip,
    twists,
    write_glb_of,
)
from tests.hands.made import hands_of_angles

DEMO = Path(str(files("recon").joinpath("assets", "demo.npz")))
NAMES = names_of_joints()
LOOKS = {
    "child, A pose, centimetres": Look(NAMES["mixamo"], CHILD, unit=100, drop=45, spread=8),
    "giant": Look(NAMES["unreal"], GIANT),
    "looks back, nodes posed": Look(
        NAMES["vrm"], {"arm": 1.3, "leg": 0.8}, drop=60, backwards=True, posed=0.2, fingers=True
    ),
}


@pytest.fixture(scope="module")
def body():
    return BodyModel.load()


@pytest.fixture(scope="module")
def motion():
    return load_motion(DEMO).motion


@pytest.fixture(scope="module")
def source(motion, body):
    """Slip of our feet, and the frames in which they stand."""
    skin, own = body.pose(motion).vertices.numpy()[..., [0, 2, 1]], body.weights.argmax(-1)
    found = []
    for side in (0, 1):
        speed, near = slip(skin[:, np.isin(own, (7 + side, 10 + side))], motion.fps)
        found.append((speed, near & (speed < 0.25)))
    return found


@pytest.mark.parametrize("look", LOOKS.values(), ids=LOOKS)
def test_feet_stand_on_the_ground_and_bones_are_not_wrung(look, motion, body, source, tmp_path):
    made = make_character(tmp_path / "c.glb", look)
    animated = write_character(tmp_path / "out.glb", motion, body, made)
    assert animated.warnings == ()
    played = play(tmp_path / "out.glb")
    assert len(played.world) == motion.frames
    assert played.vertices[..., 1].min() > -0.01
    slips, ours = [], []
    for side, (speed, stands) in zip(("left", "right"), source, strict=True):
        feet = [played.names.index(look.names[f"{side}_{j}"]) for j in ("ankle", "foot")]
        theirs, _ = slip(played.vertices[:, np.isin(played.owners, feet)], played.fps)
        slips.append(theirs[stands])
        ours.append(speed[stands])
    assert np.concatenate(slips).mean() < 1.2 * np.concatenate(ours).mean()
    bones = [
        tuple(look.names[one.format(side)] for one in chain)
        for side in ("left", "right")
        for chain in (
            ("{}_collar", "{}_shoulder", "{}_elbow"), ("{}_shoulder", "{}_elbow", "{}_wrist"),
            ("pelvis", "{}_hip", "{}_knee"), ("{}_hip", "{}_knee", "{}_ankle"),
        )
    ]  # fmt: skip
    assert max(twists(played, bones).values()) < 90


def test_limbs_point_as_ours_whatever_the_rest_pose(motion, body, tmp_path):
    look = LOOKS["child, A pose, centimetres"]
    write_character(tmp_path / "out.glb", motion, body, make_character(tmp_path / "c.glb", look))
    played, joints = play(tmp_path / "out.glb"), body.pose(motion).joints.numpy()[..., [0, 2, 1]]
    joints[..., 2] *= -1
    for side in ("left", "right"):
        for a, b in (("shoulder", "elbow"), ("elbow", "wrist")):
            names = f"{side}_{a}", f"{side}_{b}"
            theirs = played.place(look.names[names[1]]) - played.place(look.names[names[0]])
            ours = joints[:, JOINTS.index(names[1])] - joints[:, JOINTS.index(names[0])]
            cosine = (theirs * ours).sum(-1) / np.linalg.norm(theirs, axis=-1)
            assert (cosine / np.linalg.norm(ours, axis=-1)).min() > np.cos(np.radians(1))
    left, right = (played.place(look.names[f"{s}_hip"]) for s in ("left", "right"))
    ours = joints[:, 1] - joints[:, 2]
    assert ((left - right) * ours).sum(-1).min() > 0


def test_the_same_body_moves_as_it_did(motion, body, tmp_path):
    write_glb(tmp_path / "own.glb", motion, body, "unreal")
    write_character(tmp_path / "out.glb", motion, body, tmp_path / "own.glb")
    played, joints = play(tmp_path / "out.glb"), body.pose(motion).joints.numpy()
    for k, name in enumerate(JOINTS):
        ours = joints[:, k] @ np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]])
        away = np.linalg.norm(played.place(NAMES["unreal"][name]) - ours, axis=-1)
        # its soles were up to 8 mm in the ground
        assert away.max() < 0.015, name


def test_everything_else_in_the_file_stays(motion, body, tmp_path):
    made = make_character(tmp_path / "c.glb", LOOKS["giant"])
    document, data = read_glb_of(made)
    document["animations"] = [{"name": "idle", "channels": [], "samplers": [], "extras": 1}]
    document["extensionsUsed"] = ["X_unknown"]
    document["extensions"] = {"X_unknown": {"big": 12345678901234567890, "small": 1e-7}}
    write_glb_of(made, document, data)
    write_character(tmp_path / "out.glb", motion.window(0, 9), body, made)
    after, more = read_glb_of(tmp_path / "out.glb")
    assert more[: len(data)] == data
    for key, value in document.items():
        if isinstance(value, list) and key != "buffers":
            assert after[key][: len(value)] == value, key
        elif key != "buffers":
            assert after[key] == value, key
    assert [one["name"] for one in after["animations"]] == ["idle", "motion"]
    times = array_of(after, more, after["animations"][1]["samplers"][0]["input"])[:, 0]
    np.testing.assert_allclose(times, np.arange(9) / motion.fps, atol=1e-6)


def test_a_gltf_beside_its_data_becomes_one_file(motion, body, tmp_path):
    made = make_character(tmp_path / "c.glb", LOOKS["giant"])
    document, data = read_glb_of(made)
    (tmp_path / "my data.bin").write_bytes(data)
    document["buffers"][0]["uri"] = "my%20data.bin"
    document["images"] = [{"uri": "skin.png"}]
    (tmp_path / "skin.png").write_bytes(b"\x89PNG")
    (tmp_path / "c.gltf").write_text(json.dumps(document))
    read = Character.read(tmp_path / "c.gltf")
    write_character(tmp_path / "out.glb", motion.window(0, 9), body, tmp_path / "c.gltf")
    after, _ = read_glb_of(tmp_path / "out.glb")
    assert all(one["uri"].startswith("data:") for one in after["buffers"])
    assert after["images"][0]["uri"].startswith("data:image/png;base64,")
    again = Character.read(tmp_path / "out.glb")
    np.testing.assert_array_equal(read.world, again.world)
    document["buffers"][0]["uri"] = "../secret.bin"
    (tmp_path / "c.gltf").write_text(json.dumps(document))
    with pytest.raises(ReconError, match="expected data files in the same folder"):
        Character.read(tmp_path / "c.gltf")


def test_fingers_bend_where_both_have_some(motion, body, tmp_path):
    look = LOOKS["looks back, nodes posed"]
    made, short = make_character(tmp_path / "c.glb", look), motion.window(0, 6)
    angles = RELAXED.expand(6, 2, 22).clone()
    angles[3:, :, -12:] += 0.7
    moved = short.replace(
        hands=hands_of_angles(angles, HandModel.of(body, short.shape)).to(dtype=torch.float32)
    )
    write_character(tmp_path / "out.glb", moved, body, made)
    played = play(tmp_path / "out.glb")
    for name in ("left_ring2", "right_pinky2"):
        k = played.names.index(look.names[name])
        turn = np.linalg.inv(played.local[0, k, :3, :3]) @ played.local[5, k, :3, :3]
        angle = np.degrees(np.arccos((np.trace(turn) - 1) / 2))
        assert angle == pytest.approx(np.degrees(0.7), abs=1)
    write_character(tmp_path / "none.glb", short, body, made)
    document, _ = read_glb_of(tmp_path / "none.glb")
    turned = {
        document["nodes"][one["target"]["node"]]["name"]
        for one in document["animations"][-1]["channels"]
    }
    assert not turned & {look.names[joint] for joint in HAND_JOINTS}


def test_a_matrix_of_a_bone_becomes_parts_that_can_move(motion, body, tmp_path):
    made = make_character(tmp_path / "c.glb", Look(NAMES["mixamo"], rolled=False))
    document, data = read_glb_of(made)
    node = document["nodes"][4]
    x, y, z = node.pop("translation")
    del node["rotation"]
    node["matrix"] = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, x, y, z, 1]
    write_glb_of(made, document, data)
    write_character(tmp_path / "out.glb", motion.window(0, 3), body, made)
    after = read_glb_of(tmp_path / "out.glb")[0]["nodes"][4]
    assert after["translation"] == [x, y, z]
    assert after["extras"] == {"kept": 1.0}


@pytest.mark.parametrize("old", [False, True])
def test_bones_of_a_vrm_are_those_of_its_table(old, motion, body, tmp_path):
    look = Look({}, CHILD, drop=50, backwards=old)
    made = make_character(tmp_path / "c.vrm", look)
    document, data = read_glb_of(made)
    for k, node in enumerate(document["nodes"]):
        node["name"] = f"n{k}"
    table = [
        (theirs, JOINTS.index(ours)) for ours, theirs in NAMES["vrm"].items() if ours in JOINTS
    ]
    if old:
        bones = [{"bone": name, "node": node} for name, node in table]
        document["extensions"] = {"VRM": {"humanoid": {"humanBones": bones}}}
    else:
        bones = {name: {"node": node} for name, node in table}
        document["extensions"] = {"VRMC_vrm": {"humanoid": {"humanBones": bones}}}
    write_glb_of(made, document, data)
    animated = write_character(tmp_path / "out.glb", motion, body, made)
    assert animated.bones["left_knee"] == f"n{JOINTS.index('left_knee')}"
    assert play(tmp_path / "out.glb").vertices[..., 1].min() > -0.01


def test_the_command_says_which_bones_it_took(tmp_path):
    made = make_character(tmp_path / "me.glb", LOOKS["giant"])
    told = export_file(DEMO, glb=tmp_path / "out.glb", character=made)
    assert told is not None
    assert told.tables["bones of the character"]["left_knee"] == {"bone": "calf_l"}
    report = json.loads((tmp_path / "out.glb.json").read_text())
    assert report["bones"]["spine"] == "spine_01, spine_03, spine_05"
    assert str(made) in report["inputs"]
    with pytest.raises(ReconError, match="--character keeps its own names"):
        export_file(DEMO, glb=tmp_path / "a.glb", character=made, names="vrm")
    with pytest.raises(ReconError, match="--bones is an option of --character"):
        export_file(DEMO, glb=tmp_path / "a.glb", bones=made)


CONVENTIONS = {
    "HumanIK": "Character1_{S}UpLeg Character1_{S}Leg Character1_{S}Foot Character1_{S}Arm "
    "Character1_{S}ForeArm Character1_{S}Hand",
    "Unity": "{S}UpperLeg {S}LowerLeg {S}Foot {S}UpperArm {S}LowerArm {S}Hand",
    "Biped": "Bip01 {c} Thigh|Bip01 {c} Calf|Bip01 {c} Foot|Bip01 {c} UpperArm|"
    "Bip01 {c} Forearm|Bip01 {c} Hand",
    "Character Creator": "CC_Base_{c}_Thigh CC_Base_{c}_Calf CC_Base_{c}_Foot "
    "CC_Base_{c}_Upperarm CC_Base_{c}_Forearm CC_Base_{c}_Hand",
    "DAZ": "{l}Thigh {l}Shin {l}Foot {l}Shldr {l}ForeArm {l}Hand",
    "VRoid": "J_Bip_{c}_UpperLeg J_Bip_{c}_LowerLeg J_Bip_{c}_Foot J_Bip_{c}_UpperArm "
    "J_Bip_{c}_LowerArm J_Bip_{c}_Hand",
    "MakeHuman": "upperleg01.{c} lowerleg01.{c} foot.{c} upperarm01.{c} lowerarm01.{c} wrist.{c}",
    "Rigify, deforming": "DEF-thigh.{c} DEF-shin.{c} DEF-foot.{c} DEF-upper_arm.{c} "
    "DEF-forearm.{c} DEF-hand.{c}",
    "SMPL": "{s}_hip {s}_knee {s}_ankle {s}_shoulder {s}_elbow {s}_wrist",
}


def _tree(names: dict[str, str]) -> Tree:
    from recon.core.skeleton import PARENTS

    told = tuple(names.get(joint, joint.replace("_", "")) for joint in JOINTS)
    return Tree(told, PARENTS, frozenset(range(len(JOINTS))))


@pytest.mark.parametrize("convention", CONVENTIONS)
def test_bones_are_found_by_names_of_many_conventions(convention):
    text = CONVENTIONS[convention]
    words = text.split("|") if "|" in text else text.split()
    joints, names = ("hip", "knee", "ankle", "shoulder", "elbow", "wrist"), {}
    for side in ("left", "right"):
        for joint, word in zip(joints, words, strict=True):
            names[f"{side}_{joint}"] = word.format(
                S=side.title(), c=side[0].upper(), l=side[0], s=side
            )
        # bones that help, and one that another convention calls an arm
        names[f"{side}_foot"] = f"{side}_toe" if convention != "SMPL" else f"{side}_foot"
        names[f"{side}_collar"] = f"{side}_clavicle"
    found = map_bones(_tree(names), np.zeros((22, 3)), {}, Path("c.glb"))
    for joint, node in found.nodes.items():
        assert node == JOINTS.index(joint), joint
    assert found.by_tree == ()
    assert [JOINTS[k] for k in (*found.spine, *found.neck)] == [
        "spine1", "spine2", "spine3", "neck",
    ]  # fmt: skip


@pytest.mark.parametrize(("numbers", "first"), [("0123", 1), ("012", 0), ("1234", 0)])
def test_a_finger_bone_of_number_0_is_a_metacarpal_before_three_more(numbers, first):
    tree = _tree({})
    wrist = JOINTS.index("left_wrist")
    parents = (*tree.parents, wrist, *range(22, 21 + len(numbers)))
    names = (*tree.names, *(f"l_index_{k}" for k in numbers))
    grown = Tree(names, parents, frozenset(range(len(names))))
    sides = {k: side_and_words_of(name) for k, name in enumerate(names)}
    found = _finger_joints(grown, wrist, "left", sides)
    assert found == {f"left_index{k + 1}": 22 + first + k for k in range(3)}


@pytest.mark.parametrize("program", NAMES)
def test_our_own_exports_are_found_by_their_names(program, motion, body, tmp_path):
    write_glb(tmp_path / "m.glb", motion.window(0, 2), body, program)
    found = Character.read(tmp_path / "m.glb").bones
    assert found.by_tree == ()
    assert {joint: JOINTS[node] for joint, node in found.nodes.items()} == {
        joint: joint for joint in JOINTS if not joint.startswith("spine") and joint != "neck"
    }


@pytest.mark.parametrize("fingers", [False, True])
@pytest.mark.parametrize("backwards", [False, True])
def test_bones_without_names_are_found_by_the_tree(fingers, backwards, tmp_path):
    names = {joint: f"Bone.{k:03d}" for k, joint in enumerate((*JOINTS, *HAND_JOINTS))}
    look = Look(names, CHILD, drop=40, fingers=fingers, backwards=backwards)
    found = Character.read(make_character(tmp_path / "c.glb", look)).bones
    assert {joint: JOINTS[node] for joint, node in found.nodes.items() if node < 22} == {
        joint: joint for joint in JOINTS if not joint.startswith("spine") and joint != "neck"
    }
    assert "left_knee" in found.by_tree


def test_the_user_names_bones(tmp_path):
    names = {joint: f"x{k}" for k, joint in enumerate(JOINTS)} | {
        "head": "Schädel",
        "neck": "Hals",
    }
    made = make_character(tmp_path / "c.glb", Look(names))
    lines = [f'{joint} = "{name}"' for joint, name in names.items() if joint not in (
        "spine1", "spine2", "spine3", "neck")]  # fmt: skip
    told = tmp_path / "bones.toml"
    told.write_text("\n".join(lines), encoding="utf-8")
    found = Character.read(made, told).bones
    assert found.by_tree == ()
    assert found.names_by_joint([str(names[j]) for j in JOINTS])["head"] == "Schädel"
    told.write_text('left_knee = "nothing"')
    with pytest.raises(ReconError, match="no node of the character has this name"):
        Character.read(made, told)
    told.write_text('left_leg = "x4"')
    with pytest.raises(ReconError, match="expected names of joints such as left_knee"):
        Character.read(made, told)
    told.write_text('left_knee = "x5"')
    with pytest.raises(ReconError, match=r"does not lie below|several joints"):
        Character.read(made, told)

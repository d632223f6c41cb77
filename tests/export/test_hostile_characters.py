"""Characters that are damaged, odd or hostile are refused with what to do, or read as they are."""

import copy
import json
import struct
from pathlib import Path

import numpy as np
import pytest

from recon.core.bone_names import names_of_joints
from recon.core.errors import ReconError
from recon.core.skeleton import JOINTS
from recon.export.character import Character
from tests.export.characters import Look, array_of, make_character, read_glb_of, write_glb_of

LOOK = Look(names_of_joints()["mixamo"])


@pytest.fixture
def made(tmp_path):
    return make_character(tmp_path / "c.glb", LOOK)


def changed(path: Path, change) -> Path:
    document, data = read_glb_of(path)
    change(document)
    write_glb_of(path, document, data)
    return path


def _skinless(d):
    del d["skins"], d["nodes"][22]["skin"]


def _mirrored(d):
    d["nodes"][23]["scale"] = [-1, 1, 1]


def _uneven(d):
    d["nodes"][23]["scale"] = [1, 2, 1]


def _flat(d):
    d["nodes"][0]["scale"] = [0, 0, 0]


def _circle(d):
    d["nodes"][15]["children"] = [0]
    d["nodes"][23]["children"] = []


def _two_parents(d):
    d["nodes"][15]["children"] = [0]


def _far_child(d):
    d["nodes"][3]["children"] = [9999]


def _huge(d):
    d["accessors"][0]["count"] = 10**9


def _beyond(d):
    d["bufferViews"][3]["byteOffset"] = 10**6


def _text(d):
    d["nodes"][3]["translation"] = ["a", 0, 0]


def _nan(d):
    d["nodes"][3]["translation"] = [float("nan"), 0, 0]


def _joints(d):
    d["skins"][0]["joints"] = [0.5]


def _stray(d):
    d["skins"] = {}


def _old(d):
    d["asset"]["version"] = "1.0"


REFUSED = {
    "no skin": (_skinless, "expected a rigged character, but it has no skin"),
    "negative scale": (_mirrored, "mirrors the character by a negative scale"),
    "uneven scale": (_uneven, "is scaled unevenly"),
    "no size": (_flat, "is scaled to zero"),
    "circle": (_circle, "their own ancestors"),
    "two parents": (_two_parents, "has two parents"),
    "a child that is not there": (_far_child, "expected the number of a node below 24, got 9999"),
    "an accessor of 8 GB": (_huge, "number of numbers in an array|reaches beyond its buffer"),
    "a view beyond the data": (_beyond, "bufferView is damaged"),
    "text for numbers": (_text, "expected 3 numbers of a node"),
    "nan": (_nan, "expected 3 numbers of a node"),
    "half a joint": (_joints, "expected the number of a node"),
    "a record for a list": (_stray, "expected a list of JSON objects in skins"),
    "glTF 1": (_old, "expected glTF of version 2"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_a_damaged_or_mirrored_character_is_refused(case, made):
    change, message = REFUSED[case]
    path = changed(made, change)
    with pytest.raises(ReconError, match=message):
        dict(Character.read(path).skin)


def test_every_file_that_is_cut_off_is_refused(made):
    data = made.read_bytes()
    for size in (*range(0, 24, 3), len(data) // 3, len(data) - 4):
        made.write_bytes(data[:size])
        with pytest.raises(ReconError):
            Character.read(made)


def test_parts_longer_than_the_file_are_refused(made):
    data = bytearray(made.read_bytes())
    struct.pack_into("<I", data, 12, 0xFFFFFFFF)
    made.write_bytes(bytes(data))
    with pytest.raises(ReconError, match="longer than the file"):
        Character.read(made)


def test_other_kinds_of_files_say_how_they_become_one(tmp_path):
    (tmp_path / "c.fbx").write_bytes(b"Kaydara FBX Binary")
    with pytest.raises(ReconError, match="in Blender"):
        Character.read(tmp_path / "c.fbx")
    (tmp_path / "c.glb").write_text("{" * 100000)
    with pytest.raises(ReconError, match="damaged"):
        Character.read(tmp_path / "c.glb")
    with pytest.raises(FileNotFoundError):
        Character.read(tmp_path / "none.glb")


def test_two_characters_in_a_file_are_refused_by_name(made):
    def doubled(document):
        nodes = document["nodes"]
        more = copy.deepcopy(nodes)
        for node in more:
            if "children" in node:
                node["children"] = [child + len(nodes) for child in node["children"]]
            if "skin" in node:
                node["skin"] = 1
        skin = document["skins"][0]
        other = {**skin, "joints": [joint + len(nodes) for joint in skin["joints"]]}
        document["nodes"], document["skins"] = nodes + more, [skin, other]

    with pytest.raises(ReconError, match="give one character at a time"):
        Character.read(changed(made, doubled))


def test_two_skins_of_one_character_are_fine(made):
    before = Character.read(made)

    def doubled(document):
        few = {**document["skins"][0], "joints": list(range(12, 22))}
        document["skins"].append({k: v for k, v in few.items() if k != "inverseBindMatrices"})

    after = Character.read(changed(made, doubled))
    assert after.bones == before.bones
    np.testing.assert_array_equal(after.rest_rotations, before.rest_rotations)


def test_compressed_meshes_are_left_alone_and_soles_come_from_their_boxes(made):
    before = Character.read(made)

    def compressed(document):
        part = document["meshes"][0]["primitives"][0]
        part["extensions"] = {"KHR_draco_mesh_compression": {"bufferView": 0, "attributes": {}}}

    after = Character.read(changed(made, compressed))
    assert after.skin == {}
    assert after.lowest_height == pytest.approx(before.lowest_height, abs=1e-6)
    assert after.warnings == ()


def test_what_hangs_below_the_feet_is_no_sole(made):
    """A train 30 cm below the soles gave legs that are 30 cm longer, and lifted the body."""
    before = Character.read(made)
    document, data = read_glb_of(made)
    places = array_of(document, data, 0).copy()
    places[array_of(document, data, 1)[:, 0] == JOINTS.index("pelvis"), 1] -= 1.3
    document["accessors"][0] |= {"min": places.min(0).tolist(), "max": places.max(0).tolist()}
    write_glb_of(made, document, places.astype("<f4").tobytes() + data[places.nbytes :])
    after = Character.read(made)
    assert places[:, 1].min() < -0.2
    assert after.lowest_height == before.lowest_height
    hips = after.bones.nodes["pelvis"]
    assert hips not in after.skin
    assert set(after.skin) == set(before.skin) - {hips}


def test_a_bind_pose_that_cannot_be_read_is_said(made):
    def compressed(document):
        document["bufferViews"][3]["extensions"] = {"EXT_meshopt_compression": {}}

    read = Character.read(changed(made, compressed))
    assert "the pose of the nodes is taken instead" in read.warnings[0]
    assert read.reference is read.world


def test_a_buffer_for_what_is_compressed_needs_no_data(made, tmp_path):
    """gltfpack -cc writes such a buffer."""

    def packed(document):
        empty = {
            "byteLength": 10**6,
            "extensions": {"EXT_meshopt_compression": {"fallback": True}},
        }
        document["buffers"].append(empty)
        for view in document["bufferViews"][:3]:
            view["extensions"] = {"EXT_meshopt_compression": {**view, "mode": "ATTRIBUTES"}}
            view["buffer"] = 1

    read = Character.read(changed(made, packed))
    assert read.skin == {}
    read.file.write_with_animation(tmp_path / "out.glb", "a", np.zeros(2), [], {})
    assert Character.read(tmp_path / "out.glb").file.buffers[1] == b""

    def plain(document):
        del document["bufferViews"][1]["extensions"]

    with pytest.raises(ReconError, match="again, without compression"):
        Character.read(changed(made, plain))


def test_quantised_vertices_are_read(made):
    before = Character.read(made)
    document, data = read_glb_of(made)
    count = document["accessors"][0]["count"]
    places = np.frombuffer(data, "<f4", count * 3).reshape(-1, 3)
    size = np.abs(places).max() / 32767
    whole = np.zeros((count, 4), "<i2")
    whole[:, :3] = np.round(places / size)
    view = {"buffer": 0, "byteOffset": len(data), "byteLength": whole.nbytes, "byteStride": 8}
    told = document["accessors"][0]
    told |= {"componentType": 5122, "bufferView": 4}
    told |= {"min": whole[:, :3].min(0).tolist(), "max": whole[:, :3].max(0).tolist()}
    document["bufferViews"].append(view)
    # the skin takes the sizes back, as its matrices do in files of gltfpack
    data = bytearray(data + whole.tobytes())
    begin = document["bufferViews"][3]["byteOffset"]
    binds = np.frombuffer(data, "<f4", 16 * 22, begin).reshape(-1, 4, 4).copy()
    binds[:, :3] *= size
    data[begin : begin + binds.nbytes] = binds.tobytes()
    document["buffers"][0]["byteLength"] = len(data)
    write_glb_of(made, document, bytes(data))
    after = Character.read(made)
    assert after.lowest_height == pytest.approx(before.lowest_height, abs=2e-4)
    np.testing.assert_allclose(after.rest_positions, before.rest_positions, atol=1e-5)


def test_five_thousand_bones_more_take_seconds_at_most(made):
    def hairy(document):
        nodes, first = document["nodes"], len(document["nodes"])
        head = JOINTS.index("head")
        for k in range(5000):
            below = [] if k % 500 == 499 else [first + k + 1]
            nodes.append({"name": f"hair{k}", "translation": [0, 0.01, 0], "children": below})
        nodes[head]["children"] = [first + 500 * k for k in range(10)]
        del document["skins"][0]["inverseBindMatrices"]
        document["skins"][0]["joints"] += list(range(first, first + 5000))

    read = Character.read(changed(made, hairy))
    assert len(read.tree.names) == 5024
    assert len(read.animated_nodes) == len(JOINTS)


def test_unknown_bones_are_refused_with_their_names(made):
    def renamed(document):
        for k in (4, 7):
            document["nodes"][k]["name"] = "spike"

    def star(document):
        for k, node in enumerate(document["nodes"][:22]):
            node["name"] = f"point {k}"
            node["translation"] = [0, 0, 0]

    found = Character.read(changed(made, renamed)).bones
    assert set(found.by_tree) >= {"left_knee", "left_ankle"}
    with pytest.raises(ReconError, match=r"no bones were found for left_shoulder.*'point 3'"):
        Character.read(changed(made, star))


def test_json_with_lone_surrogates_is_no_crash(made):
    document, data = read_glb_of(made)
    text = json.dumps(document).replace('"somebody"', '"\\ud800"').encode()
    text += b" " * (-len(text) % 4)
    parts = struct.pack("<II", len(text), 0x4E4F534A) + text
    parts += struct.pack("<II", len(data), 0x004E4942) + data
    made.write_bytes(b"glTF" + struct.pack("<II", 2, 12 + len(parts)) + parts)
    read = Character.read(made)
    with pytest.raises(ReconError, match="NaN, infinity or broken text"):
        read.file.write_with_animation(made.with_name("o.glb"), "m", np.zeros(1), [], {})

"""Skeletons told by the names of their joints alone."""

from pathlib import Path

import numpy as np
import pytest

from recon.body.model import BodyModel
from recon.core.skeleton import JOINTS, PARENTS
from recon.ingest.maps import recognise
from recon.mocap.reader import (
    NEEDED,
    known_skeletons,
    plain_joint_name,
    read_recording,
    refuse_unknown_skeleton,
    skeleton_among,
)
from recon.mocap.recording import SkeletonRecording
from recon.mocap.trees import joints_by_tree

BVH = """HIERARCHY
ROOT Hips
{{
  OFFSET 0 0 0
  CHANNELS 6 Xposition Yposition Zposition Zrotation Yrotation Xrotation
  JOINT {name}
  {{
    OFFSET 0 10 0
    CHANNELS 3 Zrotation Yrotation Xrotation
    End Site
    {{
      OFFSET 0 10 0
    }}
  }}
}}
MOTION
Frames: 1
Frame Time: 0.01
0 0 0 0 0 0 0 0 0
"""


@pytest.mark.parametrize("name", known_skeletons())
def test_every_known_skeleton_is_recognised_and_is_a_whole_body(name: str) -> None:
    table = known_skeletons()[name]
    theirs = [joint for part in table.values() for joint in part.values()]
    found = skeleton_among([f"Actor:{joint.upper()}" for joint in theirs], "clip")
    # tables of fewer joints may be part of others
    assert {
        plain_joint_name(j) for part in known_skeletons()[found].values() for j in part.values()
    } <= {plain_joint_name(joint) for joint in theirs}
    positions = {**table.get("joints", {}), **table.get("positions", {})}
    assert set(NEEDED) <= set(positions)
    assert {joint for part in table.values() for joint in part} <= set(JOINTS)


def test_soma_and_mixamo_are_not_confused() -> None:
    """LeftLeg is the thigh of one and the shank of the other."""
    soma = [j for part in known_skeletons()["soma"].values() for j in part.values()]
    assert skeleton_among([*soma, "LeftHandThumb1", "Jaw"], "clip") == "soma"
    mixamo = [j for part in known_skeletons()["mixamo"].values() for j in part.values()]
    assert skeleton_among([f"mixamorig:{joint}" for joint in mixamo], "clip") == "mixamo"


def test_unknown_skeletons_are_refused_by_their_names(tmp_path: Path) -> None:
    """They were refused after the whole motion had been read."""
    path = tmp_path / "tail.bvh"
    path.write_text(BVH.format(name="Tail"))
    with pytest.raises(ValueError, match=r"none of .*its joints are Hips, Tail\. Name recon"):
        refuse_unknown_skeleton(path)
    refuse_unknown_skeleton(tmp_path / "none.bvh")
    refuse_unknown_skeleton(tmp_path)
    (tmp_path / "broken.bvh").write_text("nothing")
    refuse_unknown_skeleton(tmp_path / "broken.bvh")  # its reader says what is wrong with it


@pytest.mark.parametrize(
    ("file", "name"),
    [("bvh_max/131_02.bvh.xz", "cmu_max"), ("bvh_cc/06_08.bvh.xz", "character_creator")],
)
def test_real_skeletons_are_recognised(data: Path, file: str, name: str) -> None:
    path = data / "mocap" / "cmu" / file
    refuse_unknown_skeleton(path)
    recording = read_recording(path)
    assert isinstance(recording, SkeletonRecording)
    assert recognise(recording).name == name


def _walker() -> tuple[list[str], list[int], np.ndarray]:
    """The bundled body's joints as a tree."""
    rest = BodyModel.load().joint_template.double().numpy()
    offsets = np.array([rest[k] - rest[p] if p >= 0 else rest[k] for k, p in enumerate(PARENTS)])
    return list(JOINTS), list(PARENTS), offsets


SPELT = {
    "sides before": lambda side, part: f"Actor_{side[0].upper()}{part.title()}",
    "sides behind": lambda side, part: f"{part}_{side[0]}",
    "capitals behind": lambda side, part: f"{part.title()}{side[0].upper()}",
    "words": lambda side, part: f"bone.{part}.{side}",
}  # fmt: skip


@pytest.mark.parametrize("spelt", SPELT)
def test_joints_of_any_names_are_told_by_the_tree(spelt: str) -> None:
    """Skeletons of Motive, Vicon, Unity and Perception Neuron were refused for their names."""
    names, parents, offsets = _walker()
    theirs = [
        SPELT[spelt](*name.split("_")) if "_" in name else f"b{k}" for k, name in enumerate(names)
    ]
    found = joints_by_tree(theirs, parents, offsets)
    assert found is not None
    assert found == {name: one for name, one in zip(names, theirs, strict=True) if name in found}
    assert {*NEEDED, "pelvis", "left_foot", "neck", "head", "spine3"} <= set(found)


def test_toes_may_be_missing_and_bones_may_have_twists() -> None:
    names, parents, offsets = _walker()
    kept = [k for k, name in enumerate(names) if "foot" not in name]
    fewer = [kept.index(parents[k]) if parents[k] >= 0 else -1 for k in kept]
    tree = [names[k] for k in kept], fewer, offsets[kept]
    tips = [f"{name}_end" for name in tree[0] if "ankle" in name]
    tree[0].extend([*tips, "left_hip_twist"])
    hip = tree[0].index("left_hip")
    tree[1].extend([tree[0].index("left_ankle"), tree[0].index("right_ankle"), hip])
    more = np.concatenate((tree[2], [[0, 0, 0.1], [0, 0, 0.1], [0, -0.2, 0]]))
    found = joints_by_tree(tree[0], tree[1], more)
    assert found is not None
    assert {*NEEDED, "pelvis"} <= set(found)
    assert not {"left_foot", "right_foot"} & set(found)
    assert all(ours == theirs for ours, theirs in found.items())


@pytest.mark.parametrize("what", ["sides", "forearm", "quadruped", "chain"])
def test_trees_that_are_not_sure_are_none(what: str) -> None:
    names, parents, offsets = _walker()
    if what == "sides":
        names = [f"b{k}" for k in range(len(names))]
    elif what == "forearm":  # in two halves
        for side in ("left", "right"):
            wrist = names.index(f"{side}_wrist")
            offsets[wrist] /= 2
            names.append(f"{side}_half")
            parents.append(wrist)
            offsets = np.concatenate((offsets, offsets[wrist][None]))
    elif what == "quadruped":
        arms = [k for k, name in enumerate(names) if "elbow" in name or "wrist" in name]
        offsets[arms] *= 2.5
    else:
        parents = [k - 1 for k in range(len(names))]
    assert joints_by_tree(names, parents, offsets) is None

"""Skeletons told by the names of their joints alone."""

from pathlib import Path

import pytest

from recon.core.skeleton import JOINTS
from recon.ingest.maps import recognise
from recon.mocap.reader import (
    NEEDED,
    known_skeletons,
    plain,
    read_recording,
    refuse_unknown_skeleton,
    skeleton_among,
)
from recon.mocap.recording import SkeletonRecording

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
    assert {plain(j) for part in known_skeletons()[found].values() for j in part.values()} <= {
        plain(joint) for joint in theirs
    }
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
    with pytest.raises(ValueError, match=r"none of .*its joints are Hips, Tail\. Say which"):
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

"""Points of detectors, triangulated, are joint centres: not markers on the skin."""

from pathlib import Path

import pytest
import torch

from recon.body.model import BodyModel
from recon.core.skeleton import joint_index
from recon.detections.tables import plain_part_name
from recon.formats.motions import load_motion
from recon.ingest import convert
from recon.ingest.marker_sets import keypoint_places
from recon.keypoints3d.labels import are_keypoints, keypoints_of_labels
from tests.ingest.walker import MARKERS


@pytest.mark.parametrize("label", ["RHip", "LKnee", "Nose", "CHip", "Neck", "left_big_toe", "Hip"])
def test_keypoints_are_known_by_name(label: str) -> None:
    assert keypoints_of_labels([label]) != [None]
    assert plain_part_name("RHip") == "right_hip"


@pytest.mark.parametrize(
    ("hips", "clavicle", "bones"),
    [
        ("mixamorig:Hips", "LeftShoulder", ["UpLeg", "Leg", "Foot", "ToeBase", "Arm", "ForeArm",
                                            "Hand"]),
        ("Pelvis", "Left Shoulder", [" Upper Leg", " Lower Leg", " Foot", " Toe", " Upper Arm",
                                     " Forearm", " Hand"]),
        ("hips", "shoulder.L", ["thigh", "shin", "foot", "toe", "upper_arm", "forearm", "hand"]),
    ],
)  # fmt: skip
def test_bones_mean_the_joints_at_which_they_begin(
    hips: str, clavicle: str, bones: list[str]
) -> None:
    """Half of the bones were unknown, and clavicles called shoulders were shoulders."""
    sides = [("Left", ""), ("Right", "")] if bones[0][0] in "U " else [("", ".L"), ("", ".R")]
    labels = [hips, "Spine1", clavicle, *(f"{a}{one}{b}" for a, b in sides for one in bones)]
    limbs = ("hip", "knee", "ankle", "foot_joint", "shoulder", "elbow", "wrist")
    expected = [f"{side}_{joint}" for side in ("left", "right") for joint in limbs]
    assert keypoints_of_labels(labels) == ["pelvis_joint", None, None, *expected]
    assert keypoints_of_labels(["LShoulder", "LElbow", "LArm"])[0] == "left_shoulder"


def test_marker_sets_are_no_keypoints(single: BodyModel) -> None:
    halpe = ["Nose", "Neck", "Hip", *(f"{s}{j}" for s in "LR" for j in (
        "Hip", "Knee", "Ankle", "Shoulder", "Elbow", "Wrist", "Heel", "BigToe"))]  # fmt: skip
    assert are_keypoints(halpe)
    assert not are_keypoints(tuple(MARKERS))
    assert not are_keypoints(["LKNE", "RKNE", "LANK", "RANK", "LELB", "RELB", "LSHO", "RSHO"])
    vertices, offsets = keypoint_places(["RKnee", "Neck"], single)
    place = single.template[list(vertices)] + offsets
    torch.testing.assert_close(place[0], single.joint_template[joint_index("right_knee")])
    shoulders = [joint_index("left_shoulder"), joint_index("right_shoulder")]
    torch.testing.assert_close(place[1], single.joint_template[shoulders].mean(0))
    bones = single.weights[list(vertices)].argmax(-1).tolist()
    assert bones == [joint_index("right_knee"), joint_index("spine3")]


def test_keypoints_are_joint_centres(data: Path, single: BodyModel) -> None:
    """Taken for skin markers, they made a body that was 7 cm off, and nothing said so."""
    doors = data / "observations" / "doors"
    found = convert(doors / "halpe26.trc", single)
    assert "joint centres" in [w.code for w in found.warnings]
    truth = single.pose(load_motion(doors / "truth.npz").motion).joints
    ours, theirs = (joints - joints[:, :1] for joints in (found.joints, truth))
    limbs = [joint_index(f"{s}_{j}") for s in ("left", "right") for j in ("hip", "knee", "ankle")]
    lengths = [(x[:, limbs].norm(dim=-1)).mean(0) for x in (ours, theirs)]
    torch.testing.assert_close(lengths[0], lengths[1], atol=0.03, rtol=0)

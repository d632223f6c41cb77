"""Landmarks lie where their names say; marker labels of the common protocols find them."""

import json

import numpy as np
import pytest

from recon.body.landmarks import (
    KEYPOINTS_43,
    LANDMARKS_16,
    landmark,
    landmarks,
)
from recon.body.marker_labels import load_marker_map, match_markers, normalised_label
from recon.core.skeleton import JOINTS

PLUG_IN_GAIT = (
    "LFHD", "RFHD", "LBHD", "RBHD", "C7", "T10", "CLAV", "STRN", "RBAK", "LSHO", "LUPA",
    "LELB", "LFRM", "LWRA", "LWRB", "LFIN", "RSHO", "RUPA", "RELB", "RFRM", "RWRA", "RWRB",
    "RFIN", "LASI", "RASI", "LPSI", "RPSI", "SACR", "LTHI", "LKNE", "LTIB", "LANK", "LHEE",
    "LTOE", "RTHI", "RKNE", "RTIB", "RANK", "RHEE", "RTOE",
)  # fmt: skip
HELEN_HAYES = (
    "Top.Head", "Rear.Head", "Front.Head", "R.Shoulder", "R.Offset", "R.Elbow", "R.Wrist",
    "L.Shoulder", "L.Elbow", "L.Wrist", "R.ASIS", "L.ASIS", "V.Sacral", "R.Thigh", "R.Knee",
    "R.Shank", "R.Ankle", "R.Heel", "R.Toe", "L.Thigh", "L.Knee", "L.Shank", "L.Ankle",
    "L.Heel", "L.Toe",
)  # fmt: skip


@pytest.fixture(scope="module")
def places(body) -> dict[str, np.ndarray]:
    vertices = body.template.numpy()
    return {name: vertices[vertex] for name, vertex in landmarks().items()}


@pytest.fixture(scope="module")
def joints(body) -> dict[str, np.ndarray]:
    return dict(zip(JOINTS, body.joint_template.numpy(), strict=True))


def test_right_landmarks_mirror_the_left_ones(places):
    for name, place in places.items():
        if name.startswith("left_"):
            right = places[name.replace("left_", "right_")]
            assert np.allclose(right, place * [-1, 1, 1], atol=1e-5), name  # metres
            assert place[0] > 0.01, name
        elif not name.startswith("right_"):
            assert abs(place[0]) < 1e-5, name


def test_landmarks_are_different_vertices_of_the_body(body):
    vertices = list(landmarks().values())
    assert len(set(vertices)) == len(vertices)
    assert min(vertices) >= 0
    assert max(vertices) < len(body.template)


def test_opposite_sides_of_a_limb_lie_around_its_joint(places, joints):
    """Rest pose: palms down, so the elbow's outer side is up and the thumb's side in front."""
    x, y, z = range(3)
    for inner, outer, joint, axis in (
        ("knee_medial", "knee_lateral", "left_knee", x),
        ("ankle_medial", "ankle_lateral", "left_ankle", x),
        ("elbow_medial", "elbow_lateral", "left_elbow", y),
        ("wrist_ulnar", "wrist_radial", "left_wrist", z),
        ("shoulder_back", "shoulder_front", "left_shoulder", z),
        ("psis", "asis", "pelvis", z),
        ("heel", "big_toe", "left_ankle", z),
        ("toe1_base", "toe5_base", "left_foot", x),
        ("big_toe", "small_toe", "left_foot", x),
    ):
        low, high = places[f"left_{inner}"], places[f"left_{outer}"]
        assert low[axis] < high[axis] - 0.02, (inner, outer)  # metres
        if joint != "left_foot":
            assert low[axis] < joints[joint][axis] < high[axis], (inner, outer)


def test_trunk_and_head_are_in_order(places):
    heights = [places[name][1] for name in ("head_top", "forehead", "nose", "chin", "c7", "t2")]
    heights += [places[name][1] for name in ("t7", "t10", "l3", "sacrum")]
    assert heights == sorted(heights, reverse=True)
    front = ("sternal_notch", "sternum", "xiphoid", "navel")
    heights = [places[name][1] for name in front]
    assert heights == sorted(heights, reverse=True)
    assert min(places[name][2] for name in front) > places["t7"][2] + 0.1  # metres
    assert places["nose"][2] > places["left_eye"][2] > places["left_ear"][2]
    assert places["left_eye"][1] > places["nose"][1]


def test_feet_stand_on_the_sole(body, places):
    sole = float(body.template[:, 1].min())
    for name, highest in (("heel", 0.04), ("big_toe", 0.03), ("small_toe", 0.03)):
        assert places[f"left_{name}"][1] - sole < highest, name  # metres
    assert 0.2 < places["left_toe_tip"][2] - places["left_heel"][2] < 0.3  # a foot's length


def test_keypoints_are_43_and_symmetric():
    assert len(set(KEYPOINTS_43)) == len(KEYPOINTS_43) == 43
    swap = {"left": "right", "right": "left"}
    for name in KEYPOINTS_43:
        landmark(name)
        side, _, rest = name.partition("_")
        assert side not in swap or f"{swap[side]}_{rest}" in KEYPOINTS_43


def test_an_unknown_landmark_names_the_known_ones():
    with pytest.raises(ValueError, match="left_heel"):
        landmark("left_heal")


@pytest.mark.parametrize(
    "labels", [PLUG_IN_GAIT, HELEN_HAYES], ids=["plug-in gait", "helen hayes"]
)
def test_known_protocols_match_completely(labels):
    matched, unknown = match_markers(labels)
    assert unknown == ()
    for label, point in matched.items():
        side = {"L": "left_", "R": "right_"}.get(label[0])
        if point.startswith(("left_", "right_")):
            assert side is not None
            assert point.startswith(side), label


def test_spelling_does_not_matter_and_strangers_are_reported():
    assert normalised_label("Subject 01:L_Wrist.Med") == normalised_label("lwristmed")
    matched, unknown = match_markers(["Bob:LASI", "l.asis", "Left ASIS", "*113", "RKneeAngles"])
    assert matched == dict.fromkeys(["Bob:LASI", "l.asis", "Left ASIS"], "left_asis")
    assert unknown == ("*113", "RKneeAngles")


def test_a_user_map_takes_names_and_numbers(tmp_path):
    path = tmp_path / "map.toml"
    path.write_text('"Bob:LASI" = "left_asis"\nmole = 17\n')
    assert load_marker_map(path) == {"Bob:LASI": landmark("left_asis"), "mole": 17}


def test_a_user_map_may_be_json_and_leave_markers_out(tmp_path):
    path = tmp_path / "names.json"
    path.write_text('{"Channel101": "left_asis", "LHAND": "", "mole": null}')
    found = load_marker_map(path)
    assert found == {"Channel101": landmark("left_asis"), "LHAND": None, "mole": None}
    path.write_text("[1]")
    with pytest.raises(ValueError, match="expected an object"):
        load_marker_map(path)
    path.write_text("{")
    with pytest.raises(ValueError, match="not TOML or JSON"):
        load_marker_map(path)


BTS = ("c7", "r should", "sacrum", "r asis", "r thigh", "r bar 1", "r knee 1", "r knee 2",
       "r bar 2", "r mall", "r met", "r heel", "l mall", "l met")  # fmt: skip


def test_labels_of_bts_are_known_and_computed_centres_are_no_markers():
    """Knee and ankle of Davis' model, computed in the joint, were taken for the lateral markers
    whose labels they share in other protocols."""
    matched, unknown = match_markers((*BTS, "r knee", "l ankle", "r hip"))
    assert set(matched) == set(BTS)
    assert unknown == ("r knee", "l ankle", "r hip")
    assert matched["r knee 1"] == "right_knee_lateral"
    assert match_markers(["RKnee"])[0] == {"RKnee": "right_knee_lateral"}


def test_a_beginning_that_all_labels_share_is_ignored():
    matched, unknown = match_markers(["Walk01_LASI", "Walk01_RASI", "Walk01_C7", "*12"])
    assert list(matched.values()) == ["left_asis", "right_asis", "c7"]
    assert unknown == ("*12",)
    # what labels of a known set share is a part of their names
    assert match_markers(["L_IAS", "L_IPS"])[0] == {"L_IAS": "left_asis", "L_IPS": "left_psis"}


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ('LASI = "left_assis"', "no landmark 'left_assis'"),
        ("LASI = -1", "vertex number, got -1"),
        ("LASI = true", "got True"),
        ('L.ASIS = "left_asis"', "put labels with dots in quotes"),
        ("LASI left_asis", "not TOML"),
    ],
)
def test_a_wrong_user_map_is_refused(tmp_path, text, complaint):
    path = tmp_path / "map.toml"
    path.write_text(text)
    with pytest.raises(ValueError, match=complaint):
        load_marker_map(path)
    with pytest.raises(FileNotFoundError, match="no marker map"):
        load_marker_map(tmp_path / "none.toml")


def test_landmarks_file_is_flat_names_to_numbers():
    assert json.loads(json.dumps(dict(landmarks()))) == landmarks()
    with pytest.raises(TypeError):
        landmarks()["nose"] = 1  # type: ignore[index]


def test_real_recordings_match(data):
    ezc3d = pytest.importorskip("ezc3d")
    folder = data / "observations"
    for name, fewest in (
        ("cmu_c3d/02_01.c3d", 41),
        ("rehazenter/2014001_C1_01.c3d", 52),
        ("pycgm/RoboStatic.c3d", 35),
        ("nimblephysics/sehoon_squat.c3d", 51),
    ):
        labels = ezc3d.c3d(str(folder / name))["parameters"]["POINT"]["LABELS"]["value"]
        assert len(match_markers(labels)[0]) == fewest, name


def test_sixteen_landmarks_are_those_that_protocols_share():
    assert len(set(LANDMARKS_16)) == 16
    assert set(LANDMARKS_16) <= set(landmarks())
    assert set(LANDMARKS_16) <= set(match_markers(PLUG_IN_GAIT)[0].values())
    sided = [name.removeprefix("left_") for name in LANDMARKS_16 if name.startswith("left_")]
    assert sum(f"right_{name}" in LANDMARKS_16 for name in sided) == 7

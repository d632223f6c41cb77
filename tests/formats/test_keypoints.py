"""Files of 2D detectors: every producer's form, spellings of missing, refusals that say why."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from recon.core.layouts import keypoint_names
from recon.detections.reader import read_keypoints
from recon.detections.records import with_clipped_confidences
from recon.detections.tables import plain_part_name
from recon.formats.json_files import frame_numbers
from tests.keypoint_scene import SIZE, camera, figure, image, write_openpose


def person(layout: str) -> np.ndarray:
    return image(figure(layout), camera(20))


def write(path: Path, value: Any) -> Path:
    path.write_text(json.dumps(value))
    return path


@pytest.mark.parametrize("layout", ["openpose25", "openpose25b", "halpe26", "coco17"])
def test_openpose_folder_gives_back_what_was_written(tmp_path, layout):
    folder = write_openpose(tmp_path / "cam1", [[person(layout)], [], [person(layout)]], first=7)
    found = read_keypoints(folder)
    assert found.layout == layout
    assert found.frame_numbers.tolist() == [7, 8, 9]
    assert found.frame.tolist() == [7, 9]
    assert np.allclose(found.pixels[0], person(layout)[:, :2])
    assert np.allclose(found.confidence, 0.9)


def test_longer_and_older_openpose_models_keep_their_body(tmp_path):
    whole = np.concatenate((person("coco133"), np.full((110, 3), 5.0)))
    found = read_keypoints(write_openpose(tmp_path / "whole", [[whole]]))
    assert found.layout == "coco133"
    assert np.allclose(found.pixels[0], person("coco133")[:, :2])
    body = person("openpose25")
    coco18 = body[[*range(8), *range(9, 19)]]
    found = read_keypoints(write_openpose(tmp_path / "coco", [[coco18]]))
    assert found.layout == "openpose25"
    assert found.confidence[0, [8, *range(19, 25)]].tolist() == [0.0] * 7
    assert np.allclose(found.pixels[0, 9:19], body[9:19, :2])


def test_25_keypoints_of_too_few_bones_are_refused_with_the_way_out(tmp_path):
    head_only = person("openpose25")
    head_only[[*range(1, 15), *range(19, 25)]] = 0
    folder = write_openpose(tmp_path / "cam", [[head_only]])
    with pytest.raises(ValueError, match=r"BODY_25 or BODY_25B.*--layout openpose25b"):
        read_keypoints(folder)
    assert read_keypoints(folder, layout="openpose25").layout == "openpose25"
    with pytest.raises(ValueError, match=r"coco17 has 17 keypoints, the file 25"):
        read_keypoints(folder, layout="coco17")


def test_every_spelling_of_missing_is_zero():
    places = [(5, 6, 0.4), (0, 0, 0.9), (-1, -1, 0.9), (np.nan, 2, 0.9), (1, 2, np.nan),
              (1, 2, -0.3), (np.inf, 2, 1), (3, 4, 7.5)]  # fmt: skip
    found = with_clipped_confidences(np.array([places]))[0]
    assert np.allclose(found[0], (5, 6, 0.4))
    assert (found[1:7] == 0).all()
    assert found[7].tolist() == [3, 4, 1]


def test_mmpose_video_and_folder_and_rtmlib(tmp_path):
    body = person("coco17")
    instance = {"keypoints": body[:, :2].tolist(), "keypoint_scores": [1.3] * 17}
    frames = [{"frame_id": 1, "instances": [instance]}, {"frame_id": 2, "instances": []}]
    video = read_keypoints(write(tmp_path / "video.json", {"instance_info": frames}))
    assert (video.frame_numbers.tolist(), video.frame.tolist()) == ([1, 2], [1])
    assert (video.confidence == 1).all(), "SimCC scores are clipped"
    (tmp_path / "images").mkdir()
    for k in range(2):
        write(tmp_path / "images" / f"{k:05d}.json", [instance, instance])
    assert read_keypoints(tmp_path / "images").frame.tolist() == [0, 0, 1, 1]
    arrays = {"keypoints": [body[:, :2].tolist()] * 2, "scores": [[0.5] * 17] * 2}
    rtmlib = read_keypoints(write(tmp_path / "rtmlib.json", [arrays, arrays, arrays]))
    assert rtmlib.frame.tolist() == [0, 0, 1, 1, 2, 2]
    assert np.allclose(rtmlib.pixels[3], body[:, :2])


def test_alphapose_scores_run_to_six_for_coco_models(tmp_path):
    body = person("halpe26")
    people = [
        {"image_id": f"{k}.jpg", "keypoints": body.ravel().tolist(), "score": 2.0, "idx": 4}
        for k in (10, 2)
    ]
    found = read_keypoints(write(tmp_path / "alphapose-results.json", people))
    assert (found.frame_numbers.tolist(), found.identity.tolist()) == ([2, 10], [4, 4])
    assert np.allclose(found.confidence, 0.9)
    body[:, 2] = 3.0
    people[0]["keypoints"] = body.ravel().tolist()
    found = read_keypoints(write(tmp_path / "coco.json", people))
    assert np.allclose(found.confidence[1], 0.5)
    assert np.allclose(found.confidence[0], 0.15)


def test_alphapose_scores_a_little_above_one_become_one(tmp_path):
    """All were divided by 6 because of one of 1.06, and every keypoint counted as unsure."""
    body = person("halpe26")
    body[0, 2] = 1.06
    people = [{"image_id": "1.jpg", "keypoints": body.ravel().tolist(), "score": 2.0, "idx": 4}]
    found = read_keypoints(write(tmp_path / "a.json", people))
    assert found.confidence[0, 0] == 1.0
    assert np.allclose(found.confidence[0, 1:], 0.9)


def test_mediapipe_fractions_become_pixels_and_need_an_image(tmp_path):
    marks = [{"x": 0.25 + 0.01 * k, "y": 0.5, "z": 0.0, "visibility": 0.7} for k in range(33)]
    for name, value in {
        "tasks": [{"pose_landmarks": [marks]}, {"pose_landmarks": []}],
        "solutions": [{"frame": 0, "landmarks": marks}, {"frame": 1, "landmarks": None}],
    }.items():
        path = write(tmp_path / f"{name}.json", value)
        found = read_keypoints(path, image_size=SIZE)
        assert (found.layout, found.frame.tolist()) == ("mediapipe33", [0])
        assert np.allclose(found.pixels[0, 0], (320, 360))
        assert np.allclose(found.confidence, 0.7)
        with pytest.raises(ValueError, match=r"fractions of the image.*--camera"):
            read_keypoints(path)


def test_deeplabcut_parts_are_matched_by_name(tmp_path):
    parts = ["LShoulder", "right_shoulder", "left hip", "RKnee", "nose", "tailbase"]
    header = [["scorer", *["net"] * 18], ["bodyparts", *np.repeat(parts, 3)]]
    header.append(["coords", *["x", "y", "likelihood"] * 6])
    rows = [
        ["0", *map(str, range(1, 16)), "9", "9", "0.9"],
        ["1", "", "", "", *["4", "5", "0.5"] * 5],
    ]
    path = tmp_path / "cam.csv"
    path.write_text("\n".join(",".join(row) for row in [*header, *rows]))
    found = read_keypoints(path)
    assert found.layout == "coco17"
    assert "tailbase" in found.decisions[0]
    left, right = (keypoint_names("coco17").index(f"{s}_shoulder") for s in ("left", "right"))
    assert found.pixels[0, left].tolist() == [1, 2]
    assert found.confidence[1, [left, right]].tolist() == [0, 0.5]
    path.write_text(path.read_text().replace("Shoulder", "wing").replace("hip", "fin"))
    with pytest.raises(ValueError, match="known by name"):
        read_keypoints(path)


def test_spellings_of_body_parts():
    for spelling in (
        "LHip",
        "left_hip",
        "hip_left",
        "Left Hip",
        "lefthip",
        "leftHip",
        "l_hip",
        "LEFT_HIP",
        "LEFT HIP",
    ):
        assert plain_part_name(spelling) == "left_hip", spelling
    assert plain_part_name("LBigToe") == "left_big_toe"


def test_easymocap_annots(tmp_path):
    body = person("openpose25")
    for k in range(2):
        record = {"annots": [{"personID": 3, "bbox": [0] * 5, "keypoints": body.tolist()}]}
        write(tmp_path / f"{k:06d}.json", record)
    found = read_keypoints(tmp_path)
    assert (found.layout, found.identity.tolist()) == ("openpose25", [3, 3])


@pytest.mark.parametrize(("scale", "confidence"), [(1.0, 0.8), (100.0, 0.8), (10.0, 1.0)])
def test_confidences_in_per_cent_are_divided(scale, confidence, tmp_path):
    """All of them became 1, also those of keypoints that were hardly seen."""
    record = {"people": [{"pose_keypoints_2d": [9.0, 8.0, 0.8 * scale] * 17}]}
    (tmp_path / "0.json").write_text(json.dumps(record))
    found = read_keypoints(tmp_path)
    assert np.allclose(found.confidence, confidence)
    assert any("per cent" in one for one in found.decisions) == (scale == 100)


def test_labelled_images_of_three_index_columns_are_read(tmp_path):
    """DeepLabCut writes folder, video and image since 2.2, which gave too many cells."""
    names = keypoint_names("coco17")
    lines = [
        "scorer,," + ",me" * 34, "bodyparts,,," + ",".join(n for n in names for _ in "xy"),
        "coords,," + ",x,y" * 17,
        *(f"labeled-data,v,img{k:03d}.png" + ",7,8" * 17 for k in (3, 4)),
    ]  # fmt: skip
    (tmp_path / "CollectedData_me.csv").write_text("\n".join(lines))
    found = read_keypoints(tmp_path / "CollectedData_me.csv")
    assert found.frame_numbers.tolist() == [3, 4]
    assert (found.pixels == (7, 8)).all()


def test_frame_numbers_are_what_differs_between_names():
    assert frame_numbers(["cam1_003_halpe26", "cam1_010_halpe26"], "x") == [3, 10]
    assert frame_numbers(["cam01.0099"], "x") == [99]
    assert frame_numbers(["a_10", "a_20"], "x") == [10, 20]
    with pytest.raises(ValueError, match="one file per frame"):
        frame_numbers(["a_1_x", "b_1_y"], "x")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('{"people": [{"pose_keypoints_2d": [1, 2', "damaged"),
        ('{"people": [{"pose_keypoints_2d": [1, 2]}]}', "x, y, confidence"),
        ('{"people": [{"pose_keypoints_2d": [1, 2, "a"]}]}', "expected numbers"),
        ('{"people": [7]}', "list of people"),
        ('{"people": []}', "all 1 frames are empty"),
        ("{}", "all 1 frames are empty"),
        ('{"bodies": []}', "expected OpenPose"),
        ('[{"keypoints": [[1, 2]], "keypoint_scores": [1, 2]}]', "with scores"),
        ('{"people": [{"pose_keypoints_2d": [1, 2, 1]}]}', "no known layout has 1 keypoints"),
        ("3", "expected OpenPose"),
        ("[]", "expected OpenPose"),
        ("null", "expected OpenPose"),
        ('[[{"x": 0}]]', "expected OpenPose"),
        ('[{"image_id": "1.jpg", "keypoints": []}]', "empty"),
        ("[" * 100_000, "damaged"),
    ],
)
def test_damaged_json_is_refused_and_explained(tmp_path, text, message):
    path = tmp_path / "0001.json"
    path.write_text(text)
    with pytest.raises(ValueError, match=message) as caught:
        read_keypoints(path)
    assert "0001" in str(caught.value) or str(tmp_path) in str(caught.value)

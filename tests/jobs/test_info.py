"""`recon info` of what comes from cameras: told, or refused in a sentence."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from recon.formats.scans import write_ply
from recon.view.info import info
from tests.keypoint_scene import SIZE, camera, figure, image, write_openpose, write_toml

LAYOUT = "halpe26"


def view(folder: Path, angle: float, people: int = 1) -> Path:
    """Ten frames of standing people beside each other."""
    seen_by = camera(angle)
    places = [(0.0, 0.9 * k) for k in range(people)]
    frame = [image(figure(LAYOUT, place), seen_by) for place in places]
    return write_openpose(folder, [frame] * 10, first=5)


def test_a_view_tells_who_is_in_it(tmp_path):
    facts = info(view(tmp_path / "cam01_json", 0, people=2))
    assert facts["layout"] == LAYOUT
    assert facts["points"] == 26
    assert facts["frames"] == 10
    assert facts["frame_numbers"] == [5, 14]
    assert [text[:9] for text in facts["people"]] == ["person 0:", "person 1:"]
    assert facts["units"] == "pixels"
    assert any(LAYOUT in line for line in facts["decisions"])


def test_what_says_nothing_about_a_file_is_refused(tmp_path):
    for unused in ({"unit": "mm"}, {"up": "y"}, {"hand": "left"}):
        with pytest.raises(ValueError, match=f"uses no {next(iter(unused))} for 2D keypoints"):
            info(view(tmp_path / next(iter(unused)), 0), **unused)


def test_a_project_tells_its_views(tmp_path):
    view(tmp_path / "pose" / "cam01_json", 0)
    view(tmp_path / "pose" / "cam02_json", 20, people=2)
    facts = info(tmp_path)
    assert facts["format"] == "2D keypoints of 2 views"
    assert "person 1" in facts["cam02_json"]
    assert "person 1" not in facts["cam01_json"]


def test_fractions_of_an_image_need_no_camera_to_be_described(tmp_path):
    landmarks = [{"x": 0.5, "y": 0.3, "visibility": 0.9} for _ in range(33)]
    landmarks = [{**one, "x": 0.3 + 0.01 * k} for k, one in enumerate(landmarks)]
    path = tmp_path / "landmarks.json"
    path.write_text(json.dumps([landmarks, landmarks]))
    assert info(path)["layout"] == "mediapipe33"


def test_a_calibration_tells_where_its_cameras_stand(tmp_path):
    table = write_toml(tmp_path / "Calib.toml", {"a": camera(0), "b": camera(90)}, scale=1000.0)
    facts = info(table)
    assert facts["cameras"] == ["a", "b"]
    assert facts["unit"] == "mm"
    assert "at (4.00, 0.00, 1.20) m" in facts["camera a"]
    assert f"{SIZE[0]} x {SIZE[1]}" in facts["camera b"]
    assert info(tmp_path)["cameras"] == ["a", "b"]
    np.savez(tmp_path / "lens.npz", camera_matrix=np.eye(3) * [[900], [900], [1]], image_size=SIZE)
    assert "no pose" in info(tmp_path / "lens.npz")["camera lens"]


def test_scans_tell_unit_and_clock(tmp_path):
    cloud = np.random.default_rng(0).uniform((-300, -200, 0), (300, 200, 1800), (200, 3))
    for frame in range(4):
        write_ply(tmp_path / f"scan_{frame}.ply", cloud)
    facts = info(tmp_path)
    assert (facts["frames"], facts["points"], facts["units"]) == (4, 200, "mm")
    assert facts["fps"] is None
    assert any("--frame-rate" in line for line in facts["decisions"])
    (tmp_path / "times.csv").write_text("0.0\n0.1\n0.2\n0.3\n")
    assert info(tmp_path)["fps"] == pytest.approx(10)


def test_clouds_of_no_known_size_are_described_all_the_same(tmp_path):
    write_ply(tmp_path / "a.ply", np.random.default_rng(0).uniform(0, 30, (200, 3)))
    facts = info(tmp_path)
    assert facts["units"] is None
    assert any("--unit" in line for line in facts["decisions"])


def test_depth_images_and_masks_are_told_apart(tmp_path):
    for name, kind in (("depth", np.uint16), ("masks", np.uint8)):
        (tmp_path / name).mkdir()
        cv2.imwrite(str(tmp_path / name / "0.png"), np.full((20, 30), 200, kind))
    facts = info(tmp_path / "depth")
    assert (facts["format"], facts["frames"], facts["image_size"]) == ("depth images", 1, [30, 20])
    assert "masks" in info(tmp_path / "masks")["format"]
    np.savez(tmp_path / "mask.npz", mask=np.ones((3, 4, 5), bool))
    assert info(tmp_path / "mask.npz").items() >= {"format": "masks", "frames": 3}.items()


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("a.json", b"{"), ("a.json", b"[]"), ("a.json", b"3"), ("a.json", b""),
        ("a.csv", b"1,2\n3"), ("a.toml", b"= 3"), ("a.yml", b"%YAML"), ("a.png", b"png"),
        ("a.ply", b"ply"), ("folder/a.png", b"png"), ("folder/a.ply", b"ply"),
        ("folder/a.json", b"{"), ("folder/a.txt", b"hello"), ("folder/a.toml", b"= 3"),
    ],
)  # fmt: skip
def test_what_is_damaged_is_refused_by_name(name, content, tmp_path):
    path = tmp_path / name
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(content)
    shown = path.parent if "/" in name else path
    with pytest.raises(ValueError, match=shown.name):
        info(shown)

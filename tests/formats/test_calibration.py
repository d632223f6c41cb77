"""Calibration files: every format gives the same camera; units, up axis and lenses are checked."""

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from recon.formats.calibration import load_cameras
from recon.formats.observations import CameraArrays
from tests.keypoint_scene import SIZE, camera, write_toml


def assert_same(found: CameraArrays, true: CameraArrays) -> None:
    assert found.image_size == true.image_size
    for key in ("camera_matrix", "distortion", "T_camera_world"):
        one, other = getattr(found, key), getattr(true, key)
        assert (one is None) == (other is None), key
        assert one is None or np.allclose(one, other, atol=1e-9), key


def write_yaml(path: Path, values: dict[str, np.ndarray | float | list[str]]) -> None:
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for key, value in values.items():
        if isinstance(value, list):
            storage.startWriteStruct(key, cv2.FileNode_SEQ)
            for text in value:
                storage.write("", text)
            storage.endWriteStruct()
        else:
            storage.write(key, value)
    storage.release()


@pytest.mark.parametrize(("scale", "unit"), [(1.0, "m"), (1000.0, "mm")])
def test_toml_tells_metres_from_millimetres(tmp_path, scale, unit):
    cameras = {"cam_01": camera(10), "cam_02": camera(100)}
    found = load_cameras(write_toml(tmp_path / "Calib.toml", cameras, scale))
    assert found.unit == unit
    for name, true in cameras.items():
        assert_same(found.cameras[name], true)


def test_a_unit_between_the_two_is_refused_unless_given(tmp_path):
    path = write_toml(tmp_path / "Calib.toml", {"cam": camera(10)}, 30.0)
    with pytest.raises(ValueError, match="--camera-unit m or --camera-unit mm"):
        load_cameras(path)
    pose = load_cameras(path, unit="mm").cameras["cam"].T_camera_world
    true = camera(10).T_camera_world
    assert pose is not None
    assert true is not None
    assert np.allclose(pose[0, :3, 3], 0.03 * true[0, :3, 3])


@pytest.mark.parametrize("up", ["x", "y"])
def test_another_up_axis_turns_the_world(tmp_path, up):
    """A point in the file's world is seen where it was, under its coordinates with z up."""
    path = write_toml(tmp_path / "Calib.toml", {"cam": camera(10)})
    before = load_cameras(path, up="z").cameras["cam"].T_camera_world
    after = load_cameras(path, up=up).cameras["cam"].T_camera_world
    assert before is not None
    assert after is not None
    point = np.array([0.3, 0.5, 0.7])
    turned = {"x": (0.5, 0.7, 0.3), "y": (0.3, -0.7, 0.5)}[up]
    assert np.allclose(before[0] @ [*point, 1], after[0] @ [*turned, 1])


def test_easymocap_and_single_yaml_and_npz_give_the_same_camera(tmp_path):
    true = camera(30)
    assert true.T_camera_world is not None
    assert true.distortion is not None
    matrix, pose = true.camera_matrix, true.T_camera_world[0]
    lens = np.pad(true.distortion, (0, 1))[None]
    write_yaml(
        tmp_path / "intri.yml",
        {"names": ["01"], "K_01": matrix, "dist_01": lens, "H_01": 720.0, "W_01": 1280.0},
    )
    turn, shift = np.asarray(cv2.Rodrigues(pose[:3, :3])[0]), pose[:3, 3:]
    write_yaml(tmp_path / "extri.yml", {"R_01": turn, "Rot_01": pose[:3, :3], "T_01": shift})
    padded = CameraArrays(matrix, SIZE, lens[0], true.T_camera_world)
    for path in (tmp_path, tmp_path / "intri.yml", tmp_path / "extri.yml"):
        assert_same(load_cameras(path).cameras["01"], padded)
    write_yaml(
        tmp_path / "front.yml",
        {"image_width": 1280, "image_height": 720, "camera_matrix": matrix,
         "distortion_coefficients": lens, "rvec": turn, "tvec": shift},
    )  # fmt: skip
    assert_same(load_cameras(tmp_path / "front.yml").cameras["front"], padded)
    np.savez(
        tmp_path / "plain.npz", camera_matrix=matrix, image_size=SIZE, distortion=lens[0],
        T_camera_world=pose,
    )  # fmt: skip
    assert_same(load_cameras(tmp_path / "plain.npz").cameras["plain"], padded)


def test_prox_has_no_level_world_and_no_image_size(tmp_path):
    path = tmp_path / "Color.json"
    record = {"camera_mtx": camera(0).camera_matrix.tolist(), "k": [0.1, 0, 0, 0, 0],
              "view_mtx": np.eye(4)[:3].tolist()}  # fmt: skip
    path.write_text(json.dumps(record))
    with pytest.raises(ValueError, match="--image-size"):
        load_cameras(path)
    found = load_cameras(path, image_size=SIZE)
    assert found.cameras["Color"].T_camera_world is None
    assert "left out" in found.decisions[0]
    given = load_cameras(path, image_size=SIZE, up="z").cameras["Color"].T_camera_world
    assert given is not None
    assert np.allclose(given, np.eye(4))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("fisheye = false", "fisheye = true", "fisheye"),
        ("matrix = [[900.0", "matrix = [[-900.0", "focal length"),
        ("matrix = [[900.0", "matrix = [[nan", "NaN"),
        ("translation = [", "translation = [1.0, ", "translation of 3"),
        ("distortions = [", "distortions = [1.0, 1.0, ", "distortion coefficients"),
        ("distortions = [", "distortions = ['a', ", "numbers in the distortion"),
        ("rotation =", "turn =", "both rotation and translation"),
        ("size =", "extent =", "--image-size"),
        ("[cam]", "[cam", "damaged"),
        ("matrix =", "matrices =", "tables of cameras"),
    ],
)
def test_bad_toml_is_refused_and_explained(tmp_path, old, new, message):
    path = write_toml(tmp_path / "Calib.toml", {"cam": camera(10)})
    path.write_text(path.read_text().replace(old, new))
    with pytest.raises(ValueError, match=message):
        load_cameras(path)


@pytest.mark.parametrize("text", ["a: [", "words", "%YAML:1.0\n---\nother: 1\n", "%YAML:1.0\n"])
def test_bad_yaml_is_refused(tmp_path, text):
    path = tmp_path / "cam.yml"
    path.write_text(text)
    with pytest.raises(ValueError, match=r"cam\.yml"):
        load_cameras(path)


def test_a_damaged_matrix_is_not_taken_for_an_absent_one(tmp_path):
    """OpenCV's reader ended the process on such files; ours must not drop the distortion."""
    path = tmp_path / "cam.yml"
    lens = np.array([[0.1, 0, 0, 0, 0]])
    values = {"image_width": 9, "image_height": 9, "D": lens}
    values["camera_matrix"] = np.diag([9.0, 9.0, 1.0])
    write_yaml(path, values)
    assert load_cameras(path).cameras["cam"].distortion is not None
    whole = path.read_text()
    for damaged in (whole.replace("cols: 5", "cols: five"), whole.replace("cols: 5", "cols: 4")):
        path.write_text(damaged)
        with pytest.raises(ValueError, match="damaged"):
            load_cameras(path)


def test_missing_and_foreign_files(tmp_path):
    with pytest.raises(FileNotFoundError, match="no such calibration"):
        load_cameras(tmp_path / "none.toml")
    (tmp_path / "calib.txt").write_text("1")
    with pytest.raises(ValueError, match=r"\.toml"):
        load_cameras(tmp_path / "calib.txt")
    with pytest.raises(ValueError, match=r"intri\.yml"):
        load_cameras(tmp_path)


def test_camera_info_of_ros_is_read_and_its_fisheyes_are_refused(tmp_path):
    """Coefficients of `equidistant` lenses were taken for k1, k2, p1, p2."""
    true, rows = camera(10), []
    assert true.distortion is not None
    shapes = {
        "camera_matrix": true.camera_matrix,
        "distortion_coefficients": true.distortion[None],
    }
    for name, matrix in shapes.items():
        rows += [f"{name}:", f"  rows: {len(matrix)}", f"  cols: {matrix.shape[1]}",
                 f"  data: {matrix.ravel().tolist()}"]  # fmt: skip
    rows += [f"image_width: {SIZE[0]}", f"image_height: {SIZE[1]}", "distortion_model: plumb_bob"]
    path = tmp_path / "ros.yaml"
    path.write_text("\n".join(rows))
    assert_same(load_cameras(path).cameras["ros"], replace(true, T_camera_world=None))
    path.write_text("\n".join(rows).replace("plumb_bob", "equidistant"))
    with pytest.raises(ValueError, match="fisheye lenses are not read"):
        load_cameras(path)


def test_camera_array_of_caliscope_is_read(tmp_path):
    path = write_toml(tmp_path / "camera_array.toml", {"0": camera(10), "1": camera(100)})
    lines = [line for line in path.read_text().splitlines() if not line.startswith("name")]
    nested = (
        "\n".join(lines).replace("[0]", "[cameras.0]").replace("[1]", "[cameras.1]\nignore = true")
    )
    path.write_text(nested)
    found = load_cameras(path).cameras
    assert list(found) == ["cam_0"]
    assert_same(found["cam_0"], camera(10))

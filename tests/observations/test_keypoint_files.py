"""2D files and calibrations together: the right person, the right camera, or a clear refusal."""

import itertools
import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from recon.fitting.settings import ReadOptions
from recon.formats.observations import CameraArrays, KeypointsFile
from recon.reading.places import inside_silhouettes, load_silhouettes, match_cameras
from recon.reading.views import Views, read_views
from tests.keypoint_scene import SIZE, camera, figure, image, write_openpose, write_toml

CAMERAS = {
    "cam_01": camera(0),
    "cam_02": camera(80, 3.5),
    "cam_03": camera(200, 5.0),
    "cam_04": camera(280, 4.5),
}
LAYOUT = "halpe26"
FRAMES = 12


def walker(t: int) -> np.ndarray:
    return figure(LAYOUT, (0.03 * t - 0.2, 0.7))


def bystander(t: int) -> np.ndarray:
    return figure(LAYOUT, (0.6, -1.0 + 0.001 * t))


def load_views(paths, calibration, person=None, *, fps, **how) -> Views:
    options = ReadOptions(camera=calibration, frame_rate=fps, **how)
    return read_views(paths, options).views_of_person(person)


def write_scene(
    folder: Path, *people: Callable[[int], np.ndarray], cameras: dict[str, CameraArrays] = CAMERAS
) -> Path:
    """Three of the cameras, people in another order in every second frame of the second view."""
    for k, (name, one) in enumerate(list(cameras.items())[:3]):
        frames = []
        for t in range(FRAMES):
            seen = [image(person(t), one) for person in people]
            frames.append(seen[::-1] if k == 1 and t % 2 == 0 else seen)
        write_openpose(folder / f"cam{name[-2:]}_json", frames)
    write_toml(folder / "Calib.toml", cameras)
    return folder


def test_views_are_matched_by_name_and_give_the_pixels_back(tmp_path):
    folder = write_scene(tmp_path / "trial", walker)
    views = load_views([folder], folder / "Calib.toml", fps=60.0)
    assert views.names == ("cam_01", "cam_02", "cam_03")
    assert "cameras without a view: cam_04" in views.decisions
    for name, file in zip(views.names, views.files, strict=True):
        assert (file.layout, file.fps, file.camera.image_size) == (LAYOUT, 60.0, SIZE)
        true = np.stack([image(walker(t), CAMERAS[name])[:, :2] for t in range(FRAMES)])
        assert np.allclose(file.pixels, true)
        assert np.allclose(file.camera.T_camera_world, CAMERAS[name].T_camera_world)


@pytest.mark.parametrize(("person", "who"), [(0, walker), (1, bystander)])
def test_the_same_person_is_taken_in_every_view(tmp_path, person, who):
    """The second view has the people in another order: the rays decide who is who."""
    folder = write_scene(tmp_path / "trial", walker, bystander)
    views = load_views([folder], folder / "Calib.toml", fps=60.0, person=person)
    for name, file in zip(views.names, views.files, strict=True):
        true = np.stack([image(who(t), CAMERAS[name])[:, :2] for t in range(FRAMES)])
        assert np.allclose(file.pixels, true)
    with pytest.raises(ValueError, match=r"two persons .*--person"):
        load_views([folder], folder / "Calib.toml", fps=60.0)


@pytest.mark.parametrize("upwards", [("01", "02", "03"), ("02",)])
def test_keypoints_whose_y_points_up_are_turned_where_rays_tell(tmp_path, upwards):
    """The message blamed cameras and calibration."""
    folder = write_scene(tmp_path / "trial", walker)
    if len(upwards) == 1:  # of three views, the other two would agree without it
        shutil.rmtree(folder / "cam03_json")
    for path in (one for name in upwards for one in (folder / f"cam{name}_json").iterdir()):
        record = json.loads(path.read_text())
        points = np.reshape(record["people"][0]["pose_keypoints_2d"], (-1, 3))
        record["people"][0]["pose_keypoints_2d"] = (
            (points * (1, -1, 1) + (0, SIZE[1], 0)).ravel().tolist()
        )
        path.write_text(json.dumps(record))
    views = load_views([folder], folder / "Calib.toml", fps=60.0)
    for name, file in zip(views.names, views.files, strict=True):
        true = np.stack([image(walker(t), CAMERAS[name])[:, :2] for t in range(FRAMES)])
        assert np.allclose(file.pixels, true)
    assert any("points up" in said for said in views.decisions)


def test_a_track_lost_in_one_view_is_joined_where_the_others_agree(tmp_path):
    folder = write_scene(tmp_path / "trial", walker)
    frames = []
    for t in range(FRAMES):
        places = [0.0] if t not in (5, 6) else [-0.1, 0.1]  # two people where one was
        people = [walker(t) + np.array((x, 0, 0)) for x in places]
        frames.append([image(one, CAMERAS["cam_02"]) for one in people])
    write_openpose(tmp_path / "other" / "cam_02", frames)
    paths = [folder / "cam01_json", tmp_path / "other" / "cam_02", folder / "cam03_json"]
    file = load_views(paths, folder / "Calib.toml", fps=60.0).files[1]
    alone = [*range(5), *range(7, FRAMES)]
    true = np.stack([image(walker(t), CAMERAS["cam_02"])[:, :2] for t in alone])
    assert np.allclose(file.pixels[alone], true)


def test_missing_frames_have_no_confidence(tmp_path):
    folder = write_scene(tmp_path / "trial", walker)
    files = sorted((folder / "cam01_json").iterdir())
    files[0].unlink()
    files[3].unlink()
    files[4].write_text("{}")
    views = load_views([folder], folder / "Calib.toml", fps=60.0)
    assert [len(file.confidence) for file in views.files] == [FRAMES] * 3
    empty = views.files[0].confidence.max(1) == 0
    assert np.flatnonzero(empty).tolist() == [0, 3, 4]
    assert (views.files[0].pixels[empty] == 0).all()


def refusal(folder: Path, message: str, **options: object) -> None:
    with pytest.raises(ValueError, match=message):
        load_views([folder], folder / "Calib.toml", **{"fps": 60.0, **options})  # type: ignore[arg-type]


def test_what_does_not_fit_together_is_refused(tmp_path):
    folder = write_scene(tmp_path / "trial", walker)
    refusal(folder, "--frame-rate", fps=None)
    for names in itertools.permutations(CAMERAS, 3):
        if names != ("cam_01", "cam_02", "cam_03"):
            swapped = {f"cam_0{k + 1}": CAMERAS[name] for k, name in enumerate(names)}
            write_toml(folder / "Calib.toml", swapped)
            refusal(folder, r"own camera|its camera|--camera-up|--camera-unit")
    write_toml(folder / "Calib.toml", CAMERAS)
    refusal(folder, "--camera-unit", camera_unit="mm")
    with pytest.raises(ValueError, match="--camera"):
        load_views([folder], None, fps=60.0)
    with pytest.raises(FileNotFoundError, match="nowhere"):
        load_views([tmp_path / "nowhere"], folder / "Calib.toml", fps=60.0)
    (tmp_path / "empty").mkdir()
    with pytest.raises(ValueError, match="a folder per camera"):
        load_views([tmp_path / "empty"], folder / "Calib.toml", fps=60.0)


def test_millimetres_are_read_and_centimetres_are_found_out(tmp_path):
    folder = write_scene(tmp_path / "trial", walker)
    write_toml(folder / "Calib.toml", CAMERAS, 1000.0)
    file = load_views([folder], folder / "Calib.toml", fps=60.0).files[0]
    assert np.allclose(file.camera.T_camera_world, CAMERAS["cam_01"].T_camera_world)
    write_toml(folder / "Calib.toml", CAMERAS, 100.0)
    refusal(folder, "trunk 0.04.* m long.*--camera-unit")


def test_a_world_that_does_not_stand_on_z_is_found_out(tmp_path):
    turn = np.eye(4)
    turn[:3, :3] = [[1, 0, 0], [0, 0, -1], [0, 1, 0]]  # y up to z up
    cameras = {
        name: replace(one, T_camera_world=one.T_camera_world @ turn)
        for name, one in CAMERAS.items()
        if one.T_camera_world is not None
    }
    folder = write_scene(tmp_path / "trial", walker)
    write_toml(folder / "Calib.toml", cameras)
    refusal(folder, "stands along y.*--camera-up")
    file = load_views([folder], folder / "Calib.toml", fps=60.0, camera_up="y").files[0]
    assert np.allclose(file.camera.T_camera_world, CAMERAS["cam_01"].T_camera_world)


def test_images_of_another_size_are_found_out(tmp_path):
    folder = write_scene(tmp_path / "trial", walker)
    tall = {k: replace(one, image_size=SIZE[::-1]) for k, one in CAMERAS.items()}
    for path in folder.glob("cam*/*.json"):
        record = json.loads(path.read_text())
        values = np.array(record["people"][0]["pose_keypoints_2d"]).reshape(-1, 3)
        values[:, 0] += 300
        record["people"][0]["pose_keypoints_2d"] = values.ravel().tolist()
        path.write_text(json.dumps(record))
    write_toml(folder / "Calib.toml", tall)
    refusal(folder, "width and height seem to be swapped")
    small = {k: replace(one, image_size=(320, 180)) for k, one in CAMERAS.items()}
    write_toml(folder / "Calib.toml", small)
    refusal(folder, "another camera or resolution")
    for path in folder.glob("cam*/*.json"):
        record = json.loads(path.read_text())
        values = np.array(record["people"][0]["pose_keypoints_2d"]).reshape(-1, 3)
        values[:, :2] /= SIZE
        record["people"][0]["pose_keypoints_2d"] = values.ravel().tolist()
        path.write_text(json.dumps(record))
    refusal(folder, "near \\[0, 1\\]")


def test_views_that_count_frames_differently_are_refused(tmp_path):
    folder = write_scene(tmp_path / "trial", walker)
    frames = [[image(walker(t), CAMERAS["cam_04"])] for t in range(FRAMES)]
    write_openpose(folder / "cam04_json", frames, first=1)
    refusal(folder, "count their frames differently.*from 1 to 12")


def test_one_view_needs_no_pose_and_no_matching_name(tmp_path):
    folder = write_openpose(
        tmp_path / "front", [[image(walker(t), CAMERAS["cam_01"])] for t in range(FRAMES)], first=5
    )
    one = CAMERAS["cam_01"]
    np.savez(tmp_path / "phone.npz", camera_matrix=one.camera_matrix, image_size=SIZE)
    views = load_views([folder], tmp_path / "phone.npz", fps=30.0)
    assert (views.first_frame, views.names) == (5, ("phone",))
    assert views.files[0].camera.T_camera_world is None


def test_names_of_views_and_cameras():
    cameras = ["cam_01", "cam_02", "cam_11"]
    for views in (["cam1_json", "CAM02"], ["trial3_cam_1", "Camera 2"], ["01_cam_01", "cam-002"]):
        assert match_cameras(views, cameras)[0] == ["cam_01", "cam_02"]
    with pytest.raises(ValueError, match=r"view left matches no camera.*cam_01, cam_02"):
        match_cameras(["left", "cam1"], cameras)
    with pytest.raises(ValueError, match="cam_01 belongs to several views, cam1, cam_01_json"):
        match_cameras(["cam1", "cam_01_json"], cameras)
    with pytest.raises(ValueError, match="cam_01 and cam_02"):
        match_cameras(["cam_01_cam_02"], cameras)


def test_keypoints_outside_the_silhouette_are_not_believed(tmp_path):
    pixels = np.array([[[20.0, 20], [60, 20], [30, 45], [-5, 20]]] * 3)
    one = CameraArrays(np.eye(3), (80, 50))
    file = KeypointsFile(pixels, np.ones((3, 4)), "coco17", 30.0, one)
    mask = np.zeros((50, 80), np.uint8)
    mask[10:40, 10:40] = 255
    for frame, picture in ((5, mask), (6, 0 * mask)):
        cv2.imwrite(str(tmp_path / f"frame_{frame}.png"), picture)
    out = inside_silhouettes(file, load_silhouettes(tmp_path), first_frame=5)
    assert out.confidence.tolist() == [[1, 0, 1, 0], [0] * 4, [1] * 4]
    assert (out.pixels[out.confidence == 0] == 0).all()
    np.savez(tmp_path / "mask.npz", mask=np.stack((mask, 0 * mask)) > 0)
    same = inside_silhouettes(file, load_silhouettes(tmp_path / "mask.npz"))
    assert np.array_equal(same.confidence, out.confidence)
    with pytest.raises(ValueError, match="no mask is of a frame from 20 to 22"):
        inside_silhouettes(file, load_silhouettes(tmp_path), first_frame=20)
    small = replace(file, camera=CameraArrays(np.eye(3), (40, 50)))
    with pytest.raises(ValueError, match="40 x 50 pixels, got 80 x 50"):
        inside_silhouettes(small, load_silhouettes(tmp_path), first_frame=5)
    (tmp_path / "frame_5.png").write_bytes(b"no image")
    with pytest.raises(ValueError, match="damaged"):
        inside_silhouettes(file, load_silhouettes(tmp_path), first_frame=5)


@pytest.mark.parametrize("name", ["single_balancing", "multi_participants12"])
def test_real_detections_of_three_views(data, tmp_path, name):
    """OpenPose found a second person in two views, and split one body into two in one frame."""
    import zipfile

    folder = data / "observations" / "pose2sim"
    with zipfile.ZipFile(folder / f"{name}.zip") as archive:
        archive.extractall(tmp_path)
    pose = next(path for path in tmp_path.rglob("pose") if path.is_dir())
    person = None if name == "single_balancing" else 2
    views = load_views([pose], folder / "Calib_qualisys.toml", fps=60.0, person=person)
    assert views.names == ("cam_01", "cam_02", "cam_03")
    assert [file.layout for file in views.files] == ["openpose25b"] * 3
    assert min((file.confidence.max(1) > 0).sum() for file in views.files) >= 98


def test_unseen_frames_between_numbers_that_step_by_two_are_told(tmp_path):
    """Every second frame was unseen, without a word."""
    folder = write_scene(tmp_path / "trial", walker)
    for path in folder.glob("*_json/*.json"):
        number = int(path.name.split("_")[-2])
        path.rename(path.with_name(f"{path.parent.name}_2{2 * number:03d}_keypoints.json_"))
    for path in folder.glob("*_json/*.json_"):
        path.rename(path.with_suffix(".json"))
    views = read_views([folder], ReadOptions(camera=folder / "Calib.toml", frame_rate=30.0))
    assert views.frames == 2 * FRAMES - 1
    assert any("step by 2" in one for one in views.decisions)

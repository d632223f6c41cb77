"""`recon simulate` for cameras: which cameras there are, what they keep, and what is refused."""

import inspect
import math
from dataclasses import replace
from importlib import resources
from pathlib import Path

import numpy as np
import pytest
import torch

from recon.api.simulate import simulate
from recon.body.landmarks import LANDMARKS_16, landmark
from recon.body.model import BodyModel
from recon.core.camera import full_hd_camera
from recon.core.motion import Motion
from recon.formats.motions import load_motion, save_motion
from recon.formats.observations import KeypointsFile, PointsFile, PositionsFile, load_observation
from recon.formats.scans import read_scans
from recon.simulation.images import cameras_around
from recon.simulation.points import Corruption, joints3d
from recon.simulation.sensors import refuse_other_options
from recon.simulation.settings import FilmSettings, SurfaceSettings
from tests.keypoint_scene import camera, write_toml
from tests.verbs import simulate_file

NOTHING = Corruption()


@pytest.fixture(scope="module")
def clip(tmp_path_factory) -> Path:
    """Six frames of the bundled walk."""
    with resources.as_file(resources.files("recon") / "assets" / "demo.npz") as path:
        motion = load_motion(path).motion.window(30, 36)
    target = tmp_path_factory.mktemp("clip") / "truth.npz"
    save_motion(target, motion)
    return target


@pytest.fixture(scope="module")
def walk(clip) -> Motion:
    return load_motion(clip).motion


@pytest.fixture(scope="module")
def person() -> BodyModel:
    return BodyModel.load()


def keypoints(path: Path) -> KeypointsFile:
    file = load_observation(path)
    assert isinstance(file, KeypointsFile)
    return file


def test_front_and_side_look_at_the_body_from_there(walk, person):
    front = cameras_around(walk, person, FilmSettings())["cam1"]
    side = cameras_around(walk, person, FilmSettings(camera="side"))["cam1"]
    facing = walk.rotations[:, 0, :, 2].mean(0)
    facing[2] = 0
    facing = facing / facing.norm()
    middle = person.pose(walk).joints.flatten(0, -2).mean(0)
    ahead = (front.T_world_camera[:3, 3] - middle)[:2]
    assert torch.dot(ahead / ahead.norm(), facing[:2]) > 0.95
    left = (side.T_world_camera[:3, 3] - middle)[:2]
    assert abs(torch.dot(left / left.norm(), facing[:2])) < 0.3
    for one in (front, side):
        projected = one.project(person.pose(walk).joints)
        assert one.in_image(projected.pixels).all()
        assert projected.in_front.all()


def test_several_views_are_a_folder_and_see_the_same_body(clip, walk, person, tmp_path):
    film = FilmSettings(views=3, layout="smpl22")
    paths = simulate_file(clip, tmp_path / "views", "keypoints2d", NOTHING, seed=0, film=film)
    assert [path.name for path in paths] == ["cam1.npz", "cam2.npz", "cam3.npz"]
    joints = person.pose(walk).joints
    cameras = cameras_around(walk, person, film)
    for path, one in zip(paths, cameras.values(), strict=True):
        file = keypoints(path)
        assert file.layout == "smpl22"
        seen = file.confidence > 0
        away = np.abs(file.pixels - one.project(joints).pixels.numpy())[seen]
        assert away.max() < 1e-2  # pixels
        assert file.truth_T_world_camera is None
        assert file.camera.T_camera_world is not None


def test_noise_of_two_views_is_not_the_same(clip, tmp_path):
    film = FilmSettings(views=2)
    noisy, clean = Corruption(noise=3.0), tmp_path / "clean"
    paths = simulate_file(clip, tmp_path / "noisy", "keypoints2d", noisy, seed=4, film=film)
    clear = simulate_file(clip, clean, "keypoints2d", NOTHING, seed=4, film=film)
    off = [keypoints(a).pixels - keypoints(b).pixels for a, b in zip(paths, clear, strict=True)]
    both = np.all([keypoints(path).confidence > 0 for path in paths], 0)
    assert np.concatenate(off)[np.concatenate([both, both])].std() == pytest.approx(3, rel=0.15)
    correlation = np.corrcoef(off[0][both].ravel(), off[1][both].ravel())[0, 1]
    assert abs(correlation) < 0.2


@pytest.mark.parametrize("kind", ["keypoints2d", "depth"])
def test_an_unknown_ground_leaves_the_pose_to_the_truth(kind, clip, walk, person, tmp_path):
    lost, placed = tmp_path / "lost.npz", tmp_path / "placed.npz"
    simulate_file(clip, lost, kind, NOTHING, seed=0, unknown_ground=True)
    simulate_file(clip, placed, kind, NOTHING, seed=0)
    file, known = load_observation(lost), load_observation(placed)
    assert isinstance(file, KeypointsFile | PointsFile)
    assert isinstance(known, KeypointsFile | PointsFile)
    assert file.camera is not None
    assert known.camera is not None
    assert file.camera.T_camera_world is None
    assert file.truth_T_world_camera is not None
    assert known.camera.T_camera_world is not None
    away = file.truth_T_world_camera @ known.camera.T_camera_world[0] - np.eye(4)
    assert np.abs(away).max() < 1e-6
    if isinstance(file, PointsFile) and isinstance(known, PointsFile):
        T = file.truth_T_world_camera
        world = file.points @ T[:3, :3].T + T[:3, 3]
        assert np.abs(world - known.points).max() < 1e-5  # metres


def test_things_are_hidden_during_their_time_alone(clip, walk, tmp_path):
    begin = walk.start_time + 2 / walk.fps - 1e-3
    hidden = Corruption(hide_below=0.9, during=(begin, begin + 2 / walk.fps))
    path = tmp_path / "seen.npz"
    simulate_file(clip, path, "keypoints2d", hidden, seed=0, film=FilmSettings(layout="smpl22"))
    truth = keypoints(path).truth_visible
    assert truth is not None
    assert truth[:, [7, 8]].all(1).tolist() == [True, True, False, False, True, True]


def test_any_two_opposite_corners_give_a_box(walk, person):
    """A box whose first corner was not the lower one hid nothing, without a word."""
    low, high = (-9.0, -9.0, -1.0), (9.0, 9.0, 0.5)
    boxes = (low, high), (high, low), ((-9.0, 9.0, 0.5), (9.0, -9.0, -1.0))
    seen = [joints3d(walk, person, Corruption(hide_box=box), 0).visible for box in boxes]
    assert not seen[0][:, [7, 8]].any()  # ankles
    assert (seen[1] == seen[0]).all()
    assert (seen[2] == seen[0]).all()


def test_a_moving_camera_has_a_pose_per_frame(clip, tmp_path):
    path = tmp_path / "moving.npz"
    film = FilmSettings(orbit=0.5)
    simulate_file(clip, path, "keypoints2d", NOTHING, seed=0, film=film)
    poses = keypoints(path).camera.T_camera_world
    assert poses is not None
    assert poses.shape == (6, 4, 4)
    ahead = poses[:, 2, :3]  # the viewing axis in the world
    turned = math.acos(np.clip(ahead[0] @ ahead[-1], -1, 1))
    assert turned == pytest.approx(0.5, abs=0.15)  # radians


def test_cameras_of_a_calibration_are_taken_as_they_stand(clip, walk, person, tmp_path):
    cameras = {"left": camera(0, 6.0), "right": camera(90, 6.0)}
    table = write_toml(tmp_path / "Calib.toml", cameras)
    film = FilmSettings(camera=str(table))
    paths = simulate_file(clip, tmp_path / "out", "keypoints2d", NOTHING, seed=0, film=film)
    assert [path.stem for path in paths] == ["left", "right"]
    for path, one in zip(paths, cameras.values(), strict=True):
        kept = keypoints(path).camera
        assert np.allclose(kept.camera_matrix, one.camera_matrix, atol=1e-3)
        assert kept.distortion is not None
        assert one.T_camera_world is not None
        assert kept.T_camera_world is not None
        assert np.allclose(kept.T_camera_world, one.T_camera_world, atol=1e-5)


def test_a_lens_without_pose_is_placed_in_front(walk, person, tmp_path):
    lens = full_hd_camera()
    np.savez(tmp_path / "lens.npz", camera_matrix=lens.camera_matrix, image_size=lens.image_size)
    film = FilmSettings(camera=str(tmp_path / "lens.npz"))
    placed = cameras_around(walk, person, film)["lens"]
    front = cameras_around(walk, person, FilmSettings())["cam1"]
    assert torch.allclose(placed.T_camera_world, front.T_camera_world, atol=1e-5)


def test_scans_and_depth_keep_their_noise(clip, tmp_path):
    sizes = {}
    for kind in ("depth", "scans"):
        for noise in (0.0, 0.03):
            path = tmp_path / f"{kind}{noise}.npz"
            simulate_file(clip, path, kind, Corruption(noise=noise), seed=0)
            file = load_observation(path)
            assert isinstance(file, PointsFile)
            sizes[kind, noise] = np.linalg.norm(file.points.std(0))
        assert sizes[kind, 0.03] > sizes[kind, 0.0]


@pytest.mark.parametrize("offset", [0.0, 0.02])
def test_landmarks_are_markers_beside_the_skin(offset, clip, walk, person, tmp_path):
    """The offset is drawn once and turns with the bone."""
    path = tmp_path / "landmarks.npz"
    surface = SurfaceSettings(skin_offset=offset)
    simulate_file(clip, path, "landmarks", NOTHING, seed=1, surface=surface)
    file = load_observation(path)
    assert isinstance(file, PositionsFile)
    assert file.kind == "markers3d"
    assert file.names == LANDMARKS_16
    vertices = [landmark(name) for name in file.names]
    posed = person.pose(walk)
    away = torch.from_numpy(file.positions) - posed.points(torch.tensor(vertices))
    assert float(away.square().mean().sqrt()) == pytest.approx(offset, rel=0.3, abs=1e-6)
    bones = posed.orientations[:, person.weights[vertices].argmax(-1)].double()
    local = (bones.mT @ away[..., None])[..., 0]
    assert local.std(0).max() < 1e-5


def test_scans_have_as_many_points_as_asked_of_clothes_if_asked(clip, walk, person, tmp_path):
    surfaces = person.pose(walk).vertices.double()
    away = []
    for clothes in (None, 3):
        path = tmp_path / f"{clothes}.npz"
        surface = SurfaceSettings(points=300, clothed=clothes)
        simulate_file(clip, path, "scans", NOTHING, seed=0, surface=surface)
        file = load_observation(path)
        assert isinstance(file, PointsFile)
        points = torch.from_numpy(file.points).reshape(6, 300, 3)
        away.append(torch.cdist(points, surfaces).amin(-1).mean())
    assert away[1] > away[0] + 0.001


def test_scans_become_a_folder_of_clouds(clip, walk, tmp_path):
    few = SurfaceSettings(points=200)
    written = simulate_file(clip, tmp_path / "scans", "scans", NOTHING, seed=0, surface=few)
    assert written == (tmp_path / "scans",)
    simulate_file(clip, tmp_path / "scans.npz", "scans", NOTHING, seed=0, surface=few)
    folder, file = read_scans(*written, outliers=None), load_observation(tmp_path / "scans.npz")
    assert isinstance(file, PointsFile)
    assert np.array_equal(folder.frame, file.frame)
    assert np.abs(folder.points - file.points).max() < 1e-6
    assert folder.fps == pytest.approx(walk.fps, rel=1e-6)
    assert folder.start_time == pytest.approx(file.start_time, abs=1e-6)


@pytest.mark.parametrize(
    ("kind", "surface", "words"),
    [
        ("landmarks", SurfaceSettings(points=100), "points and clothed"),
        ("joints3d", SurfaceSettings(clothed=1), "points and clothed"),
        ("scans", SurfaceSettings(skin_offset=0.02), "skin offset"),
        ("landmarks", SurfaceSettings(skin_offset=-0.01), "zero or more"),
        ("depth", SurfaceSettings(points=0), "one or more"),
    ],
)
def test_options_of_other_sensors_are_refused(kind, surface, words, clip, tmp_path):
    with pytest.raises(ValueError, match=words):
        simulate_file(clip, tmp_path / "o.npz", kind, NOTHING, seed=0, surface=surface)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("kind", "film", "unknown", "words"),
    [
        ("joints3d", FilmSettings(layout="coco17"), False, "do not apply"),
        ("scans", FilmSettings(), True, "unknown ground"),
        ("depth", FilmSettings(layout="coco17"), False, "layout is"),
        ("keypoints2d", FilmSettings(layout="frobnicate"), False, "frobnicate"),
        ("keypoints2d", FilmSettings(views=0), False, "views:"),
        ("keypoints2d", FilmSettings(views=2), True, "cannot be combined"),
        ("keypoints2d", FilmSettings(orbit=1.0), True, "moving camera"),
        ("keypoints2d", FilmSettings(views=2), False, "give a folder"),
    ],
)
def test_contradictions_are_refused_and_nothing_is_written(
    kind, film, unknown, words, clip, tmp_path
):
    with pytest.raises(ValueError, match=words):
        simulate_file(
            clip, tmp_path / "o.npz", kind, NOTHING, seed=0, film=film, unknown_ground=unknown
        )
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("kind", ["joints3d", "keypoints2d", "depth", "scans"])
def test_a_time_of_hiding_without_anything_hidden_is_refused(kind, clip, tmp_path):
    """--during alone was ignored without a word."""
    when = Corruption(during=(0.0, 1.0))
    with pytest.raises(ValueError, match="hide points below a height"):
        simulate_file(clip, tmp_path / "o.npz", kind, when, seed=0)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("kind", ["joints3d", "markers3d", "landmarks", "scans", "depth"])
def test_every_kind_hides_what_is_below_a_height(kind, clip, tmp_path):
    """Depth ignored --hide-below, and wrote a cloud of the whole body."""
    path = tmp_path / "seen.npz"
    simulate_file(clip, path, kind, Corruption(hide_below=0.9), seed=0)
    seen = load_observation(path)
    if isinstance(seen, PointsFile):
        assert len(seen.points) > 0
        assert seen.points[:, 2].min() >= 0.9
    else:
        assert isinstance(seen, PositionsFile)
        assert not seen.visible.all()
        assert seen.positions[seen.visible][:, 2].min() > 0.85  # landmarks have an offset
    assert seen.truth_visible is not None
    assert not seen.truth_visible[:, [7, 8]].any()  # ankles


def test_hiding_at_times_outside_the_motion_is_refused(walk):
    """`during` counted from the first frame hid nothing in a clip that begins later."""
    assert walk.start_time > 0.5
    with pytest.raises(ValueError, match=rf"from {walk.start_time:.2f} to .* of its own clock"):
        simulate(walk, "joints3d", hide_below=0.9, during=(0.0, 0.5))


def test_an_unknown_kind_is_refused():
    """`joints` instead of `joints3d` gave markers, without a word."""
    refuse = inspect.unwrap(refuse_other_options)  # only tests check types
    with pytest.raises(ValueError, match=r"among joints3d, .*; got \('joints',\)"):
        refuse("joints", FilmSettings(), SurfaceSettings(), NOTHING)


def test_poses_of_other_frames_are_refused(clip, walk, tmp_path):
    """A part of a motion was filmed by a moving camera with the poses of its first frames."""
    poses = torch.eye(4).repeat(walk.frames, 1, 1)
    poses[:, 2, 3] = 4.0
    np.savez(
        tmp_path / "moving.npz",
        camera_matrix=full_hd_camera().camera_matrix.numpy(),
        image_size=np.array([1920, 1080]),
        T_camera_world=poses.numpy(),
    )
    film = FilmSettings(camera=str(tmp_path / "moving.npz"))
    assert cameras_around(walk, BodyModel.load(), film)
    with pytest.raises(ValueError, match="6 poses, but the motion has 3 frames"):
        cameras_around(walk.window(3, 6), BodyModel.load(), film)


def test_a_missing_calibration_names_the_presets(clip, tmp_path):
    film = FilmSettings(camera="frnt")
    with pytest.raises(FileNotFoundError, match="front, side"):
        simulate_file(clip, tmp_path / "o.npz", "keypoints2d", NOTHING, seed=0, film=film)
    with pytest.raises(ValueError, match="during"):
        replace(NOTHING, during=(2.0, 1.0))

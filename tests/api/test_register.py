"""Three simulated depth cameras whose poses are 10 cm and 5 degrees off, or not known at all."""

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

import recon
from recon import cli
from recon.body.model import BodyModel
from recon.core.camera import depth_camera, pose_looking_at
from recon.core.errors import ReconError
from recon.formats.calibration import load_cameras
from recon.formats.observations import PointsFile, load_observation, save_observation
from recon.simulation.depth import PixelSurface, depth_points
from recon.simulation.points import Corruption
from recon.simulation.scenery import furniture_around
from tests.walking import a_walk

FURNITURE = ("chair", "table", "box")


@cache
def filmed() -> tuple[list[PointsFile], list[np.ndarray]]:
    """What each camera saw of a person between furniture, in its own axes, and T_world_camera."""
    body, files, poses = BodyModel.load(), [], []
    motion = a_walk(body, seconds=1.0, speed=0.6).resample(6.0)
    things = furniture_around(FURNITURE, np.array([0.0, 0.3, 0.9]), 0.0)
    for k, degrees in enumerate((-60, 0, 55)):
        angle = math.radians(degrees)
        place = torch.tensor([2.4 * math.sin(angle), 0.3 - 2.4 * math.cos(angle), 1.2 + 0.2 * k])
        T = pose_looking_at(place.double(), torch.tensor([0.0, 0.3, 0.8]).double())
        camera = depth_camera().replace(T_camera_world=T.float())
        seen = depth_points(
            motion, body, camera, Corruption(), k, points=12_000, furniture=things,
            surfaces=(PixelSurface.BODY, PixelSurface.GROUND, PixelSurface.FURNITURE),
        )  # fmt: skip
        T = np.asarray(seen.camera.T_camera_world[0], np.float64)
        lens = replace(seen.camera, T_camera_world=None)
        files.append(replace(seen, points=seen.points @ T[:3, :3].T + T[:3, 3], camera=lens))
        poses.append(np.linalg.inv(T))
    return files, poses


def saved(folder, *, posed: bool) -> list:
    """Files of the cameras; their poses are off by 10 cm and 5 degrees, or missing."""
    random, paths = np.random.default_rng(0), []
    for k, (file, pose) in enumerate(zip(*filmed(), strict=True)):
        if posed:
            axis, shift = random.normal(size=(2, 3))
            T = pose.copy()
            turn = np.radians(5) * axis / np.linalg.norm(axis)
            T[:3, :3] = T[:3, :3] @ Rotation.from_rotvec(turn).as_matrix()
            T[:3, 3] += 0.1 * shift / np.linalg.norm(shift)
            file = replace(
                file, points=file.points @ T[:3, :3].T + T[:3, 3],
                camera=replace(file.camera, T_camera_world=np.linalg.inv(T)[None]),
            )  # fmt: skip
        paths.append(folder / f"camera{k}.npz")
        save_observation(paths[-1], file)
    return paths


def errors(cameras) -> np.ndarray:
    """Metres at the person, and degrees, that each camera misses its place beside the first."""
    poses = filmed()[1]
    found = [np.linalg.inv(one.T_camera_world[0]) for one in cameras]
    person, out = np.array([0.0, 0.3, 0.9]), []
    for true, one in zip(poses[1:], found[1:], strict=True):
        D = poses[0] @ np.linalg.inv(found[0]) @ one @ np.linalg.inv(true)
        angle = np.degrees(Rotation.from_matrix(D[:3, :3]).magnitude())
        out.append((np.linalg.norm(D[:3, :3] @ person + D[:3, 3] - person), angle))
    return np.array(out)


def test_rough_poses_become_exact(tmp_path, capsys):
    paths = saved(tmp_path, posed=True)
    out = tmp_path / "rig"
    cli.run(["register", *map(str, paths), "--out", str(out), "--json"])
    assert "the ground that camera0 sees is z = 0" in capsys.readouterr().out
    files = [load_observation(out / path.name) for path in paths]
    off = errors([file.camera for file in files])
    assert off[:, 0].max() < 0.01
    assert off[:, 1].max() < 0.5
    calibrated = load_cameras(out / "camera1.npz").cameras["camera1"]
    assert np.allclose(calibrated.T_camera_world, files[1].camera.T_camera_world)
    for file in files:
        low = np.quantile(file.points[:, 2], 0.2)
        assert abs(low) < 0.02


def test_cameras_without_poses_are_brought_together_by_the_path(tmp_path):
    """Both rooms that were tried were refused, as bodies fitted to one camera alone differ."""
    paths = saved(tmp_path, posed=False)
    rig = recon.register(paths)
    off = errors([file.camera for file in rig.files.values()])
    assert off[:, 0].max() < 0.01
    assert off[:, 1].max() < 0.5
    assert len(list(rig)) == 3
    assert "begun by the path of the person" in rig.decisions
    file = load_observation(paths[1])
    assert isinstance(file, PointsFile)
    shaken = file.points + np.array([1.5, 0.0, 0.0]) * (file.frame % 2)[:, None]
    save_observation(tmp_path / "shaken.npz", replace(file, points=shaken))
    with pytest.raises(ReconError, match="another path than in camera0"):
        recon.register([paths[0], tmp_path / "shaken.npz"])


def test_what_is_no_rig_is_refused(tmp_path):
    paths = saved(tmp_path, posed=True)
    with pytest.raises(ReconError, match="two or more cameras"):
        recon.register(paths[:1])
    with pytest.raises(ReconError, match="two or more cameras"):
        recon.register([paths[0], paths[0]])
    file = load_observation(paths[1])
    save_observation(tmp_path / "far.npz", replace(file, start_time=100.0))
    with pytest.raises(ReconError, match="far: saw nothing at the same time"):
        recon.register([*paths[:2], tmp_path / "far.npz"])
    (tmp_path / "images").mkdir()
    (tmp_path / "images" / "0.png").touch()
    with pytest.raises(ReconError, match="depth images need"):
        recon.register([paths[0], tmp_path / "images"])


def test_what_no_file_needs_is_refused(tmp_path):
    paths = saved(tmp_path, posed=True)
    for unused in ({"camera": paths[0]}, {"frame_rate": 30.0}, {"depth_scale": float("nan")}):
        with pytest.raises(ReconError, match=f"{next(iter(unused))}: .* leave them out"):
            recon.register(paths[:2], **unused)  # pyright: ignore[reportArgumentType]


def test_what_is_no_list_of_paths_is_refused():
    joints = recon.Joints3D(np.zeros((4, 1, 3)), np.ones((4, 1), bool), [0], fps=30.0)
    for given in ("one.npz", [joints, joints]):
        with pytest.raises(ReconError, match="expected paths of two or more cameras"):
            recon.register(given)


def test_a_film_is_refused_on_the_command_line(tmp_path, capsys):
    paths = saved(tmp_path, posed=True)
    (tmp_path / "film.mp4").write_bytes(b"no film")
    given = [str(paths[0]), str(tmp_path / "film.mp4"), "--out", str(tmp_path / "rig")]
    assert cli.run(["register", *given]) == cli.BAD_INPUT
    assert "film.mp4" in capsys.readouterr().err


def test_scans_of_a_wide_room_with_textures_and_dots_in_their_names_are_read(tmp_path):
    folders = [tmp_path / "cam.1", tmp_path / "cam.2"]
    for folder, file in zip(folders, filmed()[0], strict=False):
        folder.mkdir()
        (folder / "texture.PNG").touch()
        for frame in range(3):
            cloud = file.points[file.frame == frame]
            np.savetxt(folder / f"{frame}.xyz", cloud, fmt="%.4f")
    rig = recon.register(folders, frame_rate=6.0)
    assert list(rig.files) == ["cam.1", "cam.2"]

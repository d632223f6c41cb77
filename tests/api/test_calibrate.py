"""Poses and focal lengths of cameras from a figure that walks about, beside the true ones."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import recon
from recon import cli
from recon.api.calibrate import CameraRig
from recon.core.errors import ObservationError
from recon.core.layouts import keypoint_names
from recon.formats.calibration import load_cameras
from recon.formats.cameras import CameraArrays
from recon.reading.rig import FilmedPerson, rig_of_person
from tests.keypoint_scene import camera, figure, image, write_openpose, write_toml

LAYOUT, FPS, FRAMES = "openpose25", 30.0, 60
NOISE = 2.0
"""Pixels."""
TALL = 1.75
"""Metres from the figure's soles to its crown."""
TRUE = [replace(camera(angle), distortion=np.zeros(4)) for angle in (0.0, 70.0, 150.0)]


def walk() -> np.ndarray:
    """A figure that walks about and swings its arms and legs ever faster."""
    out = []
    for t in np.arange(FRAMES) / FPS:
        points, swing = figure(LAYOUT), 0.25 * np.sin(2 * np.pi * (t + 0.3 * t**2))
        for k, name in enumerate(keypoint_names(LAYOUT)):
            side = 1.0 if name.startswith("left") else -1.0
            if name.endswith(("wrist", "elbow")):
                points[k, 0] += side * swing
            if name.endswith(("ankle", "heel", "toe", "knee")):
                points[k, 0] -= side * swing
        turn = Rotation.from_euler("z", 1.5 * t).as_matrix()
        out.append(points @ turn.T + (0.8 * np.cos(1.5 * t), 0.5 * np.sin(2.3 * t), 0.0))
    return np.stack(out)


def images(seen_by: CameraArrays, seed: int) -> np.ndarray:
    rows = np.stack([image(points, seen_by) for points in walk()])
    rows[..., :2] += np.random.default_rng(seed).normal(0, NOISE, rows[..., :2].shape)
    return rows


def filmed() -> list[FilmedPerson]:
    """What three phones see whose focal length, 900 pixels, is guessed as 800."""
    rows = [images(one, seed) for seed, one in enumerate(TRUE)]
    return [
        FilmedPerson(f"view {k}", one[..., :2], one[..., 2], 800.0, 0.3, np.array([640.0, 360]))
        for k, one in enumerate(rows)
    ]


def relative(poses: list[np.ndarray]) -> list[np.ndarray]:
    """Poses in the frame of the first camera, whose distance from the second is the unit."""
    found = [one @ np.linalg.inv(poses[0]) for one in poses[1:]]
    unit = np.linalg.norm(found[0][:3, 3])
    return [np.block([[one[:3, :3], one[:3, 3:] / unit], [np.zeros((1, 3)), 1]]) for one in found]


def check_poses(poses: list[np.ndarray], degrees: float, share: float) -> None:
    truth = [one.T_camera_world[0] for one in TRUE if one.T_camera_world is not None]
    for found, true in zip(relative(poses), relative(truth), strict=True):
        turn = Rotation.from_matrix(found[:3, :3] @ true[:3, :3].T).magnitude()
        assert np.degrees(turn) < degrees
        assert np.linalg.norm(found[:3, 3] - true[:3, 3]) < share


def test_cameras_are_found_from_a_walking_figure():
    rig = rig_of_person(filmed(), longest_shift=10)
    check_poses(list(rig.T_camera_world), degrees=1.5, share=0.04)
    assert rig.focal == pytest.approx([900.0] * 3, rel=0.04)
    assert rig.late == pytest.approx([0.0] * 3, abs=0.3)
    assert rig.error < 2 * NOISE / 900


def test_film_that_began_later_is_found():
    views = filmed()
    views[1] = views[1].shifted(-7)
    rig = rig_of_person(views, longest_shift=15)
    assert rig.late == pytest.approx([0.0, 7.0, 0.0], abs=0.5)
    check_poses(list(rig.T_camera_world), degrees=2.0, share=0.06)


def test_known_vertical_is_shared_by_all_cameras():
    ups = [one.T_camera_world[0, :3, 2] for one in TRUE if one.T_camera_world is not None]
    views = [replace(one, up=up) for one, up in zip(filmed(), ups, strict=True)]
    rig = rig_of_person(views, longest_shift=0)
    worlds = [T[:3, :3].T @ up for T, up in zip(rig.T_camera_world, ups, strict=True)]
    assert np.degrees(np.arccos(np.clip(worlds[0] @ worlds[2], -1, 1))) < 1.0


def test_other_people_s_views_are_refused():
    views = filmed()
    views[2] = replace(views[2], pixels=views[2].pixels[::-1].copy())
    with pytest.raises(ObservationError, match="view 2"):
        rig_of_person(views, longest_shift=0)


def test_points_that_no_two_views_share_are_refused():
    views = filmed()
    for k, one in enumerate(views):
        hidden = np.where(np.arange(FRAMES)[:, None] // 20 == k, one.confidence, 0.0)
        views[k] = replace(one, confidence=hidden)
    with pytest.raises(ObservationError, match="share 60 keypoints"):
        rig_of_person(views, longest_shift=0)


def test_calibration_is_written_and_read(tmp_path: Path):
    folders = [
        write_openpose(tmp_path / f"cam{k}", [[one] for one in images(camera_, k)])
        for k, camera_ in enumerate(TRUE)
    ]
    out = tmp_path / "rig.toml"
    size = ["--image-size", *map(str, TRUE[0].image_size)]
    given = [*map(str, folders), "--frame-rate", "30", "--layout", LAYOUT, *size]
    cli.run(["calibrate", *given, "--height", str(TALL), "--out", str(out)])
    found = load_cameras(out).cameras
    poses = [found[one.name].T_camera_world[0] for one in folders]  # pyright: ignore[reportOptionalSubscript]
    check_poses(poses, degrees=2.0, share=0.06)
    # the world is level, the ground at z = 0, and the unit is that of the person's height
    for pose, one in zip(poses, TRUE, strict=True):
        assert one.T_camera_world is not None
        tilt = np.arccos(np.clip(pose[:3, 2] @ one.T_camera_world[0, :3, 2], -1, 1))
        assert np.degrees(tilt) < 5
        assert np.linalg.inv(pose)[2, 3] == pytest.approx(1.2, abs=0.25)
    spread = np.linalg.norm(np.linalg.inv(poses[0])[:3, 3] - np.linalg.inv(poses[1])[:3, 3])
    assert spread == pytest.approx(2 * 4 * np.sin(np.radians(35)), rel=0.1)


def test_known_lenses_keep_their_distortion(tmp_path: Path):
    bent = [replace(one, distortion=camera(0.0).distortion) for one in TRUE]
    folders = [
        write_openpose(tmp_path / f"cam{k}", [[one] for one in images(camera_, k)])
        for k, camera_ in enumerate(bent)
    ]
    named = {one.name: camera_ for one, camera_ in zip(folders, bent, strict=True)}
    lenses = write_toml(tmp_path / "lenses.toml", named)
    rig = recon.calibrate(folders, camera=lenses, frame_rate=FPS, layout=LAYOUT, height=TALL)
    for found, true in zip(rig.cameras.values(), bent, strict=True):
        assert found.distortion == pytest.approx(true.distortion)
        assert found.camera_matrix[0, 0] == pytest.approx(900.0, rel=0.01)
    check_poses([one.T_camera_world[0] for one in rig.cameras.values()], degrees=1.5, share=0.04)  # pyright: ignore[reportOptionalSubscript]


def test_one_view_is_refused(tmp_path):
    (tmp_path / "cam.json").write_text("{}")
    with pytest.raises(ObservationError, match="two or more cameras, got 1"):
        recon.calibrate([tmp_path / "cam.json"])


def test_impossible_height_is_refused():
    with pytest.raises(ObservationError, match=r"height: expected 0\.5 to 2\.5 metres, got 180"):
        recon.calibrate(["a.json", "b.json"], height=180.0)


def test_short_recordings_are_no_error_of_a_library():
    """Films may begin a second apart, which is longer than these are."""
    short = [
        replace(one, pixels=one.pixels[:20], confidence=one.confidence[:20]) for one in filmed()
    ]
    check_poses(list(rig_of_person(short, 30).T_camera_world), degrees=4.0, share=0.1)
    one = [replace(view, pixels=view.pixels[:1], confidence=view.confidence[:1]) for view in short]
    with pytest.raises(ObservationError, match="share 60 keypoints"):
        rig_of_person(one, 30)


def test_films_that_begin_too_far_apart_are_refused():
    views = filmed()[:2]
    views[1] = views[1].shifted(-9)
    with pytest.raises(ObservationError, match="begin 9 frames apart, expected at most 5"):
        rig_of_person(views, longest_shift=5)


def calibrated(tmp_path: Path, keep: list[np.ndarray], **options: Any) -> CameraRig:
    folders = [
        write_openpose(tmp_path / f"cam{k}", [[one * kept[:, None]] for one in images(camera_, k)])
        for k, (camera_, kept) in enumerate(zip(TRUE[: len(keep)], keep, strict=True))
    ]
    how = {"frame_rate": FPS, "layout": LAYOUT, "image_size": TRUE[0].image_size}
    return recon.calibrate(folders, **{**how, **options})


def test_a_person_without_feet_tells_no_vertical(tmp_path: Path):
    feet = np.array([not name.endswith("ankle") for name in keypoint_names(LAYOUT)])
    with pytest.raises(ObservationError, match="film the person from head to foot"):
        calibrated(tmp_path, [feet, feet])


def test_films_of_other_moments_are_refused(tmp_path: Path):
    rows = [images(one, seed) for seed, one in enumerate(TRUE[:2])]
    early = write_openpose(tmp_path / "early", [[one] for one in rows[0][:20]])
    later = write_openpose(tmp_path / "later", [[one] for one in rows[1][41:]], first=41)
    size = TRUE[0].image_size
    with pytest.raises(ObservationError, match="do all views show one person"):
        recon.calibrate([early, later], frame_rate=FPS, layout=LAYOUT, image_size=size)


def test_what_keypoints_do_not_need_is_refused(tmp_path: Path):
    every = np.ones(25)
    with pytest.raises(ObservationError, match="does not use detector, detections"):
        calibrated(tmp_path, [every, every], detector="full", detections="kept")


def test_a_frame_rate_of_zero_is_refused(tmp_path: Path):
    every = np.ones(25)
    with pytest.raises(ObservationError, match="it was given as 0"):
        calibrated(tmp_path, [every, every], frame_rate=0.0)

"""True extremes: recordings that are rare but real, each of which a reader must take."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from recon.detections.reader import read_keypoints
from recon.formats.calibration import load_cameras
from recon.formats.motions import load_motion
from recon.formats.observations import (
    CameraArrays,
    KeypointsFile,
    ObservationFile,
    PointsFile,
    PositionsFile,
    load_observation,
    save_observation,
)
from recon.formats.scan_times import in_time_order
from recon.mocap.marker_tables import write_trc
from recon.mocap.reader import read_recording
from tests.formats.test_large_files import chain
from tests.formats.test_markers import make_markers
from tests.formats.test_npz import amass

SEEN = np.ones((4, 3), dtype=bool)
BODY = np.array([[0.0, 0.0, 1.6], [0.0, 0.0, 0.9], [0.0, 0.1, 0.0]])
JOINTS = PositionsFile(
    "joints3d", np.tile(BODY, (4, 1, 1)), SEEN, ("head", "pelvis", "left_ankle"), 30.0
)
HD = CameraArrays(np.array([[1500.0, 0, 960], [0, 1500.0, 540], [0, 0, 1]]), (1920, 1080))
VIEW = KeypointsFile(np.full((4, 17, 2), 500.0), np.full((4, 17), 0.9), "coco17", 30.0, HD)
CLOUD = PointsFile(np.tile(BODY, (4, 1)), np.repeat(np.arange(4), 3), 30.0)


def lens(f: float, size: tuple[int, int], distortion: list[float] | None = None) -> CameraArrays:
    """A camera of a focal length in pixels that looks through the middle of its image."""
    matrix = np.array([[f, 0, size[0] / 2], [0, f, size[1] / 2], [0, 0, 1]])
    return CameraArrays(matrix, size, None if distortion is None else np.array(distortion))


def posed(camera: CameraArrays, *translation: float, poses: int = 1) -> CameraArrays:
    pose = np.tile(np.eye(4), (poses, 1, 1))
    pose[:, :3, 3] = translation
    return replace(camera, T_camera_world=pose)


def moving(speed: float, fps: float = 100.0, frames: int = 400) -> PositionsFile:
    path = np.zeros((frames, 1, 3))
    path[:, 0, 0] = speed / fps * np.arange(frames)
    return replace(JOINTS, positions=BODY + path, visible=np.ones((frames, 3), bool), fps=fps)


def of_matrix(matrix: list[list[float]], size: tuple[int, int]) -> KeypointsFile:
    return replace(VIEW, camera=CameraArrays(np.array(matrix, np.float64), size))


def ticks(step: int, fps: float) -> PointsFile:
    return replace(
        CLOUD, frame=1_760_000_000 * int(fps) + np.repeat(np.arange(4), 3) * step, fps=fps
    )


OBSERVATIONS: dict[str, ObservationFile] = {
    "a child of 1 m": replace(JOINTS, positions=0.6 * JOINTS.positions),
    "a newborn of 0.5 m": replace(JOINTS, positions=0.3 * JOINTS.positions),
    "a man of 2.2 m": replace(JOINTS, positions=1.35 * JOINTS.positions),
    "1,000 Hz": replace(JOINTS, fps=1000.0),
    "10,000 Hz": replace(JOINTS, fps=10_000.0),
    "time lapse, a frame a minute": replace(JOINTS, fps=1 / 60),
    "time lapse, a frame in ten minutes": replace(JOINTS, fps=1 / 600),
    "a sprint at 12 m/s": moving(12.0),
    "a downhill skier at 45 m/s": moving(45.0),
    "survey coordinates 9 km away": replace(JOINTS, positions=JOINTS.positions + 9e3),
    "a mine 1,000 m below the origin": replace(JOINTS, positions=JOINTS.positions - 1e3),
    "seconds since 1970": replace(JOINTS, start_time=1_760_000_000.25),
    "a clip before the trigger": replace(JOINTS, start_time=-3600.0),
    "one frame": replace(JOINTS, positions=JOINTS.positions[:1], visible=SEEN[:1]),
    "one joint": replace(
        JOINTS, positions=JOINTS.positions[:, :1], visible=SEEN[:, :1], names=("head",)
    ),
    "a suit of 400 markers": PositionsFile(
        "markers3d", np.zeros((4, 400, 3)), np.ones((4, 400), bool),
        tuple(f"M{k}" for k in range(400)), 120.0,
    ),
    "an hour at 60 Hz": moving(0.01, 60.0, 216_000),
    "nothing visible but one joint": replace(JOINTS, visible=SEEN & (np.arange(3) == 1)),
    "8K video": replace(VIEW, camera=lens(6000.0, (7680, 4320))),
    "16K video": replace(VIEW, camera=lens(12_000.0, (15_360, 8640))),
    "a thermal sensor of 32 x 24 pixels": replace(VIEW, camera=lens(30.0, (32, 24))),
    "a depth sensor of 8 x 8 pixels": replace(VIEW, camera=lens(9.0, (8, 8))),
    "a lens of 1,200 mm before an 8K sensor": replace(VIEW, camera=lens(256_000.0, (7680, 4320))),
    "an action camera of 130 degrees": replace(
        VIEW, camera=lens(450.0, (1920, 1080), [-0.25, 0.08, 0.001, 0.001, -0.01])
    ),
    "large coefficients of a long lens": replace(
        VIEW, camera=lens(60_000.0, (1920, 1080), [2.0, 900.0, 0.0, 0.0, 4e4])
    ),
    "a rational lens": replace(
        VIEW, camera=lens(900.0, (1920, 1080), [19.8, 35.0, 0.0, 0.0, 2.0, 20.0, 40.0, 7.0])
    ),
    "an anamorphic lens": of_matrix([[1500, 0, 960], [0, 3000, 540], [0, 0, 1]], (1920, 1080)),
    "a person cut out of an 8K image": of_matrix(
        [[6000, 0, -3000], [0, 6000, 900], [0, 0, 1]], (256, 512)
    ),
    "a camera on a hill 5 km away": replace(VIEW, camera=posed(HD, 0, 0, 5000.0)),
    "a camera that moves": replace(VIEW, camera=posed(HD, 0, 0, 3.0, poses=4)),
    "joints guessed far outside the image": replace(VIEW, pixels=VIEW.pixels - 9000.0),
    "a confidence of 1 but for rounding": replace(VIEW, confidence=VIEW.confidence / 0.9 + 1e-7),
    "133 keypoints": replace(
        VIEW, pixels=np.ones((4, 133, 2)), confidence=np.ones((4, 133)), layout="coco133"
    ),
    "a cloud of one point": replace(CLOUD, points=BODY[:1], frame=np.array([0])),
    "a cloud of 300,000 points": PointsFile(np.ones((300_000, 3)), np.zeros(300_000, int), 30.0),
    "a laser scanner 200 m away": replace(CLOUD, points=CLOUD.points + 200.0),
    "frames numbered by milliseconds": ticks(33, 1e3),
    "frames numbered by microseconds": ticks(33_333, 1e6),
    "frames numbered by nanoseconds since 1970": ticks(33_333_333, 1e9),
    "a minute without a frame": replace(CLOUD, frame=np.repeat([0, 1, 1800, 1801], 3)),
    "numbers that begin in the middle": replace(CLOUD, frame=CLOUD.frame + 500_000),
}  # fmt: skip


@pytest.mark.parametrize("name", OBSERVATIONS)
def test_an_observation_is_taken(tmp_path: Path, name: str) -> None:
    written = OBSERVATIONS[name]
    save_observation(tmp_path / "o.npz", written)
    read = load_observation(tmp_path / "o.npz")
    assert type(read) is type(written)
    if isinstance(read, PointsFile) and isinstance(written, PointsFile):
        seconds = read.start_time + read.frame / read.fps
        assert np.abs(seconds - written.start_time - written.frame / written.fps).max() < 1e-3
        assert read.frame.max() < 20_000
    else:
        assert read.fps == written.fps


MOTIONS: dict[str, dict[str, Any]] = {
    "a shape at five standard deviations": {"betas": np.full(10, -5.0)},
    "300 coefficients": {"betas": np.zeros(300)},
    "a pirouette of three turns, counted on": {
        "poses": np.pad(np.full((3, 1), 18.8), ((0, 0), (2, 63)))
    },
    "a motion at 1,000 Hz": {"mocap_framerate": 1000.0},
    "a probability of 1 but for rounding": {"contacts": np.full((3, 22), 1 + 1e-6)},
    "certain joints": {"joint_std": np.zeros((3, 22))},
    "a motion far from the origin": {"trans": np.full((3, 3), 8000.0)},
}


@pytest.mark.parametrize("name", MOTIONS)
def test_a_motion_is_taken(tmp_path: Path, name: str) -> None:
    np.savez(tmp_path / "m.npz", **(amass() | MOTIONS[name]))
    assert load_motion(tmp_path / "m.npz").motion.frames == 3


def detections(people: int = 1, score: float = 0.9, identity: Any = 1) -> str:
    points = np.array([[100.0 + 9 * k, 200.0 + k * k, score] for k in range(17)]).ravel()
    one = {"pose_keypoints_2d": points.tolist(), "person_id": [identity]}
    return json.dumps({"people": [one | {"person_id": [identity + k]} for k in range(people)]})


def many_people(path: Path) -> None:
    (path / "1.json").write_text(detections(people=90))
    assert len(read_keypoints(path).frame) == 90


def unnormalised_scores(path: Path) -> None:
    (path / "1.json").write_text(detections(score=9.5))
    assert (read_keypoints(path).confidence == 1).all()


def large_identities(path: Path) -> None:
    (path / "1.json").write_text(detections(identity=10**9))
    assert read_keypoints(path).identity.tolist() == [10**9]


def nanoseconds_in_names(path: Path) -> None:
    for k in range(3):
        (path / f"{1_760_000_000_000_000_000 + 33_333_333 * k}.json").write_text(detections())
    assert np.diff(read_keypoints(path).frame_numbers).tolist() == [33_333_333] * 2


def thousand_joints(path: Path) -> None:
    (path / "a.bvh").write_text(chain(1000))
    assert read_recording(path / "a.bvh").positions.shape == (2, 1000, 3)


def twenty_turns(path: Path) -> None:
    text = chain(4).replace("CHANNELS 0", "CHANNELS 1 Yrotation", 1)
    (path / "a.bvh").write_text(text.replace("0 1.7 0", "0 1.7 0 7200"))
    assert read_recording(path / "a.bvh").frames == 2


def fast_markers(path: Path) -> None:
    write_trc(path / "a.trc", replace(make_markers(), fps=1000.0))
    assert read_recording(path / "a.trc").fps == 1000


def scans_by_the_clock_of_the_day(path: Path) -> None:
    files = [path / f"{k}.ply" for k in range(4)]
    times = "".join(f"{1_760_000_000 + k / 30:.6f}\n" for k in range(4))
    (path / "times.csv").write_text(times)
    assert in_time_order(path / "times.csv", files).fps == pytest.approx(30.0, rel=1e-3)


def cameras_around_a_stadium(path: Path) -> None:
    pose = np.eye(4)
    pose[:3, 3] = 0, 0, 150_000.0  # millimetres
    np.savez(path / "a.npz", camera_matrix=HD.camera_matrix, image_size=[1920, 1080],
             T_camera_world=pose)  # fmt: skip
    camera = load_cameras(path / "a.npz").cameras["a"]
    assert camera.T_camera_world is not None
    assert camera.T_camera_world[0, 2, 3] == pytest.approx(150.0)


FILES: tuple[Callable[[Path], None], ...] = (
    many_people, unnormalised_scores, large_identities, nanoseconds_in_names, thousand_joints,
    twenty_turns, fast_markers, scans_by_the_clock_of_the_day, cameras_around_a_stadium,
)  # fmt: skip


@pytest.mark.parametrize("check", FILES, ids=lambda check: check.__name__)
def test_a_file_is_taken(tmp_path: Path, check: Callable[[Path], None]) -> None:
    check(tmp_path)


def test_there_are_fifty() -> None:
    assert len(OBSERVATIONS) + len(MOTIONS) + len(FILES) >= 50

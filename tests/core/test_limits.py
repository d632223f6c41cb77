"""Ranges of quantities: what lies outside is refused with file, quantity and value."""

import io
import pickle
import re
import struct
import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.sparse

from recon.core import limits
from recon.core.camera import check_camera, check_pose
from recon.core.limits import LIMITS, Limit
from recon.core.units import to_z_up
from recon.detections.reader import read_keypoints
from recon.formats.depth_images import read_png
from recon.formats.motions import load_motion, save_motion
from recon.formats.observations import CameraArrays, PointsFile, load_observation, save_observation
from recon.formats.opening import check_sizes
from recon.formats.scan_times import in_time_order
from recon.formats.scans import read_ply
from recon.formats.smpl import load_smpl
from recon.reading.places import load_silhouettes
from tests.formats.test_npz import KEYPOINTS, POINTS, POSITIONS, amass, make_file

CAMERA = np.array([[1000.0, 0.0, 320.0], [0.0, 1000.0, 240.0], [0.0, 0.0, 1.0]])


@pytest.mark.parametrize("limit", LIMITS, ids=lambda limit: limit.quantity)
def test_every_range_has_its_ends_and_a_reason(limit: Limit) -> None:
    assert limit.low < limit.high
    assert len(limit.reason.split()) > 6
    limit.check([limit.low, limit.high], "file")
    for value in (np.nan, np.inf, -np.inf, limit.high + abs(limit.high), limit.low - 1):
        assert not limit.holds([0.5, value])
        with pytest.raises(ValueError, match=re.escape(f"clip.npz: expected a {limit.quantity}")):
            limit.check([(limit.low + limit.high) / 2, value], "clip.npz", "key")


def test_quantities_are_named_once() -> None:
    assert len({limit.quantity for limit in LIMITS}) == len(LIMITS)


def test_a_refusal_names_file_quantity_value_and_place() -> None:
    values = np.zeros((4, 3))
    values[2, 1] = 7e5
    with pytest.raises(ValueError, match=r"a\.npz.*position.*10000 m.*got 700000.*trans\[2, 1\]"):
        limits.POSITION.check(values, Path("a.npz"), "trans")
    seen = np.ones(4, dtype=bool)
    seen[2] = False
    limits.POSITION.check(values, "a.npz", seen=seen)
    with pytest.raises(ValueError, match=r"a\.json.*got 1e\+30 at idx"):
        limits.PERSON.check(10**30, "a.json", "idx")


@pytest.mark.parametrize(
    ("place", "value", "quantity"),
    [
        ((0, 0), 1e-7, "focal length"),
        ((1, 1), 1e9, "focal length"),
        ((0, 0), 30.0, "longer side"),
        ((1, 1), 90.0, "two focal lengths"),
        ((0, 2), 1e6, "principal point"),
        ((0, 1), 500.0, "skew"),
        ((2, 0), 0.1, "camera matrix"),
        ((2, 2), 2.0, "camera matrix"),
        ((0, 0), np.nan, "focal length"),
    ],
)
def test_a_camera_that_nobody_has(place: tuple[int, int], value: float, quantity: str) -> None:
    matrix = CAMERA.copy()
    check_camera(matrix, (640, 480), [-0.3, 0.1, 0.0, 0.0, -0.02], "calib.toml")
    matrix[place] = value
    with pytest.raises(ValueError, match=rf"calib\.toml.*{quantity}"):
        check_camera(matrix, (640, 480), None, "calib.toml")
    with pytest.raises(ValueError, match="image size"):
        check_camera(CAMERA, (640, 1e92), None, "calib.toml")
    with pytest.raises(ValueError, match="distortion"):
        check_camera(CAMERA, (640, 480), [1e300, 0, 0, 0], "calib.toml")
    with pytest.raises(ValueError, match="stretch"):
        check_camera(CAMERA, (640, 480), [-300.0, 0, 0, 0], "calib.toml")


@pytest.mark.parametrize("change", ["scaled", "mirrored", "far", "row", "nan", "huge"])
def test_a_pose_that_is_none(change: str) -> None:
    pose = np.tile(np.eye(4), (3, 1, 1))
    check_pose(pose, "c.npz", "pose")
    spots = {"scaled": (0, 0, 1.1), "mirrored": (0, 0, -1.0), "far": (0, 3, 2e4)}
    spots |= {"row": (3, 0, 0.5), "nan": (1, 1, np.nan), "huge": (1, 1, 1e308)}
    row, column, value = spots[change]
    pose[1, row, column] = value
    with pytest.raises(ValueError, match=r"c\.npz.*pose"):
        check_pose(pose, "c.npz", "pose")


@pytest.mark.parametrize(
    ("record", "change", "quantity"),
    [
        (POSITIONS, {"positions": np.full((3, 2, 3), 1e306)}, "position"),
        (POSITIONS, {"fps": 1e-300}, "frame rate"),
        (POSITIONS, {"fps": 1e300}, "frame rate"),
        (POSITIONS, {"start_time": 1.7e12}, "time"),
        (KEYPOINTS, {"pixels": np.full((3, 2, 2), 1e308)}, "pixel"),
        (KEYPOINTS, {"confidence": np.full((3, 2), 40.0)}, "confidence"),
        (KEYPOINTS, {"confidence": np.full((3, 2), -1.0)}, "confidence"),
        (KEYPOINTS, {"image_size": np.array([640.0, 1e92])}, "image size"),
        (KEYPOINTS, {"camera_matrix": 1e-7 * np.eye(3)}, "camera matrix"),
        (KEYPOINTS, {"distortion": np.zeros(3)}, "distortion"),
        (KEYPOINTS, {"T_camera_world": 2.0 * np.eye(4)}, "identity"),
        (POINTS, {"points": np.full((5, 3), -2e4)}, "position"),
        (POINTS, {"frame": np.array([0, 0, 1, 1, -2])}, "frame number"),
        (POINTS, {"fps": 1e12}, "clock"),
    ],
)
def test_observations_hold_nothing_implausible(
    tmp_path: Path, record: Any, change: dict[str, Any], quantity: str
) -> None:
    """Positions of 1e306 m, an image 1e92 pixels high and the like were read without a word."""
    save_observation(tmp_path / "o.npz", record)
    load_observation(tmp_path / "o.npz")
    with np.load(tmp_path / "o.npz") as file:
        arrays: dict[str, Any] = dict(file) | change
    np.savez(tmp_path / "o.npz", **arrays)
    with pytest.raises(ValueError, match=rf"o\.npz.*{quantity}"):
        load_observation(tmp_path / "o.npz")


def test_millimetres_have_their_own_range(tmp_path: Path) -> None:
    """A room of 30 m has positions beyond 10,000 where the caller says that they are in mm."""
    save_observation(tmp_path / "o.npz", POSITIONS)
    with np.load(tmp_path / "o.npz") as file:
        arrays: dict[str, Any] = dict(file) | {"positions": np.full((3, 2, 3), 30_000.0)}
    np.savez(tmp_path / "o.npz", **arrays)
    with pytest.raises(ValueError, match="check the unit"):
        load_observation(tmp_path / "o.npz")
    load_observation(tmp_path / "o.npz", unit="mm")


@pytest.mark.parametrize(
    ("change", "quantity"),
    [
        ({"betas": np.full(16, 4000.0)}, "shape coefficient"),
        ({"betas": np.full(16, 1 + 2j)}, "numbers in betas"),
        ({"betas": np.array(["tall"])}, "numbers in betas"),
        ({"mocap_framerate": np.array("30")}, "numbers in mocap_framerate"),
        ({"trans": np.full((3, 3), 1e30)}, "position"),
        ({"poses": np.full((3, 66), 1e9)}, "rotation"),
        ({"mocap_framerate": 1e300}, "frame rate"),
        ({"mocap_framerate": 1e-300}, "frame rate"),
        ({"ground": np.array([0.0, 0.0, 5.0, 0.0])}, "length 1"),
        ({"ground": np.array([0.0, 0.0, 1.0, 1e9])}, "position"),
        ({"contacts": np.full((3, 22), 3.0)}, "probability"),
        ({"joint_std": np.full((3, 22), -1.0)}, "standard deviation"),
        ({"T_world_camera": np.zeros((1, 4, 4))}, "identity"),
        ({"in_camera": np.full((3, 6), 1e5)}, "position"),
    ],
)
def test_motions_hold_nothing_implausible(
    tmp_path: Path, change: dict[str, Any], quantity: str
) -> None:
    """Complex and textual betas ended in a KeyError; the rest was read without a word."""
    np.savez(tmp_path / "m.npz", **(amass() | change))
    with pytest.raises(ValueError, match=rf"m\.npz.*{quantity}"):
        load_motion(tmp_path / "m.npz")


def test_a_stray_frame_number_takes_no_memory(tmp_path: Path) -> None:
    """A file of 43 KB with one frame number 1,000,000 took 5.6 GB: a place for every frame."""
    frame = np.array([0, 1, 2, 3, 4, 1_000_000])
    save_observation(tmp_path / "o.npz", PointsFile(np.ones((6, 3)), frame, 30.0))
    with pytest.raises(ValueError, match=r"none follows for 33333\.2 s after 0\.133"):
        load_observation(tmp_path / "o.npz")


@pytest.mark.parametrize(
    ("fps", "step", "jitter"), [(1e6, 33_333, 0), (1e9, 33_333_333, 200_000), (1e3, 1000, 0)]
)
def test_frames_numbered_by_a_clock(tmp_path: Path, fps: float, step: int, jitter: int) -> None:
    """Clocks begin anywhere and tick faster than frames; times stay, frames are few."""
    shift = np.random.default_rng(0).integers(-jitter, jitter + 1, 90)
    ticks = 1_700_000_000 * int(fps) + np.arange(90) * step + shift
    record = PointsFile(np.ones((180, 3)), np.repeat(ticks, 2), fps)
    save_observation(tmp_path / "o.npz", record)
    read = load_observation(tmp_path / "o.npz")
    assert isinstance(read, PointsFile)
    assert read.frame.max() == 89
    assert read.fps == pytest.approx(fps / step, rel=1e-3)
    times = read.start_time + read.frame / read.fps
    assert np.abs(times - record.frame / fps).max() < 1e-3
    assert "clock" in read.decisions[0]


def test_headers_that_promise_too_much(tmp_path: Path) -> None:
    """An archive of a few kilobytes may unpack to gigabytes, or claim to; neither is tried."""
    save_motion(tmp_path / "m.npz", make_file())
    with np.load(tmp_path / "m.npz") as file:
        arrays: dict[str, Any] = dict(file)
    bomb: dict[str, Any] = arrays | {"bomb": np.zeros(1 << 20, np.uint8)}
    np.savez_compressed(tmp_path / "m.npz", **bomb)
    assert (tmp_path / "m.npz").stat().st_size < 100_000
    check_sizes(tmp_path / "m.npz")
    assert limits.PAYLOAD.high < 1 << 30
    with pytest.raises(ValueError, match=r"m\.npz.*size of the unpacked arrays.*bomb"):
        check_sizes(tmp_path / "m.npz", replace(limits.PAYLOAD, high=1e6))
    header = {"descr": "<f8", "fortran_order": False, "shape": (10**9, 66)}
    member = io.BytesIO()
    np.lib.format.write_array_header_1_0(member, header)  # type: ignore[arg-type]
    np.savez(tmp_path / "m.npz", **{k: v for k, v in arrays.items() if k != "poses"})
    with zipfile.ZipFile(tmp_path / "m.npz", "a") as archive:
        archive.writestr("poses.npy", member.getvalue() + bytes(800))
    with pytest.raises(ValueError, match=r"m\.npz.*poses promises float64 \(1000000000, 66\)"):
        load_motion(tmp_path / "m.npz")


def test_points_with_y_up_keep_their_place_before_the_camera(tmp_path: Path) -> None:
    """A transposed turn of the camera's pose was not noticed by any test."""
    pose = np.eye(4)
    pose[:3, :3] = to_z_up("x") @ np.diag([1.0, -1.0, -1.0])
    pose[:3, 3] = 0.1, 0.2, 3.0
    points = np.array([[0.3, 1.0, -0.2], [0.0, 0.5, 0.1]])
    camera = CameraArrays(CAMERA, (640, 480), None, pose[None])
    save_observation(tmp_path / "o.npz", PointsFile(points, np.array([0, 1]), 30.0, camera))
    with np.load(tmp_path / "o.npz") as file:
        arrays: dict[str, Any] = dict(file) | {"up_axis": "y"}
    np.savez(tmp_path / "o.npz", **arrays)
    read = load_observation(tmp_path / "o.npz")
    assert isinstance(read, PointsFile)
    assert read.camera is not None
    turned = read.camera.T_camera_world
    assert turned is not None
    assert np.allclose(read.points, points @ to_z_up("y").T)
    assert np.allclose(
        read.points @ turned[0, :3, :3].T + turned[0, :3, 3],
        points @ pose[:3, :3].T + pose[:3, 3],
    )


@pytest.mark.parametrize(
    ("producer", "text", "message"),
    [
        ("openpose", '{"people": [{"person_id": [1%s], "pose_keypoints_2d": %s}]}', "person"),
        ("alphapose", '[{"image_id": "1.jpg", "idx": 1%s, "keypoints": %s}]', "person"),
        ("mmpose", '[{"frame_id": 1%s, "people": %s}]', "frame number"),
    ],
)
def test_identities_of_thirty_digits(
    tmp_path: Path, producer: str, text: str, message: str
) -> None:
    """Numbers of people and frames that no 64 bits hold ended in an OverflowError."""
    path = tmp_path / f"{producer}.json"
    points = [[100.0 + 9 * k, 200.0, 0.9] for k in range(17)]
    path.write_text(text % ("0" * 30, np.ravel(points).tolist()))
    with pytest.raises(ValueError, match=rf"{producer}\.json.*{message}"):
        read_keypoints(path)
    path.write_text(text % ("0" * 5000, "[]"))
    with pytest.raises(ValueError, match=rf"{producer}\.json"):
        read_keypoints(path)


@pytest.mark.parametrize("points", [[1e308, 5.0, 0.9], [10.0, 5.0, 1e30]])
def test_keypoints_that_no_detector_gives(tmp_path: Path, points: list[float]) -> None:
    (tmp_path / "a.json").write_text(
        '{"people": [{"pose_keypoints_2d": %s}]}' % (points + [100.0, 200.0, 0.9] * 16)
    )
    with pytest.raises(ValueError, match=r"a\.json.*(pixel|score)"):
        read_keypoints(tmp_path / "a.json")


def test_frame_numbers_of_files_that_a_clock_gave(tmp_path: Path) -> None:
    name = "1" + 25 * "0"
    (tmp_path / f"{name}.json").write_text('{"people": []}')
    with pytest.raises(ValueError, match="frame number"):
        read_keypoints(tmp_path)


def test_times_that_are_hardly_numbers(tmp_path: Path) -> None:
    """times.csv of 0, 1e-320, 2e-320, 1 ended in an OverflowError."""
    files = [tmp_path / f"{k}.ply" for k in range(4)]
    (tmp_path / "times.csv").write_text("0\n1e-320\n2e-320\n1\n")
    with pytest.raises(ValueError, match=r"times\.csv.*frame rate"):
        in_time_order(tmp_path / "times.csv", files)
    (tmp_path / "times.csv").write_text("0\n1\n2\n1e9\n")
    with pytest.raises(ValueError, match=r"times\.csv.*none follows for 1e\+09 s"):
        in_time_order(tmp_path / "times.csv", files)


def test_a_sparse_matrix_of_a_million_squared(tmp_path: Path) -> None:
    """A body model of a few bytes asked for a dense matrix of 8 TB."""
    csc = scipy.sparse.csc_matrix((10**6, 10**6))
    (tmp_path / "smpl.pkl").write_bytes(pickle.dumps({"J_regressor": csc}, protocol=2))
    with pytest.raises(ValueError, match=r"smpl\.pkl.*J_regressor"):
        load_smpl(tmp_path / "smpl.pkl")


@pytest.mark.parametrize("call", [(np.ndarray, ((10**10,),)), (bytes, (10**10,))])
def test_pickles_that_ask_for_memory(tmp_path: Path, call: tuple[Any, Any]) -> None:
    class Asking:
        def __reduce__(self) -> tuple[Any, Any]:
            return call

    (tmp_path / "smpl.pkl").write_bytes(pickle.dumps({"v_template": Asking()}, protocol=2))
    with pytest.raises(ValueError, match=r"smpl\.pkl"):
        load_smpl(tmp_path / "smpl.pkl")


def test_clouds_that_promise_more_than_they_hold(tmp_path: Path) -> None:
    head = "ply\nformat binary_little_endian 1.0\n"
    head += "element vertex %d\nproperty float x\nend_header\n"
    (tmp_path / "a.ply").write_bytes((head % 10_000_000).encode() + bytes(40))
    with pytest.raises(ValueError, match=r"a\.ply.*promises 40000000 bytes"):
        read_ply(tmp_path / "a.ply")
    (tmp_path / "a.ply").write_bytes((head % 10**12).encode() + bytes(40))
    with pytest.raises(ValueError, match=r"a\.ply.*number of points"):
        read_ply(tmp_path / "a.ply")


def test_images_that_promise_more_than_they_hold(tmp_path: Path) -> None:
    size = struct.pack(">II", 60_000, 60_000)
    (tmp_path / "0.png").write_bytes(b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR" + size + bytes(40))
    with pytest.raises(ValueError, match=r"0\.png.*size of an unpacked image"):
        read_png(tmp_path / "0.png")
    with pytest.raises(ValueError, match=r"0\.png.*size of an unpacked image"):
        load_silhouettes(tmp_path).visible(0)


def test_masks_of_one_bit_a_pixel(tmp_path: Path) -> None:
    mask = np.random.default_rng(0).integers(0, 3, (4, 7, 5)).astype(np.uint8)
    np.savez_compressed(tmp_path / "mask.npz", mask=mask)
    masks = load_silhouettes(tmp_path / "mask.npz")
    for frame in range(4):
        assert np.array_equal(masks.visible(frame), mask[frame] != 0)  # type: ignore[arg-type]
    assert masks.visible(4) is None
    np.savez(tmp_path / "mask.npz", mask=mask.astype(float))
    with pytest.raises(ValueError, match=r"mask\.npz.*float64"):
        load_silhouettes(tmp_path / "mask.npz")

"""Motion and observation files: round trips, foreign spellings, refusals that say why."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from recon.core import rotations as so3
from recon.core.motion import Motion, MotionFile, padded_batch
from recon.formats.motions import load_motion, save_motion
from recon.formats.observations import (
    CameraArrays,
    KeypointsFile,
    ObservationFile,
    PointsFile,
    PositionsFile,
    load_observation,
    save_observation,
)


def make_motion(frames: int = 4) -> Motion:
    translation = torch.randn(frames, 3, dtype=torch.float64)
    rotations = so3.exp(torch.randn(frames, 22, 3, dtype=torch.float64))
    return Motion.create(translation, rotations, torch.randn(10, dtype=torch.float64), 30.0, 1.5)


def make_file(frames: int = 4) -> MotionFile:
    return MotionFile(
        make_motion(frames),
        body="toy",
        checksum="0123",
        gender="female",
        joints=torch.randn(frames, 22, 3, dtype=torch.float64),
        contacts=torch.rand(frames, 22, dtype=torch.float64),
        ground=torch.tensor([0.0, 0.0, 1.0, 0.1], dtype=torch.float64),
        contact_probability=torch.rand(frames, 22, dtype=torch.float64),
        ground_std=torch.tensor([0.02, 0.05], dtype=torch.float64),
        joint_std=torch.rand(frames, 22, dtype=torch.float64),
        observed=torch.rand(frames, 22) > 0.5,
        truth_visible=torch.rand(frames, 22) > 0.5,
        T_world_camera=torch.eye(4, dtype=torch.float64)[None],
    )


def amass(frames: int = 3, joints: int = 52, **more: Any) -> dict[str, Any]:
    rng = np.random.default_rng(0)
    return {
        "trans": rng.standard_normal((frames, 3)),
        "poses": 0.3 * rng.standard_normal((frames, 3 * joints)),
        "betas": rng.standard_normal(16),
        "gender": "male",
        "mocap_framerate": 120.0,
    } | more


@pytest.mark.parametrize("frames", [1, 4, 5])
def test_a_motion_file_is_read_back_as_it_was(tmp_path: Path, frames: int) -> None:
    file = make_file(frames)
    save_motion(tmp_path / "m.npz", file)
    back = load_motion(tmp_path / "m.npz", torch.float64)
    assert back.motion.fps == 30
    assert back.motion.start_time == 1.5
    for name, tensor in file.motion.tensors().items():
        assert torch.allclose(back.motion.tensors()[name], tensor, atol=1e-9), name
    for name in ("body", "checksum", "gender", "format_version"):
        assert getattr(back, name) == getattr(file, name)
    extra = ("joints", "contacts", "ground", "ground_std", "joint_std", "observed")
    more = ("contact_probability", "truth_visible", "T_world_camera")
    for name in (*extra, *more):
        assert torch.equal(getattr(back, name), getattr(file, name)), name
    assert list(tmp_path.iterdir()) == [tmp_path / "m.npz"]


def test_rotations_near_a_half_turn_survive(tmp_path: Path) -> None:
    axis = torch.nn.functional.normalize(torch.randn(3, 22, 3, dtype=torch.float64), dim=-1)
    angle = torch.pi - torch.tensor([1e-3, 1e-6, 0.0], dtype=torch.float64)
    rotations = so3.exp(axis * angle[:, None, None])
    motion = Motion.create(torch.zeros(3, 3).double(), rotations, torch.zeros(10).double(), 30.0)
    save_motion(tmp_path / "m.npz", motion)
    back = load_motion(tmp_path / "m.npz", torch.float64).motion
    assert (back.rotations - rotations).abs().max() < 1e-6


def test_padding_is_not_written(tmp_path: Path) -> None:
    batch = padded_batch([make_motion(3), make_motion(5)])
    save_motion(tmp_path / "m.npz", batch[0])
    assert load_motion(tmp_path / "m.npz").motion.frames == 3
    with pytest.raises(ValueError, match="batch"):
        save_motion(tmp_path / "m.npz", batch)


@pytest.mark.parametrize("joints", [22, 24, 52, 55])
@pytest.mark.parametrize("rate", ["mocap_framerate", "mocap_frame_rate", "fps"])
def test_amass_spellings(tmp_path: Path, joints: int, rate: str) -> None:
    arrays = amass(joints=joints)
    arrays[rate] = arrays.pop("mocap_framerate")
    np.savez(tmp_path / "m.npz", **arrays)
    file = load_motion(tmp_path / "m.npz", torch.float64)
    assert file.motion.fps == 120
    assert file.gender == "male"
    assert file.motion.rotations.shape == (3, 22, 3, 3)
    poses = so3.log(file.motion.rotations).flatten(-2).numpy()
    assert np.allclose(poses, arrays["poses"][:, :66], atol=1e-9)


def test_split_poses_and_repeated_betas_are_read(tmp_path: Path) -> None:
    arrays = amass()
    poses = arrays.pop("poses")
    arrays |= {"root_orient": poses[:, :3], "pose_body": poses[:, 3:66]}
    arrays |= {"betas": np.tile(arrays["betas"], (3, 1)), "gender": np.array(b"female")}
    np.savez(tmp_path / "m.npz", **arrays)
    file = load_motion(tmp_path / "m.npz", torch.float64)
    assert file.motion.shape.shape == (16,)
    assert file.gender == "female"
    assert np.allclose(so3.log(file.motion.rotations).flatten(-2).numpy(), poses[:, :66])


def test_split_poses_of_two_lengths_are_refused_by_name(tmp_path: Path) -> None:
    """A root of one length and a body of another ended in a message of numpy's, without a file."""
    arrays = amass()
    poses = arrays.pop("poses")
    arrays |= {"root_orient": poses[:2, :3], "pose_body": poses[:, 3:66]}
    np.savez(tmp_path / "m.npz", **arrays)
    with pytest.raises(ValueError, match=r"m\.npz.*root_orient \(T, 3\)"):
        load_motion(tmp_path / "m.npz")


def test_other_tools_find_their_keys(tmp_path: Path) -> None:
    save_motion(tmp_path / "m.npz", make_file())
    with np.load(tmp_path / "m.npz", allow_pickle=False) as file:
        assert {"trans", "gender", "betas", "poses", "mocap_framerate", "mocap_frame_rate",
                "root_orient", "pose_body"} <= set(file.files)  # fmt: skip
        assert str(file["gender"]) == "female"
        assert file["poses"].shape == (4, 66)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"trans": None}, "missing trans; found betas"),
        ({"poses": None}, "missing poses"),
        ({"mocap_framerate": None}, "missing mocap_framerate"),
        ({"trans": np.full((3, 3), np.nan)}, "NaN"),
        ({"poses": np.full((3, 66), np.inf)}, "infinity"),
        ({"poses": np.zeros((3, 63))}, "66"),
        ({"poses": np.zeros((2, 66))}, "as many frames"),
        ({"trans": np.zeros((0, 3)), "poses": np.zeros((0, 66))}, "at least one"),
        ({"mocap_framerate": 0.0}, "frame rate of 0.001 to"),
        ({"up_axis": "y"}, "z up"),
        ({"betas": np.arange(6.0).reshape(2, 3)}, "one shape"),
        ({"contacts": np.zeros((3, 9))}, "contacts"),
        ({"trans": np.array(["a"] * 3)}, "trans"),
        ({"format_version": 99}, "newer"),
    ],
)
def test_bad_motions_are_refused_with_the_reason(
    tmp_path: Path, change: dict[str, Any], message: str
) -> None:
    arrays = {k: v for k, v in (amass() | change).items() if v is not None}
    np.savez(tmp_path / "m.npz", **arrays)
    with pytest.raises(ValueError, match=message):
        load_motion(tmp_path / "m.npz")


def test_a_motion_with_nan_is_not_written(tmp_path: Path) -> None:
    motion = make_motion()
    motion.translation[1, 1] = torch.nan
    with pytest.raises(ValueError, match="trans"):
        save_motion(tmp_path / "m.npz", motion)
    assert list(tmp_path.iterdir()) == []


def test_pickled_objects_are_never_opened(tmp_path: Path) -> None:
    np.savez(tmp_path / "m.npz", **amass(betas=np.array([{}], dtype=object)))
    with pytest.raises(ValueError, match="plain arrays"):
        load_motion(tmp_path / "m.npz")


CAMERA = CameraArrays(
    np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]]), (640, 480), np.zeros(5), np.eye(4)[None]
)
RNG = np.random.default_rng(1)
VISIBLE = np.array([[True, False], [True, True], [False, True]])
POSITIONS = PositionsFile(
    "joints3d",
    RNG.standard_normal((3, 2, 3)) * VISIBLE[..., None],
    VISIBLE,
    ("head", "pelvis"),
    30.0,
    2.5,
    False,
    0.01 * VISIBLE,
    truth_visible=np.ones((3, 22), dtype=bool),
)
KEYPOINTS = KeypointsFile(
    RNG.standard_normal((3, 2, 2)) * VISIBLE[..., None], 0.5 * VISIBLE, "coco17", 25.0, CAMERA
)
POINTS = PointsFile(RNG.standard_normal((5, 3)), np.array([0, 0, 1, 2, 2]), 20.0, CAMERA)


@pytest.mark.parametrize("file", [POSITIONS, KEYPOINTS, POINTS])
def test_observations_are_read_back_as_they_were(tmp_path: Path, file: ObservationFile) -> None:
    save_observation(tmp_path / "o.npz", file)
    back = load_observation(tmp_path / "o.npz")
    assert type(back) is type(file)
    for name in vars(file):
        mine, theirs = getattr(file, name), getattr(back, name)
        if isinstance(mine, CameraArrays):
            for key in vars(mine):
                assert np.array_equal(getattr(mine, key), getattr(theirs, key)), key
        else:
            assert np.array_equal(mine, theirs), name


def test_observations_with_y_up_are_turned(tmp_path: Path) -> None:
    arrays = {
        "kind": "markers3d",
        "positions": np.array([[[1.0, 2.0, 3.0]]]),
        "visible": np.array([[True]]),
        "names": np.array(["C7"]),
        "fps": 30.0,
        "up_axis": "y",
    }
    np.savez(tmp_path / "o.npz", **arrays)  # type: ignore[arg-type]
    back = load_observation(tmp_path / "o.npz")
    assert isinstance(back, PositionsFile)
    assert np.array_equal(back.positions, [[[1.0, -3.0, 2.0]]])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"kind": "sonar"}, "joints3d, markers3d, keypoints3d, keypoints2d, points"),
        ({"kind": None}, "kind"),
        ({"visible": None}, "missing visible; found"),
        ({"visible": np.ones((3, 2))}, "true or false"),
        ({"positions": np.zeros((3, 4, 3))}, r"\(3, 2, 3\)"),
        ({"positions": np.full((3, 2, 3), np.nan)}, "zeros"),
        ({"names": np.array(["a"])}, r"texts of shape \(2\) in names"),
        ({"fps": 0.0}, "frame rate of 0.001"),
        ({"up_axis": "x"}, "y or z"),
        ({"start_time": np.nan}, "start_time"),
        ({"std": np.full((3, 3), 0.01)}, r"\(3, 2\) in std"),
        ({"std": np.full((3, 2), np.nan)}, "std holds NaN"),
        ({"std": np.zeros((3, 2))}, "standard deviation of a measured point of 1e-06"),
    ],
)
def test_bad_observations_are_refused_with_the_reason(
    tmp_path: Path, change: dict[str, Any], message: str
) -> None:
    save_observation(tmp_path / "o.npz", POSITIONS)
    with np.load(tmp_path / "o.npz") as file:
        arrays = dict(file) | change
    np.savez(tmp_path / "o.npz", **{k: v for k, v in arrays.items() if v is not None})
    with pytest.raises(ValueError, match=message):
        load_observation(tmp_path / "o.npz")

"""The file for robots, read as three loaders read it, on a stand-in for a SMPL-X file."""

from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

import recon
from recon import cli
from recon.body.model import BodyModel
from recon.core.motion import Motion
from recon.core.skeleton import JOINTS, PARENTS
from recon.export.robots import motion_on_body
from recon.formats.motions import load_motion
from tests.export.smplx_stand_in import write_smplx

DEMO = Path(recon.__file__).parent / "assets" / "demo.npz"


@pytest.fixture(scope="module")
def smplx(tmp_path_factory) -> Path:
    body = BodyModel.load().to(dtype=torch.float64)
    return write_smplx(tmp_path_factory.mktemp("smplx") / "SMPLX_NEUTRAL.npz", body)


@pytest.fixture(scope="module")
def written(smplx, tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("robot") / "robot.npz"
    assert cli.run(["export", str(DEMO), "--robot", str(out), "--smplx", str(smplx)]) == cli.OK
    return out


def as_gmr_reads(path: Path, smplx: BodyModel) -> tuple[np.ndarray, np.ndarray, float, float]:
    """Joints and orientations (w, x, y, z), rate, and height, by the steps of GMR's loader.

    general_motion_retargeting/utils/smpl.py: load_smplx_file and get_smplx_data_offline_fast.
    """
    data = np.load(path, allow_pickle=True)
    assert "left_hand_pose" not in data  # else it is taken for SMPL-H
    assert str(data["gender"]) == "neutral"  # the name of the body file
    frames = data["pose_body"].shape[0]
    betas = torch.tensor(data["betas"]).float().view(1, -1)
    assert betas.shape == (1, 16)  # what smplx.create makes room for
    root = torch.tensor(data["root_orient"]).float()
    pose = torch.tensor(data["pose_body"]).float()
    trans = torch.tensor(data["trans"]).float()
    assert (root.shape, pose.shape, trans.shape) == ((frames, 3), (frames, 63), (frames, 3))
    rate = data["mocap_frame_rate"].item()
    assert not rate > 30  # it would take the frames apart
    height = 1.66 + 0.1 * data["betas"][0]
    turns: list[Rotation] = []
    whole = torch.cat((root, pose), 1).reshape(frames, 22, 3).numpy()
    for joint, parent in enumerate(PARENTS):
        own = Rotation.from_rotvec(whole[:, joint])
        turns.append(own if parent < 0 else turns[parent] * own)
    matrices = torch.from_numpy(
        Rotation.from_rotvec(whole.reshape(-1, 3)).as_matrix().reshape(frames, 22, 3, 3)
    ).float()
    posed = smplx.pose(Motion.create(trans, matrices, betas[0], rate))
    orientations = np.stack([turn.as_quat(scalar_first=True) for turn in turns], 1)
    return posed.joints.numpy(), orientations, rate, height


def test_the_loader_of_gmr_gets_our_motion(written, smplx):
    target = BodyModel.load(smplx)
    joints, orientations, rate, height = as_gmr_reads(written, target)
    ours = load_motion(DEMO).motion
    truth = BodyModel.load().pose(ours).joints.numpy()
    assert rate == 30.0
    assert joints.shape == truth.shape
    away = np.linalg.norm(joints - truth, axis=-1)
    assert np.median(away) < 0.015  # m
    assert np.quantile(away, 0.95) < 0.04  # m
    assert orientations.shape == (len(truth), 22, 4)
    assert 1.0 < height < 2.3


def test_protomotions_gets_our_motion(written, smplx):
    """By the steps of data/scripts/convert_amass_to_proto.py for SMPL-X."""
    data = np.load(written)
    poses, trans = data["poses"], data["trans"]
    assert poses.shape == (len(trans), 165)
    rate = data["mocap_framerate" if "mocap_framerate" in data else "mocap_frame_rate"]
    assert np.round(rate).astype(int) == 30
    cut = np.concatenate((poses[:, :66], poses[:, 75:]), axis=-1)  # without jaw and eyes
    turns = cut.reshape(len(trans), 52, 3)
    assert np.array_equal(turns[:, 0], data["root_orient"])
    assert np.array_equal(turns[:, 1:22].reshape(len(trans), 63), data["pose_body"])
    assert not turns[:, 22:].any()
    joints, orientations, _, _ = as_gmr_reads(written, BodyModel.load(smplx))
    assert orientations.shape == (len(joints), 22, 4)


def test_holosoma_gets_our_joints(written, smplx):
    """By the steps of robot_retarget.load_motion_data for `smplx`."""
    human = dict(np.load(written))
    joints, height = human["global_joint_positions"], human["height"]
    truth, _, _, _ = as_gmr_reads(written, BodyModel.load(smplx))
    assert np.abs(joints - truth).max() < 1e-4  # m
    scale = 1.32 / height
    assert 0.7 < scale < 0.9
    toes = [JOINTS.index("left_foot"), JOINTS.index("right_foot")]
    assert 0 < joints[:, toes, 2].min() < 0.1  # m; a mat begins there
    assert set(human) >= {"num_betas", "pose_hand", "pose_jaw", "pose_eye", "gender"}


def test_soles_stand_on_the_floor_and_contacts_are_beside(written, smplx):
    target = BodyModel.load(smplx)
    with np.load(written) as data:
        assert data["contacts"].shape == (len(data["trans"]), 22)
        assert data["contacts"].dtype == bool
        assert data["contacts"][:, list(JOINTS).index("left_ankle")].any()
        assert list(data["joint_names"]) == list(JOINTS)
        assert str(data["up_axis"]) == "z"
        assert str(data["body_checksum"]) == target.checksum
    file = load_motion(written)
    skin = target.pose(file.motion).vertices[..., 2].numpy()
    stands = file.contacts[:, [7, 8, 10, 11]].any(-1).numpy() > 0.5
    assert np.abs(np.median(skin.min(1)[stands])) < 0.01  # m
    assert skin.min() > -0.04  # m


def test_betas_are_the_other_body_s_own(written, smplx):
    """Our betas under SMPL-X's name would make another person of it."""
    target, body = BodyModel.load(smplx), BodyModel.load()
    ours = load_motion(DEMO).motion
    with np.load(written) as data:
        betas = torch.from_numpy(data["betas"])
    assert not torch.allclose(betas[: body.shape_size], ours.shape[:16], atol=0.1)

    def leg(model: BodyModel, shape: torch.Tensor) -> float:
        rest = model.rest_joints(shape)
        return float((rest[1] - rest[4]).norm() + (rest[4] - rest[7]).norm())

    assert leg(target, betas) == pytest.approx(leg(body, ours.shape), abs=0.02)  # m


def test_a_motion_of_the_same_body_is_written_as_it_is(smplx):
    target = BodyModel.load(smplx)
    ours = load_motion(DEMO).motion
    shape = torch.zeros(target.shape_size)
    shape[:3] = torch.tensor([0.5, -1.0, 0.3])
    found = motion_on_body(ours.replace(shape=shape), target, target)
    assert torch.equal(found.rotations, ours.rotations)
    assert torch.equal(found.shape, shape[:16])
    shift = found.translation - ours.translation
    assert float((shift - shift[0]).abs().max()) < 1e-6


def test_other_rates_become_30(smplx, body):
    ours = load_motion(DEMO).motion.resample(50.0)
    found = motion_on_body(ours, BodyModel.load(), BodyModel.load(smplx))
    assert found.fps == 30.0
    assert found.frames == pytest.approx(ours.frames * 0.6, abs=1)
    assert found.start_time == ours.start_time


def test_other_bodies_and_options_alone_are_refused(tmp_path, smplx, capsys):
    out = tmp_path / "r.npz"
    assert cli.run(["export", str(DEMO), "--robot", str(out)]) == cli.BAD_INPUT
    assert "--robot and --smplx go together" in capsys.readouterr().err
    other = tmp_path / "someone.npz"
    other.write_bytes(smplx.read_bytes())
    line = ["export", str(DEMO), "--robot", str(out), "--smplx", str(other)]
    assert cli.run(line) == cli.BAD_INPUT
    assert "NEUTRAL, FEMALE or MALE" in capsys.readouterr().err
    assert not out.exists()

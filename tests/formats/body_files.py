"""Files of body parameters by every producer's saving call; of a walk."""

import pickle
from pathlib import Path
from typing import Any

import numpy as np
import torch

from recon.core import rotations as so3
from recon.core.motion import MotionFile
from recon.formats.motions import save_motion
from tests.filmed import bundled, walk

FRAMES = 12


def dumped(path: Path, value: Any, joblib: bool = False) -> Path:
    if joblib:
        import joblib as library

        library.dump(value, path)
    else:
        path.write_bytes(pickle.dumps(value))
    return path


def saved(path: Path, **arrays: Any) -> Path:
    np.savez(path, **arrays)
    return path


def parameters() -> dict[str, np.ndarray]:
    motion = walk(FRAMES)
    vectors = so3.log(motion.rotations).numpy().reshape(FRAMES, 66)
    return {"root": vectors[:, :3], "body": vectors[:, 3:], "all": vectors,
            "place": motion.translation.numpy(), "betas": np.zeros(10)}  # fmt: skip


def wham(at: Path) -> Path:
    one = parameters()
    long = np.concatenate((one["all"], np.zeros((FRAMES, 6))), 1)
    record = {"pose": long, "trans": one["place"], "pose_world": long, "trans_world": one["place"],
              "betas": np.zeros((FRAMES, 10)), "frame_ids": np.arange(FRAMES)}  # fmt: skip
    return dumped(at / "a.pkl", {0: record}, joblib=True)


def phalp(at: Path) -> Path:
    turns = walk(FRAMES).rotations.numpy()
    frames = {
        f"images/{t:06d}.jpg": {
            "tid": [1],
            "smpl": [{
                "global_orient": one[:1], "body_pose": np.concatenate((one[1:], one[:2])),
                "betas": np.zeros(10),
            }],
            "camera": [np.array([0.0, 0.0, 4.0])],
        }
        for t, one in enumerate(turns)
    }  # fmt: skip
    return dumped(at / "a.pkl", frames, joblib=True)


def tram(at: Path) -> Path:
    """tram/scripts/estimate_humans.py: np.save of a dictionary of tensors."""
    motion = walk(FRAMES)
    turns = torch.cat((motion.rotations, motion.rotations[:, :2]), 1).float()
    record = {
        "pred_cam": torch.zeros(FRAMES, 3), "pred_shape": torch.zeros(FRAMES, 10),
        "pred_rotmat": turns, "pred_trans": motion.translation[:, None].float(),
        "frame": torch.arange(FRAMES),
    }  # fmt: skip
    np.save(at / "hps_track_0.npy", np.array(record, dtype=object), allow_pickle=True)
    return at / "hps_track_0.npy"


def aist_motion(at: Path) -> Path:
    one = parameters()
    long = np.concatenate((one["all"], np.zeros((FRAMES, 6))), 1)
    return dumped(at / "a.pkl", {
        "smpl_loss": 1.2, "smpl_poses": long, "smpl_trans": 93.8 * one["place"],
        "smpl_scaling": np.array([93.8], np.float32),
    })  # fmt: skip


def gvhmr(at: Path) -> Path:
    one = {key: torch.from_numpy(value) for key, value in parameters().items()}
    found = {"global_orient": one["root"], "body_pose": one["body"], "transl": one["place"]}
    torch.save({"smpl_params_global": found, "smpl_params_incam": found}, at / "a.pt")
    return at / "a.pt"


def motion(at: Path) -> Path:
    body = bundled()
    save_motion(at / "a.npz", MotionFile(walk(FRAMES), body.name, body.checksum))
    return at / "a.npz"


def amass(at: Path) -> Path:
    one = parameters()
    return saved(at / "a.npz", poses=one["all"], trans=one["place"], betas=np.zeros(16),
                  gender="neutral", mocap_framerate=30.0)  # fmt: skip


def slahmr(at: Path) -> Path:
    one = parameters()
    return saved(at / "a.npz", root_orient=one["root"][None], pose_body=one["body"][None],
                  trans=one["place"][None])  # fmt: skip


def smplx(at: Path) -> Path:
    one = parameters()
    return saved(
        at / "a.npz", global_orient=one["root"], body_pose=one["body"], transl=one["place"]
    )


def any_body(at: Path) -> Path:
    one = parameters()
    record = {"global_orient": one["root"], "body_pose": one["body"], "transl": one["place"]}
    return dumped(at / "a.pkl", {"results": record})

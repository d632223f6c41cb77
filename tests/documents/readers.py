"""What a reader has before a block of code is run: arrays, observations and files of a short walk.

Documents may use these names and files without saying where they come from.
"""

import json
import runpy
from pathlib import Path
from typing import Any

import numpy as np
import torch

import recon
from observations.correspondences import BodyPoints
from recon.core import rotations as so3
from recon.core.skeleton import JOINTS
from recon.formats.observations import KeypointsFile, PositionsFile, save_observation
from recon.reading.images import keypoints_of
from recon.simulation.images import keypoints2d
from recon.simulation.points import Corruption, joints3d, scan_points
from tests.documents.blocks import ROOT
from tests.filmed import before_two, bundled, cameras, two_people, walk

FRAMES = 12
FRAMES_OF_TWO = 24
"""Who is seen for less than half a second is left out."""


def names_of_readers(folder: Path) -> dict[str, Any]:
    """Names for a block, and files in the folder."""
    body, motion = bundled(), walk(FRAMES)
    seen = joints3d(motion, body, Corruption(noise=0.02), seed=0)
    positions = seen.positions.double().numpy()
    landmarks = BodyPoints.of_layout("mediapipe33", body)
    visible = np.ones(positions.shape[:2], dtype=bool)
    views = [
        keypoints2d(motion, body, camera, Corruption(noise=3.0), k, "openpose25")
        for k, camera in enumerate(cameras(motion, 2))
    ]
    _write(folder, positions, visible, views)
    scans = scan_points(motion, body, Corruption(noise=0.005), 0, points=300)
    _write_scans(folder / "scans", scans.points, scans.frame)
    recon.save_motion(folder / "walk.npz", walk(90))
    runpy.run_path(str(ROOT / "examples" / "05_c3d.py"))["written"](folder / "trial.c3d")
    _write_alphapose(folder / "keypoints.json")
    _write_estimate(folder / "hmr4d_results.pt", walk(90))
    coco = keypoints2d(motion, body, cameras(motion)[0], Corruption(noise=3.0), 0, "coco17")
    pose = coco.camera.T_camera_world
    assert pose is not None
    return {
        "__name__": "block",
        "recon": recon,
        "torch": torch,
        "np": np,
        "my_joints": positions,
        "my_landmarks": landmarks.of(body.pose(motion)).double().numpy(),
        "my_sensor": lambda: (positions, visible),
        "positions": positions,
        "visible": visible,
        "seen": seen,
        "motion": walk(90),
        "one": walk(35)[None],
        "other": walk(35, 35)[None],
        "view": keypoints_of(coco, body),
        "pixels": coco.pixels,
        "confidence": coco.confidence,
        "camera_matrix": coco.camera.camera_matrix,
        "distortion": None,
        "T_camera_world": pose[0],
    }


def _write_estimate(path: Path, motion: recon.Motion) -> None:
    """What a video network writes of every frame (GVHMR)."""
    vectors = so3.log(motion.rotations)
    parts = {
        "global_orient": vectors[:, 0], "body_pose": vectors[:, 1:].flatten(1),
        "transl": motion.translation, "betas": torch.zeros(motion.frames, 10),
    }  # fmt: skip
    torch.save({"smpl_params_global": parts}, path)


def _write(
    folder: Path, positions: np.ndarray, visible: np.ndarray, views: list[KeypointsFile]
) -> None:
    """joints.npz; keypoints/ of one view and trial/ of two, with Calib.toml."""
    save_observation(
        folder / "joints.npz", PositionsFile("joints3d", positions, visible, JOINTS, 30.0)
    )
    lines = []
    for k, view in enumerate(views, 1):
        _write_openpose(folder / "trial" / f"cam{k}_json", view)
        lines += _calibration(f"cam{k}", view)
    (folder / "Calib.toml").write_text("\n".join(lines), encoding="utf-8")
    _write_openpose(folder / "keypoints", views[0])
    lens = views[0].camera
    np.savez(folder / "lens.npz", camera_matrix=lens.camera_matrix, image_size=lens.image_size)


def _write_openpose(folder: Path, view: KeypointsFile) -> None:
    folder.mkdir(parents=True)
    for frame, (pixels, sure) in enumerate(zip(view.pixels, view.confidence, strict=True)):
        rows = np.concatenate((pixels, sure[:, None]), -1)
        person = {"pose_keypoints_2d": rows.ravel().tolist()}
        text = json.dumps({"people": [person]})
        (folder / f"frame_{frame:04d}.json").write_text(text, encoding="utf-8")


def _write_alphapose(path: Path) -> None:
    """AlphaPose's one file of a film of two people, numbered by its tracker; 0.8 s at 30 Hz."""
    people = []
    for number, motion in enumerate(two_people(FRAMES_OF_TWO)):
        seen = keypoints2d(
            motion, bundled(), before_two(), Corruption(noise=2.0), number, "coco17"
        )
        rows = np.concatenate((seen.pixels, seen.confidence[..., None]), -1)
        people += [
            {"image_id": f"{frame}.jpg", "idx": number + 1, "keypoints": row.ravel().tolist()}
            for frame, row in enumerate(rows)
        ]
    path.write_text(json.dumps(people), encoding="utf-8")


def _calibration(name: str, view: KeypointsFile) -> list[str]:
    """A camera as Pose2Sim writes it."""
    import cv2

    camera = view.camera
    assert camera.T_camera_world is not None
    T = camera.T_camera_world[0]
    turn = cv2.Rodrigues(T[:3, :3])[0].ravel().tolist()
    return [
        f"[{name}]",
        f'name = "{name}"',
        f"size = {[float(side) for side in camera.image_size]}",
        f"matrix = {camera.camera_matrix.tolist()}",
        "distortions = [0.0, 0.0, 0.0, 0.0]",
        f"rotation = {turn}",
        f"translation = {T[:3, 3].tolist()}",
        "fisheye = false",
    ]


def _write_scans(folder: Path, points: np.ndarray, frames: np.ndarray) -> None:
    import trimesh

    folder.mkdir()
    for frame in range(int(frames.max()) + 1):
        trimesh.PointCloud(points[frames == frame]).export(folder / f"scan_{frame:03d}.ply")

"""A file of every producer of `recon.formats.producers`, by its saving call or as documented."""

import json
import tarfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.io import savemat

from observations.correspondences import BodyPoints
from recon.core.layouts import keypoint_names
from recon.core.units import to_z_up
from recon.keypoints3d.labels import keypoints_of_labels
from recon.keypoints3d.layouts import MHR70, ZED38
from recon.mocap.marker_tables import write_trc
from recon.mocap.recording import MarkerRecording
from tests.filmed import bundled, walk
from tests.films.painted import write as write_film
from tests.formats import body_files
from tests.formats.body_files import dumped, saved
from tests.keypoint_scene import camera, figure, image, write_openpose, write_toml

FRAMES = body_files.FRAMES
_DOWN = to_z_up("y-down")


def points(layout: str) -> np.ndarray:
    """The keypoints of a walk, metres, z up."""
    body = bundled()
    return BodyPoints.of_layout(layout, body).of(body.pose(walk(FRAMES))).double().numpy()


def of_labels(labels: Sequence[str]) -> np.ndarray:
    """Points of a walk by any labels; those that are no keypoints are at the wrists."""
    meant = [one or "left_wrist" for one in keypoints_of_labels(labels)]
    body = bundled()
    return BodyPoints.of_names(meant, body).of(body.pose(walk(FRAMES))).double().numpy()


def as_json(path: Path, value: Any) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(value))
    return path


def as_table(path: Path, rows: list[list[Any]]) -> Path:
    path.write_text("".join(",".join(map(str, row)) + "\n" for row in rows))
    return path


def _world(at: Path) -> Path:
    x = points("mediapipe33")
    x = (x - x[:, 23:25].mean(1, keepdims=True)) @ _DOWN
    return as_json(at / "a.json", [
        {"pose_world_landmarks": [dict(zip("xyz", p, strict=True), visibility=0.9) for p in one]}
        for one in x.tolist()
    ])  # fmt: skip


def _azure(at: Path) -> Path:
    x = points("azure32") @ _DOWN * 1000 + (0, 0, 3000)
    return as_json(at / "a.json", {"frames": [
        {"timestamp_usec": t * 33333, "bodies": [{"body_id": 4, "joint_positions": one}]}
        for t, one in enumerate(x.tolist())
    ]})  # fmt: skip


def _easymocap(at: Path) -> Path:
    """easymocap/mytools/file_utils.py, write_keypoints3d: four decimals; nobody in one frame."""
    for t, one in enumerate(points("openpose25")):
        rows = [[*(round(x, 3) for x in point), 0.8] for point in one.tolist()]
        rows[4] = [0.0, 0.0, 0.0, 0.0] if t % 3 else rows[4]
        other = [[x + 2, *rest] for x, *rest in rows]
        people = [{"id": 0, "keypoints3d": rows}, {"id": 1, "keypoints3d": other}]
        as_json(at / "keypoints3d" / f"{t:06d}.json", [] if t == 5 else people[:: 1 - 2 * (t % 2)])
    return at / "keypoints3d"


def _openpose(at: Path) -> Path:
    x = points("openpose25") @ _DOWN + (0, 0, 4)
    for t, one in enumerate(x):
        record = {
            "person_id": [-1], "pose_keypoints_2d": [],
            "pose_keypoints_3d": np.concatenate((one, np.full((25, 1), 0.8)), 1).ravel().tolist(),
        }  # fmt: skip
        as_json(at / "json" / f"film_{t:012d}_keypoints.json", {"people": [record]})
    return at / "json"


def _mmpose(at: Path) -> Path:
    """mmpose/apis/inferencers/pose3d_inferencer.py: 17 keypoints of Human3.6M, z up."""
    frames = [
        {"frame_id": t + 1, "instances": [{"keypoints": one, "keypoint_scores": [0.9] * 17}]}
        for t, one in enumerate(points("h36m17").tolist())
    ]
    return as_json(at / "a.json", {"meta_info": {"dataset_name": "h36m"}, "instance_info": frames})


def _zed(at: Path) -> Path:
    """zed-sdk, body tracking/export: an object by time stamps, NaN where nothing is found."""
    x = of_labels(ZED38) @ to_z_up("y")
    x[3, 7] = np.nan
    frames = {}
    for t, one in enumerate(x.tolist()):
        stamp = 1700000000000 + round(t * 1000 / 30)
        body = {"id": 3, "keypoint": one, "keypoint_confidence": [80.0] * 38}
        frames[str(stamp)] = {
            "is_new": True, "timestamp": stamp * 10**6, "body_list": [] if t == 5 else [body],
        }  # fmt: skip
    return as_json(at / "a.json", frames)


def _sam3d(at: Path) -> Path:
    return dumped(at / "a.pkl", [
        [{"pred_keypoints_3d": one, "pred_cam_t": np.array([0, 0, 4.0])}]
        for one in of_labels(MHR70) @ _DOWN - (0, 0.9, 0)
    ])  # fmt: skip


def _pixels() -> np.ndarray:
    return image(figure("coco17"), camera(20))


def _instances() -> list[dict[str, Any]]:
    seen = _pixels()
    return [{"keypoints": seen[:, :2].tolist(), "keypoint_scores": [0.9] * 17}]


def _deeplabcut(at: Path, axes: str = "xy") -> Path:
    names, x = keypoint_names("coco17"), points("coco17")[..., : len(axes)] * 1000
    columns = [*axes, "likelihood"] if axes == "xy" else [*axes]
    cells = np.concatenate((x, np.ones((*x.shape[:2], 1))), -1)[..., : len(columns)]
    head = [
        ["scorer", *["net"] * len(names) * len(columns)],
        ["bodyparts", *(name for name in names for _ in columns)],
        ["coords", *columns * len(names)],
    ]
    return as_table(at / "a.csv", [*head, *([t, *one.ravel()] for t, one in enumerate(cells))])


def _sleap(at: Path) -> Path:
    names, seen = keypoint_names("coco17"), _pixels()
    head = ["track", "frame_idx", "instance.score"]
    head += [f"{name}.{axis}" for name in names for axis in ("x", "y", "score")]
    return as_table(at / "a.csv", [head, *(["", t, 0.9, *seen.ravel()] for t in range(FRAMES))])


def _freemocap(at: Path) -> Path:
    (at / "output_data").mkdir()
    x = 1000 * points("mediapipe33")
    np.save(at / "output_data" / "mediapipe_body_3d_xyz.npy", x)
    return at


def _wide(at: Path) -> Path:
    names, x = keypoint_names("coco17"), points("coco17")
    head = [f"{name}_{axis}" for name in names for axis in "xyz"]
    return as_table(at / "a.csv", [head, *x.reshape(FRAMES, -1).tolist()])


def _bvh() -> str:
    return (
        "HIERARCHY\nROOT Hips\n{\n OFFSET 0 0 0\n CHANNELS 6 Xposition Yposition Zposition "
        "Zrotation Xrotation Yrotation\n End Site\n {\n OFFSET 0 170 0\n }\n}\n"
        "MOTION\nFrames: 2\nFrame Time: 0.0333333\n0 90 0 0 0 0\n0 90 0 0 0 0\n"
    )


def _text(name: str, text: str) -> Callable[[Path], Path]:
    def write(at: Path) -> Path:
        (at / name).write_text(text)
        return at / name

    return write


def _kitti(at: Path) -> Path:
    np.random.default_rng(0).normal(size=(50, 4)).astype("f4").tofile(at / "000000.bin")
    return at


def _archive(at: Path) -> Path:
    with tarfile.open(at / "a.tar.xz", "w:xz") as archive:
        archive.add(_text("a.bvh", _bvh())(at), "a.bvh")
    return at / "a.tar.xz"


_CENTRES = ("LHip", "RHip", "LKnee", "RKnee", "LAnkle", "RAnkle", "LShoulder", "RShoulder")


def _centres() -> np.ndarray:
    return of_labels(_CENTRES)


def _trc(at: Path) -> Path:
    x = _centres()
    record = MarkerRecording("a", _CENTRES, x, np.ones(x.shape[:2], bool), 30.0, ())
    write_trc(at / "a.trc", record)
    return at / "a.trc"


def _motive(at: Path) -> Path:
    """Format 1.25: a bone, then markers; the first marker is not seen in one frame."""
    x = 1000 * _centres() @ to_z_up("y")
    cells = ["Rotation"] * 4 + ["Position"] * 3 + ["Position"] * 3 * len(_CENTRES)
    kinds = ["Bone"] * 7 + ["Marker"] * 3 * len(_CENTRES)
    names = ["A:Hip"] * 7 + [f"A:{name}" for name in _CENTRES for _ in range(3)]
    head = "Format Version,1.25,Take Name,walk,Capture Frame Rate,30.000000,Export Frame Rate,"
    rows = [
        [f"\ufeff{head}30.000000,Rotation Type,Quaternion,Length Units,Millimeters"], [],
        ["", "Type", *kinds], ["", "Name", *names], ["", "ID", *["1"] * len(kinds)],
        ["", "", *cells], ["Frame", "Time (Seconds)", *"XYZWXYZ", *"XYZ" * len(_CENTRES)],
        *([t, t / 30, 0, 0, 0, 1, 0, 900, 0, *one.ravel()] for t, one in enumerate(x)),
    ]  # fmt: skip
    rows[-1][9:12] = ["", "", ""]
    return as_table(at / "a.csv", rows)


def _qualisys(at: Path) -> Path:
    x = 1000 * _centres()
    x[-1, 0] = 0.0
    lines = [
        f"NO_OF_FRAMES\t{FRAMES}", "NO_OF_CAMERAS\t8", f"NO_OF_MARKERS\t{len(_CENTRES)}",
        "FREQUENCY\t30", "NO_OF_ANALOG\t0", "ANALOG_FREQUENCY\t0", "DESCRIPTION\t--",
        "TIME_STAMP\t2024-01-01, 10:00:00", "DATA_INCLUDED\t3D",
        "\t".join(("MARKER_NAMES", *_CENTRES)),
        *("\t".join(f"{value:.3f}" for value in one.ravel()) for one in x),
    ]  # fmt: skip
    return _text("a.tsv", "\n".join(lines) + "\n")(at)


def _ntu(at: Path) -> Path:
    """25 joints of Kinect v2; a hand is not tracked."""
    x = points("kinect25") @ to_z_up("y") + (0, -0.9, 3)
    lines = [str(FRAMES)]
    for one in x:
        lines += ["1", "72057594037931101 0 1 1 1 1 0 0.02 0.05 2", "25"]
        lines += [
            f"{a:.6f} {b:.6f} {c:.6f} 277.4 191.8 1036.2 519.1 -0.2 0.05 0.97 -0.12 {2 * (k != 7)}"
            for k, (a, b, c) in enumerate(one)
        ]
    return _text("S001C001P001R001A001.skeleton", "\n".join(lines) + "\n")(at)


def _mat(at: Path) -> Path:
    data = 1000 * points("coco17").reshape(FRAMES, -1)
    names = np.array([[name] for name in keypoint_names("coco17")], dtype=object)
    record = {"type": "MoCap data", "nFrames": FRAMES, "nMarkers": 17, "freq": 30.0,
              "data": data, "markerName": names}  # fmt: skip
    savemat(at / "a.mat", {"d": record})
    return at / "a.mat"


def _aist_points(at: Path) -> Path:
    x = 100 * points("coco17") @ to_z_up("y")
    return dumped(at / "a.pkl", {"keypoints3d": x + 50, "keypoints3d_optim": x})


def _observation(at: Path) -> Path:
    x = points("smpl22")
    return saved(at / "a.npz", kind="joints3d", positions=x, visible=np.ones(x.shape[:2], bool),
                  names=np.array(keypoint_names("smpl22")), fps=30.0, up_axis="z")  # fmt: skip


def _calibration(at: Path) -> Path:
    lens = camera(0)
    return saved(at / "a.npz", camera_matrix=lens.camera_matrix, image_size=lens.image_size)


def _meshes(at: Path) -> Path:
    (at / "meshes").mkdir()
    for t, one in enumerate(of_labels(MHR70)):
        lines = ["# OBJ", "mtllib a.mtl", *(f"v {x:.4f} {y:.4f} {z:.4f} 1 1 1" for x, y, z in one)]
        (at / "meshes" / f"{t:04d}.obj").write_text("\n".join([*lines, "f 1 2 3", ""]))
    return at / "meshes"


def _arrays(at: Path) -> Path:
    (at / "clouds").mkdir()
    for t, one in enumerate(of_labels(MHR70)):
        body = one[:21]  # of the other points, most are at the wrists
        np.save(at / "clouds" / f"{t}.npy", np.concatenate([body + 1e-3 * k for k in range(10)]))
    return at / "clouds"


def saved_array(path: Path, array: np.ndarray) -> Path:
    np.save(path, array, allow_pickle=True)
    return path


_ANNOTS = {"annots": [{"personID": 0, "keypoints": _pixels().tolist()}]}
_LANDMARKS = [[{"x": 0.3 + 0.01 * k, "y": 0.3, "visibility": 0.9} for k in range(33)]] * 2
SAMPLES: dict[tuple[str, str, str], Callable[[Path], Path]] = {
    ("Vicon Nexus", "a table", ".csv"): _text(
        "a.csv", "\ufeffTrajectories\n100\n,,Ann:LFHD,,\nFrame,Sub Frame,X,Y,Z\n,,mm,mm,mm\n"
    ),
    ("CMU Panoptic", "3D keypoints", ".json"): lambda at: as_json(
        at / "a.json", {"univTime": 5.1, "bodies": [{"id": 0, "joints19": [0.5] * 76}]}
    ),
    ("Xsens", "a recording", ".mvnx"): _text("a.mvnx", "<mvnx></mvnx>"),
    ("Qualisys", "a recording", ".qtm"): _text("a.qtm", "QTM"),
    ("SLEAP, DeepLabCut or another program", "HDF5", ".h5"): _text("a.h5", "HDF"),
    ("OpenSim", "coordinates or forces", ".mot"): _text("a.mot", "Coordinates\nversion=1\n"),
    ("KITTI", "LiDAR points", ".bin"): _kitti,
    ("Excel", "a table", ".xlsx"): _text("a.xlsx", "PK"),
    ("RealSense or ROS", "a recording", ".bag"): _text("a.bag", "#ROSBAG V2.0\n"),
    ("Record3D", "a recording", ".r3d"): _text("a.r3d", "PK"),
    ("FreeMoCap", "3D keypoints", "/"): _freemocap,
    ("SAM 3D Body", "3D keypoints", ".npz"): _sam3d,
    ("AIST++", "3D keypoints", ".pkl"): _aist_points,
    ("TRAM", "body parameters", ".npy"): body_files.tram,
    ("MediaPipe", "3D keypoints", ".json"): _world,
    ("Azure Kinect", "3D keypoints", ".json"): _azure,
    ("EasyMocap", "3D keypoints", ".json"): _easymocap,
    ("OpenPose", "3D keypoints", ".json"): _openpose,
    ("ZED", "3D keypoints", ".json"): _zed,
    ("OpenPose, Pose2Sim", "2D keypoints", ".json"): lambda at: write_openpose(
        at / "cam", [[image(figure("openpose25"), camera(20))]] * 2
    ),
    ("EasyMocap", "2D keypoints", ".json"): lambda at: as_json(
        at / "annots" / "000000.json", _ANNOTS
    ).parent,
    ("AlphaPose", "2D keypoints", ".json"): lambda at: as_json(
        at / "a.json", [{"image_id": "0.jpg", "keypoints": _pixels().ravel().tolist()}]
    ),
    ("MMPose", "3D keypoints", ".json"): _mmpose,
    ("MMPose, rtmlib", "2D keypoints", ".json"): lambda at: as_json(
        at / "a.json", {"instance_info": [{"frame_id": 1, "instances": _instances()}]}
    ),
    ("MediaPipe", "2D keypoints", ".json"): lambda at: as_json(at / "a.json", _LANDMARKS),
    ("DeepLabCut", "2D keypoints", ".csv"): _deeplabcut,
    ("SLEAP", "2D keypoints", ".csv"): _sleap,
    ("rtmlib, ViTPose, your own", "2D keypoints", ".npz"): lambda at: saved(
        at / "a.npz", keypoints=_pixels()[None, None, :, :2], scores=np.ones((1, 1, 17))
    ),
    ("OptiTrack Motive", "markers or joint centres", ".csv"): _motive,
    ("Qualisys", "markers or joint centres", ".tsv"): _qualisys,
    ("", "scans", ".npy"): _arrays,
    ("", "clouds in one file", ".npy"): lambda at: saved_array(at / "a.npy", np.ones((4, 300, 3))),
    ("", "Python objects", ".npy"): lambda at: saved_array(
        at / "a.npy", np.array([np.ones((4, 3)), np.ones((5, 3))], dtype=object)
    ),
    ("Anipose, DeepLabCut, your own", "3D keypoints", ".csv"): _wide,
    ("your own", "3D keypoints", ".json"): lambda at: as_json(
        at / "a.json", {"names": keypoint_names("coco17"), "frames": points("coco17").tolist()}
    ),
    ("MotionBERT, your own", "3D keypoints", ".npy"): lambda at: (
        np.save(at / "X3D.npy", points("h36m17")), at / "X3D.npy",
    )[1],
    ("Vicon, Qualisys, Motive, Cortex, Pose2Sim, OpenCap", "markers or joint centres", ".c3d"):
        _trc,
    ("", "a skeleton's motion", ".bvh"): _archive,
    ("Motion Capture Toolbox", "markers", ".mat"): _mat,
    ("", "a skeleton without motion", ".asf"): _text("a.asf", ":version 1.10\n:root\n"),
    ("NTU RGB+D", "3D keypoints", ".skeleton"): _ntu,
    ("", "scans", ".obj"): _meshes,
    ("recon", "an observation", ".npz"): _observation,
    ("recon", "a motion", ".npz"): body_files.motion,
    ("", "a body model", ".npz"): lambda at: saved(at / "a.npz", v_template=np.zeros((9, 3))),
    ("", "a calibration of cameras", ".npz"): _calibration,
    ("", "a calibration of cameras", ".toml"): lambda at: write_toml(
        at / "a.toml", {"cam": camera(0)}
    ),
    ("", "silhouettes", ".npz"): lambda at: saved(at / "a.npz", mask=np.ones((2, 4, 4), bool)),
    ("AIST++", "body parameters", ".pkl"): body_files.aist_motion,
    ("GVHMR", "body parameters", ".pt"): body_files.gvhmr,
    ("WHAM", "body parameters", ".pkl"): body_files.wham,
    ("PHALP (4D-Humans)", "body parameters", ".pkl"): body_files.phalp,
    ("AMASS", "body parameters", ".npz"): body_files.amass,
    ("SLAHMR", "body parameters", ".npz"): body_files.slahmr,
    ("SMPL, SMPL-X", "body parameters", ".npz"): body_files.smplx,
    ("", "body parameters", ".pt"): body_files.any_body,
    ("", "a film", ".mp4"): lambda at: write_film(at / "a.mp4", np.zeros((3, 48, 64, 3), "u1")),
    ("Autodesk", "a scene", ".fbx"): _text("a.fbx", "Kaydara FBX Binary"),
}  # fmt: skip
"""By name, what it holds and its first ending: writes a sample into a folder, gives its path."""

"""Projects as Pose2Sim and OpenCap lay them out, built around real detections.

    python -m benchmarks.projects OBSERVATIONS OUT

OBSERVATIONS is a folder with pose2sim/*.zip and pose2sim/Calib_qualisys.toml. For each recording
OUT gets a session folder with `Config.toml` and `calibration/Calib_qualisys.toml`, and in it a
trial with `pose-associated/CAMERA_json/*.json` and `pose-3d/TRIAL_FIRST-LAST.trc`: the keypoints
triangulated from the views with confidence above 0.3 (Pose2Sim's
likelihood_threshold_triangulation) by a weighted DLT, gaps left empty, header, names, axis order
(y, z, x of the calibration's world) and unit as Pose2Sim's make_trc writes them
(Pose2Sim 0.10, personAssociation.py, triangulation.py, common.py: zup2yup). An OpenCap session
has the same table as MarkerData/TRIAL.trc with sessionMetadata.yaml beside (opencap-core,
utils.py) and a pickle of a calibration, which must not be opened.
"""

import argparse
import shutil
import zipfile
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float

from recon.core.skeleton import keypoint_names
from recon.formats.observations import KeypointsFile
from recon.reading.views import read_views

FPS = 60
SETS = ("single_balancing", "single_static", "multi_static_p2")
CONFIDENT = 0.3
"""Pose2Sim's likelihood_threshold_triangulation."""
_NAMES = {
    "mid_hip": "Hip", "head_top": "Head", "upper_neck": "Neck", "nose": "Nose", "neck": "Neck",
}  # fmt: skip
_CONFIG = """[project]
multi_person = false
frame_rate = {fps}
frame_range = []

[pose]
pose_model = 'BODY_25B'
"""


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("observations", type=Path)
    parser.add_argument("out", type=Path)
    arguments = parser.parse_args()
    for name in SETS:
        print(build(arguments.observations, name, arguments.out))


def build(observations: Path, name: str, out: Path) -> tuple[Path, Path]:
    """The trial folder of a Pose2Sim project, and an OpenCap session, of one recording."""
    source = observations / "pose2sim"
    session = out / f"{name}_session"
    trial = session / name
    (session / "calibration").mkdir(parents=True)
    shutil.copy(source / "Calib_qualisys.toml", session / "calibration")
    (session / "Config.toml").write_text(_CONFIG.format(fps=FPS))
    with zipfile.ZipFile(source / f"{name}.zip") as archive:
        inside = [one for one in archive.namelist() if one.startswith("pose-associated/")]
        archive.extractall(trial, inside)
    (trial / "Config.toml").write_text("[project]\n# as in the session's Config.toml\n")
    views = read_views(
        [trial / "pose-associated"], session / "calibration" / "Calib_qualisys.toml", fps=FPS
    ).person(None)
    points = triangulated(views.files)
    last = views.first_frame + len(points) - 1
    table = trial / "pose-3d" / f"{name}_{views.first_frame}-{last}.trc"
    table.parent.mkdir()
    write_trc(table, views.files[0].layout, points, views.first_frame)
    opencap = out / f"OpenCapData_{name}"
    camera = opencap / "Videos" / "Cam0"
    camera.mkdir(parents=True)
    (camera / "cameraIntrinsicsExtrinsics.pickle").write_bytes(b"never opened")
    (opencap / "sessionMetadata.yaml").write_text("mass_kg: 70.0\nheight_m: 1.7\n")
    (opencap / "MarkerData").mkdir()
    shutil.copy(table, opencap / "MarkerData" / f"{name}.trc")
    return trial, opencap


def triangulated(files: tuple[KeypointsFile, ...]) -> Float[np.ndarray, "time points 3"]:
    """Least squares of x = P X over the confident views, weighted by confidence; NaN elsewhere."""
    rays, weights = [], []
    for file in files:
        camera = file.camera
        assert camera.T_camera_world is not None
        size = file.pixels.shape
        flat = file.pixels.reshape(-1, 1, 2)
        lens = camera.distortion if camera.distortion is not None else np.zeros(4)
        normal = cv2.undistortPoints(flat, camera.camera_matrix, lens).reshape(size)
        P = camera.T_camera_world[0, :3]
        rays.append(np.stack([normal[..., k, None] * P[2] - P[k] for k in range(2)], -2))
        weights.append(np.where(file.confidence > CONFIDENT, file.confidence, 0.0))
    A = np.stack(rays, 2) * np.stack(weights, 2)[..., None, None]  # time points views 2 4
    A = A.reshape(*A.shape[:2], -1, 4)
    found = np.linalg.svd(A)[2][..., -1, :]
    enough = (np.stack(weights, 2) > 0).sum(-1) >= 2
    return np.where(enough[..., None], found[..., :3] / found[..., 3:], np.nan)


def write_trc(
    path: Path, layout: str, points: Float[np.ndarray, "time points 3"], first: int
) -> None:
    """Joint centres as Pose2Sim writes them: y, z, x of a world with z up, metres, one per row."""
    names = [_spelled(name) for name in keypoint_names(layout)]
    values = points[..., [1, 2, 0]]
    rate, count = str(FPS), str(len(points))
    lines = [
        f"PathFileType\t4\t(X/Y/Z)\t{path.name}",
        "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame"
        "\tOrigNumFrames",
        "\t".join([rate, rate, count, str(len(names)), "m", rate, str(first), count]),
        "Frame#\tTime\t" + "\t\t\t".join(names) + "\t\t\t",
        "\t\t" + "\t".join(f"X{k}\tY{k}\tZ{k}" for k in range(1, len(names) + 1)) + "\t",
    ]
    for t, row in enumerate(values):
        cells = ["" if np.isnan(x) else f"{x:.6f}" for x in row.ravel()]
        lines.append("\t".join([str(first + t), f"{(first + t) / FPS:.6f}", *cells]))
    path.write_text("\n".join(lines) + "\n")


def _spelled(name: str) -> str:
    """A keypoint as Pose2Sim spells it: RBigToe."""
    if name in _NAMES:
        return _NAMES[name]
    side, _, rest = name.partition("_")
    return side[0].upper() + rest.title().replace("_", "")


if __name__ == "__main__":
    main()

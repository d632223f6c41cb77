"""Phones: what a fit makes of one film whose camera nobody calibrated.

    python -m benchmarks.phone CORPUS --part validation --only 8 --json phone.json
    python -m benchmarks.phone CORPUS --part validation --only 8 --cases focal

Windows of 90 frames, three pixels of noise, one camera of unknown pose. Errors are distances of
the 22 joints about the pelvis, seen from the camera.

`focal`: the true focal length is 0.7, 1 or 1.4 times that which the image size suggests, by turns.
`known` is told the true one, `found` guesses it and corrects the guess, `held` believes the guess.
`ratio` is the focal length that was used over the true one.

`track`: a phone of known lens is carried around the person by 57 degrees, with a sway of 5 cm. It
is fixed (`static`), or its track is in a file of a tracker, in a world and a unit of its own where
the tracker knows of none; `undeclared` is believed to be fixed. `unit` is the length of the path
of the camera that was found over the true one.
"""

import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from rich.console import Console
from torch import Tensor

from benchmarks.arguments import over_windows
from benchmarks.humor import evenly
from benchmarks.results import corpus_source, write
from benchmarks.scores import Columns, Row, Rows, by_subject, tables
from benchmarks.track_files import write_arkit, write_colmap, write_droid, write_tum
from observations.keypoints2d import Keypoints2D
from recon.benchmark.dataset import Splits
from recon.benchmark.windows import FPS, TrueWindows, load_windows
from recon.body.model import BodyModel
from recon.core.camera import Camera, transform
from recon.core.motion import Motion
from recon.core.struct import concatenate
from recon.fitting.clip import fit_clip
from recon.fitting.fitted import ClipFit
from recon.fitting.methods import FitOptions
from recon.formats.calibration import guessed_camera
from recon.formats.camera_path import CameraPath
from recon.formats.observations import KeypointsFile
from recon.formats.tracks import read_track
from recon.reading.images import keypoints_of
from recon.simulation.images import dome, keypoints2d, orbiting
from recon.simulation.points import Corruption

SEED = 0
FRAMES = 90
PIXELS = 3.0
SIZE = (1920, 1080)
ORBIT = 1.0
"""Radians that a carried phone goes around the person."""
FACTORS = (0.7, 1.0, 1.4)
"""True focal lengths over the guessed one, by turns."""
COLUMNS: Columns = {
    "about": ("pelvis cm", 100), "ratio": ("focal ratio", 1), "unit": ("unit ratio", 1),
    "seconds": ("CPU s", 1),
}  # fmt: skip


TRACKERS: dict[str, Callable[[Path, Float[np.ndarray, "time 4 4"]], Path]] = {
    "COLMAP": write_colmap, "TUM": write_tum, "DROID-SLAM": write_droid, "ARKit": write_arkit,
}  # fmt: skip


@dataclass(frozen=True)
class Filmed:
    """One window as one camera saw it."""

    file: KeypointsFile
    """The keypoints, with the camera that filmed them."""
    camera: Camera


def main() -> None:
    parser = over_windows(__doc__)
    parser.add_argument("--only", type=int, default=None, help="use so many windows in all")
    parser.add_argument("--cases", nargs="+", choices=CASES, default=list(CASES))
    arguments = parser.parse_args()
    body, splits = BodyModel.load(), Splits.load(arguments.splits)
    windows = load_windows(arguments.corpus, splits, arguments.part, body, SEED, FRAMES)
    if arguments.only is not None:
        windows = windows.take(evenly(windows, arguments.only))
    console = Console(width=None if sys.stdout.isatty() else 160)
    found: dict[str, dict[str, Rows]] = {}
    for case in arguments.cases:
        found[case] = CASES[case](windows, body)
        for shown in tables(f"{case}, {arguments.part}", COLUMNS, found[case]):
            console.print(shown)
    if arguments.json is not None:
        about = {"part": arguments.part, **windows.about}
        write(arguments.json, SEED, corpus_source(arguments.corpus, windows.files), **about,
              tables=found)  # fmt: skip


def focal(windows: TrueWindows, body: BodyModel) -> dict[str, Rows]:
    """The focal length told, found and guessed."""
    filmed = [
        _filmed(windows.truth[k], body, k, FACTORS[k % 3]) for k in range(len(windows.names))
    ]
    known = [_lost(one, one.file.camera.camera_matrix) for one in filmed]
    guess = guessed_camera(SIZE).camera_matrix
    views: dict[str, Sequence[KeypointsFile]] = {
        "known": known,
        "found": [replace(one, camera=guessed_camera(SIZE)) for one in known],
        "held": [_lost(one, guess) for one in filmed],
    }
    return {
        name: by_subject(windows, _rows(windows, filmed, files, body))
        for name, files in views.items()
    }


def track(windows: TrueWindows, body: BodyModel) -> dict[str, Rows]:
    """A fixed phone, and one that is carried, its track in a file of each tracker."""
    still = [_filmed(windows.truth[k], body, k, factor=1.0) for k in range(len(windows.names))]
    carried = [_carried(windows.truth[k], body, k, one) for k, one in enumerate(still)]
    matrix = guessed_camera(SIZE).camera_matrix
    rows = {
        "static": _rows(windows, still, [_lost(one, matrix) for one in still], body),
        "undeclared": _rows(windows, carried, [_lost(one, matrix) for one in carried], body),
    }
    with tempfile.TemporaryDirectory() as scratch:
        for name, writer in TRACKERS.items():
            files = []
            for k, one in enumerate(carried):
                T = one.camera.T_world_camera.double().numpy()
                read = read_track(writer(Path(scratch) / f"{name}{k}", T))
                poses, _ = read.at(0, FRAMES, FPS)
                lost = _lost(one, matrix)
                path = CameraPath(poses, read.metric, read.level)
                files.append(replace(lost, camera=replace(lost.camera, path=path)))
            rows[name] = _rows(windows, carried, files, body)
    return {name: by_subject(windows, found) for name, found in rows.items()}


def _carried(truth: Motion, body: BodyModel, seed: int, still: Filmed) -> Filmed:
    """The phone carried around the person."""
    middle = body.pose(truth).joints.flatten(0, 1).mean(0)
    camera = orbiting(still.camera, middle, truth.frames, ORBIT)
    return Filmed(keypoints2d(truth, body, camera, Corruption(noise=PIXELS), 100 * seed), camera)


def _filmed(truth: Motion, body: BodyModel, seed: int, factor: float) -> Filmed:
    """A window as a fixed phone sees it from a direction of its own."""
    guess = guessed_camera(SIZE).camera_matrix
    matrix = np.diag([factor, factor, 1.0]) @ guess
    matrix[:2, 2] = guess[:2, 2]
    (camera,) = dome(truth, body, Camera.create(matrix, SIZE), 1, first=2.4 * seed)
    seen = keypoints2d(truth, body, camera, Corruption(noise=PIXELS), 100 * seed)
    return Filmed(seen, camera)


def _lost(one: Filmed, matrix: Float[np.ndarray, "3 3"]) -> KeypointsFile:
    """The keypoints with a camera of unknown pose."""
    camera = replace(one.file.camera, camera_matrix=matrix, T_camera_world=None)
    return replace(one.file, camera=camera)


def _rows(
    windows: TrueWindows, filmed: Sequence[Filmed], files: Sequence[KeypointsFile], body: BodyModel
) -> list[Row]:
    """All windows fitted together, each compared with its truth."""
    view = concatenate([keypoints_of(file, body) for file in files])
    began = time.process_time()
    fitted = fit_clip([view], FitOptions(), body)
    seconds = (time.process_time() - began) / len(files)
    (seen,) = fitted.observations
    assert isinstance(seen, Keypoints2D)
    rows: list[Row] = []
    for k, one in enumerate(filmed):
        used = float(seen.camera.camera_matrix[k, ..., 0, 0].mean())
        rows.append({
            "about": _about(fitted, seen, k, windows.truth[k], one.camera, body),
            "ratio": used / float(one.camera.camera_matrix[0, 0]),
            "unit": _unit(seen, k, one.camera),
            "seconds": seconds,
        })  # fmt: skip
    return rows


def _about(
    fitted: ClipFit, seen: Keypoints2D, k: int, truth: Motion, camera: Camera, body: BodyModel
) -> float:
    """Mean distance of joints about the pelvis in the frame of the camera, metres."""
    T = seen.camera.T_camera_world[k] @ torch.linalg.inv(fitted.T_world_recording[k])
    ours = transform(T, fitted.result.body.joints[k].detach().cpu())
    theirs = camera.to_camera(body.pose(truth).joints)
    return float((_centred(ours) - _centred(theirs)).norm(dim=-1).mean())


def _unit(seen: Keypoints2D, k: int, camera: Camera) -> float | None:
    """Length of the camera's path that was found over the true one; None where it stands."""
    if camera.T_camera_world.ndim == 2 or seen.camera.T_camera_world.shape[-3] == 1:
        return None
    found, true = seen.camera.T_world_camera[k, :, :3, 3], camera.T_world_camera[:, :3, 3]
    return float((found[-1] - found[0]).norm() / (true[-1] - true[0]).norm())


def _centred(joints: Float[Tensor, "time 22 3"]) -> Float[Tensor, "time 22 3"]:
    return joints - joints[:, :1]


CASES: dict[str, Callable[[TrueWindows, BodyModel], dict[str, Rows]]] = {
    "focal": focal,
    "track": track,
}

if __name__ == "__main__":
    main()

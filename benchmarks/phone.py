"""Phones: what a fit makes of one film whose camera nobody calibrated.

    python -m benchmarks.phone CORPUS --part validation --only 8 --json phone.json
    python -m benchmarks.phone CORPUS --part validation --only 8 --cases focal

Windows of 90 frames, three pixels of noise, one camera of unknown pose. Errors are distances of
the 22 joints about the pelvis, seen from the camera.

`focal`: the true focal length is 0.7, 1 or 1.4 times that which the image size suggests, by turns.
`known` is told the true one, `found` guesses it and corrects the guess, `held` believes the guess.
`ratio` is the focal length that was used over the true one.
"""

import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float
from rich.console import Console
from torch import Tensor

from benchmarks.arguments import over_windows
from benchmarks.humor import evenly
from benchmarks.results import corpus_source, write
from benchmarks.scores import Columns, Row, Rows, by_subject, tables
from benchmarks.windows import Windows, load_windows
from observations.files.images import keypoints_of
from observations.keypoints2d import Keypoints2D
from priors.training.dataset import Splits
from recon.body.model import BodyModel
from recon.core.camera import Camera, transform
from recon.core.motion import Motion
from recon.core.struct import concatenate
from recon.fitting.clip import ClipFit, fit_clip
from recon.fitting.options import FitOptions
from recon.formats.calibration.guessed import guessed_camera
from recon.formats.observations import KeypointsFile
from recon.simulation.images import dome, keypoints2d
from recon.simulation.points import Corruption

SEED = 0
FRAMES = 90
PIXELS = 3.0
SIZE = (1920, 1080)
FACTORS = (0.7, 1.0, 1.4)
"""True focal lengths over the guessed one, by turns."""
COLUMNS: Columns = {
    "about": ("pelvis cm", 100), "ratio": ("focal ratio", 1), "seconds": ("CPU s", 1),
}  # fmt: skip


@dataclass(frozen=True)
class Filmed:
    """One window as one camera saw it."""

    file: KeypointsFile
    """With the camera that filmed it."""
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


def focal(windows: Windows, body: BodyModel) -> dict[str, Rows]:
    """The focal length told, found and guessed."""
    filmed = [_filmed(windows.truth[k], body, k) for k in range(len(windows.names))]
    known = [_lost(one, one.file.camera.camera_matrix) for one in filmed]
    guess = guessed_camera(SIZE).camera_matrix
    views: dict[str, Sequence[KeypointsFile]] = {
        "known": known,
        "found": [
            replace(one, camera=replace(guessed_camera(SIZE), T_camera_world=None))
            for one in known
        ],
        "held": [_lost(one, guess) for one in filmed],
    }
    return {
        name: by_subject(windows, _rows(windows, filmed, files, body))
        for name, files in views.items()
    }


def _filmed(truth: Motion, body: BodyModel, seed: int) -> Filmed:
    """A window as a fixed phone sees it from a direction of its own."""
    guess = guessed_camera(SIZE).camera_matrix
    matrix = np.diag([FACTORS[seed % 3], FACTORS[seed % 3], 1.0]) @ guess
    matrix[:2, 2] = guess[:2, 2]
    (camera,) = dome(truth, body, Camera.create(matrix, SIZE), 1, first=2.4 * seed)
    seen = keypoints2d(truth, body, camera, Corruption(noise=PIXELS), 100 * seed)
    return Filmed(seen, camera)


def _lost(one: Filmed, matrix: Float[np.ndarray, "3 3"]) -> KeypointsFile:
    """The keypoints with a camera of unknown pose."""
    camera = replace(one.file.camera, camera_matrix=matrix, T_camera_world=None)
    return replace(one.file, camera=camera)


def _rows(
    windows: Windows, filmed: Sequence[Filmed], files: Sequence[KeypointsFile], body: BodyModel
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


def _centred(joints: Float[Tensor, "time 22 3"]) -> Float[Tensor, "time 22 3"]:
    return joints - joints[:, :1]


CASES: dict[str, Callable[[Windows, BodyModel], dict[str, Rows]]] = {"focal": focal}

if __name__ == "__main__":
    main()

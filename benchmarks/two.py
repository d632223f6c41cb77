"""Compares fits of two people who cross before one camera with fits of each alone.

    python -m benchmarks.two CORPUS --out FOLDER

Films are simulated keypoints of listed windows of people who go somewhere, one to the right 4.5 m
and one to the left 5.5 m away, before a camera of known lens; with three pixels of noise, and the
detections of a frame in random order. Errors are about the pelvis.
"""

import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import torch

import recon
from benchmarks.cameras import PIXELS, in_true_world
from benchmarks.protocol import Cell, Table, over_windows, tell_of
from recon import BodyModel, Motion
from recon.benchmark.dataset import Splits
from recon.benchmark.windows import load_windows
from recon.body.soles import ground_heights
from recon.core import rotations as so3
from recon.core.camera import full_hd_camera
from recon.metrics.evaluation import evaluate
from recon.people.together import fit_people, load_people
from recon.simulation.images import keypoints2d
from recon.simulation.points import Corruption

SEED, FRAMES, FILMS, LEAST_PATH_M, AWAY_M = 0, 60, 20, 0.8, (4.5, 5.5)
COLUMNS: list[tuple[str, int | None]] = [
    ("prior", None), ("films", 0), ("alone cm", 1), ("together cm", 1), ("within 1.1 x", 2),
    ("size within 5 %", 2), ("size of truth", 2), ("soles cm", 1), ("on the floor", 2),
]  # fmt: skip


def main() -> None:
    """Simulate, fit, print and write the table."""
    given = over_windows(__doc__).parse_args()
    body, rows = BodyModel.load(), list[list[Cell]]()
    windows = load_windows(given.corpus, Splits.load(given.splits), given.part, body, SEED, FRAMES)
    ways = (windows.truth.translation[:, -1] - windows.truth.translation[:, 0])[:, :2]
    movers = (ways.norm(dim=-1) > LEAST_PATH_M).nonzero()[:, 0].tolist()
    films = [(movers[k % len(movers)], movers[-1 - k % len(movers)]) for k in range(FILMS)]
    for prior in ("pose", "humor"):
        found: list[list[float]] = []
        for number, pair in enumerate(films[: given.only]):
            truths = [crossing(windows.truth[row], k, body) for k, row in enumerate(pair)]
            found += measured(truths, number, prior, body)
        alone, together, size, of_truth, soles = np.array(found).T
        within = (together <= 1.1 * alone, abs(size - 1) <= 0.05, of_truth, 100 * soles)
        each = (100 * alone, 100 * together, *within, soles <= 0.05)
        rows.append([prior, len(found) // 2, *(float(one.mean()) for one in each)])
    tell_of(given, SEED, {"two-people": Table(COLUMNS, rows)}, windows.files)


def crossing(truth: Motion, k: int, body: BodyModel) -> Motion:
    """Turn a motion to go right (0) or left (1), through the middle of the image at mid-time."""
    x, y, _ = truth.translation[-1] - truth.translation[0]
    T = torch.eye(4)
    T[:3, :3] = so3.about_z(k * torch.pi - torch.atan2(y, x))
    turned = truth.carried(T, body.rest_joints(truth.shape)[0])
    x, y, _ = body.pose(turned).joints[FRAMES // 2, 0].tolist()
    return turned.replace(translation=turned.translation + torch.tensor([-x, AWAY_M[k] - y, 0]))


def measured(truths: list[Motion], seed: int, prior: str, body: BodyModel) -> list[list[float]]:
    """Return for each person: errors alone and together, size ratios, and height of the soles."""
    camera = full_hd_camera().placed(torch.tensor([0, 0, 1.5]), torch.tensor([0, 5.0, 1.0]))
    noise = Corruption(noise=PIXELS)
    seen = [keypoints2d(one, body, camera, noise, 2 * seed + k) for k, one in enumerate(truths)]
    order = np.random.default_rng(seed).permuted(np.tile([0, 1], (FRAMES, 1)), axis=1)
    frames, names = np.arange(FRAMES)[:, None], ("pixels", "confidence")
    both = (np.stack([getattr(one, name) for one in seen], 1)[frames, order] for name in names)

    def error(found: recon.Result, truth: Motion) -> Any:
        there, _ = in_true_world(found, camera.T_world_camera, body)
        return evaluate(there, truth, body)["root_joints_all"]

    out: list[list[float]] = []
    with tempfile.TemporaryDirectory() as name:
        file, lens = Path(name) / "seen.npz", Path(name) / "lens.npz"
        how: dict[str, Any] = {"body": body, "frame_rate": 30.0, "camera": lens}
        np.savez(lens, camera_matrix=seen[0].camera.camera_matrix, image_size=(1920, 1080))
        np.savez(file, **dict(zip(("keypoints", "scores"), both, strict=True)))
        people = fit_people(load_people(file, **how), prior, body=body)
        for one, truth in zip(seen, truths, strict=True):
            np.savez(file, keypoints=one.pixels, scores=one.confidence)
            alone = recon.fit(file, prior, **how)
            own = min(people, key=lambda person: error(person, truth))
            tall, single, true = (body.height(m.shape) for m in (own.motion, alone.motion, truth))
            values = (tall / single, tall / true, ground_heights(own.motion[None], body).abs())
            out.append([error(alone, truth), error(own, truth), *map(float, values)])
    return out


if __name__ == "__main__":
    main()

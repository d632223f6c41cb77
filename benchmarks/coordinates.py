"""Counts which unknown coordinates of files are put right, asked about, or missed.

    python -m benchmarks.coordinates CORPUS --out FOLDER

Ten seconds of the listed clips, with 15 mm of noise, get their coordinates settled as `recon.fit`
does with files; nothing is fitted. Good recordings have z up, metres and right-handed axes; those
of points are counted twice, once with the legs hidden. Three calibrated views are tested for
mirroring only.
"""

import tempfile
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import get_args

import numpy as np
import torch

from benchmarks.cameras import PIXELS
from benchmarks.protocol import Cell, Table, over_windows, tell_of
from observations.correspondences import BodyPoints
from observations.keypoints2d import Keypoints2D
from recon import BodyModel, Motion
from recon.api.estimates import estimate_given
from recon.benchmark.dataset import Splits
from recon.benchmark.windows import FPS, load_windows
from recon.body.landmarks import landmark
from recon.body.marker_labels import match_markers
from recon.core import rotations as so3
from recon.core.camera import full_hd_camera
from recon.core.clouds import unit_of_clouds, up_of_clouds
from recon.core.errors import ReconError
from recon.core.hands import right_handed_signs
from recon.core.layouts import keypoint_names
from recon.core.skeleton import JOINTS
from recon.core.units import METRES, Up, to_z_up
from recon.diagnosis.keypoints import screen_views
from recon.formats.motions import load_motion
from recon.formats.observations import PositionsFile
from recon.keypoints3d.records import Points3D
from recon.mocap.recording import MarkerRecording, markers_in_metres
from recon.reading.keypoints3d import points_in_metres
from recon.reading.points import positions_in_metres
from recon.simulation.images import camera_ring
from recon.simulation.points import Corruption, scan_points

SEED, FRAMES, LEGS = 0, 300, ("knee", "ankle", "foot", "toe", "heel", "KNE", "ANK", "HEE", "TOE")
SIDED = ("FHD", "BHD", "SHO", "ELB", "WRA", "WRB", "ASI", "PSI", "KNE", "ANK", "HEE", "TOE")
LABELS = ("C7", "T10", "CLAV", "STRN", *(f"{side}{label}" for side in "LR" for label in SIDED))
VIEWS, SPACE = "calibrated views", keypoint_names("openpose25")
NAMES = {"joints": JOINTS, "keypoints in space": SPACE, VIEWS: SPACE, "markers": LABELS}
COLUMNS: list[tuple[str, int | None]] = [
    ("sensor", None), ("mirrored", 0), ("mirrored back", 0), ("told", 0), ("silent", 0),
    ("axes x units", 0), ("right", 0), ("asked", 0), ("silently wrong", 0), ("good", 0),
    ("false alarms", 0),
]  # fmt: skip
Settle = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""Function that brings seen positions (mask) in any coordinates to metres with z up."""


def main() -> None:
    """Count over all windows, print and write the table."""
    given = over_windows(__doc__).parse_args()
    body, rng = BodyModel.load(), np.random.default_rng(SEED)
    windows = load_windows(given.corpus, Splits.load(given.splits), given.part, body, SEED)
    counts = {name: Counter[str]() for name in (*NAMES, "scans", "estimates")}
    for number, path in enumerate(windows.files[: given.only or 60]):
        motion = load_motion(path).motion
        times = torch.arange(min(FRAMES, int(FPS * motion.frames / motion.fps))) / FPS
        truth = motion.at(times + motion.start_time, FPS)
        for name, points, settle in sensors(truth, body, number):
            noisy = points + (name != "estimates") * rng.normal(0, 0.015, points.shape)
            count(counts[name], noisy, settle, name)
    rows: list[list[Cell]] = []
    for name, found in counts.items():
        mirrored, axes = (
            [found[f"{what} {how}"] for how in ("right", "asked", "wrong")]
            for what in ("mirrored", "axes")
        )
        ends = (found["good"], found["false"])
        rows.append([name, sum(mirrored), *mirrored, sum(axes), *axes, *ends])
    tell_of(given, SEED, {"coordinates": Table(COLUMNS, rows)}, windows.files)


def sensors(truth: Motion, body: BodyModel, seed: int) -> Iterator[tuple[str, np.ndarray, Settle]]:
    """Yield every sensor's points of a motion, with a function that settles a file of them."""
    posed = body.pose(truth)
    places, _ = match_markers(LABELS)
    skin = posed.points(torch.tensor([landmark(places[label]) for label in LABELS]))
    of_body = BodyPoints.of_layout("openpose25", body)
    layout = of_body.of(posed)

    def joints(points: np.ndarray, seen: np.ndarray) -> np.ndarray:
        file = PositionsFile("joints3d", points * seen[..., None], seen, tuple(JOINTS), FPS)
        return positions_in_metres(file, "joints", body).positions

    def keypoints(points: np.ndarray, seen: np.ndarray) -> np.ndarray:
        shown = np.where(seen[..., None], points, np.nan)
        return points_in_metres(Points3D("points", shown, SPACE, fps=FPS), body).positions

    def views(points: np.ndarray, seen: np.ndarray) -> np.ndarray:
        there = torch.from_numpy(points - points.mean((0, 1))) + layout.mean((0, 1))
        filmed: list[Keypoints2D] = []
        for k, camera in enumerate(camera_ring(truth, body, full_hd_camera(), 3)):
            noise = PIXELS * np.random.default_rng(3 * seed + k).normal(size=(*seen.shape, 2))
            pixels = camera.project(there.float()).pixels.double().numpy() + noise
            filmed.append(Keypoints2D(pixels[None], seen[None] * 1.0, of_body, camera, FPS))
        findings = screen_views(filmed, ["0", "1", "2"], body)[1]
        if any(one.code == "sides exchanged" for one in (*findings.repairs, *findings.warnings)):
            raise ReconError("left and right are exchanged")
        return points

    def markers(points: np.ndarray, seen: np.ndarray) -> np.ndarray:
        raw = MarkerRecording("markers", LABELS, points, seen, FPS, ())
        found = markers_in_metres(raw, unit=None, up=None)
        names = [places[label] for label in LABELS]
        return found.positions * right_handed_signs(names, found.positions, found.visible)[0]

    def scans(points: np.ndarray, _: np.ndarray) -> np.ndarray:
        metres = points * METRES[unit_of_clouds(list(points), "scans")]
        return metres @ to_z_up(up_of_clouds(list(metres), "scans", unit_given=False)[0]).T

    def estimates(points: np.ndarray, _: np.ndarray) -> np.ndarray:
        ways = points[:, 1:] - points[:, :1]
        turns = truth.rotations.clone()
        turns[:, 0] = torch.from_numpy(ways / np.linalg.norm(ways, axis=-1, keepdims=True)).mT
        place = points[:, 0] - np.linalg.norm(ways[0, 0]) * posed.rest[0].numpy()
        vectors = so3.log(turns).flatten(-2).numpy()
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "estimate.npz"
            np.savez(path, poses=vectors, trans=place, fps=FPS)
            found = estimate_given(path, body, True, truth.shape, *[None] * 5)[0]
        pelvis = (found.translation + posed.rest[0])[:, None]
        turned = found.rotations[:, 0].mT
        return torch.cat((pelvis, pelvis + turned), 1).double().numpy()

    yield "joints", posed.joints.double().numpy(), joints
    yield "keypoints in space", layout.double().numpy(), keypoints
    yield VIEWS, layout.double().numpy(), views
    yield "markers", skin.double().numpy(), markers
    clouds = scan_points(truth, body, Corruption(), seed, points=500).points
    yield "scans", clouds.reshape(truth.frames, 500, 3)[::5].astype(float), scans
    root = posed.joints[:, :1]
    places_and_axes = torch.cat((root, root + posed.local[:, 0].mT), 1)
    yield "estimates", places_and_axes.double().numpy(), estimates


def outcome(points: np.ndarray, A: np.ndarray, seen: np.ndarray, settle: Settle) -> str:
    """Return whether points under a linear map A come back "right" or "wrong", or were "asked".

    Right are positions in metres with z up, after any rotation about z.
    """
    try:
        found = settle(points @ A.T, seen)[seen]
    except ReconError:
        return "asked"
    true, found = (one - one.mean(0) for one in (points[seen], found))
    B = np.linalg.lstsq(true, found, rcond=None)[0]
    close = np.allclose(true @ B, found, atol=0.02) and np.allclose(B @ B.T, np.eye(3), atol=0.02)
    return "right" if close and B[2, 2] > 0.99 and np.linalg.det(B) > 0 else "wrong"


def count(counts: Counter[str], points: np.ndarray, settle: Settle, name: str) -> None:
    """Settle points as they are, with legs hidden, mirrored, and in other axes and units."""
    seen, names = np.ones(points.shape[:2], dtype=bool), NAMES.get(name, ())
    if names:
        flipped = outcome(points, np.diag([-1.0, 1.0, 1.0]), seen, settle)
        counts[f"mirrored {flipped}"] += 1
        hidden = seen & ~np.array([any(leg in one for leg in LEGS) for one in names])
        counts["good"] += 1
        counts["false"] += outcome(points, np.eye(3), hidden, settle) != "right"
    counts["good"] += 1
    counts["false"] += outcome(points, np.eye(3), seen, settle) != "right"
    for up in () if name == VIEWS else get_args(Up):
        for unit in ("m", "cm", "mm"):
            found = outcome(points, to_z_up(up).T / METRES[unit], seen, settle)
            counts[f"axes {found}"] += 1


if __name__ == "__main__":
    main()

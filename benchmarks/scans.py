"""Simulates scanned gait cycles with known truth, and sparse versions of them.

A person of a random shape, in clothes that no shape has, is scanned all around at 50 Hz; sixteen
markers are recorded with it. Tables of completions vary how many points of a frame
(`thinned_points`) or which frames (`thinned_frames`, `thinned_landmarks`) remain.
"""

from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Int

from recon.body.landmarks import LANDMARKS_16
from recon.body.model import BodyModel
from recon.body.motion_files import with_shape
from recon.core.motion import Motion
from recon.formats.observations import PointsFile, PositionsFile
from recon.simulation.points import Corruption, landmarks3d, scan_points, visible_joints
from recon.simulation.scenery import clothed

FPS = 50.0
POINTS = 10_000
"""Number of points of a frame."""
NOISE = 0.005
"""Standard deviation (m) of every coordinate of a scan."""
MARKER_NOISE = 0.001
"""Standard deviation (m) of every coordinate of a marker."""
SKIN_OFFSET = 0.01
"""Standard deviation (m per axis) of a marker's constant offset from its landmark."""
SHORTEST, LONGEST = 0.3, 3.0
"""Least and largest duration (s) of a cycle."""
ANCHORS = 100
"""Number of frames of a cycle, evenly from its first to its last, of which some are observed."""


@dataclass(frozen=True)
class ScannedCycle:
    """One gait cycle, its scans and its landmarks; all at 50 Hz, starting at zero seconds."""

    name: str
    subject: str
    truth: Motion
    """The motion of the bare body, whose surface is under the clothes."""
    scans: PointsFile
    landmarks: PositionsFile


def scanned_cycle(
    name: str, subject: str, cycle: Motion, body: BodyModel, seed: int = 0
) -> ScannedCycle:
    """Simulate the scan of a cycle by another person in clothes, with noise.

    Every shape coefficient is N(0, 1), as among people; the same name and seed give the same
    person, clothes and noise.

    Raises:
        ValueError: when the cycle does not last 0.3 to 3 s.
    """
    seconds = cycle.duration
    if not SHORTEST - 1e-6 <= seconds <= LONGEST + 1e-6:
        raise ValueError(f"{name}: a cycle lasts {SHORTEST} to {LONGEST} s, got {seconds:.2f} s")
    return scanned(name, subject, cycle, body, seed)


def scanned(
    name: str, subject: str, motion: Motion, body: BodyModel, seed: int = 0, points: int = POINTS
) -> ScannedCycle:
    """Simulate the scan of any motion, with `points` points per frame; see `scanned_cycle`."""
    random = np.random.default_rng([seed, *name.encode()])
    drawn = torch.from_numpy(random.standard_normal(body.shape_size)).to(motion.shape)
    clothes, scanner, markers = random.integers(2**31, size=3).tolist()
    truth = with_shape(motion.replace(start_time=0.0).resample(FPS), body, drawn)
    placed = Corruption(noise=MARKER_NOISE)
    seen = landmarks3d(truth, body, placed, markers, skin_offset=SKIN_OFFSET)
    return ScannedCycle(
        name=name,
        subject=subject,
        truth=truth,
        scans=scan_points(
            truth, clothed(body, clothes), Corruption(noise=NOISE), scanner, points=points
        ),
        landmarks=PositionsFile(
            kind="markers3d",
            positions=seen.positions.double().numpy(),
            visible=seen.visible.numpy(),
            names=LANDMARKS_16,
            fps=FPS,
            truth_visible=visible_joints(truth, body, placed, markers).numpy(),
        ),
    )


def thinned_points(scans: PointsFile, points: int, seed: int) -> PointsFile:
    """Keep at most `points` points of every frame, drawn anew in every frame.

    Raises:
        ValueError: when none would remain.
    """
    if points < 1:
        raise ValueError(f"expected one point a frame or more, got {points}; none are landmarks")
    order = np.random.default_rng(seed).permutation(len(scans.frame))
    order = order[np.argsort(scans.frame[order], kind="stable")]
    frames, first = np.unique(scans.frame[order], return_index=True)
    rank = np.arange(len(order)) - first[np.searchsorted(frames, scans.frame[order])]
    kept = np.sort(order[rank < points])
    return replace(scans, points=scans.points[kept], frame=scans.frame[kept])


def observed_frames(frames: int, observed: int) -> Int[np.ndarray, " observed"]:
    """Return the frames nearest to some of a cycle's 100 anchors: the 100/f-th, 200/f-th, ...

    Short cycles have fewer frames than anchors; several anchors then share one.

    Raises:
        ValueError: when the anchors cannot be divided so.
    """
    if not 1 <= observed <= ANCHORS or ANCHORS % observed:
        raise ValueError(f"expected a divisor of {ANCHORS} anchors, got {observed}")
    step = ANCHORS // observed
    anchors = np.arange(step, ANCHORS + 1, step) - 1
    return np.unique(np.rint(anchors / (ANCHORS - 1) * (frames - 1)).astype(np.int64))


def thinned_frames(scans: PointsFile, observed: int) -> PointsFile:
    """Keep the scans of a cycle at some of the 100 anchors; the other frames are empty."""
    known = scans.truth_visible
    frames = int(scans.frame.max()) + 1 if known is None else len(known)
    kept = np.isin(scans.frame, observed_frames(frames, observed))
    return replace(scans, points=scans.points[kept], frame=scans.frame[kept])


def thinned_landmarks(landmarks: PositionsFile, observed: int) -> PositionsFile:
    """Keep landmarks at some of the 100 anchors; in other frames none is visible."""
    frames = len(landmarks.visible)
    seen = np.isin(np.arange(frames), observed_frames(frames, observed))[:, None]
    return replace(
        landmarks,
        positions=np.where(seen[..., None], landmarks.positions, 0.0),
        visible=landmarks.visible & seen,
    )

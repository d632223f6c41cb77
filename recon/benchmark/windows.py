"""Loads the true motions of windows that the splits list, or of the bundled clip."""

from dataclasses import dataclass, replace
from importlib import resources
from pathlib import Path
from typing import Literal

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from recon.benchmark.dataset import SPLITS, Part, Splits, clip_files
from recon.body.contacts import contact_labels, rest_heights
from recon.body.model import BodyModel
from recon.core.errors import ReconError
from recon.core.motion import Motion, MotionFile
from recon.core.skeleton import PARENTS
from recon.core.struct import stack
from recon.formats.motions import load_motion
from recon.formats.replacing import files_checksum
from recon.metrics.evaluation import nearest_labels

FPS = 30.0
FRAMES = 60
"""Frames of a listed window, where nothing else is said."""

BONE_ERROR = 0.005
"""Metres: how well a skeleton recording tells the length of a bone."""


@dataclass(frozen=True)
class TrueWindows:
    """True motions of windows as a batch; every window's time starts at zero."""

    truth: Motion
    contacts: Bool[Tensor, "clips time 22"]
    """Contacts as labelled at the recordings' own rates."""
    subjects: tuple[str, ...]
    names: tuple[str, ...]
    """Clip and start, for the report."""
    listed: int
    """Number of windows of which these remain."""
    apart: tuple[str, ...] = ()
    """Subjects who count in no mean over subjects."""
    files: tuple[Path, ...] = ()
    """The motion files that were read."""

    @property
    def clips(self) -> tuple[str, ...]:
        """Name of the clip that each window was cut from."""
        return tuple(name.rsplit("@", 1)[0] for name in self.names)

    @property
    def averaged_subjects(self) -> list[str]:
        """The subjects to average over: those not set apart, or all if there are no others."""
        every = sorted(set(self.subjects))
        return [subject for subject in every if subject not in self.apart] or every

    def frames(self, start: int, stop: int) -> "TrueWindows":
        """Return frames start, ..., stop - 1 of every window."""
        return replace(
            self, truth=self.truth.window(start, stop), contacts=self.contacts[:, start:stop]
        )

    def take(self, rows: list[int]) -> "TrueWindows":
        """Return the windows with the given numbers."""
        return replace(
            self,
            truth=self.truth[rows],
            contacts=self.contacts[rows],
            subjects=tuple(self.subjects[i] for i in rows),
            names=tuple(self.names[i] for i in rows),
        )


def load_windows(
    corpus: str | Path,
    splits: Splits,
    part: Part | Literal["strangers"],
    body: BodyModel,
    seed: int = 0,
    frames: int = FRAMES,
) -> TrueWindows:
    """Load all windows of one length that the splits list for a part, at 30 Hz.

    Where the splits list no windows of that length, they lie about the middle of the listed ones
    of 60 frames, shifted as far as needed to lie inside the clip; clips shorter than that drop
    out, and so does a window that shares frames with one before it. A skeleton recording does not
    tell the girth of a body, so one is drawn per subject.

    Raises:
        ReconError: when a listed clip is not in the corpus or too short for what is listed, or
            no window is that long.
    """
    files = clip_files(corpus)
    lengths = splits.windows[part]
    listed = frames if frames in lengths else FRAMES
    rows = lengths[listed]
    if missing := sorted({clip for clip, _ in rows} - set(files)):
        named = ", ".join(missing[:5]) + (" and others" if len(missing) > 5 else "")
        raise ReconError(
            f"{corpus}: {len(missing)} {part} clips are missing there: {named}; convert all "
            "recordings whose windows are listed (recon convert --all)"
        )
    recorded = {clip: load_motion(files[clip]) for clip, _ in rows}
    whole = {clip: file.motion.resample(FPS) for clip, file in recorded.items()}
    shapes: dict[str, Tensor] = {}
    found: dict[tuple[str, int], tuple[Motion, Tensor]] = {}
    for clip, seconds in rows:
        subject, first = splits.subject(clip), round(seconds * FPS)
        room = whole[clip].frames
        if room < first + listed:
            raise ReconError(
                f"{files[clip]}: expected {listed} frames from {seconds} s on, got {room - first}"
            )
        if subject not in shapes:
            generator = np.random.default_rng([seed, *subject.encode()])
            shapes[subject] = shape_with_random_girth(body, whole[clip].shape, generator)
        if room < frames:
            continue
        if listed != frames:
            first = min(max(first + (listed - frames) // 2, 0), room - frames)
            if any(clip == other and abs(first - start) < frames for other, start in found):
                continue
        window = whole[clip].window(first, first + frames)
        contacts = contacts_at(recorded[clip], window.times, body)
        window = window.replace(start_time=0.0, shape=shapes[subject])
        found[clip, first] = window, contacts
    if len(found) == 0:
        raise ReconError(f"{corpus}: no {part} clip is {frames} frames long")
    return TrueWindows(
        truth=stack([motion.replace(hands=None) for motion, _ in found.values()]),
        contacts=torch.stack([contacts for _, contacts in found.values()]),
        subjects=tuple(splits.subject(clip) for clip, _ in found),
        names=tuple(f"{clip}@{first / FPS:.2f}" for clip, first in found),
        listed=len(rows),
        apart=splits.apart,
        files=tuple(files[clip] for clip in recorded),
    )


def contacts_at(
    recorded: MotionFile, times: Float[Tensor, " time"], body: BodyModel
) -> Bool[Tensor, "time 22"]:
    """Return contact labels at given times, from the file or, if it has none, from the motion."""
    motion, labels = recorded.motion, recorded.contacts
    if labels is None:
        heights = rest_heights(body, motion.shape)
        return nearest_labels(
            contact_labels(body.pose(motion).joints, heights, motion.fps), motion.times, times
        )
    return nearest_labels(labels > 0.5, motion.times, times)


def shape_with_random_girth(
    body: BodyModel, shape: Float[Tensor, " shape"], random: np.random.Generator
) -> Float[Tensor, " shape"]:
    """Draw a random shape with about the same bone lengths as the given one.

    Shapes are N(0, I) before and every coordinate of a bone is known to `BONE_ERROR`, so what is
    added to the fitted shape has covariance (I + JᵀJ / error²)⁻¹ with J the bones' derivative.
    """
    directions = body.joint_directions.double()
    bones = directions[1:] - directions[list(PARENTS[1:])]
    jacobian = bones.flatten(0, 1)[:, : len(shape)]
    precision = torch.eye(len(shape), dtype=torch.float64)
    precision = precision + jacobian.mT @ jacobian / BONE_ERROR**2
    noise = torch.from_numpy(random.standard_normal((len(shape), 1)))
    factor = torch.linalg.cholesky(precision)
    step = torch.linalg.solve_triangular(factor.mT, noise, upper=True)[:, 0]
    return shape + step.to(shape)


BenchPart = Literal["test", "validation"]
_SEED = 0


def bench_windows(
    corpus: Path | None,
    part: BenchPart,
    splits: Path | None,
    only: int | None,
    body: BodyModel,
) -> tuple[TrueWindows, str, str]:
    """Load the windows of a split from a folder of motions, or of the bundled clip.

    Returns the windows, which they are for people, and the SHA-256 of the motion files that were
    read, with their names.

    Args:
        corpus: what `recon convert --all` made of the free CMU recordings; None is the bundled
            clip.
        part: of the splits.
        splits: own parts and windows; None takes the committed ones, of which those of freely
            licensed clips are used.
        only: how many windows to use, evenly from the list; None is all.
        body: on which the motions are.

    Raises:
        FileNotFoundError: when there are no motions or no such splits.
        ReconError: when listed clips are missing, or `splits` come without `corpus`.
    """
    if only is not None and only < 1:
        raise ReconError(f"only: expected at least one window, got {only}")
    if corpus is None and splits is not None:
        raise ReconError(
            "splits need the folder of motions whose windows they list: give it as --corpus"
        )
    if corpus is None:
        windows, about, checksum = _bundled_windows(body)
    else:
        listed = Splits.load(SPLITS if splits is None else splits)
        if splits is None:
            listed = with_freely_licensed_windows(listed, part)
        windows = load_windows(corpus, listed, part, body, _SEED)
        people = ", ".join(windows.averaged_subjects)
        about = f"{part} part, {len(windows.names)} windows, means over {people}"
        checksum = files_checksum(windows.files, corpus)
    count = len(windows.names)
    if only is None or only >= count:
        return windows, about, checksum
    chosen = [round(i * (count - 1) / max(only - 1, 1)) for i in range(only)]
    return windows.take(chosen), f"{about}; {only} of the windows only", checksum


def with_freely_licensed_windows(splits: Splits, part: Part) -> Splits:
    """Return splits that list only the windows of one part's freely licensed clips."""
    lengths = {
        frames: tuple((clip, first) for clip, first in rows if splits.has_open_licence(clip))
        for frames, rows in splits.windows.get(part, {}).items()
    }
    return replace(splits, windows={part: lengths})


def _bundled_windows(body: BodyModel) -> tuple[TrueWindows, str, str]:
    with resources.as_file(resources.files("recon") / "assets" / "demo.npz") as path:
        recorded = load_motion(path)
        checksum = files_checksum([path], path.parent)
    whole = recorded.motion.resample(FPS)
    pieces = [whole.window(i, i + FRAMES) for i in range(0, whole.frames - FRAMES + 1, FRAMES)]
    windows = TrueWindows(
        truth=stack([piece.replace(start_time=0.0, hands=None) for piece in pieces]),
        contacts=torch.stack([contacts_at(recorded, piece.times, body) for piece in pieces]),
        subjects=("16",) * len(pieces),
        names=tuple(f"16_32@{i * FRAMES / FPS:.2f}" for i in range(len(pieces))),
        listed=len(pieces),
    )
    about = f"the bundled walk, {len(pieces)} windows, which show that it runs, not how well"
    return windows, about, checksum

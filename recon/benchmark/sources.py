"""Sources of windows: the committed list over converted recordings, or the bundled clip."""

from dataclasses import replace
from importlib import resources
from pathlib import Path
from typing import Literal

import torch

from recon.benchmark.dataset import SPLITS, Part, Splits
from recon.benchmark.windows import FPS, FRAMES, TrueWindows, contacts_at, load_windows
from recon.body.model import BodyModel
from recon.core.errors import ReconError
from recon.core.struct import stack
from recon.formats.motions import load_motion
from recon.formats.replacing import files_checksum

BenchPart = Literal["test", "validation"]
_SEED = 0


def bench_source(
    corpus: Path | None,
    part: BenchPart,
    splits: Path | None,
    only: int | None,
    body: BodyModel,
) -> tuple[TrueWindows, str, str]:
    """The windows of a part in a folder of motions, or those of the bundled clip.

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
        raise ReconError(f"expected one window or more to use, got {only}")
    if corpus is None and splits is not None:
        raise ReconError("splits list windows of a folder of motions: give it as --corpus")
    if corpus is None:
        windows, about, checksum = _bundled(body)
    else:
        listed = Splits.load(SPLITS if splits is None else splits)
        if splits is None:
            listed = free_windows(listed, part)
        windows = load_windows(corpus, listed, part, body, _SEED)
        people = ", ".join(windows.counted)
        about = f"{part} part, {len(windows.names)} windows, means over {people}"
        checksum = files_checksum(windows.files, corpus)
    count = len(windows.names)
    if only is None or only >= count:
        return windows, about, checksum
    chosen = [round(i * (count - 1) / max(only - 1, 1)) for i in range(only)]
    return windows.take(chosen), f"{about}; {only} of the windows only", checksum


def free_windows(splits: Splits, part: Part) -> Splits:
    """The splits with those windows of a part alone whose clips are freely licensed."""
    lengths = {
        frames: tuple((clip, first) for clip, first in rows if splits.is_open(clip))
        for frames, rows in splits.windows.get(part, {}).items()
    }
    return replace(splits, windows={part: lengths})


def _bundled(body: BodyModel) -> tuple[TrueWindows, str, str]:
    with resources.as_file(resources.files("recon") / "assets" / "demo.npz") as path:
        recorded = load_motion(path)
        checksum = files_checksum([path], path.parent)
    whole = recorded.motion.resample(FPS)
    pieces = [whole.window(i, i + FRAMES) for i in range(0, whole.frames - FRAMES + 1, FRAMES)]
    windows = TrueWindows(
        truth=stack([piece.replace(start_time=0.0) for piece in pieces]),
        contacts=torch.stack([contacts_at(recorded, piece.times, body) for piece in pieces]),
        subjects=("16",) * len(pieces),
        names=tuple(f"16_32@{i * FRAMES / FPS:.2f}" for i in range(len(pieces))),
        listed=len(pieces),
    )
    about = f"the bundled walk, {len(pieces)} windows, which show that it runs, not how well"
    return windows, about, checksum

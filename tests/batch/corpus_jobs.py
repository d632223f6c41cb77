"""Small recordings for tests of `convert --all`, and calibrations that go wrong.

As a program it converts a folder, to be killed by a test: FOLDER OUT.
"""

import sys
from collections.abc import Sequence
from importlib import resources
from pathlib import Path

import torch

from recon.batch.collection import SourceClip
from recon.batch.corpus import convert_corpus
from recon.body.model import BodyModel
from recon.export.bvh import skeleton_of, write_bvh
from recon.formats.motions import load_motion


def write_clip(path: Path, subject: int, start: int) -> None:
    """A second of the bundled walk by a person of a height of their own."""
    with resources.as_file(resources.files("recon") / "assets" / "demo.npz") as demo:
        motion = load_motion(demo).motion.window(start, start + 31)
    shape = torch.zeros_like(motion.shape)
    shape[0] = float(subject)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_bvh(path, skeleton_of(motion.replace(shape=shape), BodyModel.load(), path.stem))


def unknown(clips: Sequence[SourceClip], body: object) -> str:
    """A calibration that costs nothing and fails with some clips."""
    if any("poison" in clip.name for clip in clips):
        raise OverflowError("poison")
    return f"calibrated from {', '.join(clip.name for clip in clips)}"


if __name__ == "__main__":
    convert_corpus(Path(sys.argv[1]), Path(sys.argv[2]), processes=2)

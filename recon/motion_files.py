"""Motion files of one body."""

from dataclasses import replace
from pathlib import Path

import torch

from recon.body import BodyModel
from recon.formats.amass import MotionFile, load_motion


def load_motion_of(path: Path, body: BodyModel) -> MotionFile:
    """Read a motion of a body, with all of the body's shape coefficients; those missing are zero.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: when it is damaged, or made with another body.
    """
    file = load_motion(path)
    if file.checksum not in (None, body.checksum):
        raise ValueError(
            f"{path}: made with the body {file.body} ({file.checksum}), not with {body.name} "
            f"({body.checksum}); give its body with --body"
        )
    missing = body.shape_size - file.motion.shape.shape[-1]
    if missing < 0:
        raise ValueError(
            f"{path}: has {file.motion.shape.shape[-1]} shape coefficients, the body "
            f"{body.name!r} {body.shape_size}; give its body with --body"
        )
    shape = torch.nn.functional.pad(file.motion.shape, (0, missing))
    return replace(file, motion=file.motion.replace(shape=shape))

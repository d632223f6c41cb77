"""Motion files of one body."""

from dataclasses import replace
from pathlib import Path

import torch

from recon.body.model import BodyModel
from recon.core.errors import ReconError
from recon.formats.motions import MotionFile, load_motion

WITH_BODY = "give the file of its body (--body, or body= in Python)"
"""What to do about a motion of another body, where one can be given."""


def load_motion_of(path: Path, body: BodyModel, remedy: str = WITH_BODY) -> MotionFile:
    """Read a motion of a body, with all of the body's shape coefficients; those missing are zero.

    Shape coefficients mean nothing on another body, so a motion of one is refused: a file that
    names another body, or one of another program (AMASS) for the bundled body, because its betas
    belong to the SMPL family. With a SMPL-family body of your own, such a file is accepted.

    Args:
        path: motion file.
        body: whose motion it must be; in its precision the motion is read.
        remedy: what to do about a motion of another body, for the message.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: when it is damaged, or made with another body.
    """
    return of_body(load_motion(path, body.template.dtype), path, body, remedy)


def of_body(
    file: MotionFile, path: object, body: BodyModel, remedy: str = WITH_BODY
) -> MotionFile:
    """What `load_motion_of` makes of a file that was read; `path` is for messages.

    Raises:
        ValueError: when it was made with another body.
    """
    bundled = body.checksum == BodyModel.load().checksum
    if file.checksum is None and file.format_version == 0 and bundled:
        raise ReconError(
            f"{path}: does not name its body, as files of AMASS do not: its betas are shape "
            f"coefficients of a SMPL-family body, which mean nothing on the bundled one; {remedy}"
        )
    if file.checksum not in (None, body.checksum):
        raise ReconError(
            f"{path}: made with the body {file.body} ({file.checksum}), not with {body.name} "
            f"({body.checksum}); {remedy}"
        )
    missing = body.shape_size - file.motion.shape.shape[-1]
    if missing < 0:
        raise ReconError(
            f"{path}: has {file.motion.shape.shape[-1]} shape coefficients, the body "
            f"{body.name!r} {body.shape_size}; {remedy}"
        )
    shape = torch.nn.functional.pad(file.motion.shape, (0, missing))
    return replace(file, motion=file.motion.replace(shape=shape))

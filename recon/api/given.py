"""Motions and bodies as callers give them: records, results, files, arrays."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from recon.api.results.motion import MotionResult
from recon.body.model import BodyModel
from recon.body.motion_files import WITH_BODY, of_body
from recon.core.errors import ReconError
from recon.core.motion import Motion
from recon.formats.motions import MotionFile, load_motion, motion_from

MotionLike = Motion | MotionResult | MotionFile | Mapping[str, Any] | Path | str
"""A motion of one clip, what a function of `recon` returned, a motion file or its path, or the
arrays of such a file by name (`trans`, `poses`, `betas`, `mocap_framerate`)."""
BodyLike = BodyModel | Path | str | None
"""A body, the path of a SMPL-family file, or None for the bundled body."""


@dataclass(frozen=True)
class GivenMotion:
    """A motion of one clip of a known body, and what is known besides."""

    file: MotionFile
    name: str
    """Its path, or what the argument is called."""

    @property
    def motion(self) -> Motion:
        """The motion, without a leading axis."""
        return self.file.motion


def body_given(given: BodyLike) -> BodyModel:
    """The body, read where a path is given.

    Raises:
        FileNotFoundError: when there is no such file.
        ReconError: when it holds no body.
    """
    return given if isinstance(given, BodyModel) else BodyModel.load(given)


def motion_given(
    given: Any, body: BodyModel, name: str = "motion", remedy: str = WITH_BODY
) -> GivenMotion:
    """A motion in the precision of the body, with all of its shape coefficients.

    Args:
        given: a `MotionLike`; a leading axis of length one is taken off, padding cut off.
        body: whose motion it must be.
        name: of the argument, for messages about what is no file.
        remedy: what to do about a motion of another body, for messages.

    Raises:
        FileNotFoundError: when there is no such file.
        ReconError: when it is no motion of one clip, is damaged, or was made with another body.
    """
    if isinstance(given, Path | str):
        path = Path(given)
        file = load_motion(path, body.template.dtype)
        return GivenMotion(of_body(file, path, body, remedy), str(given))
    if isinstance(given, Mapping):
        arrays = {key: np.asarray(value) for key, value in given.items()}
        file = motion_from(arrays, Path(name), body.template.dtype)
    elif isinstance(given, MotionResult):
        file = given.file
    elif isinstance(given, MotionFile):
        file = given
    elif isinstance(given, Motion):
        file = MotionFile(_one_clip(given, name))
    else:
        raise ReconError(
            f"{name}: expected a recon.Motion, a result, the path of a motion file (.npz) or its "
            f"arrays by name, got {type(given).__name__}"
        )
    known = of_body(file, name, body, remedy)
    motion = known.motion.detach().to(device=body.template.device, dtype=body.template.dtype)
    return GivenMotion(_with_motion(known, motion), name)


def _with_motion(file: MotionFile, motion: Motion) -> MotionFile:
    return MotionFile(**{**vars(file), "motion": motion})


def _one_clip(motion: Motion, name: str) -> Motion:
    """A motion without a leading axis and padding, and with finite numbers alone."""
    batch = tuple(motion.translation.shape[:-2])
    if batch not in ((), (1,)):
        raise ReconError(
            f"{name}: expected one clip, got leading axes {batch}; take its clips one by one, "
            "motion[k]"
        )
    motion = motion[0] if batch else motion
    frames = int(motion.valid.sum())
    if frames == 0 or not bool(motion.valid[:frames].all()):
        raise ReconError(f"{name}: expected a clip whose frames exist from the first on")
    motion = motion.window(0, frames)
    for key, tensor in motion.tensors().items():
        if not bool(torch.isfinite(tensor).all()):
            raise ReconError(f"{name}: {key} holds NaN or infinity; fill its gaps first")
    return motion

"""Joint angles of the poses that standard deviations are told from."""

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from recon.body.angles.isb import isb_angles
from recon.body.model import BodyModel
from recon.core.motion import Motion
from recon.method.laplace.deviations import Measure

MOST = 360 / 12**0.5
"""Degrees: the standard deviation of an angle of which nothing is known."""


def angles_of(body: BodyModel) -> Measure | None:
    """ISB angles of several clips, degrees, near those of the first; None for another body."""

    def measured(clips: Motion) -> Float[Tensor, "rows time angles"]:
        rows, frames = clips.translation.shape[:2]
        flat = Motion.create(
            clips.translation.flatten(0, 1), clips.rotations.flatten(0, 1), clips.shape[0],
            clips.fps,
        )  # fmt: skip
        found = np.stack(list(isb_angles(flat, body).values()), -1)
        values = torch.from_numpy(found).reshape(rows, frames, -1).to(clips.translation)
        away = values - values[:1]
        return values[:1] + away - 360 * (away / 360).round()

    try:
        isb_angles(_rest(body), body)
    except ValueError:  # landmarks of other bodies are not known
        return None
    return measured


def _rest(body: BodyModel) -> Motion:
    """One frame in the rest pose."""
    turns = torch.eye(3, dtype=body.template.dtype).repeat(1, 22, 1, 1)
    shape = body.template.new_zeros(body.shape_size)
    return Motion.create(body.template.new_zeros(1, 3), turns, shape, 30.0)

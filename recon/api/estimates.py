"""Reads a motion that another program estimated, so that a fit can refine it."""

from pathlib import Path

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from recon.api.given import MotionLike, ShapeLike, motion_given, shape_given
from recon.body.model import BodyModel
from recon.core.arrays import usable_frame_rate
from recon.core.coordinates import unit_of_path
from recon.core.errors import ReconError
from recon.core.motion import Motion
from recon.core.skeleton import FEET
from recon.core.units import METRES, Hand, Up, check_unit, to_z_up
from recon.formats.estimates import BodyEstimate, read_estimate
from recon.formats.observations import KeypointsFile
from recon.formats.opening import load_arrays

LEAST_FRAMES = 4
"""Fewest frames that tell how a person moves."""
_MAX_OTHER_FRAMES = 0.1
"""Share of a film's frames by which an estimate of the same rate may have more or fewer."""


def estimate_given(
    motion: MotionLike,
    body: BodyModel,
    own_body: bool,
    shape: ShapeLike | None,
    frame_rate: float | None,
    unit: str | None,
    up: Up | None,
    hand: Hand | None,
    person: int | None,
    film: KeypointsFile | None = None,
) -> tuple[Motion, Bool[Tensor, " time"], tuple[str, ...]]:
    """Read another program's motion onto our body, z up; return it, its known frames and notes.

    Args:
        motion: as of `recon.refine`, like the other arguments.
        body: that the estimate is brought onto.
        own_body: whether the caller gave the body, so that coefficients of a file are of it.
        shape: that is held; None takes the estimate's or the average.
        frame_rate: frames per second of an estimate that does not say it.
        unit: of its translation; None tells it from feet that stand.
        up: axis of the estimate's world that points up; None tells it from how the body stands.
        hand: handedness of its coordinates; None is right.
        person: which of several people in a file, from 0 on.
        film: 2D keypoints of the film that it is of; its rate is that of an estimate without one.

    Raises:
        ReconError: when it is damaged, no estimate, lasts less than four frames, or its frame rate
            is missing, or it has no rate and another number of frames than the film.
        FileNotFoundError: when there is no such file.
    """
    known_shape = None if shape is None else shape_given(shape, body)
    if not isinstance(motion, Path | str) or _was_saved_with_body(Path(motion), body):
        if unit or up or hand:
            raise ReconError(
                "unit, up and hand (left- or right-handed axes) are options for estimates of "
                "other programs; leave them out: a motion of recon is in metres, right-handed, "
                "with z up"
            )
        found = motion_given(motion, body).motion
        if known_shape is not None:
            found = found.replace(shape=known_shape)
        return found, torch.ones(found.frames, dtype=torch.bool), ()
    read = read_estimate(Path(motion), person, up)
    rate = read.fps if frame_rate is None else frame_rate
    if rate is None and film is not None:
        count, frames, rate = len(read.translation), len(film.pixels), film.fps
        if abs(count - frames) > _MAX_OTHER_FRAMES * frames:
            raise ReconError(
                f"{motion}: does not say how many frames there are per second, and its {count} "
                f"frames are not the {frames} of the film; give its frame rate (--frame-rate, in "
                "Python frame_rate)"
            )
    if rate is None:
        raise ReconError(
            f"{motion}: does not say how many frames there are per second; give the frame rate of "
            "the video (--frame-rate, in Python frame_rate)"
        )
    usable_frame_rate(rate, "frame_rate")
    coefficients, words = _shape_to_keep_fixed(read, body, own_body, known_shape)
    translation, rotations = read.translation, read.rotations
    if hand == "left":
        translation, rotations = _unmirrored(translation, rotations, read.up)
    placed = Motion.create(
        torch.from_numpy(translation).float(),
        torch.from_numpy(rotations).float(),
        coefficients,
        fps=rate,
    )
    pelvis = body.rest_joints(coefficients)[0]
    check_unit(unit)
    if unit is None:
        feet = body.pose(placed).joints[:, list(FEET)] - placed.translation[:, None]
        path, steps = translation[read.known], feet.double().numpy()[read.known]
        unit, said = unit_of_path(path, steps, rate, to_z_up(read.up)[2], str(motion))
        words = (*said, *words)
    placed = placed.replace(translation=METRES[unit] * placed.translation)
    turn = torch.eye(4)
    turn[:3, :3] = torch.from_numpy(to_z_up(read.up))
    upright = placed.carried(turn, pelvis)
    return upright, torch.from_numpy(read.known), (*read.notes, *words)


def _unmirrored(
    translation: Float[np.ndarray, "time 3"], rotations: Float[np.ndarray, "time 22 3 3"], up: Up
) -> tuple[Float[np.ndarray, "time 3"], Float[np.ndarray, "time 22 3 3"]]:
    """Convert a motion from left-handed to right-handed coordinates.

    A horizontal axis of the world is turned round, and the axis that the body's rest pose has
    from right to left, SMPL's x.
    """
    world_signs, body_signs = np.ones(3), np.array([-1.0, 1.0, 1.0])
    world_signs["zxy".index(up[0])] = -1.0
    turned = body_signs[:, None] * rotations * body_signs
    turned[:, 0] = world_signs[:, None] * rotations[:, 0] * body_signs
    return translation * world_signs, turned


def _was_saved_with_body(path: Path, body: BodyModel) -> bool:
    """Whether a motion file names this body model as the one of its shape coefficients."""
    if path.suffix.lower() != ".npz" or not path.is_file():
        return False
    arrays = load_arrays(path)
    return "body_checksum" in arrays and str(arrays["body_checksum"]) == body.checksum


def _shape_to_keep_fixed(
    read: BodyEstimate, body: BodyModel, own_body: bool, given: Tensor | None
) -> tuple[Tensor, tuple[str, ...]]:
    """Return the shape coefficients that the fit keeps fixed, and a note if they are a guess."""
    if given is not None:
        return given, ()
    if own_body:
        count = min(len(read.betas), body.shape_size)
        found = body.template.new_zeros(body.shape_size)
        found[:count] = torch.from_numpy(read.betas[:count]).to(found)
        return found, ()
    return body.template.new_zeros(body.shape_size), (
        "its shape coefficients are of another body model and mean nothing on this one: the "
        "average body is taken; give the person's shape (--shape height=1.80), or the body model "
        "(--body)",
    )

"""The same motion as another body performs it."""

from collections.abc import Callable

import torch
from jaxtyping import Float
from torch import Tensor

from priors.humos import Humos, at_rate, spline
from recon import rotations as so3
from recon.grounding import flies, grounded
from recon.motion import Motion
from recon.reshape import leg_length, with_shape
from recon.windows import Piece, Windows, join

WINDOW, OVERLAP = 10.0, 3.0
"""Seconds that the prior sees at once (200 frames at 20 Hz), and that neighbours share."""
_LEAST = 1.0
"""Seconds."""


def retarget(motion: Motion, shape: Float[Tensor, " shape"], prior: Humos) -> Motion:
    """What a body of another shape does when it does the same.

    The prior proposes a motion; the nearest one to it that obeys physics is the result.

    Args:
        motion: one clip, at any rate; the ground is z = 0.
        shape: of the other body.
        prior: which knows what bodies do.

    Returns:
        A clip of as many frames at the same rate, that begins at the same place.

    Raises:
        ValueError: when the clip is shorter than a second, or frames of it do not exist.
    """
    return _in_windows(motion, shape, prior, _settled)


def proposed(motion: Motion, shape: Float[Tensor, " shape"], prior: Humos) -> Motion:
    """What the prior alone makes of it: codes and details of the motion, another body's shape.

    The height is what the codes say and not what was recorded: they learned to stand on the
    ground. Arguments and errors as those of `retarget`.
    """
    return _in_windows(motion, shape, prior, _proposed)


def _proposed(
    window: Motion, shape: Float[Tensor, " shape"], prior: Humos, start: Float[Tensor, "3"]
) -> Motion:
    """One window, whose place is scaled by the legs about the place where the clip starts."""
    with torch.no_grad():
        found = prior.encode(window[None])
        grown = leg_length(prior.body, shape) / leg_length(prior.body, window.shape)
        level = start * start.new_tensor([1.0, 1.0, 0.0])
        place = level + grown * (found.base[..., :3, 3] - level)
        base = so3.rigid(found.base[..., :3, :3], place)
        shift = found.shift * found.shift.new_tensor([1.0, 1.0, 0.0])
        other = found.replace(shape=shape[None], base=base, shift=shift)
        return prior.decode(other).motion[0]


def _settled(
    window: Motion, shape: Float[Tensor, " shape"], prior: Humos, start: Float[Tensor, "3"]
) -> Motion:
    """The proposal, changed as its frames at 20 Hz have to be; it moves as the scaled copy does.

    A proposal stands on the ground in every frame, by which its height may tremble.
    """
    made = _proposed(window, shape, prior, start)
    coarse, source = at_rate(made), at_rate(window)
    copied = with_shape(source, prior.body, shape)
    flying = flies(source, prior.body)
    stands = grounded(coarse[None], copied[None], flying[None], prior.body).detach()[0]
    between = spline(coarse.frames, made.frames, made.fps).to(made.translation)
    turns = so3.log(coarse.rotations.mT @ stands.rotations).flatten(1)
    moves = stands.translation - coarse.translation
    return made.replace(
        rotations=made.rotations @ so3.exp((between @ turns).unflatten(-1, (22, 3))),
        translation=made.translation + between @ moves,
    )


def _in_windows(
    motion: Motion,
    shape: Float[Tensor, " shape"],
    prior: Humos,
    one: Callable[[Motion, Tensor, Humos, Tensor], Motion],
) -> Motion:
    if motion.translation.ndim != 2 or not bool(motion.valid.all()):
        raise ValueError(
            "expected one clip all of whose frames exist; take the clips of a batch one by one, "
            "without their padding"
        )
    if motion.frames < _LEAST * motion.fps:
        raise ValueError(
            f"expected at least {_LEAST:g} s of motion, got {motion.frames / motion.fps:.2f} s; "
            "give a longer clip"
        )
    start = motion.translation[0] + prior.body.rest_joints(motion.shape)[0]
    windows = Windows.cover(motion.frames, round(WINDOW * motion.fps), round(OVERLAP * motion.fps))
    parts = [motion.window(first, first + windows.frames) for first in windows.starts]
    return join([Piece(one(part, shape, prior, start)) for part in parts]).motion

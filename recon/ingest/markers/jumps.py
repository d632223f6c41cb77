"""Steps of the body that its markers do not make: a frame was solved into a wrong pose.

Frames are found one by one, from the poses of key frames; where markers leave their places for a
moment, or a limb turns fast, a frame may end with a foot or a hand turned over, which the robust
kernel then takes for outliers. Such frames are solved again from the poses around them.
"""

from collections.abc import Callable

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from recon.core.motion import Motion
from recon.core.skeleton import JOINTS, PARENTS
from recon.diagnosis.findings import Finding, listed, spans, stretches
from recon.ingest.markers.gaps import between, chosen

UNMADE = 0.025
"""Metres by which a joint's step may exceed those of the markers about it: their dropping out and
coming back shifts it so."""
_SHARE = 0.3
"""Share of the markers' step that a joint's step may exceed it by besides: joints turn about
markers that stand."""
_FAR = 0.08
"""Metres of a marker from its place on the body in a frame that may be wrong."""
_OFTEN = 0.2
"""Share of the frames from which on a marker's distance is no exception."""
_AROUND = 0.08
"""Seconds on either side of a suspicious frame that are solved again with it."""
_LIMIT = 0.5
"""Share of all frames up to which frames are exceptions that their neighbours can mend."""
_ROUNDS = 2

_STIFFER = (1e2, 1e3, 1e4)
"""Multiples of the weight of turns that spread a step that remains over the frames around it."""

Solve = Callable[[Int[Tensor, " frames"], Motion], Motion]
"""A motion with the poses of some frames, given by their numbers, solved again."""
Stiffer = Callable[[Int[Tensor, " frames"], Motion, Float[Tensor, " 22"]], Motion]
"""The same, with the weights of all joints' turns from frame to frame multiplied."""
Residuals = Callable[[Motion], Float[Tensor, "time markers"]]
"""Distance of every marker from its place on the body, metres; zero where not visible."""


def unmade_steps(
    joints: Float[Tensor, "time 22 3"],
    positions: Float[Tensor, "time markers 3"],
    visible: Bool[Tensor, "time markers"],
    bones: tuple[int, ...],
    limit: float = UNMADE,
) -> Bool[Tensor, "steps 22"]:
    """Steps from frame to frame in which a joint moves and no marker about it does.

    A joint is asked where a marker on its bone, on its parent's or on one of its children's is
    visible at both ends of the step. `limit` is in metres.
    """
    of = torch.tensor(bones)
    near = torch.stack(
        [torch.isin(of, torch.tensor([j, PARENTS[j], *_children(j)])) for j in range(len(JOINTS))]
    )
    both = (visible[1:] & visible[:-1])[:, None] & near
    steps = (positions[1:] - positions[:-1]).norm(dim=-1)[:, None]
    made = steps.where(both, 0.0).amax(-1)
    moved = (joints[1:] - joints[:-1]).norm(dim=-1)
    return both.any(-1) & (moved > made + limit + _SHARE * made)


def mended(
    motion: Motion,
    unmade: Callable[[Motion], Bool[Tensor, "steps 22"]],
    residuals: Residuals,
    solve: Solve,
) -> tuple[Motion, Bool[Tensor, " time"]]:
    """The motion with wrong frames solved again, and which frames those are.

    A new solution is kept, stretch by stretch, where markers fit no worse and fewer steps of
    the body are unmade by its markers.

    Args:
        motion: of all frames.
        unmade: steps of a motion that the markers do not make.
        residuals: of a motion.
        solve: solves frames.
    """
    changed = torch.zeros(motion.frames, dtype=torch.bool)
    failed = changed
    for _ in range(_ROUNDS):
        jumps, far = unmade(motion), residuals(motion)
        suspects = _untried(_suspects(jumps, far, motion.fps), failed)
        if not suspects.any() or suspects.float().mean() > _LIMIT:
            break
        asked = suspects.nonzero()[:, 0]
        kept = (~suspects).nonzero()[:, 0]
        tried = solve(asked, _joined(motion, asked, kept))
        better = _better(suspects, (jumps, unmade(tried)), (far, residuals(tried)))
        if not better.any():
            break
        failed = failed | (suspects & ~better)
        changed |= better
        motion = _taken(motion, tried, better)
    return motion, changed


def eased(
    motion: Motion, unmade: Callable[[Motion], Bool[Tensor, "steps 22"]], solve: Stiffer
) -> tuple[Motion, Bool[Tensor, " time"]]:
    """The motion with steps that remain spread over the frames around them, and which those are.

    Markers that change places, or filled gaps that cross, leave two poses that are good each and
    far from each other. The limb goes from one to the other in the time that markers take.

    Args:
        motion: of all frames.
        unmade: steps of a motion that the markers do not make.
        solve: solves frames with stiffer ties.
    """
    changed = torch.zeros(motion.frames, dtype=torch.bool)
    for stiffer in _STIFFER:
        jumps = unmade(motion)
        around = _suspects(jumps, motion.translation.new_zeros(motion.frames, 0), motion.fps)
        if not around.any() or around.float().mean() > _LIMIT:
            break
        joints = jumps.any(0)
        turning = torch.ones(len(JOINTS))
        for joint in joints.nonzero()[:, 0].tolist():
            turning[_carriers(joint)] = stiffer
        asked, kept = around.nonzero()[:, 0], (~around).nonzero()[:, 0]
        tried = solve(asked, _joined(motion, asked, kept), turning)
        after = unmade(tried)
        better = torch.zeros_like(around)
        for first, last in stretches(around.numpy()):
            steps = slice(max(0, first - 1), last + 1)
            better[first : last + 1] = int(after[steps].sum()) < int(jumps[steps].sum())
        changed |= better
        motion = _taken(motion, tried, better)
    return motion, changed


def _joined(motion: Motion, frames: Int[Tensor, " frames"], kept: Int[Tensor, " kept"]) -> Motion:
    """The motion with some frames joined from those that are kept."""
    found = between(chosen(motion, kept), kept, frames)
    return motion.replace(
        translation=motion.translation.index_copy(0, frames, found.translation),
        rotations=motion.rotations.index_copy(0, frames, found.rotations),
    )


def _taken(motion: Motion, other: Motion, frames: Bool[Tensor, " time"]) -> Motion:
    """The motion with some frames of another one."""
    return motion.replace(
        translation=other.translation.where(frames[:, None], motion.translation),
        rotations=other.rotations.where(frames[:, None, None, None], motion.rotations),
    )


def _carriers(joint: int) -> list[int]:
    """The joints whose turns move a joint fast: its parent and the parent of that."""
    found = [PARENTS[joint]] if joint > 0 else [0]
    return found + [PARENTS[found[0]]] * (found[0] > 0)


def jump_findings(
    unmade: Bool[Tensor, "steps 22"], changed: Bool[Tensor, " time"]
) -> tuple[list[Finding], list[Finding]]:
    """What was repaired, and what remains for the user to look at."""
    repairs: list[Finding] = []
    warnings: list[Finding] = []
    frames = changed.numpy()
    if frames.any():
        repairs.append(
            Finding(
                "jump",
                f"{frames.sum()} frames were solved into a pose that the markers do not show "
                f"({spans(stretches(frames))}); they were solved again from those around them",
                (),
                stretches(frames),
                float(frames.sum()),
            )
        )
    steps = unmade.any(-1).numpy()
    if steps.any():
        joints = tuple(
            name for name, hit in zip(JOINTS, unmade.any(0).tolist(), strict=True) if hit
        )
        after = np.concatenate(([False], steps))
        warnings.append(
            Finding(
                "jump",
                f"{listed(joints)} move faster than the markers about them in {steps.sum()} steps "
                f"to {spans(stretches(after))}: look there for exchanged or misplaced markers",
                joints,
                stretches(after),
                float(steps.sum()),
            )
        )
    return repairs, warnings


def _suspects(
    jumps: Bool[Tensor, "steps 22"], far: Float[Tensor, "time markers"], fps: float
) -> Bool[Tensor, " time"]:
    """Frames beside an unmade step, or with a marker that is away from its place by exception."""
    beside = torch.zeros(len(far), dtype=torch.bool)
    steps = jumps.any(-1)
    beside[1:] |= steps
    beside[:-1] |= steps
    away = far > _FAR
    away &= away.float().mean(0) < _OFTEN
    beside |= away.any(-1)
    around = max(1, round(_AROUND * fps))
    spread = torch.nn.functional.max_pool1d(
        beside[None, None].float(), 2 * around + 1, stride=1, padding=around
    )
    return spread[0, 0] > 0


def _untried(
    suspects: Bool[Tensor, " time"], failed: Bool[Tensor, " time"]
) -> Bool[Tensor, " time"]:
    """Suspects without the stretches that were solved before and did not become better."""
    kept = suspects.clone()
    for first, last in stretches(suspects.numpy()):
        kept[first : last + 1] = not bool(failed[first : last + 1].all())
    return kept


def _better(
    suspects: Bool[Tensor, " time"],
    jumps: tuple[Bool[Tensor, "steps 22"], Bool[Tensor, "steps 22"]],
    far: tuple[Float[Tensor, "time markers"], Float[Tensor, "time markers"]],
) -> Bool[Tensor, " time"]:
    """Frames of the stretches that a new solution made better."""
    kept = torch.zeros_like(suspects)
    for first, last in stretches(suspects.numpy()):
        inside = slice(first, last + 1)
        steps = slice(max(0, first - 1), last + 1)
        before, after = (int(one[steps].sum()) for one in jumps)
        old, new = (float(one[inside].square().clamp(max=_FAR**2).sum()) for one in far)
        fits = new <= 1.02 * old + 1e-6
        kept[inside] = fits and (after < before or (after == before and new < 0.9 * old))
    return kept


def _children(joint: int) -> list[int]:
    return [child for child, parent in enumerate(PARENTS) if parent == joint]

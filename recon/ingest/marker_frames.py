"""Solves the poses of a calibrated subject: key frames, all frames, then bad ones again.

Frames are found one by one, from the poses of key frames. Where markers leave their places for a
moment, or a limb turns fast, a frame may end with a foot or a hand turned over, which the robust
kernel then takes for outliers: the body makes a step that its markers do not make. Such frames are
solved again from the poses around them.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from recon.core.motion import Motion
from recon.core.skeleton import JOINTS, PARENTS
from recon.diagnosis.findings import Finding, listed, spans, stretches
from recon.ingest.marker_gaps import frames_of, interpolated_poses, widened_flags, with_poses
from recon.ingest.marker_poses import PoseEnergies
from recon.ingest.tied_frames import LevenbergMarquardt, minimise_frames

_NOISE = 3.0
"""Multiple of the mean residual by which joints may step without their markers, as noise does."""
_CHUNK = 3000
_WIDE = 0.3
"""Scale of the kernel, metres, while key frames are far from their markers."""
_SHARED_RATE = 30.0
"""Rate, Hz, at which curvatures are computed at first: poses change little in between."""
_ROUGH, _NEAR, _EXACT = 0.1, 1e-2, 3e-4
"""Relative decreases of a frame's energy that end the fits of first guesses, keys and frames."""
_UNSEEN = 1e-4
"""Metres: residuals of this size, in all markers, are too small to be worth lowering."""
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


def solved_apart(energies: PoseEnergies, frames: Int[Tensor, " frames"], start: Motion) -> Motion:
    """Solve frames independently of each other, from a rough guess.

    Args:
        energies: of all frames.
        frames: their numbers, ascending.
        start: rough poses of these frames.
    """
    apart = energies.frames(frames).untied()
    return solved_near(apart, solved_near(replace(apart, sigma=_WIDE), start, _ROUGH))


def solved_near(energies: PoseEnergies, start: Motion, tolerance: float = _NEAR) -> Motion:
    """Solve some frames to a coarse tolerance, from a good guess."""
    poses_of = energies.poses_of(start.translation, start.rotations)
    found = minimise_frames(energies, poses_of, _solver_settings(energies, tolerance)).state
    return Motion.create(found.translation, found.rotations, start.shape, start.fps)


def solved_together(energies: PoseEnergies, start: Motion) -> Motion:
    """Solve all frames, each tied to its neighbours in time, from a good guess.

    Long recordings are solved part by part; the frames before and after a part hold it.
    """
    stride = max(1, round(start.fps / _SHARED_RATE))
    settings = replace(_solver_settings(energies, _EXACT), stride=stride)
    motion = start
    for part in torch.arange(start.frames).split(_CHUNK):
        motion = _with_frames_solved(energies, part, motion, settings)
    return motion


def repaired_frames(
    energies: PoseEnergies,
    bones: tuple[int, ...],
    joints: Callable[[Motion], Float[Tensor, "frames 22 3"]],
    motion: Motion,
) -> tuple[Motion, Bool[Tensor, " frames"], Bool[Tensor, "steps 22"]]:
    """Solve the frames again in which the body is far from its markers.

    Args:
        energies: of all frames.
        bones: the bone that moves each marker most.
        joints: of a motion, world, metres.
        motion: of all frames.
    """
    positions, visible = energies.positions.mT, energies.visible > 0

    def residuals(motion: Motion) -> Float[Tensor, "frames markers"]:
        poses = energies.poses_of(motion.translation, motion.rotations)
        away = energies.markers.places(poses).mT - positions
        return away.norm(dim=-1).where(visible, 0.0)

    limit = max(UNMADE, _NOISE * float(residuals(motion)[visible].mean()))

    def unsupported(motion: Motion) -> Bool[Tensor, "steps 22"]:
        return unsupported_steps(joints(motion), positions, visible, bones, limit)

    def solved_again(frames: Int[Tensor, " frames"], start: Motion) -> Motion:
        # solve first without a robust kernel, which would ignore markers of wrongly turned limbs
        plain = replace(energies, sigma=None)
        start = _with_frames_solved(plain, frames, start, _solver_settings(energies, _NEAR))
        return _with_frames_solved(energies, frames, start, _solver_settings(energies, _EXACT))

    def solved_with_stiffer_joints(
        frames: Int[Tensor, " frames"], start: Motion, turning: Float[Tensor, " 22"]
    ) -> Motion:
        stiff = replace(energies, turning=energies.turning * turning)
        return _with_frames_solved(stiff, frames, start, _solver_settings(energies, _EXACT))

    motion, changed = with_doubtful_frames_solved(motion, unsupported, residuals, solved_again)
    motion, spread = with_jumps_spread(motion, unsupported, solved_with_stiffer_joints)
    return motion, changed | spread, unsupported(motion)


def _with_frames_solved(
    energies: PoseEnergies,
    frames: Int[Tensor, " frames"],
    start: Motion,
    settings: LevenbergMarquardt,
) -> Motion:
    """A motion with some frames solved again, tied to the neighbouring frames."""
    around = torch.unique(torch.cat((frames - 1, frames, frames + 1)))
    around = around[(around >= 0) & (around < start.frames)]
    inside = torch.searchsorted(around, frames)
    poses = energies.poses_of(start.translation[around], start.rotations[around])
    found = minimise_frames(energies.frames(around), poses, settings, inside).state[inside]
    return with_poses(start, frames, found)


def _solver_settings(energies: PoseEnergies, tolerance: float) -> LevenbergMarquardt:
    floor = 0.5 * energies.weight * energies.visible.shape[-1] * _UNSEEN**2
    return LevenbergMarquardt(tolerance=tolerance, floor=floor)


def unsupported_steps(
    joints: Float[Tensor, "time 22 3"],
    positions: Float[Tensor, "time markers 3"],
    visible: Bool[Tensor, "time markers"],
    bones: tuple[int, ...],
    limit: float = UNMADE,
) -> Bool[Tensor, "steps 22"]:
    """Mask of steps between frames in which a joint moves although no marker near it does.

    A joint is asked where a marker on its bone, on its parent's or on one of its children's is
    visible at both ends of the step. `limit` is in metres.
    """
    of = torch.tensor(bones)
    parents = torch.tensor(PARENTS)
    # whether a marker is on the joint's bone, on its parent's or on one of its children's
    near = torch.stack(
        [(of == j) | (of == PARENTS[j]) | (parents[of] == j) for j in range(len(JOINTS))]
    )
    both = (visible[1:] & visible[:-1])[:, None] & near
    steps = (positions[1:] - positions[:-1]).norm(dim=-1)[:, None]
    made = steps.where(both, 0.0).amax(-1)
    moved = (joints[1:] - joints[:-1]).norm(dim=-1)
    return both.any(-1) & (moved > made + limit + _SHARE * made)


def with_doubtful_frames_solved(
    motion: Motion,
    unsupported: Callable[[Motion], Bool[Tensor, "steps 22"]],
    residuals: Callable[[Motion], Float[Tensor, "time markers"]],
    solve: Callable[[Int[Tensor, " frames"], Motion], Motion],
) -> tuple[Motion, Bool[Tensor, " time"]]:
    """The motion with doubtful frames solved again, and a mask of the frames that changed.

    A new solution is kept, stretch by stretch, where markers fit no worse and fewer steps of
    the body lack movement of its markers.

    Args:
        motion: of all frames.
        unsupported: finds steps of joints near which no marker moves.
        residuals: distance of every marker from its place on the body in a motion, metres; zero
            where not visible.
        solve: solves frames, given by their numbers, of a motion.
    """
    changed = failed = torch.zeros(motion.frames, dtype=torch.bool)
    for _ in range(_ROUNDS):
        jumps, far = unsupported(motion), residuals(motion)
        suspects = _doubtful_frames(jumps, far, motion.fps)
        # frames that another solve did not improve are not solved again
        suspects = _stretches_where(suspects, partial(_not_all_failed, failed))
        if not suspects.any() or suspects.float().mean() > _LIMIT:
            break
        tried = solve(*_interpolated_over(motion, suspects))
        fits = partial(_fits_better, jumps, unsupported(tried), far, residuals(tried))
        better = _stretches_where(suspects, fits)
        if not better.any():
            break
        failed = failed | (suspects & ~better)
        changed = changed | better
        taken = better.nonzero()[:, 0]
        motion = with_poses(motion, taken, frames_of(tried, taken))
    return motion, changed


def with_jumps_spread(
    motion: Motion,
    unsupported: Callable[[Motion], Bool[Tensor, "steps 22"]],
    solve: Callable[[Int[Tensor, " frames"], Motion, Float[Tensor, " 22"]], Motion],
) -> tuple[Motion, Bool[Tensor, " time"]]:
    """The motion with remaining jumps spread over frames around them, and a mask of these.

    Markers that change places, or filled gaps that cross, leave two poses that are good each and
    far from each other. The limb goes from one to the other in the time that markers take.

    Args:
        motion: of all frames.
        unsupported: finds steps of joints near which no marker moves.
        solve: solves frames with the weights of all joints' turns from frame to frame multiplied.
    """
    changed = torch.zeros(motion.frames, dtype=torch.bool)
    for solved_with_stiffer_joints in _STIFFER:
        jumps = unsupported(motion)
        around = _doubtful_frames(
            jumps, motion.translation.new_zeros(motion.frames, 0), motion.fps
        )
        if not around.any() or around.float().mean() > _LIMIT:
            break
        turning = torch.ones(len(JOINTS))
        for joint in jumps.any(0).nonzero()[:, 0].tolist():
            # a joint jumps because its parent or grandparent turns: make both of these stiffer
            parent = max(PARENTS[joint], 0)
            turning[[parent, max(PARENTS[parent], 0)]] = solved_with_stiffer_joints
        tried = solve(*_interpolated_over(motion, around), turning)
        better = _stretches_where(
            around, partial(_fewer_unsupported_steps, jumps, unsupported(tried))
        )
        changed |= better
        taken = better.nonzero()[:, 0]
        motion = with_poses(motion, taken, frames_of(tried, taken))
    return motion, changed


def _interpolated_over(
    motion: Motion, flags: Bool[Tensor, " time"]
) -> tuple[Int[Tensor, " frames"], Motion]:
    """Numbers of the flagged frames, and the motion interpolated over them."""
    frames, kept = flags.nonzero()[:, 0], (~flags).nonzero()[:, 0]
    return frames, with_poses(
        motion, frames, interpolated_poses(frames_of(motion, kept), kept, frames)
    )


def _stretches_where(
    flags: Bool[Tensor, " time"], test: Callable[[slice, slice], bool]
) -> Bool[Tensor, " time"]:
    """Flags only in those runs of flagged frames that pass a test of their frames and steps."""
    kept = torch.zeros_like(flags)
    for first, last in stretches(flags.numpy()):
        inside = slice(first, last + 1)
        kept[inside] = test(inside, slice(max(0, first - 1), last + 1))
    return kept


def _not_all_failed(failed: Bool[Tensor, " time"], inside: slice, _: slice) -> bool:
    return not bool(failed[inside].all())


def _fewer_unsupported_steps(before: Tensor, after: Tensor, _: slice, steps: slice) -> bool:
    return int(after[steps].sum()) < int(before[steps].sum())


def _fits_better(
    before: Tensor, after: Tensor, far: Tensor, left: Tensor, inside: slice, steps: slice
) -> bool:
    """Whether a new solution is better: markers no farther, fewer steps without marker motion."""
    old, new = (float(one[inside].square().clamp(max=_FAR**2).sum()) for one in (far, left))
    same = int(after[steps].sum()) == int(before[steps].sum())
    better = _fewer_unsupported_steps(before, after, inside, steps) or (same and new < 0.9 * old)
    return new <= 1.02 * old + 1e-6 and better


def jump_findings(
    unsupported: Bool[Tensor, "steps 22"], changed: Bool[Tensor, " time"]
) -> tuple[list[Finding], list[Finding]]:
    """Findings about repaired jumps, and about jumps that remain."""
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
    steps = unsupported.any(-1).numpy()
    if steps.any():
        joints = tuple(
            name for name, hit in zip(JOINTS, unsupported.any(0).tolist(), strict=True) if hit
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


def _doubtful_frames(
    jumps: Bool[Tensor, "steps 22"], far: Float[Tensor, "time markers"], fps: float
) -> Bool[Tensor, " time"]:
    """Frames next to a step without marker motion, or with a marker unusually far away."""
    steps = jumps.any(-1)
    away = far > _FAR
    away &= away.float().mean(0) < _OFTEN
    flags = away.any(-1)
    flags[1:] |= steps
    flags[:-1] |= steps
    return widened_flags(flags, max(1, round(_AROUND * fps)))

"""Fits the poses of a body of known shape to markers: key frames, all frames, then bad ones again.

The fit of a frame starts from the poses of key frames. Where markers are misplaced for a moment,
or a limb rotates fast, it may end with a foot or a hand turned over, whose markers the robust
kernel then takes for outliers: the body makes a step that its markers do not make. Such frames are
fitted again, starting from the poses around them.
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
"""Multiple of the mean residual by which a joint's step may exceed its markers' steps."""
_CHUNK = 3000
_WIDE = 0.3
"""Scale (m) of the robust kernel while key frames are far from their markers."""
_SHARED_RATE = 30.0
"""Rate (Hz) at which Hessians are computed at first: poses change little in between."""
_ROUGH, _NEAR, _EXACT = 0.1, 1e-2, 3e-4
"""Relative decreases of a frame's energy that end the fits of first guesses, keys and frames."""
_NEGLIGIBLE = 1e-4
"""Residual (m) of all markers of a frame that is too small to be worth lowering."""
UNMADE = 0.025
"""Least difference (m) by which a joint's step must exceed those of markers near it to be a jump:
markers that drop out and come back shift joints by less."""
_SHARE = 0.3
"""Further excess over the markers' step, as a share of it, that is no jump yet: joints rotate
about markers that stand still."""
_FAR = 0.08
"""Distance (m) of a marker from its fitted position in a frame that may be wrong."""
_OFTEN = 0.2
"""Share of frames above which such distances are a marker's habit, not errors of frames."""
_AROUND = 0.08
"""Seconds before and after a doubtful frame that are fitted again with it."""
_LIMIT = 0.5
"""Largest share of doubtful frames among all; beyond it, none are fitted again from the others."""
_ROUNDS = 2
_STIFFER = (1e2, 1e3, 1e4)
"""Factors of the weight of joints' rotation from frame to frame, to spread a remaining jump."""


def fit_singly(energies: PoseEnergies, frames: Int[Tensor, " frames"], start: Motion) -> Motion:
    """Fit the poses of some frames independently of each other, from a rough guess.

    Args:
        energies: energies of all frames.
        frames: numbers of the frames to fit, ascending.
        start: rough poses of these frames.
    """
    apart = energies.frames(frames).untied()
    return fit_coarsely(apart, fit_coarsely(replace(apart, sigma=_WIDE), start, _ROUGH))


def fit_coarsely(energies: PoseEnergies, start: Motion, tolerance: float = _NEAR) -> Motion:
    """Fit poses to a coarse tolerance, from a good guess."""
    poses_of = energies.poses_of(start.translation, start.rotations)
    found = minimise_frames(energies, poses_of, _solver_settings(energies, tolerance)).state
    return Motion.create(found.translation, found.rotations, start.shape, start.fps)


def fit_all_frames(energies: PoseEnergies, start: Motion) -> Motion:
    """Fit the poses of all frames, each tied to its neighbours in time, from a good guess.

    Long recordings are fitted part by part, tied to the frames before and after a part.
    """
    stride = max(1, round(start.fps / _SHARED_RATE))
    settings = replace(_solver_settings(energies, _EXACT), stride=stride)
    motion = start
    for part in torch.arange(start.frames).split(_CHUNK):
        motion = _with_frames_refitted(energies, part, motion, settings)
    return motion


def repaired_frames(
    energies: PoseEnergies,
    bones: tuple[int, ...],
    joints: Callable[[Motion], Float[Tensor, "frames 22 3"]],
    motion: Motion,
) -> tuple[Motion, Bool[Tensor, " frames"], Bool[Tensor, "steps 22"]]:
    """Fit doubtful frames again; return the motion, changed frames, and jumps that remain.

    Args:
        energies: energies of all frames.
        bones: the bone that moves each marker most.
        joints: returns the joint positions of a motion; world, metres.
        motion: poses of all frames.
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
        start = _with_frames_refitted(plain, frames, start, _solver_settings(energies, _NEAR))
        return _with_frames_refitted(energies, frames, start, _solver_settings(energies, _EXACT))

    def solved_with_stiffer_joints(
        frames: Int[Tensor, " frames"], start: Motion, turning: Float[Tensor, " 22"]
    ) -> Motion:
        stiff = replace(energies, turning=energies.turning * turning)
        return _with_frames_refitted(stiff, frames, start, _solver_settings(energies, _EXACT))

    motion, changed = with_doubtful_frames_solved(motion, unsupported, residuals, solved_again)
    motion, spread = with_jumps_spread(motion, unsupported, solved_with_stiffer_joints)
    return motion, changed | spread, unsupported(motion)


def _with_frames_refitted(
    energies: PoseEnergies,
    frames: Int[Tensor, " frames"],
    start: Motion,
    settings: LevenbergMarquardt,
) -> Motion:
    """Return a motion with some frames fitted again, tied to the neighbouring frames."""
    around = torch.unique(torch.cat((frames - 1, frames, frames + 1)))
    around = around[(around >= 0) & (around < start.frames)]
    inside = torch.searchsorted(around, frames)
    poses = energies.poses_of(start.translation[around], start.rotations[around])
    found = minimise_frames(energies.frames(around), poses, settings, inside).state[inside]
    return with_poses(start, frames, found)


def _solver_settings(energies: PoseEnergies, tolerance: float) -> LevenbergMarquardt:
    floor = 0.5 * energies.weight * energies.visible.shape[-1] * _NEGLIGIBLE**2
    return LevenbergMarquardt(tolerance=tolerance, floor=floor)


def unsupported_steps(
    joints: Float[Tensor, "time 22 3"],
    positions: Float[Tensor, "time markers 3"],
    visible: Bool[Tensor, "time markers"],
    bones: tuple[int, ...],
    limit: float = UNMADE,
) -> Bool[Tensor, "steps 22"]:
    """Return a mask of steps between frames in which a joint moves but no marker near it does.

    A marker is near a joint if it is on the joint's bone, its parent's or a child's. A step counts
    only where a near marker is visible at both ends. `limit` is in metres.
    """
    bone = torch.tensor(bones)
    parents = torch.tensor(PARENTS)
    near = torch.stack(
        [(bone == j) | (bone == PARENTS[j]) | (parents[bone] == j) for j in range(len(JOINTS))]
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
    """Return the motion with doubtful frames fitted again, and a mask of the changed frames.

    In each stretch of frames the new poses are kept where markers fit no worse and fewer joints
    move without a marker near them.

    Args:
        motion: poses of all frames.
        unsupported: finds steps of a motion in which a joint moves and no marker near it does.
        residuals: returns every marker's distance from its fitted position, metres; zero where
            not visible.
        solve: fits the frames of a motion with given numbers again.
    """
    changed = failed = torch.zeros(motion.frames, dtype=torch.bool)
    for _ in range(_ROUNDS):
        jumps, far = unsupported(motion), residuals(motion)
        suspects = _doubtful_frames(jumps, far, motion.fps)
        # stretches that an earlier round fitted without improvement are not fitted again
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
    """Return the motion with remaining jumps spread over nearby frames, and a mask of these.

    Markers that change places, or gaps that were filled with the wrong marker, leave a jump from a
    pose that fits to another one. Stiffer joints make the limb take several frames for it.

    Args:
        motion: poses of all frames.
        unsupported: finds steps of a motion in which a joint moves and no marker near it does.
        solve: fits frames again, with factors of the weights of joints' rotation between frames.
    """
    changed = torch.zeros(motion.frames, dtype=torch.bool)
    for factor in _STIFFER:
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
            turning[[parent, max(PARENTS[parent], 0)]] = factor
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
    """Return the numbers of flagged frames, and the motion interpolated over these frames."""
    frames, kept = flags.nonzero()[:, 0], (~flags).nonzero()[:, 0]
    return frames, with_poses(
        motion, frames, interpolated_poses(frames_of(motion, kept), kept, frames)
    )


def _stretches_where(
    flags: Bool[Tensor, " time"], test: Callable[[slice, slice], bool]
) -> Bool[Tensor, " time"]:
    """Keep flags only in those runs of flagged frames that pass a test of frames and steps."""
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
    before: Tensor, after: Tensor, far: Tensor, new_far: Tensor, inside: slice, steps: slice
) -> bool:
    """Return whether poses are better: markers as near, fewer steps that no marker supports."""
    old, new = (float(one[inside].square().clamp(max=_FAR**2).sum()) for one in (far, new_far))
    same = int(after[steps].sum()) == int(before[steps].sum())
    better = _fewer_unsupported_steps(before, after, inside, steps) or (same and new < 0.9 * old)
    return new <= 1.02 * old + 1e-6 and better


def jump_findings(
    unsupported: Bool[Tensor, "steps 22"], changed: Bool[Tensor, " time"]
) -> tuple[list[Finding], list[Finding]]:
    """Make findings about jumps that were repaired, and warnings about those that remain."""
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
                f"between frames, which end at {spans(stretches(after))}: look there for "
                "exchanged or misplaced markers",
                joints,
                stretches(after),
                float(steps.sum()),
            )
        )
    return repairs, warnings


def _doubtful_frames(
    jumps: Bool[Tensor, "steps 22"], far: Float[Tensor, "time markers"], fps: float
) -> Bool[Tensor, " time"]:
    """Return a mask of frames at, or shortly before or after, a jump or a marker far away."""
    steps = jumps.any(-1)
    away = far > _FAR
    away &= away.float().mean(0) < _OFTEN
    flags = away.any(-1)
    flags[1:] |= steps
    flags[:-1] |= steps
    return widened_flags(flags, max(1, round(_AROUND * fps)))

"""The poses of all frames of a known subject: keys, frames in turn, and wrong ones again."""

from collections.abc import Callable
from dataclasses import replace

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from recon.core.motion import Motion
from recon.ingest.markers.jumps import UNMADE, eased, mended, unmade_steps
from recon.ingest.markers.poses import PoseEnergies, Poses
from recon.ingest.markers.tied_frames import LevenbergMarquardt, minimise_frames

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


def solved_apart(energies: PoseEnergies, frames: Int[Tensor, " frames"], start: Motion) -> Motion:
    """Poses of single frames without ties, from a rough guess.

    Args:
        energies: of all frames.
        frames: their numbers, ascending.
        start: rough poses of these frames.
    """
    apart = energies.frames(frames).untied()
    wide = replace(apart, sigma=_WIDE)
    rough = minimise_frames(wide, _poses(start, energies), _settings(energies, _ROUGH)).state
    return solved_near(apart, _motion(rough, start))


def solved_near(energies: PoseEnergies, start: Motion) -> Motion:
    """Poses of some frames, roughly, from a good guess."""
    near = _settings(energies, _NEAR)
    return _motion(minimise_frames(energies, _poses(start, energies), near).state, start)


def solved_in_turn(energies: PoseEnergies, start: Motion) -> Motion:
    """Poses of all frames, tied to each other, from a good guess.

    Long recordings are solved part by part; the frames before and after a part hold it.
    """
    stride = max(1, round(start.fps / _SHARED_RATE))
    settings = replace(_settings(energies, _EXACT), stride=stride)
    motion = start
    for part in torch.arange(start.frames).split(_CHUNK):
        motion = _solved(energies, part, motion, settings)
    return motion


def mended_frames(
    energies: PoseEnergies,
    bones: tuple[int, ...],
    joints: Callable[[Motion], Float[Tensor, "frames 22 3"]],
    motion: Motion,
) -> tuple[Motion, Bool[Tensor, " frames"], Bool[Tensor, "steps 22"]]:
    """Frames in which the body leaves its markers solved again; which, and what steps remain.

    Args:
        energies: of all frames.
        bones: the bone that moves each marker most.
        joints: of a motion, world, metres.
        motion: of all frames.
    """
    positions, visible = energies.positions.mT, energies.visible > 0

    def residuals(motion: Motion) -> Float[Tensor, "frames markers"]:
        away = energies.markers.places(_poses(motion, energies)).mT - positions
        return away.norm(dim=-1).where(visible, 0.0)

    limit = max(UNMADE, _NOISE * float(residuals(motion)[visible].mean()))

    def unmade(motion: Motion) -> Bool[Tensor, "steps 22"]:
        return unmade_steps(joints(motion), positions, visible, bones, limit)

    def again(frames: Int[Tensor, " frames"], start: Motion) -> Motion:
        # first everything counts alike: limbs that were turned over are no outliers
        plain = replace(energies, sigma=None)
        start = _solved(plain, frames, start, _settings(energies, _NEAR))
        return _solved(energies, frames, start, _settings(energies, _EXACT))

    def stiffer(
        frames: Int[Tensor, " frames"], start: Motion, turning: Float[Tensor, " 22"]
    ) -> Motion:
        stiff = replace(energies, turning=energies.turning * turning)
        return _solved(stiff, frames, start, _settings(energies, _EXACT))

    motion, changed = mended(motion, unmade, residuals, again)
    motion, spread = eased(motion, unmade, stiffer)
    return motion, changed | spread, unmade(motion)


def _solved(
    energies: PoseEnergies,
    frames: Int[Tensor, " frames"],
    start: Motion,
    settings: LevenbergMarquardt,
) -> Motion:
    """A motion with the poses of some frames solved; their neighbours hold them."""
    around = torch.unique(torch.cat((frames - 1, frames, frames + 1)))
    around = around[(around >= 0) & (around < start.frames)]
    inside = torch.searchsorted(around, frames)
    poses = Poses.of(start.translation[around], start.rotations[around], energies.rest)
    found = minimise_frames(energies.frames(around), poses, settings, inside).state[inside]
    return start.replace(
        translation=start.translation.index_copy(0, frames, found.translation),
        rotations=start.rotations.index_copy(0, frames, found.rotations),
    )


def _settings(energies: PoseEnergies, tolerance: float) -> LevenbergMarquardt:
    floor = 0.5 * energies.weight * energies.visible.shape[-1] * _UNSEEN**2
    return LevenbergMarquardt(tolerance=tolerance, floor=floor)


def _poses(motion: Motion, energies: PoseEnergies) -> Poses:
    return Poses.of(motion.translation, motion.rotations, energies.rest)


def _motion(poses: Poses, like: Motion) -> Motion:
    """Poses as a motion with the shape and the rate of another."""
    return Motion.create(poses.translation, poses.rotations, like.shape, like.fps)

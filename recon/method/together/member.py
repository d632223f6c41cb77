"""One problem among several that are solved together: its clock, its length, and its solution."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import torch
from torch import Tensor

from recon.core.motion import Motion, pad
from recon.core.scene import Scene
from recon.method.protocols import REFERENCE_FPS, Decoded, Estimate, Sensor
from recon.method.reconstruction import Problem, Reconstruction
from recon.method.stages import Stage, StageReport
from recon.method.together.alike import alike

_ABOUT = 1e-6
"""Seconds by which clocks may differ."""


@dataclass(frozen=True)
class Member:
    """A problem, and the same with a clock that begins at zero."""

    asked: Problem
    moved: Problem
    """The problem with its clock set back, as others have other times of day."""

    @classmethod
    def of(cls, problem: Problem) -> "Member | None":
        """The problem as it may be joined; None where it cannot be.

        An observation may have no clock to set back. And hypotheses of one clip that are compared
        with each other would be told apart by their rows, as those of other clips are.
        """
        if problem.others or not all(isinstance(one, Sensor) for one in problem.observations):
            return None
        begin, seen = problem.start.start_time, _sensors(problem)
        moved = tuple(one.derived(start_time=one.start_time - begin) for one in seen)
        start = problem.start.replace(start_time=0.0)
        member = cls(problem, replace(problem, observations=moved, start=start))
        proposes = any(stage.proposals is not None for stage in member.stages)
        return None if proposes else member

    @cached_property
    def stages(self) -> tuple[Stage[Any], ...]:
        """The stages of the problem as it was asked for."""
        return self.asked.stages()

    @property
    def rows(self) -> int:
        """Number of clips, or of hypotheses of one."""
        return len(self.asked.start.translation)

    @property
    def lengths(self) -> tuple[int, ...]:
        """Numbers of frames and of every sensor's moments."""
        return (self.asked.start.frames, *(one.moments for one in _sensors(self.asked)))

    @property
    def stretchable(self) -> bool:
        """Whether frames that do not exist change nothing at all.

        Where a sensor has another clock than the motion, its last moments may lie after the last
        frame; they would be compared with a frame that does not exist.
        """
        clocks = {one.fps for one in _sensors(self.asked)} | {self.asked.start.fps}
        return clocks == {REFERENCE_FPS} and bool(self.asked.start.valid.all())

    def beside(self, other: "Member") -> bool:
        """Whether both may be joined, as far as can be told without their stages."""
        a, b = self.moved, other.moved
        return (
            len(a.observations) == len(b.observations)
            and a.start.fps == b.start.fps
            and a.start.shape.shape[-1] == b.start.shape.shape[-1]
            and a.scene.offsets.shape[1:] == b.scene.offsets.shape[1:]
            and (a.scene.ground is None) == (b.scene.ground is None)
            and (a.scene.lens is None) == (b.scene.lens is None)
            and all(map(_beside, _sensors(a), _sensors(b)))
            and (self.lengths == other.lengths or (self.stretchable and other.stretchable))
            and alike(a.body, b.body)
        )

    def stretched(self, lengths: Sequence[int]) -> Problem:
        """The problem on the common clock with so many frames and moments of every sensor.

        Those that it does not have are marked as not existing, and show nothing.
        """
        if tuple(lengths) == self.lengths:
            return self.moved
        start = self.moved.start
        longest = _longer(start[0], lengths[0])
        longer = pad([*(start[row] for row in range(self.rows)), longest])[: self.rows]
        seen = tuple(
            one.window(one.start_time, one.start_time + (count - 1) / one.fps)
            for one, count in zip(_sensors(self.moved), lengths[1:], strict=True)
        )
        return replace(self.moved, observations=seen, start=longer)

    def solution(
        self, estimate: Estimate, reports: Sequence[StageReport], rows: Tensor
    ) -> Reconstruction:
        """This problem's part of a joined solution, on its own clock and of its own length.

        Args:
            estimate: of all problems.
            reports: of the joined stages.
            rows: which rows of both are of this problem.
        """
        found, count = estimate.decoded, len(estimate.motion.translation)
        motion = found.motion[rows]
        # a prior may have brought the motion to another rate
        frames = int(motion.valid.sum(-1).max())
        motion = motion.window(0, frames).replace(start_time=self.asked.start.start_time)
        decoded = Decoded(
            motion=motion,
            energies={name: energy[rows] for name, energy in found.energies.items()},
            contacts=None if found.contacts is None else found.contacts[rows][:, :frames],
            joints=None if found.joints is None else found.joints[rows][:, :frames],
        )
        own = tuple(
            StageReport(stage, report.solution.rows(rows), report.seconds * len(rows) / count)
            for stage, report in zip(self.stages, reports, strict=True)
        )
        scene: Scene = estimate.scene[rows]
        return Reconstruction(Estimate(decoded, self.asked.body.pose(motion), scene), own)


def _sensors(problem: Problem) -> tuple[Sensor, ...]:
    found: Any = problem.observations  # `Member.of` takes no others
    return found


def _beside(a: Sensor, b: Sensor) -> bool:
    return (
        type(a) is type(b)
        and a.fps == b.fps
        and abs(a.start_time - b.start_time) < _ABOUT
        and a.shown.shape[2:] == b.shown.shape[2:]
    )


def _longer(motion: Motion, frames: int) -> Motion:
    """The first so many frames, the last one repeated where there are not as many."""
    index = torch.arange(frames).clamp(max=motion.frames - 1).to(motion.translation.device)
    return motion.replace(
        translation=motion.translation[index],
        rotations=motion.rotations[index],
        valid=motion.valid[index],
    )

"""Gait cycles of the corpus, with augmentation by time shift, mirroring and other bodies."""

from collections import Counter
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from priors.anchor.frames import ANCHORS, POSED, Anchors, rest_pelvis
from recon.benchmark.dataset import Part, Splits
from recon.body.cycles import Cycle, find_cycles
from recon.body.model import BodyModel
from recon.body.motion_files import with_shape
from recon.core import rotations as so3
from recon.core.skeleton import MIRROR, UPPER
from recon.core.struct import TensorStruct, concatenate
from training.run import LOG
from training.settings import CorpusSettings

MARGIN = 10
"""Anchors kept before and after a cycle, where the recording goes on."""
_UPPER = [POSED.index(joint) for joint in UPPER]
"""Rows of neck, head and arms."""
_MIRRORED = [POSED.index(MIRROR[joint]) for joint in POSED]


@dataclass(frozen=True)
class CycleVariation:
    """Settings of the augmentation of cycles; zeros leave them as recorded."""

    mirror: float = 0.5
    """Chance of being mirrored."""
    shift: int = 5
    """Anchors by which the cycle begins earlier or later, at most."""
    shape: float = 0.7
    """Standard deviation by which each shape coefficient is moved."""
    speed: float = 0.1
    """Played up to this fraction faster or slower."""
    exchange: float = 0.3
    """Chance of neck, head and arms of another cycle of the same phase: arms are free."""
    mix: float = 0.3
    """Chance of being mixed with another cycle, each with a random share."""


@dataclass(frozen=True)
class CycleBatch(TensorStruct):
    """Aligned cycles and the bodies that perform them."""

    anchors: Anchors
    shape: Float[Tensor, "cycles shape"]


@dataclass(frozen=True)
class CycleCorpus(TensorStruct):
    """All gait cycles of one part of the corpus, with ten frames before and after each."""

    columns: Float[Tensor, "cycles frames 20 6"]
    """Rotations; 120 frames, of which the middle 100 are the cycle."""
    translation: Float[Tensor, "cycles frames 3"]
    room: Int[Tensor, "cycles 2"]
    """Frames before and after the cycle that were recorded; others repeat the nearest."""
    duration: Float[Tensor, " cycles"]
    shape: Float[Tensor, "cycles shape"]
    left: Bool[Tensor, " cycles"]
    """Whether the cycle begins with the left foot."""
    chance: Float[Tensor, " cycles"]
    """Relative chance of being drawn: a subject counts as the square root of its number of
    cycles."""
    body: BodyModel
    cycles: tuple[Cycle, ...]
    clips: tuple[str, ...]
    """The clip of every cycle."""

    @classmethod
    def load(cls, settings: CorpusSettings, part: Part, body: BodyModel) -> "CycleCorpus":
        """Load all gait cycles of one part, from the stretches that are fit for learning steps.

        Raises:
            ValueError: when there is none.
        """
        rows: list[tuple[Tensor, Tensor, Tensor]] = []
        room: list[tuple[int, int]] = []
        cycles: list[Cycle] = []
        clips: list[str] = []
        for name, _, stretch in settings.stretches_that_teach(part, "steps"):
            motion = stretch.motion
            for cycle in find_cycles(motion):
                step = cycle.duration / (ANCHORS - 1)
                around = torch.arange(-MARGIN, ANCHORS + MARGIN, dtype=torch.float64)
                times = cycle.start + around * step
                inside = (times >= motion.times[0]) & (times <= motion.times[-1])
                at = motion.at(times.clamp(motion.times[0], motion.times[-1]), 1 / step)
                rows.append((so3.to_6d(at.rotations[:, POSED]), at.translation, motion.shape))
                before, after = inside[:MARGIN].sum(), inside[-MARGIN:].sum()
                room.append((int(before), int(after)))
                cycles.append(cycle)
                clips.append(name)
        if len(rows) == 0:
            raise ValueError(f"{settings.corpus}: holds no {part} cycle of gait")
        LOG.info("%d %s cycles", len(rows), part)
        columns, translation, shape = (torch.stack(x) for x in zip(*rows, strict=True))
        return cls(
            columns=columns,
            translation=translation,
            room=torch.tensor(room),
            duration=torch.tensor([cycle.duration for cycle in cycles]),
            shape=shape,
            left=torch.tensor([cycle.side == "left" for cycle in cycles]),
            chance=_draw_probabilities(Splits.load(settings.splits), clips),
            body=body,
            cycles=tuple(cycles),
            clips=tuple(clips),
        )

    def all_cycles(self) -> CycleBatch:
        """Return all cycles as recorded, without augmentation."""
        rows = torch.arange(len(self.duration))
        return self._cut_cycles(rows, torch.zeros_like(rows), self.shape)

    def draw(self, count: int, variation: CycleVariation, random: torch.Generator) -> CycleBatch:
        """Random cycles."""

        def uniform() -> Tensor:
            return torch.rand(count, generator=random)

        row = torch.multinomial(self.chance, count, replacement=True, generator=random)
        reach = self.room[row].clamp(max=variation.shift)
        shift = ((uniform() * (reach.sum(-1) + 1)).long() - reach[:, 0]).clamp(max=reach[:, 1])
        normal = torch.randn(count, self.shape.shape[1], generator=random)
        shape = self.shape[row] + variation.shape * normal
        batch = self._cut_cycles(row, shift, shape)
        mirror = uniform() < variation.mirror
        batch = concatenate([batch, _mirrored(batch)])[torch.arange(count) + count * mirror]
        left = self.left[row] ^ mirror
        anchors = self._mixed_cycles(batch.anchors, left, variation, random)
        faster = ((2 * uniform() - 1) * variation.speed).exp()
        return batch.replace(anchors=anchors.replace(times=anchors.times * faster[:, None]))

    def _cut_cycles(self, row: Tensor, shift: Tensor, shape: Tensor) -> CycleBatch:
        frames = MARGIN + shift[:, None] + torch.arange(ANCHORS)
        step = self.duration[row] / (ANCHORS - 1)
        anchors = Anchors(
            rotations=so3.from_6d(self.columns[row[:, None], frames]),
            translation=self.translation[row[:, None], frames],
            times=step[:, None] * torch.arange(ANCHORS),
        )
        own = anchors.motion(self.shape[row], 1.0)
        anchors = anchors.replace(translation=with_shape(own, self.body, shape).translation)
        return CycleBatch(anchors.aligned(rest_pelvis(self.body, shape))[0], shape)

    def _mixed_cycles(
        self,
        anchors: Anchors,
        left: Bool[Tensor, " cycles"],
        variation: CycleVariation,
        random: torch.Generator,
    ) -> Anchors:
        """Mix some cycles with others that begin with the same foot, or take the others' arms."""
        count = len(left)
        columns = so3.to_6d(anchors.rotations)
        partner = _random_partners(left, random)
        upper = torch.rand(count, generator=random) < variation.exchange
        exchanged = columns.clone()
        exchanged[:, :, _UPPER] = columns[partner][:, :, _UPPER]
        columns = torch.where(upper[:, None, None, None], exchanged, columns)
        partner = _random_partners(left, random)
        share = torch.rand(count, generator=random)
        share = share * (torch.rand(count, generator=random) < variation.mix)

        def mixed_with(own: Tensor, other: Tensor) -> Tensor:
            return own.lerp(other, share.reshape(-1, *(1,) * (own.ndim - 1)))

        height = anchors.translation[..., 2:]
        place = mixed_with(anchors.translation[..., :2], anchors.translation[partner][..., :2])
        return Anchors(
            rotations=so3.from_6d(mixed_with(columns, columns[partner])),
            translation=torch.cat((place, height), -1),
            times=mixed_with(anchors.times, anchors.times[partner]),
        )


def _random_partners(
    left: Bool[Tensor, " cycles"], random: torch.Generator
) -> Int[Tensor, " cycles"]:
    """Random partners of cycles, one for each, that begin with the same foot."""
    partner = torch.arange(len(left))
    for side in (left, ~left):
        rows = side.nonzero()[:, 0]
        partner[rows] = rows[torch.randperm(len(rows), generator=random)]
    return partner


def _mirrored(batch: CycleBatch) -> CycleBatch:
    flip = batch.shape.new_tensor([-1.0, 1.0, 1.0])
    anchors = batch.anchors
    rotations = (flip[:, None] * anchors.rotations * flip)[..., _MIRRORED, :, :]
    return batch.replace(
        anchors=anchors.replace(rotations=rotations, translation=anchors.translation * flip)
    )


def _draw_probabilities(splits: Splits, clips: list[str]) -> Float[Tensor, " cycles"]:
    subjects = [splits.subject(clip) for clip in clips]
    count = Counter(subjects)
    return torch.tensor([count[subject] ** -0.5 for subject in subjects])

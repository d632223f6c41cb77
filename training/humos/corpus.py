"""The corpus as windows at 20 Hz, augmented: random starts, mirrored, on other bodies."""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from priors.humos.frames import BodyFrames, existing_windows, rotation_about_vertical
from priors.humos.prior import FPS
from recon.benchmark.dataset import Part
from recon.body.model import BodyModel
from recon.body.motion_files import leg_length
from recon.core.motion import Motion
from recon.core.struct import TensorStruct, concatenate
from training.recordings import mirrored_rotations
from training.run import LOG
from training.settings import TrainingSettings

_HIGH, _LONG = 0.25, 5
"""Clips whose lowest point is above so many metres in more than so many frames stand on something
that was not recorded (HUMOS, appendix)."""
_GROUND = 0.05
"""Share of frames whose lowest point is under the ground."""
_SHORTEST_S = 1.5
"""Seconds; shorter clips are left out."""


@dataclass(frozen=True)
class BodyVariation:
    """Settings of the augmentation of windows; zeros leave them as recorded."""

    mirror: float = 0.5
    """Chance of being mirrored."""
    shape: float = 0.5
    """Standard deviation by which each shape coefficient of who moves is moved."""
    unseen: float = 0.5
    """Share of other bodies that come out of the shape space, and not from the corpus."""


@dataclass(frozen=True)
class BodyBatch(TensorStruct):
    """Windows of motion with their bodies' shapes, and other shapes to transfer them to."""

    frames: BodyFrames
    height: Float[Tensor, "windows time"]
    """Height of the pelvis, in lengths of leg."""
    valid: Bool[Tensor, "windows time"]
    shape: Float[Tensor, "windows shape"]
    other: Float[Tensor, "windows shape"]
    """Shape of another body, to which the motion is transferred."""

    @property
    def windows_exist(self) -> Bool[Tensor, "windows codes"]:
        """Mask of windows with at least one valid frame."""
        return existing_windows(self.valid.sum(-1, keepdim=True), self.valid.shape[-1])


@dataclass(frozen=True)
class BodyCorpus(TensorStruct):
    """All clips of one part of the corpus, concatenated along the axis of frames."""

    frames: BodyFrames
    """About the first frame of every clip; one axis, frames."""
    height: Float[Tensor, " frames"]
    """Height of the pelvis, in lengths of leg."""
    start: Int[Tensor, " clips"]
    """First frame of every clip."""
    count: Int[Tensor, " clips"]
    """Number of its frames."""
    shape: Float[Tensor, "clips shape"]
    chance: Float[Tensor, " clips"]
    """Relative chance of being drawn: the square root of the clip's length."""
    body: BodyModel
    names: tuple[str, ...]

    @classmethod
    def load(
        cls,
        settings: TrainingSettings,
        part: Part,
        body: BodyModel,
        speeds: tuple[float, ...] = (1.0,),
    ) -> "BodyCorpus":
        """Load all stretches of one part that are fit for learning steps, put on the ground.

        Args:
            settings: of which the corpus, the splits and the licence count.
            part: which part.
            body: whose shape coefficients the clips have.
            speeds: every clip is there at each.

        Raises:
            ValueError: when no clip remains.
        """
        found: list[tuple[str, BodyFrames, Tensor, Tensor]] = []
        for name, _, stretch in settings.stretches_that_teach(part, "steps"):
            motion = stretch.motion
            for speed in speeds:
                clip = motion.replace(fps=motion.fps * speed).resample(FPS)
                if clip.frames < _SHORTEST_S * FPS:
                    continue
                frames, height = _body_frames_of(clip, body)
                legs = leg_length(body, clip.shape)
                if int((frames.clearance * legs > _HIGH).sum()) <= _LONG:
                    found.append((name, frames, height, clip.shape))
        if len(found) == 0:
            raise ValueError(
                f"{settings.corpus}: holds no {part} clip from which steps may be learned; "
                "convert more recordings"
            )
        names, clips, heights, shapes = zip(*found, strict=True)
        count = torch.tensor([len(clip.clearance) for clip in clips])
        LOG.info("%d %s clips, %.1f min", len(clips), part, count.sum().item() / FPS / 60)
        return cls(
            frames=concatenate(list(clips)),
            height=torch.cat(heights),
            start=count.cumsum(0) - count,
            count=count,
            shape=torch.stack(shapes),
            chance=count.float().sqrt(),
            body=body,
            names=names,
        )

    def draw(
        self, windows: int, frames: int, variation: BodyVariation, random: torch.Generator
    ) -> BodyBatch:
        """Draw random windows and augment them; windows of shorter clips are padded."""

        def uniform() -> Tensor:
            return torch.rand(windows, generator=random)

        def normal() -> Tensor:
            return torch.randn(windows, self.shape.shape[1], generator=random)

        clip = torch.multinomial(self.chance, windows, replacement=True, generator=random)
        room = (self.count[clip] - frames).clamp(min=0)
        first = (uniform() * (room + 1)).long()
        shape = self.shape[clip] + variation.shape * normal()
        seen = shape[torch.randperm(windows, generator=random)]
        other = torch.where((uniform() < variation.unseen)[:, None], normal(), seen)
        batch = self._cut_windows(clip, first, frames)
        mirror = uniform() < variation.mirror
        both = concatenate([batch.frames, mirrored(batch.frames)])
        row = torch.arange(windows) + windows * mirror
        return batch.replace(frames=both[row], shape=shape, other=other)

    def all_windows(self, frames: int, most: int, random: torch.Generator) -> BodyBatch:
        """Return up to `most` windows as recorded, with random other shapes to transfer to."""
        rows = [
            (clip, first)
            for clip, count in enumerate(self.count.tolist())
            for first in range(0, max(1, count - frames // 2), frames)
        ]
        picked = torch.linspace(0, len(rows) - 1, min(most, len(rows))).round().long().tolist()
        clip, first = torch.tensor([rows[k] for k in picked]).unbind(-1)
        batch = self._cut_windows(clip, first, frames)
        return batch.replace(other=torch.randn(batch.shape.shape, generator=random))

    def _cut_windows(
        self, clip: Int[Tensor, " windows"], first: Int[Tensor, " windows"], frames: int
    ) -> BodyBatch:
        steps = first[:, None] + torch.arange(frames)
        valid = steps < self.count[clip, None]
        rows = self.start[clip, None] + steps.minimum(self.count[clip, None] - 1)
        shape = self.shape[clip]
        cut = relative_to_first_frame(self.frames[rows])
        return BodyBatch(cut, self.height[rows], valid, shape, shape)


def relative_to_first_frame(frames: BodyFrames) -> BodyFrames:
    """Return frames whose directions and places are relative to the first frame's."""
    back = rotation_about_vertical(frames.direction[..., :1, :])[..., :2, :2]
    start = frames.place[..., :1, :]
    return frames.replace(
        direction=(frames.direction[..., None, :] @ back)[..., 0, :],
        place=((frames.place - start)[..., None, :] @ back)[..., 0, :],
    )


def mirrored(frames: BodyFrames) -> BodyFrames:
    """The motion as a mirror at the plane x = 0 shows it: left and right exchanged."""
    direction, place = frames.direction, frames.place
    return frames.replace(
        orientations=mirrored_rotations(frames.orientations),
        direction=direction * direction.new_tensor([1.0, -1.0]),
        place=place * place.new_tensor([-1.0, 1.0]),
    )


def _body_frames_of(clip: Motion, body: BodyModel) -> tuple[BodyFrames, Float[Tensor, " time"]]:
    """Put a clip on the ground; return its frames and the height of its pelvis.

    It is lowered or lifted until its lowest point is under the ground in 5 % of its frames.
    """
    frames, _ = BodyFrames.of(clip, body)
    level = frames.clearance.quantile(_GROUND)
    pelvis = clip.translation[:, 2] + body.rest_joints(clip.shape)[0, 2]
    height = pelvis / leg_length(body, clip.shape)
    return frames.replace(clearance=frames.clearance - level), height - level

"""The corpus as HuMoR's training windows: states at 30 Hz, cut at random times, augmented.

All recordings stay in memory as rotations at 120 Hz. A window is taken at any of their frames,
mirrored, played faster or slower, and put on another body, and only then turned into joints and
velocities; so positions, rotations and velocities agree whatever was drawn.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from priors.humor.state import State
from recon.benchmark.dataset import Part, Splits, conversion_notes
from recon.body.model import BodyModel
from recon.core import rotations as so3
from recon.core.motion import MotionFile
from recon.core.skeleton import CONTACT_JOINTS, MIRROR, TOES
from recon.core.struct import TensorStruct
from recon.method.protocols import REFERENCE_FPS
from training.humor.moments import PER_FRAME, Moments, with_edited
from training.humor.variation import Variation as Variation
from training.humor.variation import chosen_rows, with_random_edits, with_upper_body_of
from training.manifest import Lesson
from training.recordings import mirrored_rotations
from training.run import LOG
from training.settings import TrainingSettings

KINDS: Mapping[str, tuple[str, ...]] = {
    "uneven ground": ("uneven", "playground", "stairs"),
    "run": ("run", "jog"),
    "walk": ("walk",),
    "jump": ("jump",),
    "dance": ("danc",),
    "fight": ("martial", "punch", "sword"),
    "ball": ("soccer", "basketball"),
}
"""Words of a recording's description that tell the kind of motion; the first kind counts."""
OTHER = "other"


def kind_of_motion(description: str) -> str:
    """Classify a recording's kind of motion by words of its description."""
    text = description.lower()
    for kind, words in KINDS.items():
        if any(word in text for word in words):
            return kind
    return OTHER


def described_action(motion: Path) -> str:
    """The action named in the notes of a converted motion; its file name without notes."""
    return str(conversion_notes(motion).get("action", motion.stem))


RATE = 120
"""Frames per second kept in memory; slower recordings are brought to it by cubic splines."""

STRIDE = RATE // int(REFERENCE_FPS)

_SHORTEST_S = 0.6
"""Seconds; shorter clips, and pieces between jumps, are left out."""
_FASTEST = 15.0
_FASTEST_TURN = 120.0
"""Metres and radians per second: where a joint of `CONTACT_JOINTS` or any rotation is faster, the
recording jumps, and clips are cut."""

_MIRRORED_CONTACTS = [CONTACT_JOINTS.index(MIRROR[j]) for j in CONTACT_JOINTS]


@dataclass(frozen=True)
class StateWindows(TensorStruct):
    """Windows of consecutive states at 30 Hz in the world, with contacts and shapes."""

    states: State
    """Axes (windows, frames)."""
    contacts: Float[Tensor, "windows frames 9"]
    """One where a joint of `CONTACT_JOINTS` carries weight."""
    trusted: Bool[Tensor, " windows"]
    """Feet stand where they should; elsewhere nothing may be learned about contact."""
    rest: Float[Tensor, "windows 22 3"]
    """Joints of the unposed bodies."""


@dataclass(frozen=True)
class Corpus(TensorStruct):
    """All clips of one part of the corpus, concatenated along the axis of frames."""

    translation: Float[Tensor, "frames 3"]
    rotations: Float[Tensor, "frames 22 3 3"]
    contacts: Bool[Tensor, "frames 9"]
    start: Int[Tensor, " clips"]
    """First frame of every clip."""
    count: Int[Tensor, " clips"]
    """Number of its frames."""
    shape: Float[Tensor, "clips shape"]
    trusted: Bool[Tensor, " clips"]
    kind: Int[Tensor, " clips"]
    """Clips of one kind of motion have one number."""
    person: Int[Tensor, " clips"]
    """Clips of one person have one number."""
    body: BodyModel
    soles: Int[Tensor, " soles"]
    """Vertices of which one is the lowest of any unposed body."""
    names: tuple[str, ...]

    @classmethod
    def load(
        cls,
        settings: TrainingSettings,
        part: Part,
        body: BodyModel,
        lesson: Lesson = "steps",
    ) -> "Corpus":
        """Load all stretches of one part of the corpus that are fit for learning `lesson`.

        Args:
            settings: of which the corpus, the splits and the licence count.
            part: which part.
            body: whose shape coefficients the clips have.
            lesson: what they must be fit to teach.

        Raises:
            ValueError: when no clip remains.
        """
        found = [
            (name, kind_of_motion(described_action(path)), _at_corpus_rate(piece))
            for name, path, stretch in settings.stretches_that_teach(part, lesson)
            for piece in _split_at_jumps(stretch)
            if piece.motion.frames >= _SHORTEST_S * piece.motion.fps
        ]
        if len(found) == 0:
            raise ValueError(
                f"{settings.corpus}: holds no {part} clip from which {lesson} may be learned; "
                "convert more recordings"
            )
        names, kinds, clips = zip(*found, strict=True)
        splits = Splits.load(settings.splits)
        count = torch.tensor([c.motion.frames for c in clips])
        LOG.info("%d %s clips, %.1f min", len(clips), part, count.sum().item() / RATE / 60)
        return cls(
            translation=torch.cat([c.motion.translation for c in clips]),
            rotations=torch.cat([c.motion.rotations for c in clips]),
            contacts=torch.cat([_contact_labels(c) for c in clips]),
            start=count.cumsum(0) - count,
            count=count,
            shape=torch.stack([c.motion.shape for c in clips]),
            trusted=torch.tensor([c.contacts is not None for c in clips]),
            kind=_label_indices(kinds),
            person=_label_indices([splits.subject(name) for name in names]),
            body=body,
            soles=(body.template[:, 1] < body.joint_template[list(TOES), 1].min()).nonzero()[:, 0],
            names=names,
        )

    def draw(
        self, windows: int, frames: int, variation: Variation, random: torch.Generator
    ) -> StateWindows:
        """Random windows; the probability of a clip is proportional to the root of its length.

        Uniformly by length, one long dance would be all that is learned; uniformly by clip, the
        shortest clips would be learned by heart. `Variation.kinds` and `people` balance further.
        """

        def uniform(*size: int) -> Tensor:
            return torch.rand(*size, generator=random).to(self.translation.device)

        speed = ((2 * uniform(windows) - 1) * np.log1p(variation.speed)).exp()
        chance = self.count.float().sqrt() * (
            self.count > self._frames_needed(frames, 1 + variation.speed)
        )
        for group, share in ((self.kind, variation.kinds), (self.person, variation.people)):
            chance = _balanced_chances(chance, group, share)

        def drawn_places(speed: Tensor) -> tuple[Tensor, Tensor]:
            clip = torch.multinomial(chance.cpu(), len(speed), replacement=True, generator=random)
            clip = clip.to(self.start.device)
            room = self.count[clip] - self._frames_needed(frames, speed)
            return clip, self.start[clip] + 1 + (uniform(len(speed)) * room).long()

        clip, first = drawn_places(speed)
        normal = torch.randn(windows, self.shape.shape[1], generator=random)
        mirror = uniform(windows) < variation.mirror
        reverse = uniform(windows) < variation.reverse
        shape = self.shape[clip] + variation.shape * normal.to(self.shape)
        moments = self._moments_of_windows(clip, first, speed, frames, mirror, reverse, shape)
        if variation.halves > 0:
            rows = chosen_rows(uniform(windows) < variation.halves)
            if len(rows) > 0:
                other, its_first = drawn_places(speed[rows])
                trunks = self._moments_of_windows(
                    other,
                    its_first,
                    speed[rows],
                    frames,
                    uniform(len(rows)) < variation.mirror,
                    uniform(len(rows)) < variation.reverse,
                    shape[rows],
                )
                made, accepted = with_upper_body_of(moments[rows], trunks)
                moments = with_edited(moments, rows, made, accepted & (other != clip[rows]))
        moments = with_random_edits(moments, variation, random)
        return _states_at_frames(moments, self.trusted[clip])

    def all_windows(self, frames: int) -> StateWindows:
        """Return consecutive windows of all clips, as recorded, without augmentation."""
        clip: list[int] = []
        first: list[int] = []
        for k, (start, count) in enumerate(
            zip(self.start.tolist(), self.count.tolist(), strict=True)
        ):
            last = start + count - int(self._frames_needed(frames, 1.0))
            places = range(start + 1, last + 1, frames * STRIDE)
            clip += [k] * len(places)
            first += places
        if len(clip) == 0:
            raise ValueError(f"no clip is {frames} frames long at {REFERENCE_FPS:g} Hz")
        rows = torch.tensor(clip, device=self.start.device)
        one = torch.ones(len(rows), device=self.start.device)
        places = torch.tensor(first, device=self.start.device)
        never = one < 0
        moments = self._moments_of_windows(
            rows, places, one, frames, never, never, self.shape[rows]
        )
        return _states_at_frames(moments, self.trusted[rows])

    @staticmethod
    def _frames_needed(frames: int, speed: Tensor | float) -> Tensor | float:
        """Number of stored frames (120 Hz) that a window spans, with spare ones at its ends."""
        return (frames - 1) * STRIDE * speed + 4

    def _moments_of_windows(
        self,
        clip: Int[Tensor, " windows"],
        first: Int[Tensor, " windows"],
        speed: Float[Tensor, " windows"],
        frames: int,
        mirror: Bool[Tensor, " windows"],
        reverse: Bool[Tensor, " windows"],
        shape: Float[Tensor, "windows shape"],
    ) -> Moments:
        steps = torch.arange(frames, device=first.device)
        place = first[:, None] + STRIDE * speed[:, None] * steps
        place = torch.where(reverse[:, None], place.flip(1), place)
        ahead = torch.where(reverse, -1, 1)[:, None]
        moments = torch.stack((place - ahead, place, place + ahead), -1)
        before = moments.floor().long()
        part = (moments - before)[..., None]
        translation = self.translation[before].lerp(self.translation[before + 1], part)
        rotations = self.rotations.flatten(1)
        rotations = rotations[before].lerp(rotations[before + 1], part).unflatten(-1, (22, 3, 3))
        rotations = _orthonormalised(rotations)
        contacts = self.contacts[place.round().long()]

        flip = translation.new_tensor([-1.0, 1.0, 1.0])
        m = mirror[:, None, None]
        translation = torch.where(m[..., None], translation * flip, translation)
        rotations = torch.where(m[..., None, None, None], mirrored_rotations(rotations), rotations)
        contacts = torch.where(m, contacts[..., _MIRRORED_CONTACTS], contacts)

        beside = torch.arange(PER_FRAME, device=first.device) - 1
        seconds = steps[:, None] / REFERENCE_FPS + beside / (RATE * speed[:, None, None])
        # the frame and the times just before and after it become neighbours on one time axis
        return Moments(
            translation=self._translations_for_body(translation, self.shape[clip], shape).flatten(
                1, 2
            ),
            rotations=rotations.flatten(1, 2),
            contacts=contacts,
            seconds=seconds.flatten(1, 2),
            rest=self.body.rest_joints(shape),
        )

    def _translations_for_body(
        self,
        translation: Float[Tensor, "windows frames moments 3"],
        old: Float[Tensor, "windows shape"],
        new: Float[Tensor, "windows shape"],
    ) -> Float[Tensor, "windows frames moments 3"]:
        """Translations for another body, with which its feet stay on the ground.

        The pelvis' path scales with the legs, measured from the level of the toe joints, which
        becomes that of the new toes: where legs keep their proportions, no foot slips or rises.
        """
        before, toes_before = self._heights_at_rest(old)
        after, toes_after = self._heights_at_rest(new)
        legs = (after - toes_after)[:, 2:] / (before - toes_before)[:, 2:]
        shift = toes_after - self.body.rest_joints(new)[:, 0]
        path = translation + (self.body.rest_joints(old)[:, 0] - toes_before)[:, None, None]
        return path * legs[:, None, None] + shift[:, None, None]

    def _heights_at_rest(
        self, shape: Float[Tensor, "windows shape"]
    ) -> tuple[Float[Tensor, "windows 3"], Float[Tensor, "windows 3"]]:
        """Heights above the sole of a body at rest, as vertical vectors: pelvis, toe joints."""
        up = shape.new_tensor([0.0, 0.0, 1.0])
        rest = self.body.rest_joints(shape)[..., 1]
        sole = self.body.rest_vertices(shape, self.soles)[..., 1].amin(-1)
        toes = rest[:, list(TOES)].mean(-1)
        return (rest[:, 0] - sole)[:, None] * up, (toes - sole)[:, None] * up


def _states_at_frames(moments: Moments, trusted: Bool[Tensor, " windows"]) -> StateWindows:
    """States at the frames of windows; velocities are differences of neighbouring moments."""
    count = moments.contacts.shape[1]
    joints = moments.posed()[1].unflatten(1, (count, PER_FRAME))
    translation = moments.translation.unflatten(1, (count, PER_FRAME))
    rotations = moments.rotations.unflatten(1, (count, PER_FRAME))
    seconds = moments.seconds.unflatten(1, (count, PER_FRAME))
    rate = 1 / (seconds[:, :, 2] - seconds[:, :, 0])[..., None]
    spin = rotations[:, :, 2, 0] @ rotations[:, :, 0, 0].mT
    states = State(
        translation=translation[:, :, 1],
        velocity=(translation[:, :, 2] - translation[:, :, 0]) * rate,
        root=rotations[:, :, 1, 0],
        angular_velocity=so3.axis_sine(spin) * rate,
        pose=rotations[:, :, 1, 1:],
        joints=joints[:, :, 1],
        joint_velocities=(joints[:, :, 2] - joints[:, :, 0]) * rate[..., None],
    )
    return StateWindows(states, moments.contacts.to(joints), trusted, moments.rest)


def _balanced_chances(
    chance: Float[Tensor, " clips"], group: Int[Tensor, " clips"], share: float
) -> Float[Tensor, " clips"]:
    """Divide clips' chances by a power (0 to 1) of their group's total, so groups even out."""
    if share == 0:
        return chance
    together = chance.new_zeros(int(group.max()) + 1).index_add(0, group, chance)
    return chance / together[group].clamp(min=1e-9) ** share


def _split_at_jumps(clip: MotionFile) -> list[MotionFile]:
    """Split a clip, with its contacts, at implausible jumps between frames."""
    motion, contacts = clip.motion, clip.contacts
    turn = motion.rotations.diff(dim=0).flatten(-2).norm(dim=-1) / 2**0.5
    jump = (turn * motion.fps > _FASTEST_TURN).any(-1)
    if clip.joints is not None:
        step = clip.joints[:, list(CONTACT_JOINTS)].diff(dim=0).norm(dim=-1)
        jump = jump | (step * motion.fps > _FASTEST).any(-1)
    edges = [0, *((jump.nonzero()[:, 0] + 1).tolist()), motion.frames]
    return [
        MotionFile(motion.window(a, b), contacts=None if contacts is None else contacts[a:b])
        for a, b in pairwise(edges)
    ]


def _label_indices(labels: Sequence[str]) -> Int[Tensor, " clips"]:
    """The index of each label in the sorted list of labels."""
    places = {label: place for place, label in enumerate(sorted(set(labels)))}
    return torch.tensor([places[label] for label in labels])


def _contact_labels(clip: MotionFile) -> Bool[Tensor, "frames 9"]:
    if clip.contacts is None:
        return torch.zeros(clip.motion.frames, len(CONTACT_JOINTS), dtype=torch.bool)
    return clip.contacts[:, list(CONTACT_JOINTS)] > 0.5


def _at_corpus_rate(clip: MotionFile) -> MotionFile:
    """Resample a clip to `RATE` by cubic splines; contact labels are the nearest in time."""
    motion = clip.motion
    if motion.fps == RATE:
        return clip
    from scipy.interpolate import CubicSpline

    known = np.arange(motion.frames) / motion.fps
    count = int((motion.frames - 1) * RATE / motion.fps + 1e-6) + 1
    wanted = np.arange(count) / RATE
    entries = torch.cat((motion.translation, motion.rotations.flatten(1)), 1).double().numpy()
    made = torch.from_numpy(CubicSpline(known, entries)(wanted))
    rotations = made[:, 3:].unflatten(-1, (22, 3, 3))
    for _ in range(4):
        rotations = _orthonormalised(rotations)
    nearest = torch.from_numpy((wanted * motion.fps).round()).long().clamp(max=motion.frames - 1)
    return MotionFile(
        motion=motion.replace(
            translation=made[:, :3].to(motion.translation),
            rotations=rotations.to(motion.rotations),
            valid=torch.ones(count, dtype=torch.bool),
            fps=float(RATE),
        ),
        contacts=None if clip.contacts is None else clip.contacts[nearest],
    )


def _orthonormalised(matrix: Float[Tensor, "*shape 3 3"]) -> Float[Tensor, "*shape 3 3"]:
    """Bring a nearly orthonormal matrix R closer to one: a Newton-Schulz step R (3 - RᵀR) / 2."""
    a = matrix.reshape(-1, 3, 3)
    return torch.baddbmm(a, a, a.mT @ a, beta=1.5, alpha=-0.5).view(matrix.shape)

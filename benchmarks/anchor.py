"""What tables of the anchor-frame prior share: its command line, labelled cycles, the surface."""

import argparse
import re
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from priors.anchor.frames import Anchors
from priors.anchor.prior import AnchorFrames
from recon.benchmark.dataset import SPLITS, Licence, Part, Splits
from recon.core import rotations as so3
from training.anchor.corpus import CycleBatch, CycleCorpus

TURNS = 30.0
"""Degrees by which a cycle turns at least: clips named after turns also walk straight."""
LABELS = {
    "walk": ("dataset-?_walk_*", "35_0?", "35_1[0-6]", "35_2[89]", "35_3?", "02_01", "02_02"),
    "run": ("dataset-?_run_*", "35_1[7-9]", "35_2[0-6]", "02_03"),
    "dash": ("dataset-?_dash_*",),
    "walk-back": ("dataset-?_walk-back_*",),
    "walk-left": ("dataset-?_walk-left_*",),
    "walk-right": ("dataset-?_walk-right_*",),
    "turn-left": ("dataset-?_walk-turn-left_*",),
    "turn-right": ("dataset-?_walk-turn-right_*",),
    "salsa": ("salsa_*",),
}
"""What is done in clips of these names; of CMU those whose speeds tell the same."""


@dataclass(frozen=True)
class Ask:
    """What every table is told."""

    corpus: Path
    weights: str
    licence: Licence
    splits: Splits
    only: int | None
    json: Path | None
    picture: Path | None


def parser(about: str | None) -> argparse.ArgumentParser:
    """Corpus, weights, licence and where to write; a table adds its own."""
    made = argparse.ArgumentParser(
        description=about, formatter_class=argparse.RawTextHelpFormatter
    )
    made.add_argument("corpus", type=Path, help="folder of all converted motions")
    made.add_argument("--weights", default="open", help="open, nc or a file")
    made.add_argument("--licence", choices=("open", "nc"), default="open",
                      help="of the cycles that the weights learned from")  # fmt: skip
    made.add_argument("--splits", type=Path, default=SPLITS)
    made.add_argument("--only", type=int, default=None, help="cycles of a set, to try it out")
    made.add_argument("--json", type=Path, default=None)
    made.add_argument("--picture", type=Path, default=None, help=".png to draw")
    return made


def asked(arguments: argparse.Namespace) -> Ask:
    """What the command line says."""
    return Ask(
        corpus=arguments.corpus,
        weights=arguments.weights,
        licence=arguments.licence,
        splits=Splits.load(arguments.splits),
        only=arguments.only,
        json=arguments.json,
        picture=arguments.picture,
    )


@dataclass(frozen=True)
class Cycles:
    """Cycles of one part of the corpus, as recorded and aligned."""

    batch: CycleBatch
    clips: tuple[str, ...]
    left: Bool[Tensor, " cycles"]
    """Whether each begins with the left foot."""

    @classmethod
    def load(cls, ask: Ask, part: Part, licence: Licence, prior: AnchorFrames) -> "Cycles":
        """All of them, in the prior's alignment."""
        corpus = CycleCorpus.load(ask.corpus, ask.splits, part, licence, prior.body)
        return cls(corpus.every(prior.alignment), corpus.clips, corpus.left)

    def rows(self, rows: Int[Tensor, " some"]) -> "Cycles":
        """Some of them."""
        clips = tuple(self.clips[row] for row in rows.tolist())
        return Cycles(self.batch[rows], clips, self.left[rows])

    def thinned(self, most: int | None) -> "Cycles":
        """Some of the cycles, so many, evenly spread; None leaves all."""
        count = len(self.clips)
        if most is None or count <= most:
            return self
        return self.rows(torch.linspace(0, count - 1, most).round().long())

    @property
    def labels(self) -> list[str | None]:
        """What is done in each, None where its clip's name does not tell."""
        turn = turned(self.batch.anchors)
        return [label(clip, float(angle)) for clip, angle in zip(self.clips, turn, strict=True)]

    def one_per_clip(self, wanted: str) -> "Cycles":
        """The middle cycle of every clip of a label; of a turn, the cycle that turns most."""
        labels, turn = self.labels, turned(self.batch.anchors).abs()
        rows = [row for row, name in enumerate(labels) if name == wanted]
        chosen: list[int] = []
        for clip in sorted({self.clips[row] for row in rows}):
            own = [row for row in rows if self.clips[row] == clip]
            if wanted.startswith("turn"):
                chosen.append(max(own, key=lambda row: float(turn[row])))
            else:
                chosen.append(own[len(own) // 2])
        return self.rows(torch.tensor(chosen, dtype=torch.long))


def label(clip: str, turn: float) -> str | None:
    """What a cycle of a clip is, given by how many degrees it turns to the left."""
    for name, patterns in LABELS.items():
        if any(fnmatchcase(clip, pattern) for pattern in patterns):
            sign = {"turn-left": 1.0, "turn-right": -1.0}.get(name)
            return name if sign is None or sign * turn >= TURNS else None
    return None


def turned(anchors: Anchors) -> Float[Tensor, " cycles"]:
    """Degrees of heading from the first anchor to the last, to the left."""
    first, last = (so3.heading(anchors.rotations[:, row, 0]) for row in (0, -1))
    step = last.mT @ first
    return torch.rad2deg(torch.atan2(step[:, 1, 0], step[:, 0, 0]))


def surface(
    prior: AnchorFrames, cycles: CycleBatch, vertices: Int[Tensor, " points"]
) -> Float[Tensor, "cycles 100 points 3"]:
    """Some vertices of the bodies at the anchors, in the frame of the first, metres."""
    return prior.body.pose(cycles.anchors.motion(cycles.shape, 1.0)).points(vertices)


def weights_name(weights: str) -> str:
    """What a weights file is called in tables."""
    return re.sub(r"\.safetensors$", "", Path(weights).name)

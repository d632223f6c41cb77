"""Likeness of motions: clips of unknown people beside the people who are tested.

    python -m benchmarks.likeness CORPUS --json likeness.json

CMU's `u_*` clips do not say who moves in them, and some may be of a test or validation person.
The distance of a clip from a person is taken frame by frame at 10 Hz: the directions of the 21
bones are turned so that the body faces one way, a frame's distance from another is the mean angle
between their bones, and every frame of the clip looks for the nearest frame of the person's other
clips. The median over the clip's frames is the clip's distance, in degrees.

The rule: a clip of unknown people that lies nearer than `NEAR` to a test or validation person is
excluded from all parts. Takes of one walker lie within 3.8 degrees of the walker's other takes
(`own`), and no clip of another known person comes nearer to test subject 07 than 6.0 degrees
(`others`). `NEAR` is that upper end: excluding a clip of somebody else costs a few seconds of
training data, keeping one of a test person would spoil the test. One pair of known people lies
nearer than that, too: 16 and 35, at 3.2 degrees, who therefore count as one gait.
"""

import argparse
from collections import defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from rich.console import Console
from rich.table import Table
from torch import Tensor

from benchmarks.results import corpus_source, write
from recon.benchmark.dataset import SPLITS, Splits, clip_files
from recon.body.model import BodyModel
from recon.core import rotations as so3
from recon.core.motion import Motion
from recon.core.skeleton import PARENTS
from recon.formats.motions import load_motion

FPS = 10.0
NEAR = 6.0
"""Degrees."""
UNKNOWN = "u_"
"""What names of clips of unknown people begin with."""

Directions = Float[Tensor, "frames 21 3"]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("corpus", type=Path, help="folder of all converted motions")
    parser.add_argument("--splits", type=Path, default=SPLITS)
    parser.add_argument("--json", type=Path, default=None)
    arguments = parser.parse_args()

    body, splits = BodyModel.load(), Splits.load(arguments.splits)
    files = clip_files(arguments.corpus)
    people = (*splits.test, *splits.apart, *splits.validation)
    cmu = [name for name in files if not name.startswith("dataset-")]
    subjects = {name: splits.subject(name) for name in cmu}
    # Bandai-Namco's actors were recorded elsewhere and are nobody of CMU's database
    people = tuple(person for person in people if person in subjects.values())
    found = {name: directions(load_motion(files[name]).motion, body) for name in cmu}

    unknown = {
        name: nearest_people(name, found, subjects, people)
        for name in cmu
        if name.startswith(UNKNOWN)
    }
    own = {person: own_distances(person, found, subjects) for person in people}
    known = {name: who for name, who in subjects.items() if not name.startswith(UNKNOWN)}
    others = {person: other_distances(person, found, known) for person in people}
    near = sorted(
        name
        for name, row in unknown.items()
        if subjects[name] not in people and min(row.values()) < NEAR
    )
    report(unknown, own, others, people, near)
    if arguments.json is not None:
        source = corpus_source(arguments.corpus, [files[name] for name in cmu])
        write(
            arguments.json, None, source, near_degrees=NEAR, people=people, unknown=unknown,
            own=own, others=others, near=near,
        )  # fmt: skip


def directions(motion: Motion, body: BodyModel) -> Directions:
    """Unit directions of all bones at 10 Hz, turned about the vertical until the body faces x."""
    some = motion.resample(FPS)
    joints = body.pose(some).joints
    bones = joints[:, 1:] - joints[:, list(PARENTS[1:])]
    bones = bones / bones.norm(dim=-1, keepdim=True).clamp(min=1e-9)
    ahead = some.rotations[:, 0, :, 2]
    turn = so3.about_z(-torch.atan2(ahead[:, 1], ahead[:, 0]))
    return (turn[:, None] @ bones[..., None])[..., 0].double()


def distance(clip: Directions, others: Directions) -> float:
    """Median over a clip's frames of the mean bone angle to the nearest other frame, degrees."""
    nearest = [
        torch.einsum("bi,fbi->fb", frame, others).clamp(-1, 1).acos().mean(1).min()
        for frame in clip
    ]
    return float(np.degrees(torch.stack(nearest).median().item()))


def nearest_people(
    name: str, found: Mapping[str, Directions], subjects: Mapping[str, str], people: Sequence[str]
) -> dict[str, float]:
    """A clip's distance from each person, from the person's clips other than this one."""
    row: dict[str, float] = {}
    for person in people:
        clips = [
            found[other] for other, who in subjects.items() if who == person and other != name
        ]
        if clips:
            row[person] = distance(found[name], torch.cat(clips))
    return row


def own_distances(
    person: str, found: Mapping[str, Directions], subjects: Mapping[str, str]
) -> dict[str, float]:
    """How far each clip of a person is from the person's other clips."""
    rows = {
        name: nearest_people(name, found, subjects, [person])
        for name, who in subjects.items()
        if who == person
    }
    return {name: row[person] for name, row in rows.items() if row}


def other_distances(
    person: str, found: Mapping[str, Directions], subjects: Mapping[str, str]
) -> dict[str, float]:
    """How near the nearest clip of each other person comes to this person."""
    rows: dict[str, list[float]] = defaultdict(list)
    for name, who in subjects.items():
        if who != person:
            rows[who].append(nearest_people(name, found, subjects, [person])[person])
    return {who: min(values) for who, values in rows.items()}


def report(
    unknown: Mapping[str, Mapping[str, float]],
    own: Mapping[str, Mapping[str, float]],
    others: Mapping[str, Mapping[str, float]],
    people: Sequence[str],
    near: Sequence[str],
) -> None:
    """The distances of all unknown clips, and what to judge them by."""
    table = Table("clip", *people, title="degrees from a person's nearest frames")
    for name, row in sorted(unknown.items(), key=lambda item: min(item[1].values())):
        table.add_row(name, *(f"{row[person]:.1f}" if person in row else "" for person in people))
    table.add_section()
    for title, pick in (("own clips, median", np.median), ("own clips, greatest", max)):
        cells = [f"{pick(list(own[p].values())):.1f}" if own[p] else "" for p in people]
        table.add_row(title, *cells)
    nearest = [min(others[p].items(), key=lambda item: item[1]) for p in people]
    table.add_row("nearest other person", *(f"{value:.1f} ({who})" for who, value in nearest))
    console = Console(width=160)
    console.print(table)
    console.print(f"nearer than {NEAR:g} degrees: {', '.join(near) or 'none'}", markup=False)


if __name__ == "__main__":
    main()

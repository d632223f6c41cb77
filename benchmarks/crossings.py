"""Two people who cross before one camera: is everybody followed, is anybody exchanged?

    python -m benchmarks.crossings CORPUS --part validation --json crossings.json

Of the windows of 90 frames in which somebody gets along by 1.2 m or more, pairs are set before a
fixed phone so that they pass each other: in `opposite` directions, one `overtaking` the other, or
`diagonal`, where who is in front changes. Their paths are 0.5 to 1.1 m apart in depth.

Keypoints (openpose25) have three pixels of noise. Those of the person behind that the person in
front covers are missing (60 %), found on the same limb of the person in front (25 %) or found with
three times the noise (15 %); somebody of whom less than six are left is not detected. The file
names nobody, and people change places in it at random.

`followed` is the share of the frames in which somebody was detected that their longest track has;
`of all` counts all frames. A track that has three or more detections of a second person is an
exchange, and one that ends near another person is `said`.
"""

import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float
from rich.console import Console
from rich.table import Table

from benchmarks.arguments import over_windows
from benchmarks.results import corpus_source, write
from observations.correspondences import BodyPoints
from recon.benchmark.dataset import Part, Splits
from recon.benchmark.windows import TrueWindows, load_windows
from recon.body.model import BodyModel
from recon.core import rotations as so3
from recon.core.camera import Camera, full_hd_camera
from recon.core.motion import Motion
from recon.core.skeleton import PARENTS
from recon.formats.detections.records import Detections, Row, gather
from recon.reading.tracks import Track, follow

SEED = 0
FRAMES = 90
SCENES = 20
PIXELS = 3.0
LAYOUT = "openpose25"
KINDS = ("opposite", "overtaking", "diagonal")
_LEAST_WAY = 1.2
"""Metres that somebody gets along in a window that is used."""
_LIMB, _TRUNK = 0.07, 0.16
"""Metres around limbs and around the trunk's bones that a body covers."""
_MISSING, _WRONG = 0.6, 0.25
_FEWEST = 6
_EXCHANGED = 3
_BONES = tuple((k, parent) for k, parent in enumerate(PARENTS) if parent >= 0)


@dataclass(frozen=True)
class Scene:
    """Two people as one camera saw them."""

    kind: str
    motions: tuple[Motion, ...]
    camera: Camera
    detections: Detections
    person: tuple[int, ...]
    """The number of the person that every detection is of."""


def main() -> None:
    parser = over_windows(__doc__)
    parser.add_argument("--scenes", type=int, default=SCENES)
    arguments = parser.parse_args()
    body = BodyModel.load()
    windows = walkers(arguments.corpus, Splits.load(arguments.splits), arguments.part, body)
    rows = [judged(one) for one in scenes(windows, body, arguments.scenes)]
    console = Console(width=None if sys.stdout.isatty() else 160)
    console.print(_table(rows))
    if arguments.json is not None:
        about = {"part": arguments.part, **windows.about}
        source = corpus_source(arguments.corpus, windows.files)
        write(arguments.json, SEED, source, **about, scenes=rows)


def walkers(corpus: Path, splits: Splits, part: Part, body: BodyModel) -> TrueWindows:
    """The windows in which somebody gets along."""
    windows = load_windows(corpus, splits, part, body, SEED, FRAMES)
    way = (windows.truth.translation[:, -1] - windows.truth.translation[:, 0])[:, :2].norm(dim=-1)
    return windows.take([k for k in range(len(way)) if way[k] >= _LEAST_WAY])


def scenes(windows: TrueWindows, body: BodyModel, count: int) -> list[Scene]:
    """Scenes of two subjects each, by turns of each kind."""
    random = np.random.default_rng(SEED)
    made: list[Scene] = []
    for k in range(count):
        first = int(random.integers(len(windows.names)))
        others = [
            one for one in range(len(windows.names))
            if windows.subjects[one] != windows.subjects[first]
        ] or [one for one in range(len(windows.names)) if one != first]  # fmt: skip
        second = others[int(random.integers(len(others)))]
        pair = windows.truth[first], windows.truth[second]
        made.append(scene(pair, body, KINDS[k % len(KINDS)], 1000 + k))
    return made


def scene(pair: Sequence[Motion], body: BodyModel, kind: str, seed: int) -> Scene:
    """Two people who meet in the middle of the window, seen from seven metres away."""
    random = np.random.default_rng(seed)
    apart = random.uniform(0.5, 1.1)
    tilt = math.radians(random.uniform(-15, 15))
    headings = {
        "opposite": (tilt, math.pi - tilt),
        "overtaking": (tilt, tilt + math.radians(random.uniform(-8, 8))),
        "diagonal": (math.radians(35), math.pi - math.radians(35)),
    }[kind]
    # who overtakes is behind at first: paths that begin together are set apart by their speeds
    when = FRAMES // 2 + int(random.integers(-15, 16))
    motions = [
        _set(motion, body, heading, when, side * apart / 2)
        for motion, heading, side in zip(pair, headings, (-1, 1), strict=True)
    ]
    if kind == "overtaking":
        motions[1] = _faster(motions[1], headings[1], when)
    lens = full_hd_camera()
    camera = lens.placed(torch.tensor([0.0, -7.0, 1.5]), torch.tensor([0.0, 0.0, 0.95]))
    detections, person = _detected(motions, body, camera, random)
    return Scene(kind, tuple(motions), camera, detections, person)


def _set(motion: Motion, body: BodyModel, heading: float, when: int, depth: float) -> Motion:
    """A motion that goes in a direction and is before the camera in one frame."""
    pelvis = body.rest_joints(motion.shape)[0]
    way = motion.translation[-1] - motion.translation[0]
    turn = so3.about_z(torch.tensor([heading - math.atan2(float(way[1]), float(way[0]))]))[0]
    T = torch.eye(4)
    T[:3, :3] = turn
    at = turn @ (motion.translation[when] + pelvis)
    T[:2, 3] = torch.tensor([0.0, depth]) - at[:2]
    return motion.carried(T, pelvis)


def _faster(motion: Motion, heading: float, when: int) -> Motion:
    """A faster walker: the steps are made on ground that moves along by 0.5 m/s."""
    seconds = (torch.arange(motion.frames) - when) / motion.fps
    along = torch.tensor([math.cos(heading), math.sin(heading), 0.0])
    return motion.replace(translation=motion.translation + 0.5 * seconds[:, None] * along)


def _detected(
    motions: Sequence[Motion], body: BodyModel, camera: Camera, random: np.random.Generator
) -> tuple[Detections, tuple[int, ...]]:
    posed = [body.pose(motion) for motion in motions]
    places = BodyPoints.of_layout(LAYOUT, body)
    points = [places.of(one) for one in posed]
    true = [camera.project(one).pixels.double().numpy() for one in points]
    depth = [camera.project(one).depth.double().numpy() for one in points]
    near = [camera.project(one.joints) for one in posed]
    focal = float(camera.camera_matrix[0, 0])
    rows: list[Row] = []
    person: list[int] = []
    for t in range(motions[0].frames):
        found: list[tuple[int, np.ndarray]] = []
        for k in range(len(motions)):
            confidence = np.clip(random.normal(0.85, 0.08, len(true[k][t])), 0.3, 1.0)
            pixels = true[k][t] + PIXELS * random.standard_normal(true[k][t].shape)
            confidence[random.random(len(confidence)) < 0.03] = 0.0
            for other in range(len(motions)):
                if other == k:
                    continue
                covered = _covered(
                    true[k][t], depth[k][t], near[other].pixels[t].double().numpy(),
                    near[other].depth[t].double().numpy(), focal,
                )  # fmt: skip
                draw = random.random(len(confidence))
                wild = 3 * PIXELS * random.standard_normal(pixels.shape)
                wrong = covered & (draw >= _MISSING) & (draw < _MISSING + _WRONG)
                pixels = np.where(wrong[:, None], true[other][t] + wild, pixels)
                unsure = covered & (draw >= _MISSING + _WRONG)
                pixels = np.where(unsure[:, None], true[k][t] + wild, pixels)
                confidence = np.where(covered & (draw < _MISSING), 0.0, confidence)
                confidence = np.where(wrong | unsure, confidence * 0.6, confidence)
            if (confidence > 0).sum() >= _FEWEST:
                found.append((k, np.concatenate((pixels, confidence[:, None]), -1)))
        for place in random.permutation(len(found)).tolist():
            k, detection = found[place]
            rows.append((t, np.where(detection[:, 2:] > 0, detection, 0.0), -1))
            person.append(k)
    return gather("phone", range(motions[0].frames), rows, layout=LAYOUT), tuple(person)


def _covered(
    pixels: Float[np.ndarray, "points 2"],
    depth: Float[np.ndarray, " points"],
    joints: Float[np.ndarray, "22 2"],
    joint_depth: Float[np.ndarray, " 22"],
    focal: float,
) -> Bool[np.ndarray, " points"]:
    """Keypoints that lie behind another body in the image."""
    out = np.zeros(len(pixels), bool)
    for end, start in _BONES:
        a, way = joints[start], joints[end] - joints[start]
        along = np.clip(((pixels - a) @ way) / max(float(way @ way), 1e-9), 0, 1)
        away = np.linalg.norm(pixels - a - along[:, None] * way, axis=-1)
        front = joint_depth[start] + along * (joint_depth[end] - joint_depth[start])
        reach = _TRUNK if end in (1, 2, 3, 6, 9, 13, 14) else _LIMB
        out |= (away < reach * focal / front) & (depth > front)
    return out


def judged(one: Scene) -> dict[str, Any]:
    """What became of the two people of a scene."""
    tracks = follow(one.detections)
    owners = [_owners(track, one) for track in tracks]
    shares: list[float] = []
    whole: list[float] = []
    for k in range(len(one.motions)):
        there = sum(own == k for own in one.person)
        most = max((int((who == k).sum()) for who in owners), default=0)
        shares.append(most / max(there, 1))
        whole.append(most / FRAMES)
    exchanged = sum(
        len(who) > 0 and int(min((who == k).sum() for k in range(2))) >= _EXCHANGED
        for who in owners
    )
    return {
        "kind": one.kind,
        "detected": min(sum(own == k for own in one.person) for k in range(2)) / FRAMES,
        "followed": min(shares),
        "of_all": min(whole),
        "tracks": len(tracks),
        "exchanged": int(exchanged),
        "said": sum(track.ended_by is not None for track in tracks),
    }


def _owners(track: Track, one: Scene) -> np.ndarray:
    """Numbers of the people that the detections of a track are of."""
    found: list[int] = []
    for frame, pixels in zip(track.frame, track.pixels, strict=True):
        rows = np.flatnonzero(one.detections.frame == frame)
        found += [one.person[r] for r in rows if np.array_equal(one.detections.pixels[r], pixels)]
    return np.array(found, dtype=np.int64)


def _table(rows: Sequence[dict[str, Any]]) -> Table:
    table = Table(title="two people who cross", title_justify="left")
    for heading in ("scenes", "number", "both followed 95 %", "least followed", "of all frames",
                    "exchanged", "said"):  # fmt: skip
        table.add_column(heading, justify="right")
    for kind in (*KINDS, "all"):
        own = [row for row in rows if kind in ("all", row["kind"])]
        if own:
            table.add_row(
                kind, str(len(own)), str(sum(row["followed"] >= 0.95 for row in own)),
                f"{min(row['followed'] for row in own):.0%}",
                f"{np.mean([row['of_all'] for row in own]):.0%}",
                str(sum(row["exchanged"] > 0 for row in own)),
                str(sum(row["said"] > 0 for row in own)),
            )  # fmt: skip
    return table


if __name__ == "__main__":
    main()

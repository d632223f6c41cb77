"""Style of a walk that was carried over: A's on B's body, beside how B was recorded walking.

A network that had learned how bodies move would bring A's walk nearer to B's own way of walking
than a scaled copy is, which changes nothing but size. `codes` is the network without the details
that codes leave out, which are A's own.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import permutations
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from torch import Tensor

from benchmarks.retarget import Retargeter
from benchmarks.retarget_baselines import scaled
from benchmarks.retarget_clips import evenly
from benchmarks.retarget_shapes import codes_only
from priors.humos.prior import Humos
from recon.benchmark.dataset import Splits, clip_files, is_flat
from recon.body.model import BodyModel
from recon.body.motion_files import leg_length
from recon.core.motion import Motion
from recon.core.skeleton import joint_index
from recon.fitting.retargeting import proposed
from recon.formats.motions import load_motion
from recon.gait.analysis import GaitCycle, find_gait_cycles
from recon.gait.feet import Feet, find_stances
from training.humor.corpus import described, kind_of

FPS = 60.0
"""Frames per second at which gait is told; the recordings have 120."""
LONGEST = 6.0
"""Seconds of a walk, from its beginning: a network of one code per clip knows as much at once."""
STATISTICS: Mapping[str, str] = {
    "cadence": "cadence, steps/min",
    "step": "step length / leg length",
    "speed": "speed, leg lengths/s",
    "sway": "sway of the pelvis / leg length",
    "arms": "arm swing, degrees",
}
"""Statistics of a walk, and their headings. All but cadence have no length in them, so that a
scaled copy keeps A's."""
_SCALED, _CODES, _NETWORK = "scaled copy", "codes", "network"
_ARMS = tuple(tuple(joint_index(f"{side}_{n}") for n in ("shoulder", "wrist"))
              for side in ("left", "right"))  # fmt: skip


@dataclass(frozen=True)
class Walk:
    """One recorded walk with its statistics."""

    clip: str
    person: str
    motion: Motion
    statistics: Mapping[str, float]


def walkers(
    corpus: Path, splits: Splits, parts: tuple[str, ...], body: BodyModel, each: int
) -> dict[str, list[Walk]]:
    """People of whom several walks on flat ground are known, each with so many walks at most."""
    files = clip_files(corpus)
    clips: dict[str, list[str]] = {}
    for clip, part in splits.parts(list(files)).items():
        person = splits.subject(clip)
        if part not in parts or person == "unknown" or not splits.is_open(clip):
            continue
        if kind_of(described(files[clip])) == "walk" and is_flat(files[clip]):
            clips.setdefault(person, []).append(clip)
    found: dict[str, list[Walk]] = {}
    for person, names in clips.items():
        walks: list[Walk] = []
        for clip in evenly(names, each):
            motion = load_motion(files[clip]).motion.resample(FPS)
            motion = motion.window(0, min(motion.frames, round(LONGEST * FPS)))
            own = statistics(motion, body)
            if own is not None:
                walks.append(Walk(clip, person, motion, own))
        if len(walks) > 1:
            found[person] = walks
    return found


def methods(networks: Mapping[str, Humos]) -> dict[str, Retargeter]:
    """The scaled copy, then what every network proposes with and without details."""
    found: dict[str, Retargeter] = {_SCALED: scaled}
    for name, prior in networks.items():
        before = f"{name}: " if name else ""
        found[before + _NETWORK] = _proposing(prior)
        found[before + _CODES] = _decoding(prior)
    return found


def pair_rows(
    walks: list[Walk], to: list[Walk], made_by: Mapping[str, Retargeter], body: BodyModel
) -> list[dict[str, Any]]:
    """One row per walk of A and method: statistics of A's walk on B's body, beside both people's.

    Args:
        walks: of A.
        to: of B.
        made_by: how A's walk comes onto B's body, by name.
        body: of all.
    """
    shape = to[0].motion.shape
    rows: list[dict[str, Any]] = []
    for walk in walks:
        for name, method in made_by.items():
            made = method(body, walk.motion, shape).detach()
            rows.append(
                {
                    "clip": walk.clip,
                    "person": walk.person,
                    "body": to[0].person,
                    "method": name,
                    "made": statistics(made, body),
                    "own": dict(walk.statistics),
                    "other": mean_of(to),
                }
            )
    return rows


def pairs(people: Mapping[str, list[Walk]]) -> list[tuple[str, str]]:
    """Everybody who walks with everybody else's body."""
    return list(permutations(people, 2))


def mean_of(walks: list[Walk]) -> dict[str, float]:
    """How a person walks: the mean over walks."""
    return {key: float(np.mean([w.statistics[key] for w in walks])) for key in STATISTICS}


def spreads(people: Mapping[str, list[Walk]]) -> dict[str, float]:
    """Standard deviations of statistics within a person: the unit of distances between people."""
    return {
        key: float(
            np.sqrt(
                np.mean(
                    [np.var([w.statistics[key] for w in ws], ddof=1) for ws in people.values()]
                )
            )
        )
        for key in STATISTICS
    }


def statistics(motion: Motion, body: BodyModel) -> dict[str, float] | None:
    """Statistics of a walk; None where it has no whole stride.

    `sway` is the standard deviation of the pelvis across the line of the path, less what is slower
    than a stride; `arms` is the mean range of the angle of the arms, from shoulder to wrist,
    against the vertical in the plane that the pelvis faces.
    """
    feet = Feet.of(motion, body)
    cycles = [c for c in find_gait_cycles(feet, find_stances(feet)) if c.step_length is not None]
    if not cycles:
        return None
    leg = float(leg_length(body, motion.shape))
    return {
        "cadence": _mean(cycles, lambda c: 120 / c.seconds),
        "step": _mean(cycles, lambda c: c.step_length or 0.0) / leg,
        "speed": _mean(cycles, lambda c: c.speed) / leg,
        "sway": float(np.mean([_sway(feet, c) for c in cycles])) / leg,
        "arms": float(np.mean([_swing(motion, body, feet, c) for c in cycles])),
    }


def _mean(cycles: list[GaitCycle], value: Callable[[GaitCycle], float]) -> float:
    return float(np.mean([value(cycle) for cycle in cycles]))


def _rows(feet: Feet, cycle: GaitCycle) -> slice:
    first, last = np.searchsorted(feet.times, (cycle.strike - 1e-6, cycle.next_strike + 1e-6))
    return slice(int(first), int(last))


def _sway(feet: Feet, cycle: GaitCycle) -> float:
    """Standard deviation of the pelvis across its straight way through one stride, metres."""
    path = feet.pelvis[_rows(feet, cycle), :2]
    share = np.linspace(0, 1, len(path))[:, None]
    away = path - (path[0] + share * (path[-1] - path[0]))
    along = (path[-1] - path[0]) / max(float(np.linalg.norm(path[-1] - path[0])), 1e-9)
    return float(np.std(away @ np.array([-along[1], along[0]])))


def _swing(motion: Motion, body: BodyModel, feet: Feet, cycle: GaitCycle) -> float:
    """Range of the arms' angle in one stride, degrees, mean of both."""
    rows = _rows(feet, cycle)
    joints = body.pose(motion.detach()).joints.double().numpy()[rows]
    ranges = []
    for shoulder, wrist in _ARMS:
        arm = joints[:, wrist] - joints[:, shoulder]
        ahead = (arm[:, :2] * feet.forward[rows]).sum(-1)
        ranges.append(np.ptp(np.degrees(np.arctan2(ahead, -arm[:, 2]))))
    return float(np.mean(ranges))


def _proposing(prior: Humos) -> Retargeter:
    return lambda _, motion, shape: proposed(motion, shape, prior)


def _decoding(prior: Humos) -> Retargeter:
    def made(_: BodyModel, motion: Motion, shape: Float[Tensor, " shape"]) -> Motion:
        return codes_only(prior, motion, shape)

    return made

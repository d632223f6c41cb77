"""The cycle between those of two motion files, its feet settled: what `interpolate` does."""

import math
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from priors.anchor.frames import ANCHORS
from priors.anchor.prior import AnchorFrames
from recon.body.cycles import LONGEST, SHORTEST, Cycle
from recon.body.model import BodyModel
from recon.body.motion_files import load_motion_of
from recon.core.motion import Motion
from recon.fitting.interpolation import agreement, between, cycles_of, foot_lift, played
from recon.fitting.settling import flies, grounded
from recon.formats.results.reports import checksums, versions
from recon.jobs.fit import write_result


@dataclass(frozen=True)
class InterpolationSettings:
    """How to mix two motions."""

    at: float
    """Share of the second, 0 to 1."""
    weights: str = "open"
    """As `AnchorFrames.load` takes them."""
    body: Path | None = None
    """A SMPL-family file; None is the bundled body."""
    fps: float | None = None
    """Of the result; None is the first file's rate."""


def interpolate_files(
    a: Path, b: Path, out: Path, settings: InterpolationSettings, *, overwrite: bool = False
) -> dict[str, Any]:
    """Write the cycle between the best cycles of two motion files; returns the report.

    Best are those that look like gait and stand on the same feet: backward walking, whose hips
    swing as those of forward walking do, stands on the other foot meanwhile. The report is
    written to OUT.json too.

    Raises:
        FileNotFoundError: when a file does not exist.
        ValueError: for a share outside 0 to 1, a motion that is damaged, on another body or
            without a cycle, and for motions whose cycles never stand on the same feet.
        FileExistsError: when something is there that recon did not write, unless `overwrite`.
    """
    if not 0 <= settings.at <= 1:
        raise ValueError(f"--at lies between 0 (the first file) and 1, got {settings.at}")
    if settings.fps is not None and not (math.isfinite(settings.fps) and settings.fps > 0):
        raise ValueError(f"--fps is a positive rate, got {settings.fps}")
    body = BodyModel.load(settings.body)
    prior = AnchorFrames.load(settings.weights, body)
    motions = [load_motion_of(path, body).motion for path in (a, b)]
    candidates = [_cycles(path, motion) for path, motion in zip((a, b), motions, strict=True)]
    lifts = [_lifts(body, motion, x) for motion, x in zip(motions, candidates, strict=True)]
    agree = agreement(*lifts)
    if float(agree.max()) <= 0:
        raise ValueError(
            f"{a} and {b}: where one stands on the left foot the other stands on the right, and "
            "what lies between would stand on neither; give a longer recording of one, or a "
            "cycle that begins half a cycle later"
        )
    costs = [torch.tensor([cycle.cost for cycle in found]) for found in candidates]
    unlike = costs[0][:, None] + costs[1] - agree
    first, second = divmod(int(unlike.argmin()), unlike.shape[1])
    chosen = (candidates[0][first], candidates[1][second])
    parts = [
        prior.encode(cycle.of(motion, ANCHORS).map(lambda tensor: tensor[None]))
        for cycle, motion in zip(chosen, motions, strict=True)
    ]
    mixed = between(prior, parts[0], parts[1], settings.at)
    fps = motions[0].fps if settings.fps is None else settings.fps
    made = played(prior, mixed, fps)
    motion = grounded(made, made, flies(made, body), body).detach()
    report = {
        "feet agree": float(agree[first, second]),
        "cycles": {
            name: {"file": str(path), **asdict(cycle)}
            for name, path, cycle in zip("AB", (a, b), chosen, strict=True)
        },
        "durations": {
            "A": chosen[0].duration,
            "B": chosen[1].duration,
            "result": float(prior.anchors(mixed).duration[0]),
        },
        "settings": asdict(settings),
        "inputs": checksums((a, b)),
        "versions": versions(),
    }
    write_result(out, motion[0], body, report, overwrite=overwrite)
    return report


def _cycles(path: Path, motion: Motion) -> tuple[Cycle, ...]:
    found = cycles_of(motion)
    if len(found) == 0:
        raise ValueError(
            f"{path}: found no cycle of gait, in which both hips swing once and come back within "
            f"{SHORTEST} to {LONGEST:g} s; give a motion that walks or runs, or cut one cycle out"
        )
    return found


def _lifts(
    body: BodyModel, motion: Motion, cycles: tuple[Cycle, ...]
) -> Float[Tensor, "cycles 100"]:
    return torch.stack(
        [foot_lift(body.pose(cycle.of(motion, ANCHORS)).joints) for cycle in cycles]
    )

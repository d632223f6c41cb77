"""One person's motion as another body would do it: what `recon retarget` does to files."""

import math
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from priors.humos.prior import FPS, Humos
from recon.body.identities import doubts, height, identity, weight
from recon.body.model import BodyModel
from recon.body.motion_files import load_motion_of
from recon.body.reshape import copied
from recon.core import rotations as so3
from recon.core.motion import Motion
from recon.fitting.retargeting import OVERLAP, SHORTEST, WINDOW, retarget
from recon.formats.motions import MotionFile
from recon.formats.results.reports import checksums, versions
from recon.jobs.fit import write_result
from recon.method.windows import Windows
from recon.metrics.generation import FASTEST
from recon.physics.metrics import physics_metrics
from recon.physics.samples import NO_GROUND, PhysicsSamples, physics_samples

RATE = FPS
"""Hz, of the prior and of HUMOS's metrics."""
_LEVEL = math.cos(math.radians(1.0))
"""Cosine of the tilt up to which a ground is level."""


@dataclass(frozen=True)
class RetargetSettings:
    """How to retarget."""

    shape: str
    """The body to move, as `recon.body.identities.identity` takes it."""
    weights: str = "open"
    """As `Humos.load` takes them."""
    body: Path | None = None
    """A SMPL-family file; None is the bundled body."""
    fps: float | None = None
    """Of the result; None is the motion's rate."""
    ground: float | None = None
    """Height of the ground in the motion, metres; None is what the file says, else 0."""


def retarget_files(
    motion: Path, out: Path, settings: RetargetSettings, *, overwrite: bool = False
) -> dict[str, Any]:
    """Write a motion as the body asked for does it; returns the report, which is OUT.json too.

    The report has both bodies, warnings, by how much rotations changed, and the physics of the
    motion, of its copy on the other body, and of the result (docs/physics.md), at 20 Hz; slip is
    that of feet that are in contact in the motion. `rotation_change` is in radians, on average
    over joints and frames; `windows` begin at these seconds after the first frame.

    Raises:
        FileNotFoundError: when a file does not exist.
        ValueError: when the motion is damaged, too short or on another body, when nobody said
            where its ground is and it never comes near z = 0, and when the shape is not
            understood; nothing is written.
        FileExistsError: when OUT or OUT.json is there and recon did not write it, unless
            `overwrite`.
    """
    for name, value in (("--fps", settings.fps), ("--ground", settings.ground)):
        if value is not None and not math.isfinite(value):
            raise ValueError(f"{name} is a number, got {value}")
    if settings.fps is not None and settings.fps <= 0:
        raise ValueError(f"--fps is a positive rate, got {settings.fps}")
    body = BodyModel.load(settings.body)
    shape = identity(settings.shape, body)
    file = load_motion_of(motion, body)
    ground = ground_height(motion, file, settings.ground)
    source = raised(file.motion, -ground)
    if source.frames < max(SHORTEST * source.fps, 2):
        raise ValueError(
            f"{motion}: lasts {source.frames / source.fps:.2f} s; a motion that is retargeted "
            f"lasts {SHORTEST:g} s or longer, and has two frames or more"
        )
    told = settings.ground is not None or file.ground is not None
    before = physics_samples(source.resample(RATE), body)
    warnings = rate_warnings(motion, source, body) + ground_warnings(motion, before, told)
    warnings += [f"--shape {settings.shape}: {doubt}" for doubt in doubts(body, shape)]
    made = _retargeted(source, shape, body, settings).detach()
    result = made if settings.fps is None else made.resample(settings.fps)
    windows = Windows.cover(source.frames, round(WINDOW * source.fps), round(OVERLAP * source.fps))
    report = {
        "source": {"file": str(motion), **_measures(body, source.shape)},
        "target": {"asked": settings.shape, **_measures(body, shape)},
        "frames": result.frames,
        "fps": result.fps,
        "windows": [start / source.fps for start in windows.starts],
        "ground": ground,
        "rotation_change": float(so3.geodesic(source.rotations, made.rotations).mean()),
        "physics": {
            "source": physics_metrics(before),
            "copy": _physics(copied(source, body, shape), body, before),
            "retargeted": _physics(made, body, before),
        },
        "warnings": warnings,
        "settings": asdict(settings),
        "inputs": checksums([motion]),
        "versions": versions(),
    }
    write_result(out, raised(result, ground), body, report, ground, overwrite=overwrite)
    return report


def ground_height(path: Path, file: MotionFile, asked: float | None) -> float:
    """Height of a motion's level ground: what is asked for, else what the file says, else zero.

    Raises:
        ValueError: when the file says that it is not level.
    """
    if asked is not None or file.ground is None:
        return asked or 0.0
    normal, offset = file.ground[:3], float(file.ground[3])
    length = float(normal.norm())
    if not float(normal[2]) >= _LEVEL * length > 0:
        raise ValueError(
            f"{path}: its ground has the normal {[round(x, 3) for x in normal.tolist()]}, and is "
            "not level; expected one within 1 degree of z. Turn the motion, or give --ground"
        )
    return offset / length


def raised(motion: Motion, metres: float) -> Motion:
    """The same motion higher up."""
    up = motion.translation.new_tensor((0.0, 0.0, 1.0))
    return motion.replace(translation=motion.translation + metres * up)


def rate_warnings(path: Path, source: Motion, body: BodyModel) -> list[str]:
    """Motions that are sampled too rarely, or move as nobody does."""
    found: list[str] = []
    if source.fps < RATE:
        found.append(
            f"{path}: has {source.fps:g} frames per second, the prior {RATE:g}; what happens "
            "between frames is interpolated"
        )
    fastest = float(body.pose(source).joints.diff(dim=-3).norm(dim=-1).max()) * source.fps
    if fastest > FASTEST:
        found.append(
            f"{path}: a joint moves at {fastest:.0f} m/s; check that {source.fps:g} is its "
            "frame rate"
        )
    return found


def ground_warnings(path: Path, samples: PhysicsSamples, told: bool) -> list[str]:
    """What is wrong where a body never touches the ground z = 0.

    Raises:
        ValueError: when nobody told where the ground is.
    """
    lowest = samples.lowest
    if bool((lowest.abs() < NO_GROUND).any()):
        return []
    nearest = float(lowest[lowest.abs().argmin()])
    where = "above" if nearest > 0 else "below"
    words = (
        f"{path}: the body never comes within {100 * NO_GROUND:g} cm of the ground; its lowest "
        f"point stays {abs(nearest):.2f} m {where} it"
    )
    if told:
        return [f"{words}. The prior knows people on level ground alone"]
    raise ValueError(
        f"{words} (z = 0, as the file does not say where it is). Give the ground's height, "
        f"--ground {float(lowest.median()):.2f} where it is there, or --ground 0 to go on all "
        "the same"
    )


def _retargeted(
    motion: Motion, shape: Float[Tensor, " shape"], body: BodyModel, settings: RetargetSettings
) -> Motion:
    return retarget(motion, shape, Humos.load(settings.weights, body))


def _physics(motion: Motion, body: BodyModel, source: PhysicsSamples) -> dict[str, float | None]:
    """Metrics of a motion whose feet are in contact when those of the source are."""
    touch = source.soles_touch
    contacts = touch | torch.nn.functional.pad(touch, (0, 0, 1, 0))[:-1]
    return physics_metrics(physics_samples(motion.resample(RATE), body, contacts))


def _measures(body: BodyModel, shape: Float[Tensor, " shape"]) -> dict[str, Any]:
    return {
        "height": float(height(body, shape)),
        "weight": float(weight(body, shape)),
        "shape": [round(x, 4) for x in shape.tolist()],
    }

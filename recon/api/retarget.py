"""`recon.retarget`: transfer a motion to a body of another shape."""

import math
from collections.abc import Iterator
from typing import Any, Literal

import torch
from jaxtyping import Float
from torch import Tensor

from priors.humos.prior import FPS, Humos
from recon.api.given import (
    BodyLike,
    GivenMotion,
    MotionLike,
    ShapeLike,
    body_given,
    motion_given,
    shape_given,
    shape_name,
)
from recon.api.made import MadeMotion
from recon.api.result import motion_file_of
from recon.body.identities import body_weight, reasons_for_doubt
from recon.body.model import BodyModel
from recon.body.motion_files import with_equal_pelvis_path
from recon.core import rotations as so3
from recon.core.arrays import finite_number, positive_number
from recon.core.errors import ReconError
from recon.core.motion import Motion, MotionFile
from recon.diagnosis.findings import Finding
from recon.fitting import retargeting
from recon.fitting.retargeting import OVERLAP, SHORTEST_MOTION, WINDOW
from recon.method.windows import Windows
from recon.metrics.generation import FASTEST
from recon.physics.metrics import NO_GROUND, PhysicsSamples, physics_metrics, physics_samples

RATE = FPS
"""Hz, of the prior and of HUMOS's metrics."""
METHODS = ("physics", "network")
"""Methods of retargeting."""
_LEVEL = math.cos(math.radians(1.0))
"""Cosine of the tilt up to which a ground is level."""


def retarget(
    motion: MotionLike,
    shape: ShapeLike,
    *,
    method: Literal["physics", "network"] = "physics",
    weights: str = "open",
    body: BodyLike = None,
    fps: float | None = None,
    ground: float | None = None,
) -> MadeMotion:
    """Transfer a motion to a body of another shape.

    By `physics` the scaled copy is proposed (equal rotations, a path that grows with the legs),
    and by `network` what the HUMOS prior makes of the motion for that body; the nearest motion to
    the proposal that obeys physics is the result. It begins at the same place. Nothing is random,
    and everything is computed on the processor. docs/start/motions.md compares the two.

    A shape is coefficients (0.5,-1,2; write --shape=-1,2 where the first is negative), measures
    (height=1.80,weight=75: metres and kilograms, one or both), words (man or woman, tall or
    short, heavy or slim), words and measures (woman,height=1.65), or a motion file of somebody.
    Measures mean the shape with them that is nearest to the average, or to that of men or women.

    The report (`about`) has both bodies (`source` and `target`: height in metres, weight in
    kilograms, shape), the `method`, `rotation_change` (radians, on average over joints and
    frames), where the `windows` begin (seconds after the first frame), and the `physics` of the
    motion, of its plain copy on the other body and of the result (docs/physics.md), at 20 Hz; slip
    is that of feet that are in contact in the motion.

    Args:
        motion: a motion of one clip of a second or longer, at any rate.
        shape: the other body; in Python also a motion or result of somebody.
        method: `physics` or `network`.
        weights: of the network: `open` or a file.
        body: the motion's body; a SMPL-family file; default: the bundled body.
        fps: rate of the result, frames per second; default: the motion's.
        ground: height of the level ground in the motion, metres; default: what the motion's file
            says, else 0.

    Raises:
        ReconError: when the motion is damaged, too short or of another body, when nobody said
            where its ground is and it never comes near z = 0, or the shape is not understood.
        FileNotFoundError: when there is no such file.
    """
    if method not in METHODS:
        names = ", ".join(METHODS)
        raise ReconError(f"method: expected one of {names}, got {method!r:.60}")
    if method != "network" and weights != "open":
        raise ReconError(f"weights={weights!r:.60} needs method='network', got {method!r}")
    model = body_given(body)
    rate = None if fps is None else positive_number(fps, "fps")
    asked = None if ground is None else finite_number(ground, "ground")
    target = shape_given(shape, model)
    given = motion_given(motion, model)
    level = ground_height(given, asked)
    source = raised_motion(given.motion, -level)
    if source.frames < max(SHORTEST_MOTION * source.fps, 2):
        raise ReconError(
            f"{given.name}: expected a motion of {SHORTEST_MOTION:g} s or longer and two frames "
            f"or more, got {source.frames / source.fps:.2f} s"
        )
    told = asked is not None or given.file.ground is not None
    before = physics_samples(source.resample(RATE), model)
    warnings = (
        *_rate_warnings(given.name, source, model),
        *_ground_warnings(given.name, before, told),
        *(
            Finding("body size", f"shape {shape_name(shape)}: {doubt}")
            for doubt in reasons_for_doubt(model, target)
        ),
    )
    made = _retargeted(source, target, model, method, weights).detach()
    result = made if rate is None else made.resample(rate)
    windows = Windows.cover(source.frames, round(WINDOW * source.fps), round(OVERLAP * source.fps))
    bodies = {
        "source": _measures_of_body(model, source.shape),
        "target": _measures_of_body(model, target),
    }
    about = {
        "source": {"file": given.name, **bodies["source"]},
        "target": {"asked": shape_name(shape), **bodies["target"]},
        "method": method,
        "frames": result.frames,
        "fps": result.fps,
        "windows": [start / source.fps for start in windows.starts],
        "ground": level,
        "rotation_change": float(so3.geodesic_angle(source.rotations, made.rotations).mean()),
        "physics": {
            "source": physics_metrics(before),
            "copy": _physical_metrics(
                with_equal_pelvis_path(source, model, target), model, before
            ),
            "retargeted": _physical_metrics(made, model, before),
        },
        "warnings": [finding.message for finding in warnings],
    }
    lines = [f"{k}: {row['height']:.2f} m, {row['weight']:.1f} kg" for k, row in bodies.items()]
    tables = {
        "bodies": {
            k: {"height, m": round(row["height"], 3), "weight, kg": round(row["weight"], 1)}
            for k, row in bodies.items()
        },
        "physics at 20 Hz": {k: _metrics_to_show(row) for k, row in about["physics"].items()},
    }
    file = motion_file_of(raised_motion(result, level), model, level)
    return MadeMotion(file, model, warnings, about, tuple(lines), summary_tables=tables)


def ground_height(given: GivenMotion, stated_height: float | None) -> float:
    """Height of a motion's level ground: as the caller gave it, else from the file, else zero.

    Raises:
        ReconError: when the file says that it is not level.
    """
    file: MotionFile = given.file
    if stated_height is not None or file.ground is None:
        return stated_height or 0.0
    normal, offset = file.ground[:3], float(file.ground[3])
    length = float(normal.norm())
    if not float(normal[2]) >= _LEVEL * length > 0:
        raise ReconError(
            f"{given.name}: its ground has the normal {[round(x, 3) for x in normal.tolist()]}, "
            "so the ground is not level; expected a normal within 1 degree of z. Turn the motion, "
            "or give the height of its `ground`"
        )
    return offset / length


def raised_motion(motion: Motion, metres: float) -> Motion:
    """The motion moved upwards by `metres`."""
    up = motion.translation.new_tensor((0.0, 0.0, 1.0))
    return motion.replace(translation=motion.translation + metres * up)


def _rate_warnings(name: str, source: Motion, body: BodyModel) -> Iterator[Finding]:
    """Yield warnings if the frame rate is low or a joint moves impossibly fast."""
    if source.fps < RATE:
        yield Finding(
            "rate",
            f"{name}: has {source.fps:g} frames per second, the prior {RATE:g}; what happens "
            "between frames is interpolated",
            value=source.fps,
        )
    fastest = float(body.pose(source).joints.diff(dim=-3).norm(dim=-1).max()) * source.fps
    if fastest > FASTEST:
        yield Finding(
            "rate",
            f"{name}: a joint moves at {fastest:.0f} m/s; check that {source.fps:g} is its "
            "frame rate",
            value=fastest,
        )


def _ground_warnings(name: str, samples: PhysicsSamples, ground_given: bool) -> Iterator[Finding]:
    """Yield a warning if the body never comes near the ground z = 0.

    Raises:
        ReconError: when nobody told where the ground is.
    """
    lowest = samples.lowest
    if bool((lowest.abs() < NO_GROUND).any()):
        return
    nearest = float(lowest[lowest.abs().argmin()])
    where = "above" if nearest > 0 else "below"
    words = (
        f"{name}: the body never comes within {100 * NO_GROUND:g} cm of the ground; its lowest "
        f"point stays {abs(nearest):.2f} m {where} it"
    )
    if not ground_given:
        raise ReconError(
            f"{words} (taken as z = 0, since the motion does not state it). Give the height of "
            f"the `ground`: {float(lowest.median()):.2f} if the body stands on it, or 0 to keep z "
            "= 0"
        )
    message = f"{words}. The prior knows people on level ground alone"
    yield Finding("floor", message, value=nearest)


def _retargeted(
    motion: Motion,
    shape: Float[Tensor, " shape"],
    body: BodyModel,
    method: str,
    weights: str,
) -> Motion:
    if method == "physics":
        return retargeting.retarget_by_physics(motion, shape, body)
    return retargeting.retarget(motion, shape, Humos.load(weights, body))


def _physical_metrics(
    motion: Motion, body: BodyModel, source: PhysicsSamples
) -> dict[str, float | None]:
    """Return contact and balance metrics of a motion, with foot contacts of the source motion."""
    touch = source.soles_touch
    contacts = touch | torch.nn.functional.pad(touch, (0, 0, 1, 0))[:-1]
    return physics_metrics(physics_samples(motion.resample(RATE), body, contacts))


def _measures_of_body(body: BodyModel, shape: Float[Tensor, " shape"]) -> dict[str, Any]:
    return {
        "height": float(body.height(shape)),
        "weight": float(body_weight(body, shape)),
        "shape": [round(x, 4) for x in shape.tolist()],
    }


def _metrics_to_show(row: dict[str, float | None]) -> dict[str, float | None]:
    """Return four metrics of contact and balance in printed units: cm, m/s and percent."""
    columns = {
        "penetrate, cm": ("penetrate", 100),
        "float, cm": ("float", 100),
        "slip, m/s": ("slip_in_contact", 1),
        "stable, %": ("dynamic_stability", 100),
    }
    return {
        name: None if (value := row[key]) is None else factor * value
        for name, (key, factor) in columns.items()
    }

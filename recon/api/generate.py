"""`recon.sample` and `recon.predict`: random motions, and continuations of a motion."""

from dataclasses import replace
from typing import Any, Literal

import torch

from priors.humor import generation
from priors.humor.prior import Humor
from priors.humos.prior import Humos
from recon.api.given import (
    BodyLike,
    MotionLike,
    ShapeLike,
    body_given,
    motion_given,
    shape_given,
    shape_name,
)
from recon.api.made import MadeMotion, MotionResults
from recon.body.contacts import contact_labels, rest_heights
from recon.body.identities import reasons_for_doubt
from recon.body.model import BodyModel
from recon.core.arrays import finite_number, usable_device, usable_frame_rate
from recon.core.errors import ReconError, WeightsError
from recon.core.motion import MotionFile
from recon.diagnosis.findings import Finding
from recon.method.protocols import REFERENCE_FPS, Decoded
from recon.metrics.generation import stays_on_its_feet


def sample(
    prior: str | Humor | Humos = "humor",
    *,
    count: int = 1,
    seconds: float = 5.0,
    shape: ShapeLike | None = None,
    fps: float | None = None,
    temperature: float | None = None,
    weights: str = "open",
    body: BodyLike = None,
    seed: int = 0,
    device: Literal["cpu", "cuda"] = "cpu",
) -> MotionResults:
    """Draw random motions from a prior.

    Of HuMoR, where they begin is drawn from the mixture of first states, every step after it from
    the transition prior. Of HUMOS, the whole motion of a body of your choice is drawn at once.
    The report (`about` of every motion) says whether it stays on its feet.

    Args:
        prior: `humor`, `humos`, or one of them that is loaded.
        count: how many motions.
        seconds: from the first frame of a motion to its last.
        shape: of `humos`: the body, as `recon.retarget` takes it; default: the average body.
        fps: of `humos`: rate of the motions, frames per second; default: 30.
        temperature: of `humor`: factor on the standard deviations of the prior; higher ones make
            motions that vary more; default: 0.9.
        weights: of a prior that is given by its name: `open` or a file.
        body: a SMPL-family file; default: the bundled body.
        seed: of everything random; the same seed gives the same motions.
        device: where to compute, `cpu` or, of `humor`, `cuda`.

    Raises:
        ReconError: when the prior cannot do as asked, or a number is none that it can be.
        FileNotFoundError: when there are no such weights, or no such body.
    """
    _checked_count(count, "count")
    if prior == "humos" or isinstance(prior, Humos):
        if temperature is not None:
            raise ReconError(
                f"temperature is an option of HuMoR: leave it out with HUMOS, got {temperature}"
            )
        if device != "cpu":
            raise ReconError(f"device: HUMOS makes motions on the processor, got {device!r}")
        found = prior if isinstance(prior, Humos) else None
        return _humos_motions(found, count, seconds, shape, fps, weights, body, seed)
    if prior != "humor" and not isinstance(prior, Humor):
        raise WeightsError(
            f"prior: expected 'humor', 'humos' or a loaded Humor or Humos, got {prior!r:.60}"
        )
    if shape is not None or fps is not None:
        raise ReconError(
            "shape and fps are options of the prior humos (--prior humos): HuMoR draws the shape "
            "itself, and its motions have 30 Hz; leave them out"
        )
    frames = _frame_count(seconds)
    humor = _humor_prior(prior, weights, body, device)
    random = torch.Generator().manual_seed(seed)
    factor = _checked_temperature(temperature)
    made = generation.sample(humor, frames, count, random, temperature=factor)
    return replace(_motion_results(made, humor.body, "sample"), settings={"temperature": factor})


def predict(
    motion: MotionLike,
    prior: str | Humor = "humor",
    *,
    seconds: float = 2.0,
    samples: int = 1,
    at: float | None = None,
    temperature: float | None = None,
    weights: str = "open",
    body: BodyLike = None,
    seed: int = 0,
    device: Literal["cpu", "cuda"] = "cpu",
) -> MotionResults:
    """Continue a motion from its last frame, in one way or in several.

    Every continuation begins with the frame that it continues, at that frame's time, and has 30
    frames per second. The report (`about` of each) says whether it stays on its feet.

    Args:
        motion: a motion of one clip with two frames or more, at any rate.
        prior: `humor`, or one that is loaded.
        seconds: to come.
        samples: how many continuations.
        at: seconds after the motion's first frame from which on it is not known; default: its end.
        temperature: factor on the standard deviations of the prior; higher ones make motions that
            vary more; default: 0.9.
        weights: of a prior that is given by its name: `open` or a file.
        body: the motion's body; a SMPL-family file; default: the bundled body.
        seed: of everything random.
        device: where to compute, `cpu` or `cuda`.

    Raises:
        ReconError: when the motion is damaged, of another body or has less than two frames up to
            there, or a number is none that it can be.
        FileNotFoundError: when a file does not exist.
    """
    _checked_count(samples, "samples")
    frames, factor = _frame_count(seconds), _checked_temperature(temperature)
    if prior != "humor" and not isinstance(prior, Humor):
        raise WeightsError(f"prior: expected 'humor' or a loaded Humor, got {prior!r:.60}")
    humor = _humor_prior(prior, weights, body, device)
    given = motion_given(motion, humor.body.to(device="cpu"))
    known = given.motion
    if at is not None:
        last = round(finite_number(at, "at") * known.fps)
        if not 0 < last < known.frames:
            raise ReconError(
                f"at: expected a time after the first frame of {given.name} and not after its "
                f"last, {known.duration:.3f} s; got {at}"
            )
        known = known.window(0, last + 1)
    if known.frames < 2:
        raise ReconError(f"{given.name}: a single frame has no velocity; expected two or more")
    random = torch.Generator().manual_seed(seed)
    one = known.to(device=device)[None]
    made = generation.predict(humor, one, frames, samples, random, temperature=factor)
    return replace(
        _motion_results(made, humor.body, "prediction"),
        about={"motion": given.name, "at": at},
        settings={"temperature": factor},
    )


def _humos_motions(
    prior: Humos | None,
    count: int,
    seconds: float,
    shape: ShapeLike | None,
    fps: float | None,
    weights: str,
    body: BodyLike,
    seed: int,
) -> MotionResults:
    """Random motions of one body, drawn from the prior HUMOS."""
    _frame_count(seconds)
    rate = REFERENCE_FPS if fps is None else usable_frame_rate(fps, "fps")
    model = body_given(body) if prior is None else prior.body
    asked = "0" if shape is None else shape
    coefficients = shape_given(asked, model)
    random = torch.Generator().manual_seed(seed)
    humos = Humos.load(weights, model) if prior is None else prior
    motion = humos.sample(coefficients.expand(count, -1), seconds, random).resample(rate)
    joints = model.pose(motion).joints
    labels = contact_labels(joints, rest_heights(model, motion.shape), motion.fps)
    warnings = tuple(
        Finding("body size", f"shape {shape_name(asked)}: {doubt}")
        for doubt in reasons_for_doubt(model, coefficients)
    )
    made = Decoded(motion, contacts=labels.to(coefficients))
    return replace(
        _motion_results(made, model, "sample"), warnings=warnings, settings={"fps": rate}
    )


def _motion_results(made: Decoded, body: BodyModel, noun: str) -> MotionResults:
    """Wrap the motions that a prior generated as results with joints, contacts and ground."""
    joints = body.pose(made.motion).joints
    stays = stays_on_its_feet(joints, rest_heights(body, made.motion.shape), made.motion.fps)
    contacts, here = made.contacts, body.to(device="cpu")
    assert contacts is not None
    results = [
        MadeMotion(
            MotionFile(
                made.motion[k].to(device="cpu"),
                body=body.name,
                checksum=body.checksum,
                joints=joints[k].cpu(),
                contacts=contacts[k].cpu(),
                ground=torch.tensor([0.0, 0.0, 1.0, 0.0]),
            ),
            here,
            (),
            {"stays on its feet": bool(stay)},
            ("stays on its feet" if stay else "does not stay on its feet",),
        )
        for k, stay in enumerate(stays)
    ]
    return MotionResults(tuple(results), noun)


def _humor_prior(prior: str | Humor, weights: str, body: BodyLike, device: str) -> Humor:
    place = usable_device(device)
    humor = prior if isinstance(prior, Humor) else Humor.load(weights, body_given(body))
    return humor.to(device=place)


def _frame_count(seconds: float) -> int:
    if not finite_number(seconds, "seconds") >= 1 / REFERENCE_FPS:
        raise ReconError(f"seconds: expected a frame (1/30 s) or longer, got {seconds}")
    return round(seconds * REFERENCE_FPS) + 1


def _checked_temperature(temperature: float | None) -> float:
    if temperature is None:
        return generation.TEMPERATURE
    if not finite_number(temperature, "temperature") >= 0:
        raise ReconError(f"temperature: expected a number of 0 or more, got {temperature}")
    return temperature


def _checked_count(count: Any, name: str) -> None:
    if not hasattr(count, "__index__") or count < 1:
        raise ReconError(f"{name}: expected one motion or more, a whole number, got {count}")

"""Previews: a network's likeliest motion for one clip, which no stage of a fit has refined."""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import cast

import torch
from jaxtyping import Float
from torch import Tensor

from observations.camera_paths import triangulate, views_to_triangulate
from observations.keypoints3d import Keypoints3D
from recon.body.model import BodyModel
from recon.body.soles import ground_heights
from recon.core.errors import ReconError
from recon.core.motion import Motion
from recon.core.plugins import LOOKS, imported_object, registered_places
from recon.core.scene import Scene, UnknownGround
from recon.diagnosis.checks import guessed, residuals, size_and_soles, unseen
from recon.diagnosis.examination import Check, CheckedClip, ExaminedClip, checked
from recon.diagnosis.findings import Finding, Findings
from recon.fitting.ground import ground_by_feet, ground_by_posture
from recon.fitting.methods import FitOptions, Method
from recon.fitting.records import ClipFit
from recon.method.laplace import Deviations
from recon.method.looks import Look, ProposedMotions
from recon.method.protocols import Decoded, Estimate
from recon.method.reconstruction import Reconstruction, checked_start
from recon.method.sensor import Sensor, frame_is_level, views_of

_CHECKS: tuple[Check, ...] = (residuals, size_and_soles, unseen, guessed)
"""Checks that take no longer than a preview; none of them repairs data."""
_ROOT = 3.7
"""Radians of the root's standard deviation for a metre of the joints', on validation people."""


def preview(
    clip: CheckedClip, start: Motion | None, checks: Sequence[Check] | None
) -> ExaminedClip:
    """Return a network's likeliest motion for one clip as a fit without stages, and findings.

    Args:
        clip: whose options name the network as their method.
        start: of the caller; a preview has none.
        checks: of the preview; None are those that take no longer than it.

    Raises:
        ReconError: when an option has no effect on a preview, or the network cannot see such
            observations or returns no motions.
    """
    options = clip.options
    unheeded = {
        "prior": options.prior != FitOptions.prior, "terms": len(options.terms) > 0,
        "physics": options.physics != 0, "ground=None": not options.grounded,
        "start": start is not None,
    }  # fmt: skip
    if names := [name for name, given in unheeded.items() if given]:
        raise ReconError(
            f"method: a network that makes a preview does not use {', '.join(names)}; leave "
            "these out, or leave the method out to fit"
        )
    found, fit = _preview_fit(clip.observations, options, clip.body)
    examined = ExaminedClip.of(clip, fit)
    if found.joint_std is not None:
        std = found.joint_std[found.likeliest].double()
        spread = torch.ones_like(fit.result.motion.shape[0])
        # among people, shape coefficients have a standard deviation of 1
        shape_std = 0.0 if options.shape is not None else 1.0
        own = Deviations(std, _ROOT * std.mean(-1), shape_std * spread)
        examined = replace(examined, deviations=own)
    said = (
        "a preview: the motion that a network proposes at first sight; no data were repaired and "
        "nothing was fitted; leave the method out for the reconstruction"
    )
    warnings = (Finding("preview", said),)
    if found.doubt is not None:
        warnings = (*warnings, Finding("unfamiliar", found.doubt))
    examined = replace(examined, found=examined.found + Findings(warnings=warnings))
    return checked(examined, _CHECKS if checks is None else checks)


def loaded_look(method: Method, weights: str, body: BodyModel) -> Look:
    """Return a network that proposes motions, given as a function or by its name.

    Raises:
        FileNotFoundError: when there are no such weights.
        ReconError: when there is no such class or function.
    """
    method_or_class, known = method, registered_places(LOOKS)
    if isinstance(method, str):
        if method not in known and ":" not in method:
            names = ", ".join(known)
            raise ReconError(f"method: expected {names} or 'package.module:Class', got {method!r}")
        method_or_class = imported_object(known.get(method, method), "method")
        if isinstance(method_or_class, type):
            load = getattr(method_or_class, "load", None)
            method_or_class = method_or_class() if load is None else load(weights, body)
    if isinstance(method_or_class, type) or not callable(method_or_class):
        raise ReconError(
            "method: expected a function of observations and a body (recon.method.Look), "
            f"got {method_or_class!r:.80}"
        )
    return cast(Look, method_or_class)


def likeliest_motion(
    look: Look, observations: Sequence[Sensor], body: BodyModel
) -> tuple[Motion, ProposedMotions]:
    """The likeliest motion (1, time) that a network proposes, and all that it returned.

    Args:
        look: the network.
        observations: with a leading axis of length one, in a world whose z = 0 is the ground.
        body: whose motion it is.

    Raises:
        ReconError: when it cannot see such observations, or returns no motions of their time.
    """
    with torch.no_grad():
        found = look([one[0] for one in observations], body)
    ProposedMotions.check(found, type(look).__name__)
    motion = found.motions[found.likeliest]
    return checked_start(motion[None], observations, body), found


def _preview_fit(
    observations: Sequence[Sensor], options: FitOptions, body: BodyModel
) -> tuple[ProposedMotions, ClipFit]:
    """Return a network's proposed motions, and the likeliest as a fit without stages.

    An unknown ground is put below the feet of a first guess, then of the network's first motion.
    """
    assert options.method is not None
    look = loaded_look(options.method, options.weights, body)
    given = [options.noise_of(row) for row in range(len(observations))]
    seen = with_triangulated_views(
        one.derived(rms_std=noise) if one.named and noise else one
        for one, noise in zip(observations, given, strict=True)
    )
    ground, T = None, torch.eye(4)[None]
    if not all(one.ground_known for one in observations):
        guess = seen[0].start(body)
        below = ground_by_feet if frame_is_level(observations) else ground_by_posture
        ground = below(guess, body)
        first, _ = likeliest_motion(look, _moved_to_world(seen, ground), body)
        ground = ground.replace(lift=ground.lift - ground_heights(first, body))
        T = ground.T_world_recording
    motion, found = likeliest_motion(look, _moved_to_world(seen, ground), body)
    if (shape := options.starting_shape) is not None:
        motion = with_shape(motion, shape, body)
    scene = Scene.create(1, like=motion.translation).replace(ground=ground)
    estimate = Estimate(Decoded(motion), body.pose(motion), scene)
    noises = (one.noise(motion, body, own) for one, own in zip(observations, given, strict=True))
    return found, ClipFit(
        Reconstruction(estimate, ()), tuple(noises), ground is None, T, tuple(observations),
        ground_seen=ground is not None and any(one.ground_seen for one in observations),
    )  # fmt: skip


def _moved_to_world(seen: Sequence[Sensor], ground: UnknownGround | None) -> Sequence[Sensor]:
    if ground is None:
        return seen
    return [one.transformed(ground.T_world_recording[0].numpy()) for one in seen]


def with_triangulated_views(given: Iterable[Sensor]) -> tuple[Sensor, ...]:
    """Replace 2D keypoints of calibrated cameras by the 3D keypoints triangulated from them.

    If the views cannot be triangulated, all observations are returned unchanged.
    """
    observations = tuple(given)
    views = views_of(observations)
    if len(views) < 2 or any(one.unposed for one in views):
        return observations
    if len(views_to_triangulate(views)) < len(views):
        return observations
    first, (places, shown) = views[0], triangulate(views)
    met = Keypoints3D(
        places, shown, first.points, first.fps, first.start_time, ground_known=first.ground_known
    )
    return (*(one for one in observations if not one.view), met)


def with_shape(motion: Motion, shape: Float[Tensor, " shape"], body: BodyModel) -> Motion:
    """Give a motion another shape, shifted to keep the mean of the joints in every frame."""
    found = motion.replace(shape=shape.to(motion.shape).expand_as(motion.shape))
    away = (body.pose(motion).joints - body.pose(found).joints).mean(-2)
    return found.replace(translation=found.translation + away)

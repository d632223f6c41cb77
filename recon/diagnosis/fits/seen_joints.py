"""Which joints of which frames were seen, and which a prior inferred."""

from collections.abc import Sequence

import numpy as np
import torch
from jaxtyping import Bool, Float, Int

from observations.depth import PointCloud
from observations.keypoints2d import Keypoints2D
from observations.timing import at_observation_times
from observations.together.first_guess import Seen
from recon.body.model import BodyModel
from recon.core.motion import Motion
from recon.core.skeleton import JOINTS, PARENTS
from recon.diagnosis.findings import Finding, listed, spans, stretches
from recon.diagnosis.points.named_points import NamedPoints
from recon.method.protocols import Estimate

_NEAR = 0.2
"""Metres at rest within which a point on a neighbouring bone shows where a joint is."""
_CLOUD_NEAR = 0.15
"""Metres from a joint within which points of a cloud lie on the flesh around it."""
_CLOUD_POINTS = 3
"""Points that must lie there."""


def observed_joints(
    observations: Sequence[Seen], estimate: Estimate
) -> Bool[np.ndarray, "time 22"]:
    """For every frame of the first clip's motion, which joints some sensor saw.

    A joint is seen where a visible point lies within 20 cm of it at rest and on a bone that ends
    or begins there; or where points of a cloud lie within 15 cm of it.
    """
    motion = estimate.motion
    seen = np.zeros((motion.frames, len(JOINTS)), dtype=bool)
    for observation in observations:
        moments = _of(observation, estimate)
        number = _nearest_moments(observation, motion)
        within = (number >= 0) & (number < len(moments))
        seen[within] |= moments[number[within]]
    return seen


def unseen_findings(observed: Bool[np.ndarray, "time 22"]) -> list[Finding]:
    """Joints that were never seen, and frames in which nothing was seen, as said to the user."""
    found: list[Finding] = []
    never = tuple(
        name for name, some in zip(JOINTS, np.any(observed, axis=0), strict=True) if not some
    )
    if never:
        found.append(
            Finding(
                "unseen",
                f"{listed(never)} {'was' if len(never) == 1 else 'were'} never seen; the prior "
                "inferred them (`observed` in the motion file)",
                never,
                value=len(never) / len(JOINTS),
            )
        )
    empty = ~np.any(observed, axis=1)
    if empty.any():
        found.append(
            Finding(
                "gap",
                f"nothing was seen in {int(empty.sum())} of {len(empty)} frames "
                f"({spans(stretches(empty))}); the motion there is inferred",
                (),
                stretches(empty),
                float(empty.mean()),
            )
        )
    return found


def _of(observation: Seen, estimate: Estimate) -> Bool[np.ndarray, "moments 22"]:
    """Which joints one sensor saw, at its own moments."""
    body = estimate.body.model
    if isinstance(observation, PointCloud):
        return _near_points(observation, estimate)
    if isinstance(observation, Keypoints2D):
        visible = observation.confidence[0].cpu().numpy() > 0
        bones = observation.points.bones
        rest = observation.points.at_rest(body, body.template.new_zeros(body.shape_size))
        rest = rest.double().cpu().numpy()
    else:
        points = NamedPoints.of(observation, body)
        visible, bones, rest = points.visible, points.bones, points.rest
    return visible @ _shows(bones, rest, body)


def _shows(
    bones: Sequence[int], rest: Float[np.ndarray, "points 3"], body: BodyModel
) -> Bool[np.ndarray, "points 22"]:
    """Which joints each point tells the place of."""
    joints = body.joint_template.double().cpu().numpy()
    near = np.linalg.norm(rest[:, None] - joints[None], axis=-1) < _NEAR
    touches = np.array(
        [[b == j or PARENTS[j] == b or PARENTS[b] == j for j in range(len(JOINTS))] for b in bones]
    )
    return near & touches


def _near_points(cloud: PointCloud, estimate: Estimate) -> Bool[np.ndarray, "moments 22"]:
    """Joints with points of the cloud around them."""
    moments = cloud.points.shape[-3]
    joints, covered = at_observation_times(
        estimate.scene.to_recording(estimate.body.joints), estimate.motion,
        fps=cloud.fps, start_time=cloud.start_time, moments=moments,
    )  # fmt: skip
    seen = np.zeros((moments, len(JOINTS)), dtype=bool)
    for moment in range(covered.start, covered.stop):
        points = cloud.points[0, moment][cloud.present[0, moment]]
        away = torch.cdist(joints[0, moment - covered.start], points)
        seen[moment] = ((away < _CLOUD_NEAR).sum(-1) >= _CLOUD_POINTS).cpu().numpy()
    return seen


def _nearest_moments(observation: Seen, motion: Motion) -> Int[np.ndarray, " time"]:
    """For every frame of the motion the number of the nearest tick of the observation's clock.

    Frames before its first and after its last moment have numbers beyond its own.
    """
    times = motion.start_time + np.arange(motion.frames) / motion.fps
    return np.rint((times - observation.start_time) * observation.fps).astype(int)

"""HUMOS as a prior of fits, person by person, beside stages 1-2 and the same fit without networks.

`physics` is the fit of `HumosFit` with its networks' two terms at weight zero: poses,
smoothness, and penetration and slide in the last stage. What HUMOS has above it is what the
networks bring; what it has above stages 1-2 may be physics alone.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from benchmarks.humor import evenly
from benchmarks.scores import fit_windows
from observations.markers3d import Markers3D
from priors.humos.collocation import HumosFit
from priors.humos.prior import Humos
from priors.pose.prior import PosePrior, PoseWeights
from recon.benchmark.protocols import noisy_joints, occluded_points
from recon.benchmark.windows import TrueWindows
from recon.body.model import BodyModel
from recon.method.reconstruction import Method
from recon.metrics.evaluation import ObservedPoints, evaluate

SEED = 0
NOISY, HIDDEN = "noisy joints", "hidden points"
ERRORS: Mapping[str, str] = {NOISY: "joints_all", HIDDEN: "observed_hidden"}
"""Protocols, and the error that each is about, as `recon evaluate` calls it."""
_NOISE: Mapping[str, float] = {NOISY: 0.04, HIDDEN: 0.0}
STAGES, PHYSICS, HUMOS = "stages 1-2", "physics", "humos"


def methods(prior: Humos, noise: float) -> dict[str, Method]:
    """The three fits of observations with so much noise, metres."""
    whole = HumosFit.for_noise(prior, noise)
    return {
        STAGES: PosePrior.load(weights=PoseWeights.for_noise(noise)),
        PHYSICS: replace(whole, weights=replace(whole.weights, codes=0.0, error=0.0)),
        HUMOS: whole,
    }


def of_person(windows: TrueWindows, person: str, most: int) -> TrueWindows:
    """Windows of one person, at most so many, spread evenly."""
    own = windows.take(windows.of(person))
    return own.take(evenly(own, most))


def window_rows(
    windows: TrueWindows, protocol: str, prior: Humos, body: BodyModel
) -> list[dict[str, Any]]:
    """One row per window and method."""
    truth = windows.truth
    points = None
    if protocol == NOISY:
        observed = noisy_joints(truth, body, SEED)
    else:
        observed, points = occluded_points(truth, body)
    rows: list[dict[str, Any]] = []
    for name, method in methods(prior, _NOISE[protocol]).items():
        fitted = fit_windows(observed, method, body)
        for k, touching in enumerate(windows.contacts):
            hidden = None
            if (
                isinstance(observed, Markers3D)
                and points is not None
                and fitted.points is not None
            ):
                hidden = ObservedPoints(fitted.points[k], points[k], observed.visible[k])
            values = evaluate(
                fitted.motion[k], truth[k], body, truth_contacts=touching, observed=hidden
            )
            rows.append(
                {
                    "clip": windows.clips[k],
                    "window": windows.names[k],
                    "subject": windows.subjects[k],
                    "protocol": protocol,
                    "method": name,
                    "error": values[ERRORS[protocol]],
                    "slip": values["slip_speed"],
                    "slip_truth": values["slip_speed_truth"],
                    "seconds": fitted.seconds,
                }
            )
    return rows

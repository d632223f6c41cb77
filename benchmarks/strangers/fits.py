"""Fits a fold's windows under the pose prior and under a HuMoR that never saw its people."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from benchmarks.strangers.choice import Chosen
from benchmarks.strangers.training import FoldPriors
from observations.joints3d import Joints3D
from observations.markers3d import Markers3D
from priors.humor.collocation import Collocation
from priors.pose.prior import PosePrior, PoseWeights
from recon.benchmark.protocols import UPPER_BODY, noisy_joints, occluded_points, with_gap
from recon.benchmark.windows import FPS, TrueWindows
from recon.body.contacts import contact_labels, rest_heights
from recon.body.model import BodyModel
from recon.core.motion import Motion
from recon.core.skeleton import FEET
from recon.core.struct import concatenate
from recon.method.priors import Prior
from recon.method.reconstruction import solve
from recon.metrics.evaluation import ObservedPoints, evaluate

SEED, AT_ONCE = 0, 16
NOISE, GAP = 0.01, round(FPS)
"""Noise (m) where a gap or the legs are hidden; number of frames of the gap."""
POSE, HUMOR = "pose", "humor"
WHOLE = ("noisy joints", "hidden points", "gap")
"""Protocols for windows of `FRAMES` frames."""
RUNS = ("noisy joints", "hidden points", "hidden legs")
"""Protocols for the shorter windows of runs, which are too short for a gap of a second."""


@dataclass(frozen=True)
class Seen:
    """Observations of a protocol for some windows, and the frames in which fits are judged."""

    observed: Joints3D | Markers3D
    noise: float
    """Standard deviation (m) of a coordinate that the method is given."""
    judged: slice
    metric: str
    """Error by which the protocol is judged, as `recon evaluate` calls it."""


@dataclass(frozen=True)
class Row:
    """Errors and contacts of one window by one method."""

    window: str
    frames: int
    protocol: str
    method: str
    error: float | None
    """The error that the protocol is about, metres: of all joints, hidden points, joints within
    the gap, or hidden legs; None where nothing was hidden."""
    slip: float | None
    """Mean speed (m/s) of the fitted feet while the true ones are in contact."""
    slip_truth: float | None
    network: tuple[int, int, int, int] | None
    """Counts of contacts of feet by the network: right ones where the truth touches, frames in
    which it touches, right ones where it does not, frames in which it does not. None where the
    method predicts no contacts, or the truth is not known."""
    labels: tuple[int, int, int, int] | None
    """Counts as in `network` for contacts that are labelled by the method's motion."""


def seen(protocol: str, windows: TrueWindows, body: BodyModel) -> Seen:
    """Simulate the observations of a protocol."""
    truth, every = windows.truth, slice(0, windows.truth.frames)
    if protocol == "noisy joints":
        return Seen(noisy_joints(truth, body, SEED), 0.04, every, "joints_all")
    if protocol == "hidden points":
        return Seen(occluded_points(truth, body)[0], 0.0, every, "observed_hidden")
    if protocol == "hidden legs":
        upper = noisy_joints(truth, body, SEED, NOISE, UPPER_BODY)
        return Seen(upper, NOISE, every, "joints_legs")
    first = (truth.frames - GAP) // 2
    gap = slice(first, first + GAP)
    observed = with_gap(noisy_joints(truth, body, SEED, NOISE), gap)
    return Seen(observed, NOISE, gap, "joints_all")


def methods(priors: FoldPriors, noise: float) -> dict[str, Prior[Any]]:
    """Return the methods of fitting, with the fold's own pose density in each."""
    return {
        POSE: PosePrior(priors.density, PoseWeights.for_noise(noise)),
        HUMOR: Collocation.for_noise(priors.humor, noise, priors.density),
    }


def fits(
    chosen: Chosen, protocols: tuple[str, ...], priors: FoldPriors, body: BodyModel
) -> Iterator[Row]:
    """Fit all windows in some protocols by both methods."""
    for protocol in protocols:
        shown = seen(protocol, chosen.windows, body)
        for name, method in methods(priors, shown.noise).items():
            fitted = fit_windows(shown.observed, method, body)
            yield from _rows(chosen, protocol, name, shown, fitted, body)


@dataclass(frozen=True)
class Fitted:
    """Result of a method for a batch of windows."""

    motion: Motion
    points: Float[Tensor, "clips time points 3"]
    """Fitted places (m) of the observation's points."""
    network: Float[Tensor, "clips time 22"] | None
    """Probability of contact by the prior's network; None if it does not predict it."""

    def frames(self, part: slice) -> "Fitted":
        """Return some frames of every clip."""
        network = None if self.network is None else self.network[:, part]
        return Fitted(self.motion.window(part.start, part.stop), self.points[:, part], network)


def fit_windows(observed: Joints3D | Markers3D, method: Prior[Any], body: BodyModel) -> Fitted:
    """Fit all clips of an observation, a few at once to bound memory."""
    motions: list[Motion] = []
    network: list[Tensor] = []
    points: list[Tensor] = []
    for first in range(0, len(observed.positions), AT_ONCE):
        some = observed[first : first + AT_ONCE]
        result = solve([some], method, body)
        motions.append(result.motion.detach())
        points.append(some.predicted(result.estimate).detach())
        said = result.estimate.decoded.contacts
        if said is not None:
            network.append(said.detach())
    told = torch.cat(network) if len(network) > 0 else None
    return Fitted(concatenate(motions), torch.cat(points), told)


def _rows(
    chosen: Chosen, protocol: str, name: str, shown: Seen, fitted: Fitted, body: BodyModel
) -> Iterator[Row]:
    part = shown.judged
    windows = chosen.windows.frames(part.start, part.stop)
    own = fitted.frames(part)
    heights = rest_heights(body, own.motion.shape)
    labels = contact_labels(body.pose(own.motion).joints, heights, FPS)
    points = None
    if isinstance(shown.observed, Markers3D):
        points = occluded_points(windows.truth, body)[1]
    for k, touching in enumerate(windows.contacts):
        observed = None
        if points is not None:
            visible = shown.observed.visible[k, part]
            observed = ObservedPoints(own.points[k], points[k], visible)
        values = evaluate(
            own.motion[k], windows.truth[k], body, truth_contacts=touching, observed=observed
        )
        flat = chosen.flat[k]
        said = None if own.network is None else own.network[k] > 0.5
        yield Row(
            window=windows.names[k],
            frames=chosen.windows.truth.frames,
            protocol=protocol,
            method=name,
            error=values[shown.metric],
            slip=values["slip_speed"] if flat else None,
            slip_truth=values["slip_speed_truth"] if flat else None,
            network=feet_right(said, touching) if said is not None and flat else None,
            labels=feet_right(labels[k], touching) if flat else None,
        )


def feet_right(
    said: Bool[Tensor, "time 22"], touching: Bool[Tensor, "time 22"]
) -> tuple[int, int, int, int]:
    """Return counts as those of `Row.network` over ankles and toes."""
    said, touching = said[:, list(FEET)], touching[:, list(FEET)]
    return (
        int((said & touching).sum()),
        int(touching.sum()),
        int((~said & ~touching).sum()),
        int((~touching).sum()),
    )

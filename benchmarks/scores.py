"""What is measured of a method on the listed windows, clip by clip, and how it is shown.

Values are means over a subject's windows, then over the subjects who are not apart. Beside them,
rows hold the values of every window under `WINDOWS`, from which intervals are made.
"""

import time
from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float
from rich.table import Table
from torch import Tensor

from observations.joints3d import Joints3D
from observations.markers3d import Markers3D
from recon.benchmark.answers import (
    WINDOWS,
    Row,
    Rows,
    by_subject,
    clip_row,
    feet_balanced,
)
from recon.benchmark.answers import mean_of as mean_of
from recon.benchmark.answers import rounded as rounded
from recon.benchmark.windows import FPS
from recon.benchmark.windows import TrueWindows as Windows
from recon.body.contacts import contact_labels, rest_heights
from recon.body.model import BodyModel
from recon.core.motion import Motion
from recon.core.skeleton import LEGS
from recon.core.struct import concatenate
from recon.method.reconstruction import Method, solve
from recon.metrics import errors as metrics
from recon.metrics.evaluation import ObservedPoints, smoothness

Columns = dict[str, tuple[str, float]]
"""The heading of every metric, and what turns metres into centimetres or shares into per cent."""


def subject_mean(windows: Windows, values: Tensor) -> float:
    """Mean over each subject's windows, then over the subjects who count."""
    means = [values[windows.of(s)].mean() for s in windows.counted]
    return torch.stack(means).mean().item()


def acceleration_ratio(row: Row) -> float | None:
    """Own over true size of accelerations; None where either is not known."""
    own, true = row.get("accel"), row.get("accel_truth")
    return own / true if own is not None and true else None


@dataclass(frozen=True)
class Fitted:
    """What a method gave back for a batch of windows."""

    motion: Motion
    network: Float[Tensor, "clips time 22"] | None = None
    """Probability of contact by the prior's network; None where it says nothing of it."""
    points: Float[Tensor, "clips time points 3"] | None = None
    """Places that it gives the observation's points."""
    seconds: float | None = None
    """CPU time of one processor for one clip."""

    def frames(self, start: int, stop: int) -> "Fitted":
        """Some frames of every clip."""
        return replace(
            self,
            motion=self.motion.window(start, stop),
            network=None if self.network is None else self.network[:, start:stop],
            points=None if self.points is None else self.points[:, start:stop],
        )


def fit_windows(
    observed: Joints3D | Markers3D,
    method: Method,
    body: BodyModel,
    at_once: int = 16,
    start: Motion | None = None,
) -> Fitted:
    """Fit all clips of an observation, so many at once to bound memory; `start` as in `fit`."""
    motions: list[Motion] = []
    network: list[Tensor] = []
    points: list[Tensor] = []
    began = time.process_time()
    for first in range(0, len(observed.positions), at_once):
        rows = slice(first, first + at_once)
        some = observed[rows]
        result = solve([some], method, body, start=None if start is None else start[rows])
        motions.append(result.motion.detach())
        points.append(some.predict(result.estimate).detach())
        said = result.estimate.decoded.contacts
        if said is not None:
            network.append(said.detach())
    return Fitted(
        motion=concatenate(motions),
        network=torch.cat(network) if len(network) > 0 else None,
        points=torch.cat(points),
        seconds=(time.process_time() - began) / len(observed.positions),
    )


def score(
    windows: Windows,
    fitted: Fitted,
    body: BodyModel,
    truth: Float[Tensor, "clips time points 3"] | None = None,
    visible: Bool[Tensor, "clips time points"] | None = None,
) -> Rows:
    """Every metric of `recon evaluate`, and how feet stand.

    `sole_height` is the mean distance of a foot's lowest skin from the ground while its toe or
    ankle is in true contact, `accel_ratio` own over true acceleration, `feet_balanced` the
    balanced accuracy of the contacts of ankles and toes over all windows of a subject, labelled
    from the motion as in every result.

    Args:
        windows: the same frames as were fitted.
        fitted: what the method gave back.
        body: of both.
        truth: where the observation's points truly were; None leaves their columns out.
        visible: which of them were seen.
    """
    heights = rest_heights(body, fitted.motion.shape)
    said = contact_labels(body.pose(fitted.motion).joints, heights, FPS)
    clips: list[Row] = []
    for i, touching in enumerate(windows.contacts):
        motion, actual = fitted.motion[i], windows.truth[i]
        observed = None
        if truth is not None and visible is not None and fitted.points is not None:
            observed = ObservedPoints(fitted.points[i], truth[i], visible[i])
        row = clip_row(motion, actual, body, said[i], touching, observed)
        clips.append({**row, "seconds": fitted.seconds})
    rows = by_subject(windows, clips)
    feet = feet_balanced(windows, said)
    return {
        name: row
        if name == WINDOWS
        else {**row, "accel_ratio": acceleration_ratio(row), **feet[name]}
        for name, row in rows.items()
    }


def constant_contacts(windows: Windows) -> Rows:
    """The contacts of who says each joint's more frequent label, always."""
    common = windows.contacts.double().mean((0, 1)) > 0.5
    said = common.expand_as(windows.contacts)
    nine = [
        {"contact_accuracy": metrics.contact_accuracy(a, b)}
        for a, b in zip(said, windows.contacts, strict=True)
    ]
    feet = feet_balanced(windows, said)
    rows = by_subject(windows, nine)
    return {n: row if n == WINDOWS else {**row, **feet[n]} for n, row in rows.items()}


def score_points(
    windows: Windows,
    points: Float[Tensor, "clips time 22 3"],
    truth: Float[Tensor, "clips time 22 3"],
) -> Rows:
    """Metrics of joints without a body."""
    clips: list[Row] = []
    for own, actual in zip(points, truth, strict=True):
        errors = metrics.point_errors(own, actual)
        clips.append(
            {
                "joints_all": metrics.mean(errors),
                "joints_legs": metrics.mean(errors[:, list(LEGS)]),
                **smoothness(own, actual, FPS),
            }
        )
    rows = by_subject(windows, clips)
    return {
        name: row if name == WINDOWS else {**row, "accel_ratio": acceleration_ratio(row)}
        for name, row in rows.items()
    }


def tables(title: str, columns: Columns, rows: dict[str, Rows]) -> tuple[Table, Table]:
    """One table of means, and one of the first column by subject."""
    means = Table(title=f"{title} (mean over subjects; cm, m/s², %)", title_justify="left")
    means.add_column("method")
    for heading, _ in columns.values():
        means.add_column(heading, justify="right")
    for name, row in rows.items():
        means.add_row(name, *(cell(row["mean"].get(k), f) for k, (_, f) in columns.items()))

    first, (heading, factor) = next(iter(columns.items()))
    single = Table(title=f"{title}: {heading}, by subject", title_justify="left")
    single.add_column("method")
    subjects = [name for name in next(iter(rows.values())) if name != WINDOWS]
    for subject in subjects:
        single.add_column(subject, justify="right")
    for name, row in rows.items():
        values = [row.get(subject, {}).get(first) for subject in subjects]
        if any(value is not None for value in values):
            single.add_row(name, *(cell(value, factor) for value in values))
    return means, single


def cell(value: float | None, factor: float) -> str:
    return "–" if value is None else f"{value * factor:.2f}"

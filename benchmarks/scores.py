"""What is measured of a method on the listed windows, clip by clip, and how it is shown.

Values are means over a subject's windows, then over the subjects who are not apart. Beside them,
rows hold the values of every window under `WINDOWS`, from which intervals are made.
"""

import time
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Bool, Float
from rich.table import Table
from torch import Tensor

from benchmarks.windows import FPS, Windows
from observations.joints3d import Joints3D
from observations.markers3d import Markers3D
from recon.body.contacts import contact_labels, rest_heights
from recon.body.model import BodyModel
from recon.core.motion import Motion
from recon.core.skeleton import FEET, LEGS
from recon.core.struct import concatenate
from recon.method.reconstruction import Method, solve
from recon.metrics import errors as metrics
from recon.metrics.evaluation import ObservedPoints, evaluate, smoothness, sole_heights

Row = dict[str, float | None]
Rows = dict[str, Row]
"""Values by metric for every subject, and as "mean" over those who count. Under `WINDOWS` is a
list of the values of every window for each metric."""

WINDOWS = "windows"
KEPT = (
    "joints_all", "joints_legs", "root_joints_all", "vertices", "observed_all",
    "observed_visible", "observed_hidden", "accel", "accel_error", "penetration_freq",
    "slip_speed", "contact_accuracy", "root_visible", "root_hidden", "root_all",
)  # fmt: skip
"""Metrics whose values are kept window by window."""

Columns = dict[str, tuple[str, float]]
"""The heading of every metric, and what turns metres into centimetres or shares into per cent."""


@dataclass(frozen=True)
class Fitted:
    """What a method gave back for a batch of windows."""

    motion: Motion
    contacts: Float[Tensor, "clips time 22"] | None = None
    """Probability of contact; None where the method says nothing of it."""
    points: Float[Tensor, "clips time points 3"] | None = None
    """Places that it gives the observation's points."""
    seconds: float | None = None
    """CPU time of one processor for one clip."""

    def without_contacts(self) -> "Fitted":
        """The fit as that of a method that says nothing of contacts."""
        return replace(self, contacts=None)

    def frames(self, start: int, stop: int) -> "Fitted":
        """Some frames of every clip."""
        return replace(
            self,
            motion=self.motion.window(start, stop),
            contacts=None if self.contacts is None else self.contacts[:, start:stop],
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
    contacts: list[Tensor] = []
    points: list[Tensor] = []
    began = time.process_time()
    for first in range(0, len(observed.positions), at_once):
        rows = slice(first, first + at_once)
        some = observed[rows]
        result = solve([some], method, body, start=None if start is None else start[rows])
        motions.append(result.motion.detach())
        points.append(some.predict(result.estimate).detach())
        if result.contacts is not None:
            contacts.append(result.contacts.detach())
    return Fitted(
        motion=concatenate(motions),
        contacts=torch.cat(contacts) if len(contacts) > 0 else None,
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
    balanced accuracy of the contacts of ankles and toes over all windows of a subject. Where the
    method says nothing of contacts, they are labelled from its motion.

    Args:
        windows: the same frames as were fitted.
        fitted: what the method gave back.
        body: of both.
        truth: where the observation's points truly were; None leaves their columns out.
        visible: which of them were seen.
    """
    said = fitted.contacts
    if said is None:
        heights = rest_heights(body, fitted.motion.shape)
        said = contact_labels(body.pose(fitted.motion).joints, heights, FPS).double()
    clips: list[Row] = []
    for i, touching in enumerate(windows.contacts):
        motion, actual = fitted.motion[i], windows.truth[i]
        observed = None
        if truth is not None and visible is not None and fitted.points is not None:
            observed = ObservedPoints(fitted.points[i], truth[i], visible[i])
        row = evaluate(
            motion, actual, body, contacts=said[i], truth_contacts=touching, observed=observed
        )
        heights = {
            "sole_height": stance_height(motion, touching, body),
            "sole_height_truth": stance_height(actual, touching, body),
        }
        clips.append({**row, **heights, "seconds": fitted.seconds})
    rows = by_subject(windows, clips)
    feet = feet_balanced(windows, said > 0.5)
    return {
        name: row if name == WINDOWS else {**row, "accel_ratio": _ratio(row), **feet[name]}
        for name, row in rows.items()
    }


def stance_height(
    motion: Motion, touching: Bool[Tensor, "time 22"], body: BodyModel
) -> float | None:
    """Mean distance of the lowest skin of a foot from the ground while that foot stands."""
    stands = touching[:, list(FEET)].unflatten(-1, (2, 2)).any(-2)  # ankles or toes; left, right
    return metrics.mean(sole_heights(body.pose(motion)).abs(), stands)


def feet_balanced(windows: Windows, said: Bool[Tensor, "clips time 22"]) -> Rows:
    """Balanced accuracy of the four foot channels, over all windows of a subject together."""
    found: Rows = {}
    for subject in sorted(set(windows.subjects)):
        own = windows.of(subject)
        value = metrics.contact_balanced_accuracy(said[own], windows.contacts[own], FEET)
        found[subject] = {"feet_balanced": value}
    return {**found, "mean": mean_of([found[subject] for subject in windows.counted])}


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
        name: row if name == WINDOWS else {**row, "accel_ratio": _ratio(row)}
        for name, row in rows.items()
    }


def by_subject(windows: Windows, clips: list[Row]) -> Rows:
    subjects = sorted(set(windows.subjects))
    rows = {s: mean_of([clips[i] for i in windows.of(s)]) for s in subjects}
    rows["mean"] = mean_of([rows[s] for s in windows.counted])
    kept = {key: [rounded(row[key]) for row in clips] for key in KEPT if key in clips[0]}
    return {**rows, WINDOWS: kept}  # type: ignore[dict-item]


def rounded(value: float | None) -> float | None:
    """The value rounded to six digits, which intervals do not notice."""
    return None if value is None else float(f"{value:.6g}")


def mean_of(rows: list[Row]) -> Row:
    """Average by metric over the rows that have it."""
    found: Row = {}
    for key in rows[0]:
        values = [v for row in rows if (v := row[key]) is not None]
        found[key] = float(np.mean(values)) if values else None
    return found


def subject_mean(windows: Windows, values: Tensor) -> float:
    """Mean over each subject's windows, then over the subjects who count."""
    means = [values[windows.of(s)].mean() for s in windows.counted]
    return torch.stack(means).mean().item()


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


def _ratio(row: Row) -> float | None:
    own, true = row.get("accel"), row.get("accel_truth")
    return own / true if own is not None and true else None

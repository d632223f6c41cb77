"""What is measured of a motion that was given back, window by window, and means over subjects.

Values are means over a subject's windows, then over the subjects who are not apart. Beside them,
rows hold the values of every window under `WINDOWS`, from which intervals are made.
"""

import numpy as np
from jaxtyping import Bool
from torch import Tensor

from recon.api.bench.windows import TrueWindows
from recon.body.model import BodyModel
from recon.core.motion import Motion
from recon.core.skeleton import FEET
from recon.metrics import errors as metrics
from recon.metrics.evaluation import ObservedPoints, evaluate, sole_heights

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


def clip_row(
    motion: Motion,
    truth: Motion,
    body: BodyModel,
    contacts: Tensor | None,
    touching: Bool[Tensor, "time 22"],
    observed: ObservedPoints | None = None,
) -> Row:
    """Every metric of `recon evaluate` of one window, and how its feet stand.

    `sole_height` is the mean distance of a foot's lowest skin from the ground while its toe or
    ankle is in true contact.

    Args:
        motion: what a method gave back.
        truth: the true motion, the same frames.
        body: of both.
        contacts: what the method says of them, labels or probabilities; None where nothing.
        touching: the true contacts.
        observed: the observation's points, where they are and where the method has them.
    """
    row = evaluate(
        motion, truth, body, contacts=contacts, truth_contacts=touching, observed=observed
    )
    heights = {
        "sole_height": stance_height(motion, touching, body),
        "sole_height_truth": stance_height(truth, touching, body),
    }
    return {**row, **heights}


def stance_height(
    motion: Motion, touching: Bool[Tensor, "time 22"], body: BodyModel
) -> float | None:
    """Mean distance of the lowest skin of a foot from the ground while that foot stands."""
    stands = touching[:, list(FEET)].unflatten(-1, (2, 2)).any(-2)  # ankles or toes; left, right
    return metrics.mean(sole_heights(body.pose(motion)).abs(), stands)


def feet_balanced(windows: TrueWindows, said: Bool[Tensor, "clips time 22"]) -> Rows:
    """Balanced accuracy of the four foot channels, over all windows of a subject together."""
    found: Rows = {}
    for subject in sorted(set(windows.subjects)):
        own = windows.of(subject)
        value = metrics.contact_balanced_accuracy(said[own], windows.contacts[own], FEET)
        found[subject] = {"feet_balanced": value}
    return {**found, "mean": mean_of([found[subject] for subject in windows.counted])}


def by_subject(windows: TrueWindows, clips: list[Row]) -> Rows:
    """Means of rows by subject and over the subjects who count, and values by window."""
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

"""HuMoR on the listed windows, beside what it must beat: the paper's Table 2, and two recipes.

    python -m benchmarks.humor CORPUS --json humor.json
    python -m benchmarks.humor CORPUS --part validation --only 6 --shooting 3
    python -m benchmarks.humor CORPUS --nc WEIGHTS --json humor.json

Windows of 60 and of 90 frames. Noisy joints: 22 with 4 cm of noise per coordinate. Occluded
points: 43 of the skin, those below 0.9 m hidden. In-betweening: 22 joints with 1 cm of noise,
nothing seen for one second in the middle; errors are those inside the gap. Upper body: the joints
from the pelvis up with 1 cm of noise, no legs. Smoothers, and all weights but published ones, were
chosen on the validation windows. `CPU s` is the time of one processor for one clip, sixteen clips
at once.
"""

import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float
from rich.console import Console
from torch import Tensor

from benchmarks.arguments import over_windows
from benchmarks.humor_recipes import (
    GAP_COLUMNS,
    UPPER_COLUMNS,
    in_between_rows,
    upper_body_rows,
)
from benchmarks.results import corpus_source, write
from benchmarks.scores import (
    WINDOWS,
    Columns,
    Fitted,
    Rows,
    constant_contacts,
    fit_windows,
    score,
    score_points,
    tables,
)
from benchmarks.stage12 import SEED, tune_smoothers
from observations.joints3d import Joints3D
from observations.markers3d import Markers3D
from priors.humor.collocation import Collocation
from priors.humor.prior import Humor
from priors.humor.shooting import Shooting
from priors.pose.prior import PosePrior, PoseWeights
from recon.benchmark.dataset import Splits
from recon.benchmark.protocols import noisy_joints, occluded_points
from recon.benchmark.windows import FRAMES, TrueWindows, load_windows
from recon.body.model import BodyModel
from recon.method.reconstruction import Method

_FEET_COLUMNS: Columns = {
    "joints_legs": ("legs", 100), "vertices": ("vertices", 100),
    "accel_ratio": ("accel / true", 1), "accel_error": ("accel error", 1),
    "penetration_freq": ("pen. %", 100), "penetration_freq_truth": ("true pen.", 100),
    "sole_height": ("soles cm", 100), "slip_speed": ("slip cm/s", 100),
    "contact_accuracy": ("contacts %", 100), "feet_balanced": ("feet, bal. %", 100),
    "seconds": ("CPU s", 1),
}  # fmt: skip
COLUMNS: dict[str, Columns] = {
    "noisy joints": {"joints_all": ("all", 100), **_FEET_COLUMNS},
    "occluded points": {
        "observed_all": ("all", 100), "observed_visible": ("visible", 100),
        "observed_hidden": ("hidden", 100), **_FEET_COLUMNS,
    },
    "in-betweening": GAP_COLUMNS,
    "upper body": UPPER_COLUMNS,
}  # fmt: skip
"""`soles`: mean distance of the soles from the ground while they truly stand on it."""

Observed = Joints3D | Markers3D


def main() -> None:
    parser = over_windows(__doc__)
    parser.add_argument("--frames", type=int, nargs="+", default=[FRAMES, 90])
    parser.add_argument("--weights", type=Path, default=None, help="HuMoR's; default: bundled")
    parser.add_argument("--nc", type=Path, default=None, help="weights of more data, a row more")
    parser.add_argument(
        "--shooting", type=int, default=None, help="fit so many windows by it; 0: none"
    )
    parser.add_argument("--protocols", nargs="+", choices=COLUMNS, default=list(COLUMNS))
    parser.add_argument("--only", type=int, default=None, help="use so many windows in all")
    arguments = parser.parse_args()

    body, splits = BodyModel.load(), Splits.load(arguments.splits)
    networks = Networks.load(arguments.weights, arguments.nc)
    console = Console(width=None if sys.stdout.isatty() else 180)
    about: dict[str, dict[str, object]] = {}
    found: dict[str, dict[str, dict[str, Rows]]] = {}
    for frames in arguments.frames:
        windows, tuning = (
            load_windows(arguments.corpus, splits, part, body, SEED, frames)
            for part in (arguments.part, "validation")
        )
        if arguments.only is not None:
            windows = windows.take(evenly(windows, arguments.only))
        key = f"{frames} frames"
        console.print(f"{key}: {len(windows.names)} of {windows.listed} listed windows")
        about[key] = windows.about
        found[key] = {}
        rows_of = protocols(windows, tuning, body, networks, arguments.shooting)
        for name in arguments.protocols:
            rows = found[key][name] = rows_of[name]()
            for shown in tables(f"{name}, {key}, {arguments.part}", COLUMNS[name], rows):
                console.print(shown)
            if arguments.json is not None:
                source = corpus_source(arguments.corpus, (*windows.files, *tuning.files))
                write(arguments.json, SEED, source, part=arguments.part, windows=about,
                      tables=found)  # fmt: skip


@dataclass(frozen=True)
class Networks:
    """What is compared."""

    default: Humor
    nc: Humor | None

    @classmethod
    def load(cls, default: Path | None, nc: Path | None) -> "Networks":
        """Networks of files; without `default` the bundled ones, without the others none."""
        return cls(
            default=Humor.load(default),
            nc=None if nc is None else Humor.load(nc),
        )

    @property
    def trained(self) -> dict[str, Humor]:
        """Weights of the package, and those of more data where they are given."""
        return {"HuMoR": self.default} | ({} if self.nc is None else {"HuMoR, nc": self.nc})


@dataclass(frozen=True)
class Entry:
    """A row to be."""

    name: str
    method: Method
    most: int | None = None
    """Windows; None is all."""


def entries(
    networks: Networks,
    noise: float,
    published: PoseWeights,
    most: int | None,
) -> list[Entry]:
    """All that is fitted to points with so much noise.

    Args:
        networks: what is compared.
        noise: metres.
        published: weights of stages 1 and 2.
        most: windows that are fitted through the roll-out.
    """
    tuned = PoseWeights.for_noise(noise)
    few = "" if most is None else f", {most} windows"
    rolled = Shooting.for_noise(networks.default, noise)
    found = [
        Entry("stages 1-2, published", PosePrior.load(weights=published)),
        Entry("stages 1-2, tuned", PosePrior.load(weights=tuned)),
    ]
    if most != 0:
        found.append(Entry(f"HuMoR by shooting{few}", rolled, most))
    found += [
        Entry(name, Collocation.for_noise(humor, noise))
        for name, humor in networks.trained.items()
    ]
    return found


def protocols(
    windows: TrueWindows,
    tuning: TrueWindows,
    body: BodyModel,
    networks: Networks,
    most: int | None,
) -> dict[str, Callable[[], dict[str, Rows]]]:
    """What measures the rows of each table."""
    joints = body.pose(windows.truth).joints

    def noisy() -> dict[str, Rows]:
        seen = noisy_joints(windows.truth, body, SEED)
        rows = {"observed": score_points(windows, seen.positions, joints)}
        for name, (smooth, _) in tune_smoothers(tuning, body).items():
            if "tuned" in name:
                rows[name] = score_points(windows, smooth(seen.positions), joints)
        published = PoseWeights.published_joints()
        rows |= fitted_rows(windows, seen, joints, entries(networks, 0.04, published, most), body)
        return {**rows, "each joint's more frequent contact": constant_contacts(windows)}

    def hidden() -> dict[str, Rows]:
        occluded, points = occluded_points(windows.truth, body)
        fits = entries(networks, 0.0, PoseWeights.published_points(), most)
        return fitted_rows(windows, occluded, points, fits, body)

    return {
        "noisy joints": noisy,
        "occluded points": hidden,
        "in-betweening": lambda: in_between_rows(windows, body, networks.trained, SEED),
        "upper body": lambda: upper_body_rows(windows, body, networks.trained, SEED),
    }


def fitted_rows(
    windows: TrueWindows,
    observed: Observed,
    truth: Float[Tensor, "clips time points 3"],
    fits: list[Entry],
    body: BodyModel,
) -> dict[str, Rows]:
    """A row for every method, and the truth's own."""
    rows: dict[str, Rows] = {}
    for entry in fits:
        chosen = evenly(windows, entry.most)
        fitted = fit_windows(observed[chosen], entry.method, body)
        print(f"{entry.name}: {fitted.seconds:.1f} CPU s per clip", flush=True)
        some = windows.take(chosen)
        row = score(some, fitted, body, truth[chosen], observed.visible[chosen])
        if len(chosen) < len(windows.names):
            row[WINDOWS]["names"] = some.names  # type: ignore[assignment]
        rows[entry.name] = row
    itself = Fitted(windows.truth, points=truth)
    return {**rows, "truth": score(windows, itself, body, truth, observed.visible)}


def evenly(windows: TrueWindows, most: int | None) -> list[int]:
    """Numbers of so many windows, evenly from the list; all when there are no more."""
    count = len(windows.names)
    if most is None or most >= count:
        return list(range(count))
    return np.linspace(0, count - 1, most).round().astype(int).tolist()


if __name__ == "__main__":
    main()

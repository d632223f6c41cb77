"""Physics in fitting: HuMoR's fit with energies of a body on the ground, and without.

    python -m benchmarks.physics_fit CORPUS --only 24 --json physics_fit.json
    python -m benchmarks.physics_fit CORPUS --part validation --only 10

Windows of 60 frames, two protocols of `benchmarks.humor`: noisy joints (4 cm per coordinate) and
occluded points (43 of the skin, those below 0.9 m hidden). `as many steps` has one more stage as
physics has, but without its energies. `pen.` is how often toes penetrate the ground and `soles`
how often the skin of the feet does, averaged over 0 to 15 cm of depth (HuMoR); `slip` is the speed
of foot joints while the truth is in contact. The second table is `recon.physics.metrics` of all
windows together, at 20 Hz. Weights were chosen on ten validation windows.
"""

import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from jaxtyping import Float
from rich.console import Console
from rich.table import Table
from torch import Tensor

from benchmarks.arguments import over_windows
from benchmarks.humor import Observed, evenly
from benchmarks.results import corpus_source, write
from benchmarks.scores import Columns, Fitted, Row, Rows, cell, fit_windows, score, tables
from benchmarks.stage12 import SEED
from priors.humor.collocation import Collocation
from priors.humor.prior import Humor
from recon.benchmark.dataset import Splits
from recon.benchmark.protocols import noisy_joints, occluded_points
from recon.benchmark.windows import TrueWindows, load_windows
from recon.body.model import BodyModel
from recon.core.motion import Motion
from recon.core.struct import concatenate
from recon.fitting.methods import WithPhysics
from recon.method.reconstruction import Method
from recon.method.stages import Stage
from recon.method.terms import Term
from recon.physics.energies import physics_terms
from recon.physics.metrics import physics_metrics, physics_samples

PHYSICS_FPS = 20.0
"""Rate of HUMOS's metrics, Hz."""

COLUMNS: Columns = {
    "joints_all": ("joints", 100), "observed_all": ("points", 100),
    "penetration_freq": ("pen. %", 100), "penetration_freq_truth": ("true", 100),
    "penetration_dist": ("depth mm", 1000),
    "sole_penetration_freq": ("soles %", 100), "sole_penetration_freq_truth": ("true", 100),
    "sole_penetration_dist": ("depth mm", 1000),
    "slip_speed": ("slip cm/s", 100), "slip_speed_truth": ("true", 100),
    "accel_error": ("accel error", 1), "seconds": ("CPU s", 1),
}  # fmt: skip
PHYSICS_COLUMNS: Columns = {
    "penetrate": ("penetrate", 100), "float": ("float", 100),
    "physdiff_penetrate": ("all frames: pen.", 100), "physdiff_float": ("float", 100),
    "slip_in_contact": ("slip in contact", 100), "slipping": ("slipping %", 100),
    "stability_supported": ("stability %", 100),
    "bos_distance_supported": ("BoS dist", 100),
}  # fmt: skip


def main() -> None:
    parser = over_windows(__doc__)
    parser.add_argument("--weights", default="open", help="HuMoR's: open, nc or a file")
    parser.add_argument("--only", type=int, default=None, help="use so many windows in all")
    arguments = parser.parse_args()

    body, humor = BodyModel.load(), Humor.load(arguments.weights)
    splits = Splits.load(arguments.splits)
    windows = load_windows(arguments.corpus, splits, arguments.part, body, SEED)
    windows = windows.take(evenly(windows, arguments.only))
    console = Console(width=None if sys.stdout.isatty() else 180)
    console.print(f"{len(windows.names)} of {windows.listed} listed windows")
    about = {"names": windows.names, "listed": windows.listed}
    occluded, points = occluded_points(windows.truth, body)
    joints = body.pose(windows.truth).joints
    protocols: dict[str, tuple[Observed, Tensor, float]] = {
        "noisy joints": (noisy_joints(windows.truth, body, SEED), joints, 0.04),
        "occluded points": (occluded, points, 0.0),
    }
    found: dict[str, Any] = {}
    for name, (observed, truth, noise) in protocols.items():
        plain = Collocation.for_noise(humor, noise)
        rows, physical = compared(windows, observed, truth, plain, noise, body)
        found[name] = {"errors": rows, "physics": physical}
        title = f"{name}, {arguments.part}"
        console.print(tables(title, COLUMNS, rows)[0])
        console.print(table(f"{title} (all windows together; cm, cm/s, %)", physical))
        if arguments.json is not None:
            source = corpus_source(arguments.corpus, windows.files)
            write(arguments.json, SEED, source, part=arguments.part,
                  weights=str(arguments.weights), windows=about, tables=found)  # fmt: skip


@dataclass(frozen=True)
class LastStage:
    """A method's last stage alone."""

    method: Method

    def stages(self, data: tuple[Term, ...]) -> tuple[Stage[Any], ...]:
        """One stage."""
        return self.method.stages(data)[-1:]


def compared(
    windows: TrueWindows,
    observed: Observed,
    truth: Float[Tensor, "clips time points 3"],
    plain: Method,
    noise: float,
    body: BodyModel,
) -> tuple[dict[str, Rows], dict[str, Row]]:
    """Errors by subject, and physics of all windows, for every method and for the truth.

    Methods differ in their last stage, so what comes before is fitted once; seconds are of all.
    """
    first = fit_windows(observed, plain, body)
    results = {"HuMoR": first}
    for name, terms in (("as many steps", ()), ("physics", physics_terms(noise))):
        last = LastStage(WithPhysics(plain, terms))
        fitted = fit_windows(observed, last, body, start=first.motion)
        results[f"HuMoR, {name}"] = replace(
            fitted, seconds=(first.seconds or 0.0) + (fitted.seconds or 0.0)
        )
    results["truth"] = Fitted(windows.truth, points=truth)
    errors = {
        name: score(windows, fitted, body, truth, observed.visible)
        for name, fitted in results.items()
    }
    every = range(len(windows.names))
    physical = {
        name: pooled([fitted.motion[i] for i in every], body) for name, fitted in results.items()
    }
    return errors, physical


def pooled(motions: Sequence[Motion], body: BodyModel) -> Row:
    """`physics_metrics` of all frames of some clips."""
    samples = [physics_samples(motion.resample(PHYSICS_FPS), body) for motion in motions]
    return physics_metrics(concatenate(samples))


def table(title: str, rows: dict[str, Row]) -> Table:
    """One line a method."""
    shown = Table("method", title=title, title_justify="left")
    for heading, _ in PHYSICS_COLUMNS.values():
        shown.add_column(heading, justify="right")
    for name, row in rows.items():
        shown.add_row(name, *(cell(row[k], f) for k, (_, f) in PHYSICS_COLUMNS.items()))
    return shown


if __name__ == "__main__":
    main()

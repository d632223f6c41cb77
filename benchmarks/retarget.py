"""Retargeting to other bodies: physics of the result, for the network and for baselines.

    python -m benchmarks.retarget CORPUS --licence nc --weights nc
        --json benchmarks/results/retarget.json --picture retarget.png

Clips, windows and target bodies are those of `benchmarks/identities.toml`. The five numbers of
HUMOS are as released, the others as in docs/physics.md. Slip is measured while the source's
soles are within 1.5 cm of the ground, for all methods. `turned` is the mean angle of the 22 local
rotations from the source's.

Two sums of errors, each divided by that of the copy; less is better. `sum` (copy: 5): penetrate,
float, 100 % minus dynamic stability, BoS distance, slip. `sum*` (copy: 4): distance from the
ground (PhysDiff penetration and float), 100 % minus supported stability, supported BoS distance,
slip. The first has float and BoS distance of flight in it, where they mean nothing: read it over
the clips `without flight`.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from time import process_time

import numpy as np
import torch
from jaxtyping import Float
from rich.console import Console
from rich.table import Table
from torch import Tensor

from benchmarks.arguments import over_windows
from benchmarks.results import corpus_source, write
from benchmarks.retarget_baselines import (
    copied,
    copied_to_ground,
    foot_ik,
    physics_only,
    scaled,
    soles_down,
)
from benchmarks.retarget_clips import SEED, Job, load_jobs
from priors.humos.prior import Humos
from recon.benchmark.dataset import Splits
from recon.body.model import BodyModel
from recon.core import rotations as so3
from recon.core.motion import Motion
from recon.core.struct import concatenate
from recon.fitting.retargeting import proposed, retarget
from recon.physics.metrics import PhysicsSamples, physics_metrics, physics_samples
from recon.view.frames import write_png
from recon.view.scene import CORAL, Figure, Show

Retargeter = Callable[[BodyModel, Motion, Float[Tensor, " shape"]], Motion]
Row = dict[str, float | None]

BASELINES: dict[str, Retargeter] = {
    "copy": copied,
    "copy-G": copied_to_ground,
    "scaled": scaled,
    "foot IK": foot_ik,
    "physics only": physics_only,
}
TRUTH = "truth"
COLUMNS: dict[str, tuple[str, float]] = {
    "penetrate": ("penetr. cm", 100),
    "float": ("float cm", 100),
    "skate": ("skate %", 100),
    "dynamic_stability": ("dyn.st. %", 100),
    "bos_distance": ("BoS cm", 100),
    "physdiff_penetrate": ("PD pen mm", 1000),
    "physdiff_float": ("PD float mm", 1000),
    "physdiff_skate": ("PD skate mm", 1000),
    "physdiff_error": ("PD error mm", 1000),
    "stability_supported": ("supp. %", 100),
    "bos_distance_supported": ("s. BoS cm", 100),
    "stability_flight": ("in flight %", 100),
    "slip_in_contact": ("slip m/s", 1),
    "slipping": ("slipping %", 100),
    "turned": ("turned deg", 1),
    "sum": ("sum", 1),
    "sum_supported": ("sum*", 1),
    "seconds": ("CPU s/clip", 1),
}
"""Shown name and factor to the shown unit; files hold SI units and shares."""
PICTURED = ("copy", "scaled", "physics only")


def itself(_body: BodyModel, motion: Motion, _shape: Float[Tensor, " shape"]) -> Motion:
    """The source on its own body: what real people do under these metrics."""
    return motion


def networks(name: str, weights: str, body: BodyModel) -> dict[str, Retargeter]:
    """The shape-conditioned prior: what it proposes, and what becomes of that."""
    prior = Humos.load(weights, body)
    return {
        f"{name}, proposed": lambda _, motion, shape: proposed(motion, shape, prior),
        name: lambda _, motion, shape: retarget(motion, shape, prior),
    }


def measured(
    method: Retargeter, jobs: Sequence[Job], body: BodyModel
) -> tuple[list[PhysicsSamples], Row]:
    """Samples of every clip, and what is no physics: mean turn from the source, CPU seconds."""
    samples: list[PhysicsSamples] = []
    turns: list[Tensor] = []
    seconds = 0.0
    for job in jobs:
        began = process_time()
        made = method(body, job.motion, job.target).detach()
        seconds += process_time() - began
        if made.frames != job.motion.frames or made.fps != job.motion.fps:
            raise ValueError(
                f"{job.name}: {job.motion.frames} frames at {job.motion.fps:g} Hz became "
                f"{made.frames} at {made.fps:g} Hz; a retargeted clip keeps its times"
            )
        samples.append(physics_samples(made, body, soles_down(job.motion, body)))
        turns.append(so3.geodesic(made.rotations, job.motion.rotations).flatten())
    turned = float(torch.cat(turns).mean().rad2deg())
    return samples, {"turned": turned, "seconds": seconds / len(jobs)}


def summary(
    samples: Sequence[PhysicsSamples], jobs: Sequence[Job], apart: Collection[str] = ()
) -> dict[str, Row]:
    """Pooled frames: of all clips, of those without flight, of every subject; means over these.

    Subjects `apart` have a row of their own and count in no other.
    """

    def over(wanted: Callable[[Job], bool]) -> Row:
        rows = [s for s, job in zip(samples, jobs, strict=True) if wanted(job)]
        return physics_metrics(concatenate(rows)) if rows else {}

    def counted(job: Job) -> bool:
        return job.subject not in apart

    subjects = dict.fromkeys(job.subject for job in jobs)
    own = {name: over(lambda job, name=name: job.subject == name) for name in subjects}
    pooled = over(counted)
    mean = {
        key: _mean({n: row for n, row in own.items() if n not in apart}, key) for key in pooled
    }
    groups = {
        "pooled": pooled,
        "without flight": over(lambda job: counted(job) and not job.flies),
        "bodies of people": over(lambda job: counted(job) and job.real and not job.flies),
        "bodies drawn": over(lambda job: counted(job) and not (job.real or job.flies)),
        "mean": mean,
        **own,
    }
    return {name: row for name, row in groups.items() if row}


def normalised(errors: Sequence[float | None], copy: Sequence[float | None]) -> float | None:
    """The sum of errors, each divided by that of the copy; None where a part is unknown."""
    pairs = list(zip(errors, copy, strict=True))
    if any(a is None or not b for a, b in pairs):
        return None
    return sum(a / b for a, b in pairs if a is not None and b)


def with_sums(table: Mapping[str, dict[str, Row]]) -> None:
    """Add the sums of normalised metrics to every row of every method."""
    for groups in table.values():
        for name, row in groups.items():
            copy = table["copy"][name]
            row["sum"] = normalised(_released(row), _released(copy))
            row["sum_supported"] = normalised(_supported(row), _supported(copy))


def show(title: str, table: Mapping[str, dict[str, Row]], group: str) -> None:
    """Print one line a method."""
    shown = Table("method", *(name for name, _ in COLUMNS.values()), title=f"{title}, {group}")
    for method, groups in table.items():
        shown.add_row(method, *(_cell(groups[group].get(k), f) for k, (_, f) in COLUMNS.items()))
    Console(width=220).print(shown)


def draw(path: Path, job: Job, methods: Mapping[str, Retargeter], body: BodyModel) -> None:
    """A row of pictures for the source and for each method."""
    source = Figure(body, job.motion, "source")
    shows = [Show(f"source, {job.name}", (source,))]
    for name, method in methods.items():
        made = method(body, job.motion, job.target).detach()
        shows.append(Show(name, (Figure(body, made, "target body", CORAL),)))
    write_png(path, shows, size=(260, 320))


def _released(row: Row) -> list[float | None]:
    names = ("penetrate", "float", "bos_distance", "slip_in_contact")
    return [*(row.get(name) for name in names), _lack(row.get("dynamic_stability"))]


def _supported(row: Row) -> list[float | None]:
    sunk, afloat = row.get("physdiff_penetrate"), row.get("physdiff_float")
    off = None if sunk is None or afloat is None else sunk + afloat
    lack = _lack(row.get("stability_supported"))
    return [off, lack, row.get("bos_distance_supported"), row.get("slip_in_contact")]


def _lack(share: float | None) -> float | None:
    return None if share is None else 1 - share


def _mean(rows: Mapping[str, Row], key: str) -> float | None:
    known = [value for row in rows.values() if (value := row[key]) is not None]
    return float(np.mean(known)) if known else None


def _named(weights: str) -> tuple[str, str]:
    name, _, which = weights.rpartition("=")
    return name or Path(which).stem, which


def _cell(value: float | None, factor: float) -> str:
    return "-" if value is None else f"{factor * value:.3g}"


def _main() -> None:
    parser = over_windows(__doc__)
    parser.add_argument("--licence", choices=("open", "nc"), default="open",
                        help="of the source clips")  # fmt: skip
    parser.add_argument("--weights", nargs="*", default=[],
                        help="open, nc, FILE or NAME=FILE; a row each")  # fmt: skip
    parser.add_argument("--methods", nargs="*", choices=BASELINES, default=list(BASELINES))
    parser.add_argument("--clips", nargs="*", default=None, help="only these, to look closer")
    parser.add_argument("--picture", type=Path, default=None, help=".png to draw")
    given = parser.parse_args()
    torch.set_num_threads(1)
    body = BodyModel.load()
    splits = Splits.load(given.splits)
    jobs = load_jobs(given.corpus, splits, given.part, given.licence, body)
    if given.clips is not None:
        jobs = [job for job in jobs if job.name in given.clips]
        if len(jobs) < len(given.clips):
            parser.error(f"not all listed among the {given.licence} {given.part} clips")
    methods = {name: BASELINES[name] for name in ("copy", *given.methods)}
    trained: dict[str, Retargeter] = {}
    for name, weights in map(_named, given.weights):
        if name in {*trained, TRUTH, *BASELINES}:
            parser.error("rows need different names: give NAME=FILE")
        trained |= networks(name, weights, body)
    table: dict[str, dict[str, Row]] = {}
    for name, method in ({TRUTH: itself} | methods | trained).items():
        samples, more = measured(method, jobs, body)
        table[name] = summary(samples, jobs, splits.apart)
        table[name]["pooled"] |= more
    with_sums(table)
    standing = sum(not job.flies for job in jobs)
    for group in ("pooled", "without flight", "mean"):
        show(f"{given.part}, {len(jobs)} clips, {standing} without flight", table, group)
    if given.json is not None:
        about = {"clips": len(jobs), "without_flight": standing, "licence": given.licence}
        source = corpus_source(given.corpus)
        write(given.json, SEED, source, part=given.part, **about, methods=table)
    if given.picture is not None:
        pictured = {name: methods[name] for name in PICTURED if name in methods} | trained
        job = max(jobs, key=lambda job: float((job.target - job.motion.shape).norm()))
        draw(given.picture, job, pictured, body)


if __name__ == "__main__":
    _main()

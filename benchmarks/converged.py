"""Fits of today beside those of version 0.1.0: how far both descend, how long it takes them.

    python -m benchmarks.converged CORPUS --baseline VERSION_0.1.0 --json converged.json
    python -m benchmarks.converged CORPUS --baseline VERSION_0.1.0 --part validation --only 4

VERSION_0.1.0 is a source checkout of that version (commit 0ce0517). Windows of 60 frames, one clip
at a time, one thread; both versions fit a window right after each other, so that what else the
machine does hits both alike. `objective` is that of 0.1.0's last stage, evaluated by 0.1.0 at
both results. `by tolerance` is the share of windows that end by a tolerance, in the stage with
the fewest. `moved` is how far joints go when all tolerances are ten times tighter. One evaluation
of the last stage is timed beside its matrix products alone.
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from benchmarks.arguments import over_windows
from benchmarks.humor import evenly
from benchmarks.humor_recipes import GAP, NOISE, UPPER_BODY
from benchmarks.results import corpus_source, show, write
from observations.joints3d import Joints3D
from observations.markers3d import Markers3D
from priors.humor.collocation import Collocation
from priors.humor.prior import Humor
from recon.benchmark.dataset import Splits
from recon.benchmark.protocols import noisy_joints, occluded_points, with_gap
from recon.benchmark.windows import TrueWindows, load_windows
from recon.body.model import BodyModel
from recon.core.scene import Scene
from recon.core.struct import concatenate
from recon.method.reconstruction import Method, Reconstruction, solve
from recon.method.stages import Stage
from recon.method.terms import Term
from recon.method.unknowns import Layout, Unknowns
from recon.solver.solution import Termination

SEED = 0
BY_TOLERANCE = (Termination.CONVERGED.name, Termination.GRADIENT.name)
Observed = Joints3D | Markers3D


@dataclass(frozen=True)
class Protocol:
    """Observations of the windows."""

    observed: Observed
    noise: float
    points: Float[Tensor, "clips time points 3"]
    """True places of its points."""


@dataclass(frozen=True)
class Row:
    """One window, fitted by both."""

    protocol: str
    window: str
    subject: str
    joints: tuple[float, float]
    """Mean error of 0.1.0 and of today, metres; likewise below."""
    vertices: tuple[float, float]
    all_points: tuple[float, float]
    hidden: tuple[float, float] | None
    objective: tuple[float, float]
    seconds: tuple[float, float]
    ends: tuple[list[str], list[str]]
    moved: float
    moved_hidden: float | None


def protocols(windows: TrueWindows, body: BodyModel) -> dict[str, Protocol]:
    """Protocols of `benchmarks.humor`."""
    joints = body.pose(windows.truth).joints
    occluded, points = occluded_points(windows.truth, body)
    start = (windows.truth.frames - GAP) // 2
    seen = noisy_joints(windows.truth, body, SEED, NOISE)
    upper = noisy_joints(windows.truth, body, SEED, NOISE, UPPER_BODY)
    return {
        "noisy joints": Protocol(noisy_joints(windows.truth, body, SEED), 0.04, joints),
        "hidden points": Protocol(occluded, 0.0, points),
        "in-betweening": Protocol(with_gap(seen, slice(start, start + GAP)), NOISE, joints),
        "upper body": Protocol(upper, NOISE, joints[:, :, list(UPPER_BODY)]),
    }


class Baseline:
    """Version 0.1.0 in a process of its own."""

    def __init__(self, checkout: Path, folder: Path) -> None:
        """Start it; files that are handed over lie in the folder."""
        self._folder = folder
        environment = os.environ | {"PYTHONPATH": str(checkout), "OMP_NUM_THREADS": "1"}
        self._process = subprocess.Popen(
            [sys.executable, str(Path(__file__).with_name("baseline.py"))],
            cwd=checkout, env=environment, text=True,
            stdin=subprocess.PIPE, stdout=subprocess.PIPE,
        )  # fmt: skip

    def __enter__(self) -> "Baseline":
        return self

    def __exit__(self, *_: object) -> None:
        assert self._process.stdin is not None
        self._process.stdin.close()
        self._process.wait()

    def fit(self, seen: Observed, noise: float) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Arrays of the motion that it finds, and its seconds and ends."""
        answer = self._ask(seen, noise, None)
        with np.load(self._folder / "fitted.npz") as found:
            return {name: found[name] for name in found.files}, answer

    def value(self, seen: Observed, noise: float, motion: dict[str, np.ndarray]) -> float:
        """Its last stage's objective at a motion."""
        path = self._folder / "motion.npz"
        np.savez(
            path, translation=motion["translation"], rotations=motion["rotations"],
            shape=motion["shape"],
        )  # fmt: skip
        return self._ask(seen, noise, path)["value"][0]

    def _ask(self, seen: Observed, noise: float, motion: Path | None) -> dict[str, Any]:
        data, joints = self._folder / "data.npz", isinstance(seen, Joints3D)
        places = seen.joints if isinstance(seen, Joints3D) else seen.vertices
        np.savez(data, positions=seen.positions, visible=seen.visible, places=np.array(places))
        asked = {
            "data": str(data), "sensor": "joints" if joints else "markers", "fps": seen.fps,
            "noise": noise, "motion": motion and str(motion),
            "out": str(self._folder / "fitted.npz"),
        }  # fmt: skip
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(json.dumps(asked) + "\n")
        self._process.stdin.flush()
        return json.loads(self._process.stdout.readline())


@dataclass(frozen=True)
class Tighter:
    """A method with all tolerances divided by ten."""

    method: Method

    def stages(self, data: tuple[Term, ...]) -> tuple[Stage[Any], ...]:
        """Its stages."""
        return tuple(
            replace(stage, minimiser=_tightened(stage.minimiser))
            for stage in self.method.stages(data)
        )


def _tightened(minimiser: Any) -> Any:
    return replace(
        minimiser,
        tolerance_decrease=minimiser.tolerance_decrease / 10,
        max_iterations=4 * minimiser.max_iterations,
    )


def main() -> None:
    parser = over_windows(__doc__)
    parser.add_argument("--baseline", type=Path, required=True, help="checkout of 0.1.0")
    parser.add_argument("--only", type=int, default=None, help="use so many windows in all")
    parser.add_argument("--protocols", nargs="+", default=None)
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    body, humor = BodyModel.load(), Humor.load()
    windows = load_windows(
        arguments.corpus, Splits.load(arguments.splits), arguments.part, body, SEED
    )
    windows = windows.take(evenly(windows, arguments.only))
    rows: list[Row] = []
    found: dict[str, dict[str, float]] = {}
    evaluation = evaluations(windows, humor, body)
    show("one evaluation of the last stage", evaluation)
    with (
        tempfile.TemporaryDirectory() as folder,
        Baseline(arguments.baseline.resolve(), Path(folder)) as baseline,
    ):
        for name, protocol in protocols(windows, body).items():
            if arguments.protocols is not None and name not in arguments.protocols:
                continue
            method = Collocation.for_noise(humor, protocol.noise)
            _warmed(protocol, method, body, baseline)
            for k in range(len(windows.names)):
                rows.append(compared(name, protocol, windows, k, method, body, baseline))
                print(rows[-1], flush=True)
            own = [row for row in rows if row.protocol == name]
            found[name] = summary(own, windows.counted)
            show(name, found[name])
            if arguments.json is not None:
                write(
                    arguments.json, SEED, corpus_source(arguments.corpus, windows.files),
                    part=arguments.part, windows=windows.about, evaluation=evaluation,
                    summary=found, rows=[asdict(row) for row in rows],
                )  # fmt: skip


def _warmed(protocol: Protocol, method: Method, body: BodyModel, baseline: Baseline) -> None:
    solve([protocol.observed[[0]]], method, body)
    baseline.fit(protocol.observed[[0]], protocol.noise)


def compared(
    name: str,
    protocol: Protocol,
    windows: TrueWindows,
    k: int,
    method: Method,
    body: BodyModel,
    baseline: Baseline,
) -> Row:
    """One window, fitted by 0.1.0, by today's default, and with tighter tolerances."""
    seen = protocol.observed[[k]]
    old, told = baseline.fit(seen, protocol.noise)
    began = time.process_time()
    result = solve([seen], method, body)
    seconds = time.process_time() - began
    tight = solve([seen], Tighter(method), body)
    own = {
        "translation": result.motion.translation.detach().numpy(),
        "rotations": result.motion.rotations.detach().numpy(),
        "shape": result.motion.shape.detach().numpy(),
        "points": seen.predict(result.estimate).detach().numpy(),
    }
    true = body.pose(windows.truth[[k]])
    errors: list[dict[str, Tensor]] = []
    for motion in (old, own):
        fields = {name: torch.from_numpy(motion[name]) for name in ("translation", "rotations")}
        posed = body.pose(
            windows.truth[[k]].replace(**fields, shape=torch.from_numpy(motion["shape"]))
        )
        errors.append({
            "joints": (posed.joints - true.joints).norm(dim=-1),
            "vertices": (posed.vertices - true.vertices).norm(dim=-1),
            "points": (torch.from_numpy(motion["points"]) - protocol.points[[k]]).norm(dim=-1),
        })  # fmt: skip
    unseen = _unseen(seen)

    def both(field: str, mask: Tensor | None = None) -> tuple[float, float]:
        found = [e[field] if mask is None else e[field][mask] for e in errors]
        return float(found[0].mean()), float(found[1].mean())

    moved = (tight.body.joints - result.body.joints).detach().norm(dim=-1)
    hidden_moved = (seen.predict(tight.estimate) - seen.predict(result.estimate)).norm(dim=-1)
    return Row(
        protocol=name,
        window=windows.names[k],
        subject=windows.subjects[k],
        joints=both("joints"),
        vertices=both("vertices"),
        all_points=both("points"),
        hidden=both("points", unseen) if bool(unseen.any()) else None,
        objective=(
            baseline.value(seen, protocol.noise, old), baseline.value(seen, protocol.noise, own),
        ),
        seconds=(told["seconds"], seconds),
        ends=([names[0] for names in told["ends"]], _ends(result)),
        moved=float(moved.mean()),
        moved_hidden=float(hidden_moved[unseen].mean()) if bool(unseen.any()) else None,
    )  # fmt: skip


def _unseen(seen: Observed) -> Tensor:
    return ~seen.visible


def _ends(result: Reconstruction) -> list[str]:
    return [report.solution.termination[0].name for report in result.reports]


def summary(rows: Sequence[Row], subjects: Sequence[str]) -> dict[str, float]:
    """Means over windows of a subject, then over the subjects who count."""

    def mean(value: Callable[[Row], float | None]) -> float | None:
        found = []
        for subject in subjects:
            own = [v for row in rows if row.subject == subject and (v := value(row)) is not None]
            found += [float(np.mean(own))] if own else []
        return float(np.mean(found)) if found else None

    def ratio(pair: Callable[[Row], tuple[float, float] | None]) -> float | None:
        old, new = (mean(lambda row, k=k: None if (p := pair(row)) is None else p[k])
                    for k in range(2))  # fmt: skip
        return None if old is None or new is None else new / old

    stages = max(len(row.ends[1]) for row in rows)
    ended = [
        np.mean([row.ends[1][s] in BY_TOLERANCE for row in rows if s < len(row.ends[1])])
        for s in range(stages)
    ]
    own_objective = [row.objective[1] <= row.objective[0] for row in rows]
    found = {
        "CPU, ratio": ratio(lambda row: row.seconds),
        "objective, ratio": ratio(lambda row: row.objective),
        "windows with an objective not above 0.1.0's": float(np.mean(own_objective)),
        "joints, ratio": ratio(lambda row: row.joints),
        "vertices, ratio": ratio(lambda row: row.vertices),
        "all points, ratio": ratio(lambda row: row.all_points),
        "hidden points, ratio": ratio(lambda row: row.hidden),
        "by tolerance, in the stage with the fewest": float(min(ended)),
        "moved by tighter tolerances, mm": 1e3 * (mean(lambda row: row.moved) or 0.0),
        "hidden moved, mm": None
        if (hidden := mean(lambda row: row.moved_hidden)) is None
        else 1e3 * hidden,
        "CPU s of 0.1.0": mean(lambda row: row.seconds[0]),
        "CPU s": mean(lambda row: row.seconds[1]),
    }
    return {name: value for name, value in found.items() if value is not None}


def evaluations(windows: TrueWindows, humor: Humor, body: BodyModel) -> dict[str, float]:
    """Milliseconds of an evaluation of the last stage, and of its matrix products alone."""
    found: dict[str, float] = {}
    observed = noisy_joints(windows.truth, body, SEED)
    for clips in (1, 16):
        seen = concatenate([observed[[k % len(windows.names)]] for k in range(clips)])
        stage = Collocation.for_noise(humor, 0.04).stages((Term("data", seen, 1.0),))[-1]
        start = seen.start(body)
        scene = Scene.create(clips, like=start.translation)
        unknowns = Unknowns.of(stage.prior, start, scene, body).detach()
        layout = Layout.of(unknowns, stage.free)
        x = layout.flatten(unknowns)
        whole = _fastest(lambda: _evaluated(stage, body, unknowns, layout, x))  # noqa: B023
        products = _fastest(_products(humor, clips * (windows.truth.frames - 1)))
        found[f"clips at once: {clips}, ms"] = 1e3 * whole
        found[f"clips at once: {clips}, products alone, ms"] = 1e3 * products
        found[f"clips at once: {clips}, ratio"] = whole / products
    return found


def _evaluated(
    stage: Stage[Any], body: BodyModel, unknowns: Unknowns[Any], layout: Layout, x: Tensor
) -> None:
    x = x.detach().requires_grad_()
    estimate = layout.unflatten(unknowns, x).estimate(stage.prior, body)
    terms = torch.stack([t.weight * t.energy(estimate) for t in stage.terms])
    torch.autograd.grad(terms.sum(), x)


def _products(humor: Humor, rows: int) -> Callable[[], None]:
    """Forward and backward products of all layers of the three networks."""
    weights = [p for name, p in humor.networks.named_parameters() if p.ndim == 2]
    inputs = [torch.randn(rows, w.shape[1]) for w in weights]
    gradients = [torch.randn(rows, w.shape[0]) for w in weights]

    def run() -> None:
        for w, x, g in zip(weights, inputs, gradients, strict=True):
            _ = x @ w.mT, g @ w

    return run


def _fastest(call: Callable[[], None], times: int = 12) -> float:
    call()
    found: list[float] = []
    for _ in range(times):
        began = time.process_time()
        call()
        found.append(time.process_time() - began)
    return min(found)


if __name__ == "__main__":
    main()

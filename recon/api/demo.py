"""The demo: a real recording with added noise or hidden points, reconstructed with two priors."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources
from pathlib import Path

from observations.joints3d import Joints3D
from observations.markers3d import Markers3D
from observations.noise import estimate_noise
from priors.humor.collocation import Collocation
from priors.humor.prior import Humor
from priors.pose.prior import PosePrior, PoseWeights
from recon.api.result import motion_file_of
from recon.body.model import BodyModel
from recon.core.motion import Motion
from recon.formats.motions import load_motion, save_motion
from recon.formats.outputs import Output, OutputKind
from recon.formats.reports import versions
from recon.formats.writing import writing, writing_file
from recon.method.priors import Prior
from recon.method.reconstruction import Reconstruction, solve
from recon.metrics.evaluation import (
    ObservedPoints,
    evaluate,
    joint_errors,
    observed_errors,
    smoothness,
)
from recon.simulation import points as simulate
from recon.simulation.points import Corruption
from recon.view.frames import write_png
from recon.view.html import write_html
from recon.view.scene import GREY, Figure, Points, Show

Metrics = dict[str, float | None]


@dataclass(frozen=True)
class Case:
    """A case of the demo: the simulated sensor, and the noise or occlusion added to its data."""

    title: str
    sensor: str
    """What the sensor tracks: `joints3d` or `markers3d`."""
    corruption: Corruption


CASES: Mapping[str, Case] = {
    "noisy": Case(
        "joints, 4 cm noise",
        "joints3d",
        Corruption(noise=0.04),
    ),
    "occluded": Case(
        "points of the skin above 0.9 m",
        "markers3d",
        Corruption(hide_below=0.9),
    ),
}
SEED = 0


class Demo(dict[str, dict[str, Metrics]]):
    """The metrics of the demo, by case and prior, and the path of the page that shows them."""

    def __init__(self, metrics: Mapping[str, dict[str, Metrics]], out: Path) -> None:
        super().__init__(metrics)
        self.place = f"open {out / 'demo.html'} in a browser; the picture is {out / 'demo.png'}"
        """Which files to open."""

    @property
    def tables(self) -> dict[str, dict[str, dict[str, float | None]]]:
        """Mean errors in centimetres as a table, with a row per case and prior."""
        return {"mean errors of the reconstruction, centimetres": summary(self)}


def demo(out: Path | str = "demo", *, overwrite: bool = False) -> Demo:
    """Add noise to a real recording, hide parts of it, and reconstruct it.

    Writes demo.json (all metrics), demo.html and noisy.html (pages to play), demo.png and the
    motions.

    Args:
        out: folder to write into.
        overwrite: replace files that are there and recon did not write.

    Raises:
        FileExistsError: when the folder holds files that recon did not write, unless `overwrite`.
    """
    place = Path(out)
    report = {"seed": SEED, "cases": {name: case.title for name, case in CASES.items()}}
    report["versions"] = versions()
    with writing(Output(place, OutputKind.FOLDER), report=report, overwrite=overwrite) as (
        staged,
    ):
        return Demo(_fit_cases(staged), place)


def _fit_cases(out: Path) -> dict[str, dict[str, Metrics]]:
    body = BodyModel.load()
    with resources.as_file(resources.files("recon") / "assets" / "demo.npz") as path:
        truth = load_motion(path).motion
    humor = Humor.load(body=body)
    table: dict[str, dict[str, Metrics]] = {}
    shows: list[Show] = []
    for name, case in CASES.items():
        see = simulate.joints3d if case.sensor == "joints3d" else simulate.markers3d
        seen = see(truth, body, case.corruption, SEED)
        noise = estimate_noise(seen.positions, seen.visible)
        methods: dict[str, Prior] = {
            "pose prior": PosePrior.load(weights=PoseWeights.for_noise(noise)),
            "HuMoR": Collocation.for_noise(humor, noise),
        }
        results = {method: solve([seen[None]], prior, body) for method, prior in methods.items()}
        table[name] = {"observed": _errors_of_data(seen, truth, body)}
        for method, result in results.items():
            table[name][method] = _metrics_of_result(result, seen, truth, body)
            shows.append(_show_of_case(f"{case.title}: {method}", seen, result, truth))
        motion = results["HuMoR"].clip(0).detach()
        said = {"case": case.title, "seed": SEED}
        with writing_file(out / f"{name}.npz", said) as staged:
            save_motion(staged, motion_file_of(motion, body))
        write_html(out / ("demo.html" if name == "occluded" else f"{name}.html"), shows[-1])
    write_png(out / "demo.png", *shows)
    (out / "demo.json").write_text(json.dumps(table, indent=1))
    return table


def _metrics_of_result(
    result: Reconstruction, seen: Joints3D | Markers3D, truth: Motion, body: BodyModel
) -> Metrics:
    predicted = seen[None].predicted(result.estimate)[0].detach()
    exact = seen.predict(body.pose(truth))
    points = ObservedPoints(predicted.double(), exact.double(), seen.visible)
    return evaluate(result.clip(0).detach(), truth, body, observed=points)


def _errors_of_data(seen: Joints3D | Markers3D, truth: Motion, body: BodyModel) -> Metrics:
    """Return the errors of the noisy observations, before a fit, against the true motion."""
    exact = seen.predict(body.pose(truth))
    errors = observed_errors(ObservedPoints(seen.positions, exact, seen.visible))
    metrics: Metrics = {"observed_visible": errors["observed_visible"]}
    if not seen.on_skin:
        metrics |= joint_errors(seen.positions, exact, None)
        metrics |= smoothness(seen.positions, exact, seen.fps)
    return metrics


def _show_of_case(
    title: str, seen: Joints3D | Markers3D, result: Reconstruction, truth: Motion
) -> Show:
    predicted = seen[None].predicted(result.estimate)[0].detach()
    model = result.body.model
    figures = (
        Figure(model, result.clip(0).detach(), "reconstruction"),
        Figure(model, truth, "truth", colour=GREY, opacity=0.4),
    )
    return Show(title, figures, Points(seen.positions, seen.visible, predicted))


COLUMNS = {
    "joints": "joints_all",
    "legs": "joints_legs",
    "seen points": "observed_visible",
    "hidden points": "observed_hidden",
    "vertices": "vertices",
    "below ground": "penetration_dist",
}
"""Headings of the table a person reads, and the metrics below them."""


def summary(table: Mapping[str, Mapping[str, Metrics]]) -> dict[str, dict[str, float | None]]:
    """Return the printed table: errors in centimetres, a row per case and prior."""
    rows: dict[str, dict[str, float | None]] = {}
    for case, methods in table.items():
        for method, metrics in methods.items():
            values = {heading: metrics.get(key) for heading, key in COLUMNS.items()}
            rows[f"{case}: {method}"] = {
                heading: None if value is None else 100 * value
                for heading, value in values.items()
            }
    return rows

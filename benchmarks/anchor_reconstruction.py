"""Reconstruction of cycles the prior has not seen, after Marsot et al., equation 6.

    python -m benchmarks.anchor_reconstruction CORPUS --weights nc --licence nc --phase1 WEIGHTS
        --json benchmarks/results/anchor_reconstruction_nc.json
        --picture docs/anchor_reconstruction.png

Test cycles of CMU and of Bandai-Namco's dataset 2 apart. The model, the same after its first
phase, and principal components of the same training cycles encode a cycle and decode it on the
true body; the error of a cycle is the mean squared distance of its surface, at all anchors.
Codes are means, or drawn as in training. The components see shapes and count them in, the model
is given them: `PCA-72` is the paper's, the other one has as many numbers as code and shape.

Distances are those of 200 vertices spread evenly; `subset` says by how much that differs from
the whole surface.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from benchmarks.anchor import Ask, Cycles, asked, parser, surface, weights_name
from benchmarks.anchor_baselines import COMPONENTS, LinearCycles
from benchmarks.results import corpus_source, show, write
from priors.anchor.frames import Anchors
from priors.anchor.prior import AnchorFrames
from recon.body.sampled import spread_vertices
from recon.formats.opening import replacing
from training.anchor.corpus import CycleBatch

POINTS = 200
_AT_ONCE = 50
_CHECKED = 8
"""Cycles of which the whole surface is looked at."""


@dataclass(frozen=True)
class Errors:
    """One number per cycle."""

    squared: Float[Tensor, " cycles"]
    """Equation 6, mm²."""
    distance: Float[Tensor, " cycles"]
    """Mean distance, mm."""
    duration: Float[Tensor, " cycles"]
    """How much too long or short, ms."""


def main() -> None:
    """Measure, print, write and draw."""
    own = parser(__doc__)
    own.add_argument("--phase1", default=None, help="weights after the first phase")
    arguments = own.parse_args()
    ask = asked(arguments)
    prior = AnchorFrames.load(ask.weights)
    phase1 = None if arguments.phase1 is None else AnchorFrames.load(arguments.phase1, prior.body)
    training = Cycles.load(ask, "train", ask.licence, prior).batch
    numbers = prior.weights.networks.latent + prior.body.shape_size
    components = sorted({COMPONENTS, min(numbers, len(training.shape) - 1)})
    linear = {f"PCA-{k}": LinearCycles.fit(training, k) for k in components}
    test = Cycles.load(ask, "test", "nc", prior)
    sets: dict[str, Any] = {}
    for name, cycles in by_source(test, ask).items():
        errors = of_models(prior, phase1, cycles.batch)
        errors |= {
            k: measured(prior, pca(v, cycles.batch), cycles.batch) for k, v in linear.items()
        }
        rows = {key: summary(found) for key, found in errors.items()}
        for key, row in rows.items():
            show(f"{name}, {key}", {k: v for k, v in row.items() if isinstance(v, float)})
        sets[name] = {
            "cycles": len(cycles.clips),
            "rows": rows,
            "order": order(rows),
            "subset": subset(prior, cycles.batch),
        }
        print(name, sets[name]["order"], sets[name]["subset"])
    if ask.json is not None:
        write(ask.json, 0, corpus_source(ask.corpus),
              weights=weights_name(ask.weights), licence=ask.licence, sets=sets)  # fmt: skip
    if ask.picture is not None:
        draw(ask.picture, sets)


def by_source(cycles: Cycles, ask: Ask) -> dict[str, Cycles]:
    """CMU's cycles, and those of Bandai-Namco."""
    is_open = torch.tensor([ask.splits.is_open(clip) for clip in cycles.clips])
    both = {"CMU": is_open, "d2C": ~is_open}
    return {
        name: cycles.rows(rows.nonzero()[:, 0]).thinned(ask.only)
        for name, rows in both.items()
        if bool(rows.any())
    }


def of_models(
    prior: AnchorFrames, phase1: AnchorFrames | None, cycles: CycleBatch
) -> dict[str, Errors]:
    """Rows of the networks."""
    models = {"model": prior} if phase1 is None else {"model": prior, "phase 1": phase1}
    return {
        f"{name}, {kind}": measured(prior, decoded(model, cycles, draw), cycles)
        for name, model in models.items()
        for kind, draw in (("mean code", 0.0), ("drawn code", 1.0))
    }


@torch.no_grad()
def decoded(prior: AnchorFrames, cycles: CycleBatch, spread: float) -> CycleBatch:
    """Encoded and decoded; codes are away from their means by `spread` deviations, at random."""
    networks = prior.weights.networks
    mean, log_variance = networks.posterior(cycles.anchors.pack())
    noise = torch.randn(mean.shape, generator=torch.Generator().manual_seed(0))
    codes = mean + spread * (0.5 * log_variance).exp() * noise
    return CycleBatch(Anchors.unpack(networks.decode(codes, cycles.shape)), cycles.shape)


def pca(linear: LinearCycles, cycles: CycleBatch) -> CycleBatch:
    """Projected; bodies are the true ones again."""
    return linear.decode(linear.codes(cycles)).replace(shape=cycles.shape)


def measured(prior: AnchorFrames, made: CycleBatch, truth: CycleBatch) -> Errors:
    """How far the surface is from where it should be."""
    vertices = spread_vertices(prior.body, POINTS)
    squared: list[Tensor] = []
    distance: list[Tensor] = []
    for rows in torch.arange(len(truth.shape)).split(_AT_ONCE):
        away = surface(prior, made[rows], vertices) - surface(prior, truth[rows], vertices)
        lengths = 1000 * away.norm(dim=-1)
        squared.append(lengths.square().mean((-1, -2)))
        distance.append(lengths.mean((-1, -2)))
    late = (made.anchors.duration - truth.anchors.duration).abs()
    return Errors(torch.cat(squared), torch.cat(distance), 1000 * late)


def summary(errors: Errors) -> dict[str, Any]:
    """Means over cycles, and the box of squared errors."""
    return {
        "squared mm2": errors.squared.mean().item(),
        "distance mm": errors.distance.mean().item(),
        "duration ms": errors.duration.mean().item(),
        "box of squared mm2": box(errors.squared),
        "box of distance mm": box(errors.distance),
    }


def box(values: Float[Tensor, " cycles"]) -> dict[str, Any]:
    """Tukey's: whiskers reach to the last cycle within 1.5 of the box's height."""
    x = values.double().numpy()
    q1, median, q3 = np.quantile(x, (0.25, 0.5, 0.75))
    reach = 1.5 * (q3 - q1)
    inside = x[(x >= q1 - reach) & (x <= q3 + reach)]
    return {
        "q1": float(q1),
        "med": float(median),
        "q3": float(q3),
        "whislo": float(inside.min()),
        "whishi": float(inside.max()),
        "fliers": sorted(float(v) for v in x[(x < q1 - reach) | (x > q3 + reach)]),
    }


def order(rows: dict[str, Any]) -> dict[str, bool]:
    """Whether the model is better than its first phase, and that than 72 components (eq. 6)."""
    squared = {name: row["squared mm2"] for name, row in rows.items()}
    baseline = squared[f"PCA-{COMPONENTS}"]
    found: dict[str, bool] = {}
    for kind in ("mean code", "drawn code"):
        model, phase1 = squared[f"model, {kind}"], squared.get(f"phase 1, {kind}")
        found[f"{kind}: model < PCA-{COMPONENTS}"] = model < baseline
        if phase1 is not None:
            found[f"{kind}: model < phase 1"] = model < phase1
            found[f"{kind}: phase 1 < PCA-{COMPONENTS}"] = phase1 < baseline
    return found


def subset(prior: AnchorFrames, cycles: CycleBatch) -> dict[str, float]:
    """Mean squared error over the spread vertices beside that over the whole surface."""
    few = cycles[:_CHECKED]
    made = decoded(prior, few, 0.0)
    means: list[float] = []
    whole = torch.arange(len(prior.body.template))
    for vertices in (spread_vertices(prior.body, POINTS), whole):
        each: list[float] = []
        for row in torch.arange(len(few.shape)).split(1):
            away = surface(prior, made[row], vertices) - surface(prior, few[row], vertices)
            each.append(1e6 * away.square().sum(-1).mean().item())
        means.append(float(np.mean(each)))
    return {"vertices mm2": means[0], "whole surface mm2": means[1], "ratio": means[0] / means[1]}


def draw(path: Path, sets: dict[str, Any]) -> None:
    """Box plots, a panel per set."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(5.5 * len(sets), 4.2), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(1, len(sets), squeeze=False)[0]
    for axes, (name, found) in zip(panels, sets.items(), strict=True):
        boxes = [{**row["box of squared mm2"], "label": key.replace(", ", "\n")}
                 for key, row in found["rows"].items()]  # fmt: skip
        axes.bxp(boxes, flierprops={"markersize": 3})
        axes.set_yscale("log")
        axes.set_ylabel("mean squared distance, mm²")
        axes.set_title(f"{name}: {found['cycles']} test cycles")
        axes.tick_params(axis="x", labelsize=8)
    with replacing(path) as beside:
        figure.savefig(beside, format="png", dpi=110)


if __name__ == "__main__":
    main()

"""Whether codes of the same action lie together, after figure 4 of Marsot et al.

    python -m benchmarks.anchor_structure CORPUS --weights nc --licence nc
        --json benchmarks/results/anchor_structure_nc.json --picture docs/anchor_structure.png

At most twelve cycles per action, each of another clip; what is done is told by the clip's name,
except that a turn must turn by 30 degrees. The picture is the plane of the two principal
components of these codes; the numbers are of the whole codes. `1-NN` is the share of cycles whose
nearest neighbour does the same; guessing by frequency is beside it. Training cycles are apart
from validation cycles, whose networks have not seen them. `PCA-72` are the coefficients of a
linear model of the same training cycles.
"""

from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from benchmarks.anchor import LABELS, Ask, Cycles, asked, parser, weights_name
from benchmarks.anchor_baselines import LinearCycles
from benchmarks.results import corpus_source, show, write
from priors.anchor.prior import AnchorFrames
from recon.benchmark.dataset import Part
from recon.core.struct import concatenate
from recon.formats.opening import replacing

MOST = 12
"""Cycles of an action."""
PARTS: tuple[Part, ...] = ("train", "validation")


def main() -> None:
    """Measure, print, write and draw."""
    ask = asked(parser(__doc__).parse_args())
    prior = AnchorFrames.load(ask.weights)
    loaded = {part: Cycles.load(ask, part, "nc", prior) for part in PARTS}
    linear = LinearCycles.fit(learned(loaded["train"], ask).batch)
    rows: dict[str, Any] = {}
    planes: dict[str, Any] = {}
    for part, cycles in loaded.items():
        chosen, labels = labelled(cycles, MOST if ask.only is None else min(ask.only, MOST))
        found = {"code": codes(prior, chosen), "PCA-72": linear.codes(chosen.batch)}
        rows[part] = {name: clusters(points, labels) for name, points in found.items()}
        rows[part]["cycles"] = {name: labels.count(name) for name in LABELS if name in labels}
        planes[part] = (plane(found["code"]), labels)
        for name in found:
            show(f"{part}, {name}", rows[part][name])
    if ask.json is not None:
        write(ask.json, 0, corpus_source(ask.corpus),
              weights=weights_name(ask.weights), licence=ask.licence, parts=rows)  # fmt: skip
    if ask.picture is not None:
        draw(ask.picture, planes)


def learned(training: Cycles, ask: Ask) -> Cycles:
    """The training cycles that the weights learned from."""
    if ask.licence == "nc":
        return training
    rows = torch.tensor([ask.splits.is_open(clip) for clip in training.clips]).nonzero()[:, 0]
    return training.rows(rows)


def labelled(cycles: Cycles, most: int) -> tuple[Cycles, list[str]]:
    """Cycles of every action, so many of each, with their actions."""
    parts = [cycles.one_per_clip(name).thinned(most) for name in LABELS]
    kept = {name: part for name, part in zip(LABELS, parts, strict=True) if len(part.clips) > 1}
    labels = [name for name, part in kept.items() for _ in part.clips]
    batch = concatenate([part.batch for part in kept.values()])
    clips = tuple(clip for part in kept.values() for clip in part.clips)
    return Cycles(batch, clips, torch.cat([part.left for part in kept.values()])), labels


def codes(prior: AnchorFrames, cycles: Cycles) -> Float[Tensor, "cycles latent"]:
    """Mean codes."""
    with torch.no_grad():
        return prior.weights.networks.posterior(cycles.batch.anchors.pack())[0]


def clusters(points: Float[Tensor, "cycles latent"], labels: list[str]) -> dict[str, float]:
    """Silhouette from -1 to 1, and how often the nearest other point has the same label."""
    from sklearn.metrics import silhouette_score

    x = points.double()
    distance = torch.cdist(x, x)
    distance.fill_diagonal_(torch.inf)
    nearest = distance.argmin(1).tolist()
    same = [labels[row] == labels[other] for row, other in enumerate(nearest)]
    guess = max(labels.count(name) for name in set(labels)) / len(labels)
    return {
        "silhouette": float(silhouette_score(x.numpy(), labels)),
        "1-NN": sum(same) / len(same),
        "most frequent label": guess,
    }


def plane(points: Float[Tensor, "cycles latent"]) -> Float[Tensor, "cycles 2"]:
    """The first two principal components."""
    away = points - points.mean(0)
    return away @ torch.linalg.svd(away, full_matrices=False)[2][:2].mT


def draw(path: Path, planes: dict[str, Any]) -> None:
    """Points coloured by action, a panel per part."""
    from matplotlib import colormaps
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    colours = {name: colormaps["tab10"](row) for row, name in enumerate(LABELS)}
    figure = Figure(figsize=(6 * len(planes), 5), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(1, len(planes), squeeze=False)[0]
    for axes, (part, (points, labels)) in zip(panels, planes.items(), strict=True):
        for name in dict.fromkeys(labels):
            own = points[torch.tensor([label == name for label in labels])]
            axes.scatter(own[:, 0], own[:, 1], label=name, color=colours[name], s=28)
        axes.set_title(f"codes of {part} cycles, first two components")
        axes.legend(fontsize=8)
    with replacing(path) as beside:
        figure.savefig(beside, format="png", dpi=100)


if __name__ == "__main__":
    main()

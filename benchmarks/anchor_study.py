"""Size of the code and weight of its divergence: the two studies of Marsot et al., section 5.1.

    python -m benchmarks.anchor_study CORPUS --licence nc --out RUNS
        --json benchmarks/results/anchor_study.json --picture docs/anchor_study.png

Each row is a training of its own with the package's networks, short (200 steps on parameters, 400
on the surface), judged on the validation cycles: errors after encoding and decoding, with mean
codes and drawn ones; what the code holds; and how samples from N(mean, S) differ from recorded
cycles (distance of each from the nearest training cycle, and how far feet sink below the ground).
"""

import json
from dataclasses import replace
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor

from benchmarks.anchor import asked, parser
from benchmarks.results import corpus_source, write
from priors.anchor.frames import Anchors
from priors.anchor.networks import load_weights
from recon.body.model import BodyModel
from recon.body.sampled import spread_vertices
from recon.formats.opening import replacing
from training.anchor.corpus import CycleCorpus
from training.anchor.run import AnchorTraining, export_learned
from training.anchor.train import some_of, train_on

SIZES = (8, 16, 32, 64, 128, 256)
KL = (1e-1, 1e-2, 1e-3, 1e-4)
_SIZE, _KL = 64, 1e-3
"""What the other study keeps."""
_SAMPLES = 200
_EVERY = 20
"""Anchors that samples are compared at."""


def main() -> None:
    """Train, measure, print, write and draw."""
    own = parser(__doc__)
    own.add_argument("--out", type=Path, required=True, help="folder of the runs")
    arguments = own.parse_args()
    ask = asked(arguments)
    torch.set_num_threads(1)
    body = BodyModel.load()
    learned, held_out = (
        CycleCorpus.load(ask.corpus, ask.splits, part, ask.licence, body)
        for part in ("train", "validation")
    )
    plain = AnchorTraining(
        corpus=ask.corpus, out=arguments.out, data=ask.licence, steps=200, surface_steps=400,
        validate_every=200,
    )  # fmt: skip
    settings = [replace(plain, latent=size, kl=_KL) for size in SIZES]
    settings += [replace(plain, latent=_SIZE, kl=kl) for kl in KL if kl != _KL]
    rows: list[dict[str, float]] = []
    for one in settings:
        run = replace(one, out=arguments.out / f"{one.latent}_{one.kl:g}")
        run.out.mkdir(parents=True, exist_ok=True)
        train_on(run, learned, held_out.every(run.alignment))
        path = export_learned(run, run.out / "anchor.safetensors", learned)
        found = _last(run.out / "losses.csv")
        row = {"latent": float(run.latent), "kl": run.kl, **found, **_samples(path, learned, body)}
        rows.append(row)
        print(json.dumps(row), flush=True)
        if ask.json is not None:
            write(ask.json, 0, corpus_source(ask.corpus), licence=ask.licence, rows=rows)
    if ask.picture is not None:
        _draw(rows, ask.picture)


def _last(path: Path) -> dict[str, float]:
    """The row of the losses that scored best, as far as it is of use here."""
    lines = [line.split(",") for line in path.read_text().splitlines()]
    table = [dict(zip(lines[0], map(float, line), strict=True)) for line in lines[1:]]
    best = min(table, key=lambda row: row["score"])
    return {name: best[name] for name in ("vertex_cm", "sampled_vertex_cm", "kl_nats", "active")}


def _samples(path: Path, learned: CycleCorpus, body: BodyModel) -> dict[str, float]:
    """Cycles of codes drawn from the fitted normal, on the average body."""
    weights = load_weights(path)
    random = torch.Generator().manual_seed(0)
    noise = torch.randn(_SAMPLES, weights.networks.latent, generator=random)
    shape = torch.zeros(_SAMPLES, body.shape_size)
    codes = weights.spread.mean + noise @ weights.spread.root.mT
    made = Anchors.unpack(weights.networks.decode(codes, shape))
    known = learned.every(weights.alignment)
    vertices = spread_vertices(body, 60)
    points = [
        _surface(body, anchors, rows, vertices)
        for anchors, rows in ((made, shape), (known.anchors, known.shape))
    ]
    apart = torch.cdist(points[0].flatten(1), points[1].flatten(1)).amin(-1)
    per_point = apart / (points[0].shape[1] * points[0].shape[2]) ** 0.5
    lowest = points[0][..., 2].amin(-1)
    return {"nearest_cm": 100 * float(per_point.mean()), "lowest_cm": 100 * float(lowest.mean())}


def _surface(
    body: BodyModel, anchors: Anchors, shape: Float[Tensor, "cycles shape"], vertices: Tensor
) -> Float[Tensor, "cycles anchors points 3"]:
    few = some_of(anchors, torch.arange(0, anchors.times.shape[1], _EVERY))
    return body.pose(few.motion(shape, 1.0)).points(vertices)


def _draw(rows: list[dict[str, float]], path: Path) -> None:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 4), layout="constrained")
    FigureCanvasAgg(figure)
    by_kl = sorted((r for r in rows if r["latent"] == _SIZE), key=lambda r: r["kl"])
    studies = (("latent", [r for r in rows if r["kl"] == _KL]), ("kl", by_kl))
    for axes, (name, own) in zip(figure.subplots(1, 2), studies, strict=True):
        for column in ("vertex_cm", "sampled_vertex_cm", "nearest_cm"):
            axes.plot([r[name] for r in own], [r[column] for r in own], "o-", label=column)
        axes.set(xscale="log", xlabel=name, ylabel="cm", ylim=(0, None))
        axes.legend()
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as beside:
        figure.savefig(beside, format="png", dpi=100)


if __name__ == "__main__":
    main()

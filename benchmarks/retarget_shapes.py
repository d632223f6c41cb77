"""What the HUMOS prior makes of shape: reconstruction, what codes know, knees and hands.

    python -m benchmarks.retarget_shapes CORPUS --weights open
        --json benchmarks/results/retarget_shapes.json --picture docs/retarget_shapes.png

`reconstruction` is the joint error of mean codes alone, without details, on the clips of
`benchmarks/identities.toml` and their own bodies, in the world. `probe` is a ridge regression from
the mean code of 3.2 s to the shape of who moved, bodies drawn from N(0, I): R², the mean over
coefficients, at most .1 where codes do not know who moved. Learned on clips of training people,
and judged on other windows of theirs and on test people; of recorded windows, and of what the
networks make of them on another body, which they encode again. `changed` is by how
much local rotations differ between bodies of one motion, in degrees: what codes alone say, and
the result of `retarget`, beside the scaled copy (zero). The picture has HUMOS's figures: the
angle of a knee over a walk on 100 bodies from slim and short to heavy and tall, less that of the
middle one, and the speed of a hand on six.
"""

from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor

from benchmarks.anchor import asked, parser, weights_name
from benchmarks.results import corpus_source, show, write
from benchmarks.retarget_clips import Job, load_jobs
from priors.humos.prior import FPS, Humos
from recon.body.identities import identity
from recon.body.motion_files import with_shape
from recon.core import rotations as so3
from recon.core.motion import Motion
from recon.core.skeleton import joint_index
from recon.fitting.retargeting import retarget
from recon.formats.opening import replacing
from training.humos.corpus import AS_RECORDED, BodyCorpus
from training.humos.train import encoded

ENDS = ("woman,short,slim", "man,tall,heavy")
"""Bodies between which 100 are taken."""
SIX = ("woman,short,slim", "woman,heavy", "woman,tall", "man,short", "man,slim", "man,tall,heavy")
BODIES = 100
_DRAWN = 1024
"""Windows that a probe learns from and is judged by."""
_RIDGE = 1.0


def main() -> None:
    """Measure, print, write and draw."""
    ask = asked(parser(__doc__).parse_args())
    torch.set_num_threads(1)
    prior = Humos.load(ask.weights)
    jobs = load_jobs(ask.corpus, ask.splits, "test", "nc", prior.body)
    jobs = jobs[:: max(1, len(jobs) // ask.only)] if ask.only is not None else jobs
    learned = BodyCorpus.load(ask.corpus, ask.splits, "train", ask.licence, prior.body)
    held_out = BodyCorpus.load(ask.corpus, ask.splits, "test", "nc", prior.body)
    rows = {
        "reconstruction": reconstruction(prior, jobs),
        "probe": probe(prior, learned, held_out),
        "changed": changed(prior, jobs),
    }
    for name, row in rows.items():
        show(name, row)
    if ask.json is not None:
        about = {"weights": weights_name(ask.weights), "licence": ask.licence}
        write(ask.json, 0, corpus_source(ask.corpus), **about, clips=len(jobs), rows=rows)
    if ask.picture is not None:
        walk = next(job for job in jobs if job.name.startswith(("07", "16")))
        draw(ask.picture, prior, walk.motion)


def codes_only(prior: Humos, motion: Motion, shape: Float[Tensor, " shape"]) -> Motion:
    """What mean codes say of one clip as a body performs it, without details."""
    found = prior.encode(motion.map(lambda tensor: tensor[None]))
    plain = found.replace(bend=0 * found.bend, shift=0 * found.shift, shape=shape[None])
    return prior.decode(plain).motion[0]


def reconstruction(prior: Humos, jobs: list[Job]) -> dict[str, float]:
    """Joint error of every clip on its own body, cm: mean, by subject.

    Of clips that are longer than one code per clip knows, the beginning counts.
    """
    errors: dict[str, list[float]] = {}
    for job in jobs:
        known = min(job.motion.frames, prior.longest * FPS)
        motion = job.motion.window(0, int(known))
        made = codes_only(prior, motion, motion.shape)
        away = prior.body.pose(made).joints - prior.body.pose(motion).joints
        errors.setdefault(job.subject, []).append(100 * float(away.norm(dim=-1).mean()))
    every = [error for own in errors.values() for error in own]
    mean = {name: sum(own) / len(own) for name, own in errors.items()}
    return {"mean cm": sum(every) / len(every), "worst clip cm": max(every), **mean}


def probe(prior: Humos, learned: BodyCorpus, held_out: BodyCorpus) -> dict[str, float]:
    """R² of linear probes for the shape."""
    random = torch.Generator().manual_seed(0)
    own, others = (_codes(prior, corpus, random) for corpus in (learned, held_out))
    some, rest = ({k: v[side::2] for k, v in own.items()} for side in (0, 1))

    def found(a: dict[str, Tensor], b: dict[str, Tensor], codes: str, shape: str) -> float:
        return _r2(a[codes].mean(1), a[shape], b[codes].mean(1), b[shape])

    return {
        "recorded, test people": found(own, others, "codes", "shape"),
        "recorded, training people": found(some, rest, "codes", "shape"),
        "retargeted, test people": found(own, others, "again", "other"),
        "retargeted, training people": found(some, rest, "again", "other"),
    }


def changed(prior: Humos, jobs: list[Job]) -> dict[str, float]:
    """Mean angle between local rotations of the same motion on two bodies, degrees."""
    codes, whole = [], []
    for job in jobs:
        pair = [codes_only(prior, job.motion, s) for s in (job.motion.shape, job.target)]
        codes.append(so3.geodesic(pair[0].rotations, pair[1].rotations).mean())
        made = retarget(job.motion, job.target, prior)
        whole.append(so3.geodesic(made.rotations, job.motion.rotations).mean())
    return {
        "codes, degrees": float(torch.stack(codes).mean().rad2deg()),
        "retarget, degrees": float(torch.stack(whole).mean().rad2deg()),
        "scaled copy, degrees": 0.0,
    }


def draw(path: Path, prior: Humos, walk: Motion) -> None:
    """The angle of the left knee over 100 bodies, and the speed of the left hand of six."""
    from matplotlib import colormaps
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    walk = walk.window(0, min(walk.frames, 60))
    first, last = (identity(spec, prior.body) for spec in ENDS)
    figure = Figure(figsize=(12, 4), layout="constrained")
    FigureCanvasAgg(figure)
    knees, hands, copies = figure.subplots(1, 3)
    colours = colormaps["viridis"]
    share = torch.linspace(0, 1, BODIES)
    clock = torch.arange(walk.frames) / FPS
    knee, wrist = joint_index("left_knee"), joint_index("left_wrist")

    def bent(shape: Tensor) -> Tensor:
        made = codes_only(prior, walk, shape)
        return so3.log(made.rotations[:, knee]).norm(dim=-1).rad2deg()

    middle = bent(first.lerp(last, 0.5))
    for s in share.tolist():
        knees.plot(clock, bent(first.lerp(last, s)) - middle, color=colours(s), linewidth=0.6)
    knees.set(title=f"left knee, {BODIES} bodies less the middle one", ylabel="degrees")
    swing = float(middle.max() - middle.min())
    knees.set_xlabel(f"seconds; slim woman (dark) to heavy man; bends by {swing:.0f} degrees")
    for k, spec in enumerate(SIX):
        shape = identity(spec, prior.body)
        colour = colours(k / (len(SIX) - 1))
        for axes, made in (
            (hands, codes_only(prior, walk, shape)),
            (copies, with_shape(walk, prior.body, shape)),
        ):
            hand = prior.body.pose(made).joints[:, wrist]
            speed = hand.diff(dim=0).norm(dim=-1) * FPS
            axes.plot(clock[1:], speed, color=colour, label=spec)
    hands.set(title="left hand, HUMOS prior", ylabel="m/s")
    copies.set(title="left hand, scaled copy", ylabel="m/s")
    copies.legend(fontsize="x-small")
    for axes in (hands, copies):
        axes.set_xlabel("seconds")
    with replacing(path) as beside:
        figure.savefig(beside, format="png", dpi=100)


def _codes(
    prior: Humos, corpus: BodyCorpus, random: torch.Generator
) -> dict[str, Float[Tensor, "clips ..."]]:
    """Codes of windows on drawn bodies, and of what the networks make of them on others."""
    batch = corpus.draw(_DRAWN, 64, AS_RECORDED, random)
    some = batch.valid.all(-1)
    exists = batch.windows[some]
    rows = batch.frames.map(lambda rows: rows[some]).pack()
    shape, other = torch.randn(2, *batch.shape[some].shape, generator=random)
    networks, density = prior.weights.networks, prior.weights.density
    with torch.no_grad():
        found = encoded(networks, rows, shape, exists, None).mean
        made = networks.decode(found, other, exists, rows.shape[1])
        again = encoded(networks, made, other, exists, None).mean
    codes, others = density.white(found), density.white(again)
    return {"codes": codes, "shape": shape, "again": others, "other": other}


def _r2(codes: Tensor, shape: Tensor, others: Tensor, truth: Tensor) -> float:
    """Ridge regression; 1 - squared error over variance, mean over coefficients."""
    middle, mean = codes.mean(0), shape.mean(0)
    x = (codes - middle).double()
    size = x.shape[1]
    solved = torch.linalg.solve(
        x.mT @ x + _RIDGE * torch.eye(size, dtype=x.dtype), x.mT @ (shape - mean).double()
    )
    guess = (others - middle).double() @ solved + mean
    error = (guess - truth).square().mean(0)
    return float((1 - error / truth.double().var(0)).mean())


if __name__ == "__main__":
    main()

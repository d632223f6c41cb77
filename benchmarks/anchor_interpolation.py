"""Cycles between cycles: durations, feet that slip, and how far from recorded codes.

    python -m benchmarks.anchor_interpolation CORPUS --weights nc --licence nc
        --json benchmarks/results/anchor_interpolation.json
        --picture docs/anchor_interpolation.png

Pairs of cycles, of one subject where there are two: running and walking, walking forward and
backward, turning left and right. Codes and shapes are mixed by the
prior, linear coefficients by PCA-72, and anchors by slerp (Marsot et al., section 5.2); each as it
is, and settled (`recon.fitting.retargeting`), as `recon interpolate` leaves it.

Pairs stand on the same feet, each told by which foot is lower: hips of backward walking swing as
those of forward walking do, while the other foot stands.

Nothing was recorded halfway that would tell which foot is held. So a foot counts as held where it
is the lowest of the four joints of the feet, less the height at which each touches, and within
4 cm of the ground; its horizontal speed is the slip. Recorded cycles are measured likewise: feet
roll, and low feet of runners fly, which is what their own slip is. `held` is the share of moments
with such a foot, `nearest` the distance of the encoded cycle from the nearest training code, in
deviations of the codes, per root of their number. `monotone` is the share of pairs whose duration
goes one way as k goes from 0 to 1 by tenths.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from benchmarks.anchor import Ask, Cycles, asked, parser, turned, weights_name
from benchmarks.anchor_baselines import LinearCycles, slerp
from benchmarks.anchor_structure import learned
from benchmarks.results import corpus_source, show, write
from priors.anchor.frames import ANCHORS, POSED, Anchors
from priors.anchor.prior import AnchorFrames
from recon.benchmark.dataset import Part
from recon.body.contacts import TOE_REACH, rest_heights, touching_heights
from recon.core.skeleton import FEET
from recon.core.struct import concatenate
from recon.fitting.interpolation import agreement, foot_lift
from recon.fitting.retargeting import flies, settled
from recon.formats.opening import replacing
from recon.metrics import errors as metrics
from training.anchor.corpus import CycleBatch

KINDS = {
    "run - walk": ("run", "walk"),
    "forward - backward": ("walk", "walk-back"),
    "left turn - right turn": ("turn-left", "turn-right"),
}
PARTS: tuple[Part, ...] = ("validation", "test")
MOST = 12
"""Pairs of a kind."""
STEPS = 10
"""Values of k from 0 to 1."""
_STILL = 1e-3
"""Seconds by which durations may go back without counting as such."""
Between = Callable[[CycleBatch, CycleBatch, float], CycleBatch]


@dataclass(frozen=True)
class Pairs:
    """Two cycles per row."""

    a: Cycles
    b: Cycles


def main() -> None:
    """Measure, print, write and draw."""
    ask = asked(parser(__doc__).parse_args())
    prior = AnchorFrames.load(ask.weights)
    training = learned(Cycles.load(ask, "train", "nc", prior), ask)
    linear = LinearCycles.fit(training.batch)
    methods: dict[str, Between] = {
        "ours": lambda a, b, k: mixed(prior, a, b, k),
        "PCA-72": linear.between,
        "slerp": slerp,
    }
    methods |= {f"{name}, settled": stood(prior, each) for name, each in methods.items()}
    known = whitened(prior, training.batch)
    parts: dict[str, Any] = {}
    drawn: dict[str, Pairs] = {}
    for part in PARTS:
        cycles = Cycles.load(ask, part, "nc", prior)
        parts[part] = {}
        for kind, names in KINDS.items():
            pairs = paired(prior, cycles, names, MOST if ask.only is None else ask.only, ask)
            if pairs is None:
                continue
            drawn.setdefault(kind, pairs)
            rows = measured(prior, methods, pairs, known)
            for name, row in rows.items():
                show(f"{part}, {kind}, {name}", {k: v for k, v in row.items() if v is not None})
            parts[part][kind] = {"pairs": len(pairs.a.clips), "rows": rows}
    if ask.json is not None:
        write(ask.json, 0, corpus_source(ask.corpus),
              weights=weights_name(ask.weights), licence=ask.licence, parts=parts)  # fmt: skip
    if ask.picture is not None:
        draw(ask.picture, prior, methods, drawn)


@torch.no_grad()
def mixed(prior: AnchorFrames, a: CycleBatch, b: CycleBatch, share: float) -> CycleBatch:
    """Mean codes and shapes mixed, and decoded."""
    networks = prior.weights.networks
    one, other = (networks.posterior(x.anchors.pack())[0] for x in (a, b))
    shape = torch.lerp(a.shape, b.shape, share)
    return CycleBatch(Anchors.unpack(networks.decode(torch.lerp(one, other, share), shape)), shape)


def stood(prior: AnchorFrames, between: Between) -> Between:
    """Cycles likewise, with feet that stand where they are; kept, as all tables ask for k = 1/2.

    Durations stay, and only they are looked at elsewhere: other shares are left as they are.
    """
    known: dict[int, tuple[CycleBatch, CycleBatch]] = {}

    def settle(a: CycleBatch, b: CycleBatch, share: float) -> CycleBatch:
        made = between(a, b, share)
        if share != 0.5:
            return made
        if id(a) not in known:
            rows = [_settled(prior, made[k : k + 1]) for k in range(len(made.shape))]
            known[id(a)] = a, concatenate(rows)  # a is held, so that its number stays its own
        return known[id(a)][1]

    return settle


def _settled(prior: AnchorFrames, cycle: CycleBatch) -> CycleBatch:
    anchors = cycle.anchors
    fps = (ANCHORS - 1) / float(anchors.duration)
    made = anchors.motion(cycle.shape, fps)
    motion = settled(made, made, flies(made, prior.body), prior.body).detach()
    rotations = motion.rotations[..., POSED, :, :]
    moved = anchors.replace(rotations=rotations, translation=motion.translation)
    return cycle.replace(anchors=moved)


def paired(
    prior: AnchorFrames, cycles: Cycles, names: tuple[str, str], most: int, ask: Ask
) -> Pairs | None:
    """Cycles of two actions that stand on the same feet, each used once; None without any.

    Of the first action a cycle per clip, of the second the one whose feet agree best, of the same
    subject where there is one.
    """
    one = cycles.one_per_clip(names[0])
    other = cycles.rows(
        torch.tensor(
            [k for k, name in enumerate(cycles.labels) if name == names[1]], dtype=torch.long
        )
    )
    if min(len(one.clips), len(other.clips)) == 0:
        return None
    agree = agreement(*(lifts(prior, x.batch) for x in (one, other)))
    own, theirs = ([ask.splits.subject(clip) for clip in x.clips] for x in (one, other))
    free = set(range(len(theirs)))
    rows: list[tuple[int, int]] = []
    for row, subject in enumerate(own):
        fitting = [k for k in free if float(agree[row, k]) > 0]
        if fitting:
            best = max(fitting, key=lambda k: (theirs[k] == subject, float(agree[row, k])))
            free.remove(best)
            rows.append((row, best))
    if len(rows) == 0:
        return None
    chosen = torch.tensor(rows)
    both = Pairs(one.rows(chosen[:, 0]), other.rows(chosen[:, 1]))
    return Pairs(both.a.thinned(most), both.b.thinned(most))


def lifts(prior: AnchorFrames, cycles: CycleBatch) -> Float[Tensor, "cycles 100"]:
    """How much higher the left foot is than the right."""
    return foot_lift(prior.body.pose(cycles.anchors.motion(cycles.shape, 1.0)).joints)


def measured(
    prior: AnchorFrames,
    methods: dict[str, Between],
    pairs: Pairs,
    known: Float[Tensor, "cycles latent"],
) -> dict[str, dict[str, float | None]]:
    """A row per method at k = 1/2, and one of the recorded cycles."""
    a, b = pairs.a.batch, pairs.b.batch
    rows: dict[str, dict[str, float | None]] = {}
    for name, between in methods.items():
        along = torch.stack(
            [between(a, b, k / STEPS).anchors.duration for k in range(STEPS + 1)], -1
        )
        rows[name] = {
            **motion_row(prior, between(a, b, 0.5), known),
            "monotone": monotone(along).double().mean().item(),
        }
    recorded = [motion_row(prior, x, known) for x in (a, b)]
    for name, row in zip(("recorded, k = 0", "recorded, k = 1"), recorded, strict=True):
        rows[name] = {**row, "monotone": None}
    return rows


def motion_row(
    prior: AnchorFrames, cycles: CycleBatch, known: Float[Tensor, "cycles latent"]
) -> dict[str, float | None]:
    """What the feet do, how far the cycles go and turn, and how near they are to known codes."""
    slips: list[float] = []
    held: list[float] = []
    for row in range(len(cycles.shape)):
        cycle = cycles[row]
        fps = (ANCHORS - 1) / float(cycle.anchors.duration)
        joints = prior.body.pose(cycle.anchors.motion(cycle.shape, fps)).joints
        standing = supports(joints, rest_heights(prior.body, cycle.shape))
        slip = metrics.slip_speed(joints, standing, fps)
        held.append(standing.any(-1).double().mean().item())
        if slip is not None:
            slips.append(slip)
    away = torch.cdist(whitened(prior, cycles), known).amin(1) / known.shape[1] ** 0.5
    path = cycles.anchors.translation[:, -1, :2] - cycles.anchors.translation[:, 0, :2]
    return {
        "slip m/s": sum(slips) / len(slips) if slips else None,
        "held": sum(held) / len(held),
        "nearest": away.mean().item(),
        "duration s": cycles.anchors.duration.mean().item(),
        "forward m": path[:, 1].mean().item(),
        "turn deg": turned(cycles.anchors).mean().item(),
    }


def supports(
    joints: Float[Tensor, "time 22 3"], rest_height: Float[Tensor, " 22"]
) -> Bool[Tensor, "time 22"]:
    """The lowest joint of the feet where it is within reach of the ground."""
    feet = list(FEET)
    above = joints[:, feet, 2] - touching_heights(rest_height)[feet]
    lowest = above == above.amin(-1, keepdim=True)
    found = torch.zeros(joints.shape[:2], dtype=torch.bool)
    found[:, feet] = lowest & (above < TOE_REACH)
    return found


def monotone(along: Float[Tensor, "cycles steps"]) -> Bool[Tensor, " cycles"]:
    """Whether durations go one way only."""
    steps = along.diff(dim=-1)
    return (steps > -_STILL).all(-1) | (steps < _STILL).all(-1)


@torch.no_grad()
def whitened(prior: AnchorFrames, cycles: CycleBatch) -> Float[Tensor, "cycles latent"]:
    """Mean codes, less their mean and over their deviations."""
    spread = prior.weights.spread
    away = prior.weights.networks.posterior(cycles.anchors.pack())[0] - spread.mean
    return torch.linalg.solve_triangular(spread.root, away.mT, upper=False).mT


@torch.no_grad()
def slip_course(prior: AnchorFrames, cycles: CycleBatch) -> Float[Tensor, " steps"]:
    """Speed of the held foot from anchor to anchor, mean over cycles, m/s; nan without any."""
    courses: list[Tensor] = []
    for row in range(len(cycles.shape)):
        cycle = cycles[row]
        fps = (ANCHORS - 1) / float(cycle.anchors.duration)
        joints = prior.body.pose(cycle.anchors.motion(cycle.shape, fps)).joints
        standing = supports(joints, rest_heights(prior.body, cycle.shape))
        speed = joints[..., :2].diff(dim=0).norm(dim=-1) * fps
        courses.append(speed.where(standing[1:] & standing[:-1], torch.nan).nanmean(-1))
    return torch.stack(courses).nanmean(0)


def draw(
    path: Path, prior: AnchorFrames, methods: dict[str, Between], drawn: dict[str, Pairs]
) -> None:
    """The speed of held feet through the cycle at k = 1/2 and durations along k, for each kind."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(4.2 * len(drawn), 7), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(2, len(drawn), squeeze=False)
    shares = [k / STEPS for k in range(STEPS + 1)]
    through = (torch.arange(ANCHORS - 1) + 0.5) / (ANCHORS - 1)
    for (above, below), (kind, pairs) in zip(panels.T, drawn.items(), strict=True):
        a, b = pairs.a.batch, pairs.b.batch
        for cycles, style in ((a, ":"), (b, "--")):
            name = "recorded, k = 0" if cycles is a else "recorded, k = 1"
            above.plot(through, slip_course(prior, cycles), style, color="0.5", label=name)
        for number, (name, between) in enumerate(methods.items()):
            look = {"color": f"C{number % 3}", "linestyle": "-" if number < 3 else "-."}
            above.plot(through, slip_course(prior, between(a, b, 0.5)), label=name, **look)
            if number < 3:
                durations = torch.stack([between(a, b, k).anchors.duration for k in shares])
                below.plot(shares, durations.mean(-1), label=name, **look)
        above.set_title(f"{kind}, {len(pairs.a.clips)} pairs")
        above.set_xlabel("share of the cycle")
        above.set_ylabel("speed of the held foot, m/s")
        above.set_ylim(0, 1.5)
        above.legend(fontsize=8)
        below.set_xlabel("k")
        below.set_ylabel("mean duration, s")
        below.legend(fontsize=8)
    with replacing(path) as beside:
        figure.savefig(beside, format="png", dpi=100)


if __name__ == "__main__":
    main()

"""What HuMoR's networks can say of true motions: errors of one step, and what they add up to.

    python -m benchmarks.drift CORPUS --json drift.json

All listed windows of 60 frames, those of acrobatics (subject 49) apart. Nothing is fitted: the
encoder tells the latent of every step of the true motion, and the decoder what it makes of it.
One step, from the true state: distance of the joints it lands with from the true ones, ½ eᵀ C⁻¹ e
of all that it misses, C the covariance of such errors over the training corpus (a usual step has
half of 207), and the surprise, KL(q ‖ p). Roll-outs: of these latents, in which errors add up, and
of latents that each lead from where those before have led back to the motion, which is the nearest
to it that the encoder finds. A fit moves latents further, so its error can be smaller.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from rich.console import Console
from rich.table import Table
from torch import Tensor

from benchmarks.arguments import over_windows
from benchmarks.results import corpus_source, write
from benchmarks.tables.drift import HEADINGS, lines
from priors.humor.prior import Humor
from priors.humor.state import states_of
from priors.humor.steps import explain, latents_of
from recon.benchmark.dataset import Splits
from recon.benchmark.windows import TrueWindows, load_windows
from recon.body.model import BodyModel

SEED = 0
_JOINTS = slice(75, 141)
"""Joints among the 207 numbers of a step's error (`priors.humor.state.step_between`)."""


@dataclass(frozen=True)
class Row:
    """One window's true motion as the networks see it."""

    window: str
    subject: str
    speed: float
    """Mean speed of the joints, m/s."""
    step: float
    """Mean distance of joints from the true ones after one step from the true state, metres."""
    nats: float
    """Mean ½ eᵀ C⁻¹ e of a step."""
    surprise: float
    """Mean KL divergence of a step's latent, nats."""
    added: tuple[float, ...]
    """Mean error of joints of the roll-out of these latents, by thirds of the frames, metres."""
    followed: tuple[float, ...]
    """Mean error likewise, of latents that lead back to the motion."""


def main() -> None:
    """Measure, print and write."""
    parser = over_windows(__doc__)
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    body, humor = BodyModel.load(), Humor.load()
    splits = Splits.load(arguments.splits)
    windows = load_windows(arguments.corpus, splits, arguments.part, body, SEED)
    with torch.no_grad():
        rows = rows_of(windows, humor, body)
    table = Table(*HEADINGS)
    for line in lines([vars(row) for row in rows]):
        table.add_row(*line)
    Console(width=150).print(table)
    if arguments.json is not None:
        write(arguments.json, SEED, corpus_source(arguments.corpus, windows.files),
              part=arguments.part, windows=windows.about,
              rows=[vars(row) for row in rows])  # fmt: skip


def rows_of(windows: TrueWindows, humor: Humor, body: BodyModel) -> list[Row]:
    """Every window."""
    states, pelvis = states_of(windows.truth, body), humor.pelvis(windows.truth.shape)
    steps = explain(humor.networks, states, pelvis)
    landed = steps.error[..., _JOINTS].unflatten(-1, (-1, 3)).norm(dim=-1).mean((1, 2))
    nats = 0.5 * (steps.error @ humor.error_whitening).square().sum(-1).mean(1)
    surprise, speed = steps.surprise.mean(1), states.joint_velocities.norm(dim=-1).mean((1, 2))
    back = humor.encode(windows.truth)
    ahead = back.replace(latents=latents_of(humor.networks, states, pelvis)[0])

    def errors(motion: Tensor) -> list[Float[Tensor, " clips"]]:
        away = (motion - states.joints).norm(dim=-1).mean(-1)
        return [part.mean(1) for part in away.tensor_split(3, 1)]

    added, followed = (
        errors(body.pose(humor.decode(variables).motion).joints) for variables in (ahead, back)
    )
    return [
        Row(
            window, windows.subjects[k], float(speed[k]), float(landed[k]), float(nats[k]),
            float(surprise[k]),
            tuple(float(part[k]) for part in added),
            tuple(float(part[k]) for part in followed),
        )
        for k, window in enumerate(windows.names)
    ]  # fmt: skip


if __name__ == "__main__":
    main()

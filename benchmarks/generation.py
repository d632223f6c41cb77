"""Generation, after HuMoR's Table 1: prediction, diversity, contacts, and who stays on its feet.

    python -m benchmarks.generation CORPUS --json generation.json
    python -m benchmarks.generation CORPUS --part validation --weights WEIGHTS

Every listed window gives a first state (velocities by central differences at the recording's own
rate), from which 50 motions of 5 s are drawn. Their first 2 s are compared with the window: the
sample of the least average displacement is the prediction, as in the paper. Diversity is over the
whole 5 s. Joints are those of the posed body. Three to four minutes on one core.
"""

import sys
import time
from dataclasses import dataclass
from pathlib import Path

import torch
from jaxtyping import Bool, Float
from rich.console import Console
from rich.table import Table
from torch import Tensor

from benchmarks.arguments import over_windows
from benchmarks.results import corpus_source, write
from benchmarks.scores import Columns, Row, Rows, by_subject, cell
from priors.humor.generation import (
    TEMPERATURE,
    Footing,
    roll_from,
    sample,
)
from priors.humor.prior import Humor
from priors.humor.state import Frame, State, states_of
from recon.benchmark.dataset import Splits, clip_files
from recon.benchmark.windows import FPS, FRAMES, TrueWindows, load_windows
from recon.body.contacts import contact_labels, rest_heights
from recon.body.model import BodyModel
from recon.core.motion import Motion
from recon.core.skeleton import CONTACT_JOINTS, FEET, JOINTS
from recon.core.struct import stack
from recon.formats.motions import load_motion
from recon.metrics import errors as metrics
from recon.metrics import generation as generation_metrics
from recon.metrics.generation import displacements, pairwise_distance

SEED = 0
SAMPLES = 50
SECONDS = 5
WARM = 1.3
"""Temperature of the least ADE + FDE on validation subjects, among 1, 1.2 and 1.4 (1.2 and 1.4 are
equal)."""
UNCONDITIONED = 100
"""Samples from the mixture of first states."""
_CLIPS_AT_ONCE = 4

OURS = "held by the ground (default)"
NETWORKS = "body at the joints"
WAYS: dict[str, tuple[float, Footing | None]] = {
    NETWORKS: (1.0, None),
    OURS: (TEMPERATURE, Footing()),
    f"default, temperature {WARM}": (WARM, Footing()),
}
"""The temperature of the latents, and who holds the body."""

COLUMNS: Columns = {
    "ade": ("ADE", 100), "fde": ("FDE", 100), "ade_mean": ("ADE, a sample", 100),
    "ade_of_mean": ("ADE, mean of all", 100),
    "apd_upright": ("APD, on their feet", 100), "apd": ("APD, all", 100),
    "speed": ("speed", 1), "accel": ("accel", 1),
}  # fmt: skip
FEET_COLUMNS: Columns = {
    "count": ("motions", 1), "stays": ("on its feet %", 100), "upright": ("upright %", 100),
    "ground": ("on ground %", 100), "human_speed": ("human speed %", 100),
    "foot_low": ("foot 1 %, cm", 100), "foot_high": ("foot 99 %, cm", 100),
    "speed": ("mean speed", 1),
}  # fmt: skip
CONTACT_COLUMNS: Columns = {"accuracy": ("nine joints %", 100), "feet": ("feet, balanced %", 100)}


def main() -> None:
    parser = over_windows(__doc__)
    parser.add_argument("--weights", default=None, help="as Humor.load takes them")
    arguments = parser.parse_args()

    began = time.perf_counter()
    body, splits = BodyModel.load(), Splits.load(arguments.splits)
    windows = load_windows(arguments.corpus, splits, arguments.part, body, SEED)
    humor = Humor.load(arguments.weights)
    first = first_states(arguments.corpus, windows, body)
    scene = Scene(windows, first, body.pose(windows.truth).joints, body)

    generated = {name: generate(humor, scene, *way) for name, way in WAYS.items()}
    prediction = {name: predicted(found, scene) for name, found in generated.items()}
    for name, joints in simple_predictions(first).items():
        prediction[name] = predicted(Generated(joints, None), scene)
    prediction["truth"] = by_subject(windows, [motion_of(one) for one in scene.truth])
    feet = feet_rows(humor, generated, scene, clip_files(arguments.corpus))
    contacts = contact_rows(humor, generated[OURS], scene)
    seconds = time.perf_counter() - began

    console = Console(width=None if sys.stdout.isatty() else 140)
    means = {name: rows["mean"] for name, rows in prediction.items()}
    title = f"{arguments.part}: mean over subjects; cm, m/s, m/s²"
    console.print(table(title, COLUMNS, means))
    console.print(table("for 5 s", FEET_COLUMNS, feet))
    console.print(table("contacts", CONTACT_COLUMNS, contacts))
    console.print(f"{seconds:.0f} s")
    if arguments.json is not None:
        about = {
            "part": arguments.part, "weights": str(arguments.weights), "samples": SAMPLES,
            "windows": windows.names, "seconds": round(seconds, 1),
        }  # fmt: skip
        tables = {"prediction": prediction, "on their feet": feet, "contacts": contacts}
        source = corpus_source(arguments.corpus, windows.files)
        write(arguments.json, SEED, source, **about, tables=tables)  # fmt: skip


@dataclass(frozen=True)
class Scene:
    """What is known, and what happened."""

    windows: TrueWindows
    first: State
    truth: Float[Tensor, "clips time 22 3"]
    body: BodyModel

    @property
    def rest_heights(self) -> Float[Tensor, "clips 22"]:
        """Heights of the joints of every window's body at rest."""
        return rest_heights(self.body, self.windows.truth.shape)


@dataclass(frozen=True)
class Generated:
    """What follows every first state, in samples; joints may be fewer frames than 5 s."""

    joints: Float[Tensor, "clips samples time 22 3"]
    contacts: Float[Tensor, "clips samples time 22"] | None


def first_states(corpus: Path, windows: TrueWindows, body: BodyModel) -> State:
    """The first state of every window; velocities are by the frames beside it in the recording."""
    files = clip_files(corpus)
    states: list[State] = []
    for name, shape in zip(windows.names, windows.truth.shape, strict=True):
        clip, seconds = name.rsplit("@", 1)
        motion = load_motion(files[clip]).motion
        frame = round(round(float(seconds) * FPS) / FPS * motion.fps)
        beside = motion.window(max(frame - 1, 0), frame + 2).replace(shape=shape)
        states.append(states_of(beside[None], body)[0][min(frame, 1)])
    return stack(states)


@torch.no_grad()
def generate(humor: Humor, scene: Scene, temperature: float, footing: Footing | None) -> Generated:
    """All samples of all windows, a few windows at a time to bound memory."""
    random = torch.Generator().manual_seed(SEED)
    shape, count = scene.windows.truth.shape, len(scene.truth)
    joints: list[Tensor] = []
    contacts: list[Tensor] = []

    def repeated(tensor: Tensor) -> Tensor:
        return tensor.repeat_interleave(SAMPLES, 0)

    for start in range(0, count, _CLIPS_AT_ONCE):
        some = slice(start, start + _CLIPS_AT_ONCE)
        first = scene.first[some].map(repeated)
        made = roll_from(
            humor,
            first,
            repeated(shape[some]),
            round(SECONDS * FPS) + 1,
            random,
            temperature=temperature,
            footing=footing,
        )
        assert made.contacts is not None
        joints.append(scene.body.pose(made.motion).joints.unflatten(0, (-1, SAMPLES)))
        contacts.append(made.contacts.unflatten(0, (-1, SAMPLES)))
    return Generated(torch.cat(joints), torch.cat(contacts))


def simple_predictions(first: State) -> dict[str, Float[Tensor, "clips 1 time 22 3"]]:
    """The body as it stands, still or sliding on with the pelvis' horizontal velocity."""
    seconds = torch.arange(FRAMES)[:, None, None] / FPS
    level = first.velocity.new_tensor([1.0, 1.0, 0.0])
    still = first.joints[:, None, None].expand(-1, 1, FRAMES, -1, -1)
    slide = (first.velocity * level)[:, None, None, None] * seconds
    return {"constant velocity": still + slide, "stand still": still}


def predicted(found: Generated, scene: Scene) -> Rows:
    """Table 1's columns of every subject and their mean; the given first frame does not count."""
    rows: list[Row] = []
    for joints, truth, heights in zip(found.joints, scene.truth, scene.rest_heights, strict=True):
        away = displacements(joints[:, 1:FRAMES], truth[1:])
        average = away.mean(-1)
        stays = generation_metrics.stays_on_its_feet(joints, heights, FPS)
        rows.append(
            {
                "ade": average.min().item(),
                "fde": away[average.argmin(), -1].item(),
                "ade_mean": average.mean().item(),
                "ade_of_mean": displacements(joints[:, 1:FRAMES].mean(0), truth[1:]).mean().item(),
                "apd": pairwise_distance(joints),
                "apd_upright": pairwise_distance(joints[stays]),
                **motion_of(joints[:, :FRAMES]),
            }
        )
    return by_subject(scene.windows, rows)


def motion_of(joints: Float[Tensor, "*samples time 22 3"]) -> Row:
    """How much moves: mean speed, m/s, and acceleration, m/s², of the joints over 2 s."""
    return {
        "speed": metrics.mean(joints.diff(dim=-3).norm(dim=-1) * FPS),
        "accel": metrics.mean(metrics.accelerations(joints, FPS).norm(dim=-1)),
    }


def feet_rows(
    humor: Humor, generated: dict[str, Generated], scene: Scene, files: dict[str, Path]
) -> dict[str, Row]:
    """Shares of motions that stay on their feet: samples, and the listed clips as recorded."""
    body = scene.body
    rows: dict[str, Row] = {}
    for name, footing in (("from the mixture", Footing()), ("from the mixture, networks", None)):
        frames, temperature = round(SECONDS * FPS) + 1, 1.0 if footing is None else TEMPERATURE
        made = sample(
            humor, frames, UNCONDITIONED, seeded(), temperature=temperature, footing=footing
        ).motion
        joints = body.pose(made).joints
        rows[name] = feet_of([joints], [rest_heights(body, made.shape)])
        rows[name]["speed"] = motion_of(joints)["speed"]
    real = list(scene.rest_heights[:, None])
    for name, found in generated.items():
        rows[f"from real states, {name}"] = feet_of(list(found.joints), real)
    clips = sorted({name.rsplit("@", 1)[0] for name in scene.windows.names})
    recorded = [pieces(load_motion(files[clip]).motion.resample(FPS)) for clip in clips]
    rows["as recorded, up to 5 s"] = feet_of(
        [body.pose(m).joints[None] for own in recorded for m in own],
        [rest_heights(body, m.shape)[None] for own in recorded for m in own],
    )
    return rows


def pieces(motion: Motion) -> list[Motion]:
    """A recording in pieces of at most 5 s; a rest of less than 2 s is left out."""
    most = round(SECONDS * FPS) + 1
    found = [motion.window(k, k + most) for k in range(0, motion.frames, most)]
    return [m for m in found if m.frames >= FRAMES]


def feet_of(joints: list[Float[Tensor, "_ _ 22 3"]], heights: list[Float[Tensor, "_ 22"]]) -> Row:
    """Shares over all motions, and how low and how high the lower foot is."""
    pairs = list(zip(joints, heights, strict=True))
    g = generation_metrics

    def share(kept: list[Bool[Tensor, " _"]]) -> float:
        return torch.cat(kept).double().mean().item()

    low = torch.cat([g.lowest_foot(j, h).flatten() for j, h in pairs]).sort().values
    return {
        "count": float(sum(len(j) for j in joints)),
        "stays": share([g.stays_on_its_feet(j, h, FPS) for j, h in pairs]),
        "upright": share([g.stays_upright(j, h) for j, h in pairs]),
        "ground": share([g.stays_on_ground(j, h, FPS) for j, h in pairs]),
        "human_speed": share([g.moves_as_people_do(j, FPS) for j, h in pairs]),
        "foot_low": low[round(0.01 * (len(low) - 1))].item(),
        "foot_high": low[round(0.99 * (len(low) - 1))].item(),
    }


@torch.no_grad()
def contact_rows(humor: Humor, found: Generated, scene: Scene) -> dict[str, Row]:
    """What the network says of contacts, against labels made from positions and speeds."""
    truth = scene.windows.contacts
    assert found.contacts is not None
    saying = found.contacts > 0.5
    average = displacements(found.joints[:, :, 1:FRAMES], scene.truth[:, None, 1:]).mean(-1)
    best = saying[torch.arange(len(saying)), average.argmin(1), :FRAMES]
    heights = scene.rest_heights[:, None].expand(-1, SAMPLES, -1)
    common = truth.flatten(0, 1).double().mean(0) > 0.5
    return {
        "of true steps": agreement(step_contacts(humor, scene), truth[:, 1:]),
        "of the prediction, against the truth": agreement(best[:, 1:], truth[:, 1:]),
        "of all samples, against their own feet": agreement(
            saying, contact_labels(found.joints, heights, FPS)
        ),
        "each joint's more frequent label": agreement(common.expand_as(truth), truth),
    }


def step_contacts(humor: Humor, scene: Scene) -> Bool[Tensor, "clips steps 22"]:
    """Contacts when the truth is encoded, step by step."""
    states = states_of(scene.windows.truth, humor.body)
    pelvis = humor.pelvis(scene.windows.truth.shape)[:, None]
    past, future = states.map(lambda t: t[:, :-1]), states.map(lambda t: t[:, 1:])
    frame = Frame.of(past)
    before, after = (frame.enter(s, pelvis).pack() for s in (past, future))
    before, after = before.flatten(0, 1), after.flatten(0, 1)
    logits = humor.networks.decode(before, humor.networks.posterior(before, after)[0])[:, -9:]
    said = torch.zeros(len(logits), len(JOINTS), dtype=torch.bool)
    said[:, list(CONTACT_JOINTS)] = logits > 0
    return said.unflatten(0, (*states.translation.shape[:1], -1))


def agreement(said: Bool[Tensor, "*frames 22"], truth: Bool[Tensor, "*frames 22"]) -> Row:
    """Share of equal labels of HuMoR's nine joints, and balanced over the feet's four."""
    return {
        "accuracy": metrics.contact_accuracy(said, truth),
        "feet": metrics.contact_balanced_accuracy(said, truth, FEET),
    }


def seeded() -> torch.Generator:
    return torch.Generator().manual_seed(SEED)


def table(title: str, columns: Columns, rows: dict[str, Row]) -> Table:
    shown = Table(title=title, title_justify="left")
    shown.add_column("")
    for heading, _ in columns.values():
        shown.add_column(heading, justify="right")
    for name, row in rows.items():
        shown.add_row(name, *(cell(row.get(k), f) for k, (_, f) in columns.items()))
    return shown


if __name__ == "__main__":
    main()

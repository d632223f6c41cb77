"""Cameras that move though nobody says so: how many are found, and how many fixed ones suspected?

    python -m benchmarks.undeclared CORPUS --part validation --json undeclared.json

Windows of 90 frames in the film of a phone of unknown pose, three pixels of noise (openpose25). A
hand turns a phone about all axes at 0.2 to 2 Hz, with a tremor of a tenth of that at 6 to 10 Hz;
who walks turns it as much again with every step. Root mean squares of the turn about an axis:

* `in the hand`: 0.4 degrees, standing on a spot. Hands turn phones by less than half a degree;
* `slow pan`: 4 to 12 degrees per second whatever the person does, and 0.15 degrees by hand;
* `following`: panned to where the person is, from a spot, and 0.3 degrees by hand;
* `alongside`: carried beside the person at their speed, at least 0.5 m/s, and 0.4 degrees by hand;
* `around`: carried around the person by 57 degrees, and 0.4 degrees by hand.

Beside these, hard ones: `steady hand`, 0.2 degrees, as optical stabilisation leaves, and `gimbal`,
carried around as before without any turn by hand. Fixed cameras look from three directions.

Clips of which the image alone does not tell, as no part of a foot quite rests, are fitted, by the
pose prior, and judged by the fit; with `--fit` all are of which the image does not tell.
"""

import math
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float
from rich.console import Console
from rich.table import Table

from benchmarks.arguments import over_windows
from benchmarks.results import corpus_source, write
from observations.keypoints2d import Keypoints2D
from recon.benchmark.dataset import Splits
from recon.benchmark.windows import TrueWindows, load_windows
from recon.body.model import BodyModel
from recon.core import rotations as so3
from recon.core.camera import Camera, looking
from recon.core.motion import Motion
from recon.core.struct import concatenate
from recon.diagnosis.motions.carried import carried_finding
from recon.diagnosis.views.images import Images
from recon.diagnosis.views.rest import Rest, rest_of
from recon.fitting.clip import fit_clip
from recon.fitting.methods import FitOptions
from recon.formats.calibration import guessed_camera
from recon.reading.images import keypoints_of
from recon.simulation.images import dome, keypoints2d, orbiting
from recon.simulation.points import Corruption

SEED = 0
FRAMES = 90
PIXELS = 3.0
SIZE = (1920, 1080)
DIRECTIONS = 3
PER_KIND = 10
_ORBIT = 1.0
_TOGETHER = 23
_STEPS = (1.8, 0.9, 0.9)
"""Times per second that steps turn a phone about its axes x, y, z."""


def main() -> None:
    parser = over_windows(__doc__)
    parser.add_argument("--each", type=int, default=PER_KIND, help="clips of each kind")
    parser.add_argument("--directions", type=int, default=DIRECTIONS)
    parser.add_argument("--fit", action="store_true", help="fit clips whose feet rest, too")
    arguments = parser.parse_args()
    body = BodyModel.load()
    windows = load_windows(
        arguments.corpus, Splits.load(arguments.splits), arguments.part, body, SEED, FRAMES
    )
    clips = fixed(windows, body, arguments.directions) + moving(windows, body, arguments.each)
    rows = judged(clips, body, every=arguments.fit)
    Console(width=None if sys.stdout.isatty() else 160).print(_table(rows))
    if arguments.json is not None:
        about = {"part": arguments.part, **windows.about}
        source = corpus_source(arguments.corpus, windows.files)
        write(arguments.json, SEED, source, **about, clips=rows)


Clip = dict[str, str | float | bool | None]
"""Kind, window, speed of what rests most in m/s, and whether the camera was said to move."""


@dataclass(frozen=True)
class Undeclared:
    """A clip whose camera is believed to be fixed."""

    kind: str
    window: str
    view: Keypoints2D
    rest: Rest | None


def fixed(windows: TrueWindows, body: BodyModel, directions: int) -> list[Undeclared]:
    """Every window before fixed cameras."""
    return [
        _filmed("fixed", windows, k, _placed(windows.truth[k], body, k, turn), body, 10 * k + turn)
        for k in range(len(windows.names))
        for turn in range(directions)
    ]


def moving(windows: TrueWindows, body: BodyModel, each: int) -> list[Undeclared]:
    """Windows by turns before every kind of moving camera."""
    out: list[Undeclared] = []
    for number, (kind, carried) in enumerate(CARRIED.items()):
        for turn in range(each):
            k = (turn + number * each) % len(windows.names)
            random = np.random.default_rng([SEED, number, turn])
            truth = windows.truth[k]
            camera = carried(truth, body, _placed(truth, body, k, turn), random)
            out.append(_filmed(kind, windows, k, camera, body, 5000 + 100 * number + turn))
    return out


def _filmed(
    kind: str, windows: TrueWindows, k: int, camera: Camera, body: BodyModel, seed: int
) -> Undeclared:
    file = keypoints2d(windows.truth[k], body, camera, Corruption(noise=PIXELS), seed)
    lost = replace(file, camera=replace(file.camera, T_camera_world=None))
    view = keypoints_of(lost, body)
    return Undeclared(kind, windows.names[k], view, rest_of(Images.of([view], ["phone"], body)))


def judged(clips: Sequence[Undeclared], body: BodyModel, *, every: bool) -> list[Clip]:
    """What is said of every clip; those that need a fit are fitted together.

    Args:
        clips: with what their images tell.
        body: that is fitted.
        every: whether clips whose feet rest are fitted, too.
    """
    said = [clip.rest is not None and clip.rest.moves for clip in clips]
    undecided = [clip.rest is None or clip.rest.may_move or every for clip in clips]
    rows = [k for k in range(len(clips)) if undecided[k] and not said[k]]
    for begin in range(0, len(rows), _TOGETHER):
        some = rows[begin : begin + _TOGETHER]
        views = concatenate([clips[k].view for k in some])
        found = fit_clip([views], FitOptions(prior="pose"), body).result
        for row, k in enumerate(some):
            rest = clips[k].rest
            rests = rest is not None and not rest.may_move
            motion = found.clip(row).detach()
            said[k] = carried_finding("phone", motion, body, rests=rests) is not None
    return [
        {
            "kind": clip.kind,
            "window": clip.window,
            "speed": None if clip.rest is None else clip.rest.speed,
            "said": own,
        }
        for clip, own in zip(clips, said, strict=True)
    ]


def _placed(truth: Motion, body: BodyModel, k: int, turn: int) -> Camera:
    lens = Camera.create(guessed_camera(SIZE).camera_matrix, SIZE)
    (camera,) = dome(truth, body, lens, 1, first=2.4 * k + 2.1 * turn)
    return camera


def _in_hand(
    camera: Camera,
    truth: Motion,
    degrees: float,
    random: np.random.Generator,
    *,
    walks: bool = False,
) -> Camera:
    """The camera turned as a hand turns it."""
    seconds = np.arange(truth.frames) / truth.fps
    turns = np.zeros((truth.frames, 3))
    for axis in range(3):
        slow = _band(seconds, np.linspace(0.2, 2.0, 10), random)
        tremor = _band(seconds, np.linspace(6.0, 10.0, 5), random)
        turns[:, axis] = slow + 0.1 * tremor
        if walks:
            turns[:, axis] += _band(seconds, np.array([_STEPS[axis]]), random)
    vectors = torch.from_numpy(np.radians(degrees * turns)).to(camera.T_camera_world)
    return camera.replace(T_camera_world=so3.rigid(so3.exp(vectors), torch.zeros_like(vectors))
                          @ camera.T_camera_world)  # fmt: skip


def _band(
    seconds: Float[np.ndarray, " time"],
    frequencies: Float[np.ndarray, " lines"],
    random: np.random.Generator,
) -> Float[np.ndarray, " time"]:
    """A sum of waves whose mean square is 1, slower ones larger."""
    sizes = 1 / np.sqrt(frequencies)
    phases = random.uniform(0, math.tau, len(frequencies))
    waves = np.cos(math.tau * seconds[:, None] * frequencies + phases)
    return waves @ sizes * np.sqrt(2 / np.square(sizes).sum())


def _hand(truth: Motion, body: BodyModel, camera: Camera, random: np.random.Generator) -> Camera:
    del body
    return _in_hand(camera, truth, 0.4, random)


def _steady(truth: Motion, body: BodyModel, camera: Camera, random: np.random.Generator) -> Camera:
    del body
    return _in_hand(camera, truth, 0.2, random)


def _pan(truth: Motion, body: BodyModel, camera: Camera, random: np.random.Generator) -> Camera:
    del body
    rate = math.radians(random.uniform(4, 12)) * random.choice([-1.0, 1.0])
    seconds = (torch.arange(truth.frames) - truth.frames / 2) / truth.fps
    vectors = torch.zeros(truth.frames, 3)
    vectors[:, 1] = rate * seconds
    turn = so3.rigid(so3.exp(vectors), torch.zeros_like(vectors))
    panned = camera.replace(T_camera_world=turn.to(camera.T_camera_world) @ camera.T_camera_world)
    return _in_hand(panned, truth, 0.15, random)


def _following(
    truth: Motion, body: BodyModel, camera: Camera, random: np.random.Generator
) -> Camera:
    middle = _smooth(body.pose(truth).joints[:, 0])
    eye = camera.T_world_camera[:3, 3]
    poses = torch.stack(
        [looking(eye, torch.stack((x, y, torch.ones_like(x)))) for x, y, _ in middle]
    )
    return _in_hand(camera.replace(T_camera_world=poses), truth, 0.3, random)


def _alongside(
    truth: Motion, body: BodyModel, camera: Camera, random: np.random.Generator
) -> Camera:
    del body
    way = truth.translation[-1] - truth.translation[0]
    way = way * way.new_tensor([1.0, 1.0, 0.0])
    seconds = (truth.frames - 1) / truth.fps
    speed = max(float(way.norm()) / seconds, 0.5)
    step = way / way.norm().clamp(min=1e-6) * speed / truth.fps
    steps = (torch.arange(truth.frames) - truth.frames / 2)[:, None] * step
    poses = camera.T_world_camera.expand(truth.frames, 4, 4).clone()
    poses[:, :3, 3] += steps.to(poses)
    carried = camera.replace(T_camera_world=torch.linalg.inv(poses))
    return _in_hand(carried, truth, 0.4, random, walks=True)


def _around(truth: Motion, body: BodyModel, camera: Camera, random: np.random.Generator) -> Camera:
    return _in_hand(_gimbal(truth, body, camera, random), truth, 0.4, random, walks=True)


def _gimbal(truth: Motion, body: BodyModel, camera: Camera, random: np.random.Generator) -> Camera:
    middle = body.pose(truth).joints.flatten(0, 1).mean(0)
    return orbiting(camera, middle, truth.frames, _ORBIT * float(random.choice([-1.0, 1.0])))


def _smooth(path: Float[torch.Tensor, "time 3"]) -> Float[torch.Tensor, "time 3"]:
    """A path as somebody with a phone follows it: over a second."""
    kernel = np.hanning(31) / np.hanning(31).sum()
    wide = np.pad(path.numpy(), ((15, 15), (0, 0)), mode="edge")
    out = np.stack([np.convolve(wide[:, axis], kernel, "valid") for axis in range(3)], -1)
    return torch.from_numpy(out).to(path)


CARRIED: dict[str, Callable[[Motion, BodyModel, Camera, np.random.Generator], Camera]] = {
    "in the hand": _hand, "slow pan": _pan, "following": _following, "alongside": _alongside,
    "around": _around, "steady hand": _steady, "gimbal": _gimbal,
}  # fmt: skip
HARD = ("steady hand", "gimbal")
"""Kinds that are counted beside the others."""


def _table(rows: Sequence[Clip]) -> Table:
    table = Table(title="cameras that move though nobody says so", title_justify="left")
    for heading in ("camera", "clips", "said to move", "share %"):
        table.add_column(heading, justify="right")
    usual = [row for row in rows if row["kind"] not in ("fixed", *HARD)]
    groups = {kind: [row for row in rows if row["kind"] == kind] for kind in ("fixed", *CARRIED)}
    for kind, own in (groups | {"moving, without the hard ones": usual}).items():
        said = sum(bool(row["said"]) for row in own)
        table.add_row(kind, str(len(own)), str(said), f"{100 * said / max(len(own), 1):.0f}")
    return table


if __name__ == "__main__":
    main()

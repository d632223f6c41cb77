"""Errors of a network's estimates of test windows, refined, and of plain fits to them.

    python -m benchmarks.refine CORPUS --out FOLDER
    python -m benchmarks.refine CORPUS --part validation --only 8

Estimates have the errors of `RegressorErrors`: biased and wandering joints, jitter, a
limb hidden for a second, legs exchanged for moments, a path that drifts. Columns: mean error of
joints in the world and about the pelvis, of accelerations; speed of feet that stand along the
ground; and, of hands and toes that are faster than 3 m/s in truth, the ratio of their highest
speed to the true one and how far it is from one. Baselines: the estimate itself, and its joints
taken as independent noise by `recon.fit` (pose prior, HuMoR).
"""

import time
from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Generator, Tensor

import recon
from benchmarks.protocol import (
    Metrics,
    Table,
    cells,
    columns_of,
    corpus_source,
    evenly,
    over_windows,
    tell,
)
from recon import BodyModel, Joints3D, Motion
from recon.benchmark.dataset import Splits
from recon.benchmark.windows import FPS, load_windows
from recon.core import rotations as so3
from recon.core.skeleton import FEET, JOINTS, TOES
from training.recordings import mirrored_rotations

_LEGS = tuple(
    k for k, name in enumerate(JOINTS) if any(part in name for part in ("hip", "knee", "ankle"))
)
_LIMBS = tuple(
    tuple(JOINTS.index(f"{side}_{part}") for part in parts)
    for side in ("left", "right")
    for parts in (("hip", "knee", "ankle", "foot"), ("shoulder", "elbow", "wrist"))
)


@dataclass(frozen=True)
class RegressorErrors:
    """Sizes of the errors; the defaults are near what is published of networks on video.

    They give about 7 cm of joints after aligning the pelvis and 10 m/s² of acceleration, between
    what is published of networks that see a clip (WHAM, GVHMR on EMDB: 6 to 8 cm, 4 to 6 m/s²)
    and of those that see a frame (HMR 2.0: 7 to 12 cm, 18 to 25 m/s²).
    """

    bias: float = 0.05
    """Constant error of every joint's rotation, standard deviation per axis, radians."""
    slow: float = 0.05
    """Error of every joint's rotation that changes slowly, radians."""
    slow_seconds: float = 0.7
    """Time after which the correlation of what changes slowly has fallen to one half."""
    jitter: float = 0.006
    """Error of every joint's rotation that is another in every frame at 30 Hz, radians."""
    heading: float = 0.02
    """Drift of the heading, radians for every square root of a second."""
    drift: float = 0.08
    """Standard deviation per axis of the error of the path's velocity, m/s."""
    drift_seconds: float = 1.0
    """Time after which its correlation has fallen to one half."""
    place_jitter: float = 0.003
    """Error of the place that is another in every frame, metres per axis."""
    swaps: float = 0.1
    """Exchanges of the legs per second, each of 0.1 to 0.2 s."""
    occlusion: float = 1.0
    """Seconds for which one limb is hidden: it keeps its posture of the first moment."""
    occluded: float = 2.0
    """How many times as much its joints err then."""


def estimated(motion: Motion, errors: RegressorErrors, seed: int = 0) -> Motion:
    """The motion of one clip (no leading axis) as a network would have told it.

    Args:
        motion: the truth.
        errors: what the network gets wrong.
        seed: of the errors.
    """
    generator = torch.Generator().manual_seed(seed)
    frames, fps = motion.frames, motion.fps
    like = motion.translation

    def normal(*shape: int) -> Tensor:
        return torch.randn(*shape, generator=generator, dtype=torch.float64).to(like)

    turns = errors.bias * normal(1, len(JOINTS), 3)
    wander = errors.slow * _wander(normal(frames, len(JOINTS), 3), fps, errors.slow_seconds)
    shake = errors.jitter * normal(frames, len(JOINTS), 3)
    rotations, blame = _occluded(motion, errors, generator)
    rotations = _swapped(rotations, errors, fps, generator)
    rotations = rotations @ so3.exp((turns + wander) * blame[..., None] + shake)
    heading = (errors.heading / fps**0.5 * normal(frames)).cumsum(0)
    about = so3.about_z(heading)
    rotations = torch.cat((about[:, None] @ rotations[:, :1], rotations[:, 1:]), 1)
    velocity = errors.drift * _wander(normal(frames, 3), fps, errors.drift_seconds)
    steps = (about[:-1] @ motion.translation.diff(dim=0)[..., None])[..., 0]
    path = torch.cat((motion.translation[:1], motion.translation[:1] + steps.cumsum(0)))
    path = path + velocity.cumsum(0) / fps + errors.place_jitter * normal(frames, 3)
    return motion.replace(translation=path, rotations=rotations)


def _wander(
    white: Float[Tensor, "time ..."], fps: float, seconds: float
) -> Float[Tensor, "time ..."]:
    """Unit noise that changes smoothly (Matérn's of smoothness 3/2), from unit white noise."""
    times = torch.arange(len(white), dtype=torch.float64) / fps
    away = 3**0.5 * (times[:, None] - times).abs() / seconds
    covariance = (1 + away) * (-away).exp()
    root = torch.linalg.cholesky(covariance + 1e-9 * torch.eye(len(white), dtype=torch.float64))
    return torch.einsum("ts,s...->t...", root.to(white), white)


def _occluded(
    motion: Motion, errors: RegressorErrors, generator: Generator
) -> tuple[Float[Tensor, "time 22 3 3"], Float[Tensor, "time 22"]]:
    """One limb hidden for a while, and how many times as much every joint errs."""
    rotations, blame = motion.rotations.clone(), motion.translation.new_ones(motion.frames, 22)
    length = round(errors.occlusion * motion.fps)
    if not 0 < length < motion.frames:
        return rotations, blame
    first = int(torch.randint(motion.frames - length, (), generator=generator))
    limb = list(_LIMBS[int(torch.randint(len(_LIMBS), (), generator=generator))])
    rotations[first : first + length, limb] = rotations[first, limb]
    blame[first : first + length, limb] = errors.occluded
    return rotations, blame


def _swapped(
    rotations: Float[Tensor, "time 22 3 3"],
    errors: RegressorErrors,
    fps: float,
    generator: Generator,
) -> Float[Tensor, "time 22 3 3"]:
    """The legs exchanged for moments: each does what the other does, mirrored."""
    swapped, mirrored = rotations.clone(), mirrored_rotations(rotations)
    for start in range(len(rotations)):
        if float(torch.rand((), generator=generator)) < errors.swaps / fps:
            length = float(torch.rand((), generator=generator)) * 0.1 + 0.1
            frames = slice(start, start + max(round(length * fps), 1))
            swapped[frames, list(_LEGS)] = mirrored[frames, list(_LEGS)]
    return swapped


SEED = 0
FAST = 3.0
"""Speed above which a hand or toe counts as fast, metres per second."""
_ENDS = (JOINTS.index("left_wrist"), JOINTS.index("right_wrist"), *TOES)
COLUMNS: Metrics = {
    "joints": ("joints, cm", 100, 1), "about_pelvis": ("about the pelvis, cm", 100, 2),
    "acceleration": ("acceleration, m/s²", 1, 1), "slip": ("slip, cm/s", 100, 1),
    "peak": ("peak speed / true", 1, 2), "peak_error": ("off by, %", 100, 0),
    "seconds": ("CPU s", 1, 1),
}  # fmt: skip

Method = Callable[[Motion, BodyModel], Motion]


def as_joints(prior: str) -> Method:
    """Its joints as independent noise."""

    def fitted(motion: Motion, body: BodyModel) -> Motion:
        joints = body.pose(motion).joints.detach()
        seen = Joints3D(
            joints, torch.ones(joints.shape[:-1], dtype=torch.bool), tuple(range(22)), motion.fps,
            ground_known=False,
        )  # fmt: skip
        return recon.fit(seen, prior, body=body, shape=motion.shape, start=motion).motion

    return fitted


def refined(prior: str) -> Method:
    """`recon.refine`."""
    return lambda motion, body: recon.refine(motion, prior, body=body).motion


METHODS: dict[str, Method] = {
    "the estimate": lambda motion, body: motion,
    "its joints, pose prior": as_joints("pose"),
    "its joints, HuMoR": as_joints("humor"),
    "refined, pose prior": refined("pose"),
    "refined, HuMoR": refined("humor"),
}


def main() -> None:
    """Estimate, refine, judge, print and write."""
    arguments = over_windows(__doc__)
    arguments.set_defaults(only=12)
    given = arguments.parse_args()
    torch.set_num_threads(1)
    body = BodyModel.load()
    windows = load_windows(given.corpus, Splits.load(given.splits), given.part, body)
    chosen = evenly(windows, given.only)
    some = windows.take(chosen)
    values: dict[str, dict[str, list[float | None]]] = {m: {} for m in METHODS}
    for number, clip in enumerate(chosen):
        truth = some.truth[number]
        seen = estimated(truth, RegressorErrors(), SEED + clip)
        for name, method in METHODS.items():
            began = time.process_time()
            found = method(seen, body)
            row = judged(found, truth, some.contacts[number], body)
            for key, value in {**row, "seconds": time.process_time() - began}.items():
                values[name].setdefault(key, []).append(value)
    rows = [[name, *cells(own, some, COLUMNS)] for name, own in values.items()]
    source = corpus_source(given.corpus, windows.files)
    tell(given.out, SEED, source, {"refine": Table(columns_of("", COLUMNS), rows)})


def judged(
    found: Motion, truth: Motion, contacts: Bool[Tensor, "time 22"], body: BodyModel
) -> dict[str, float | None]:
    """Errors of one window, SI units."""
    frames = min(found.frames, truth.frames)
    own, true = (body.pose(m).joints.detach()[:frames].double() for m in (found, truth))
    about = (own - own[:, :1]) - (true - true[:, :1])
    bends = (own - true).diff(n=2, dim=0) * FPS**2
    stands = contacts[1:frames, list(FEET)] & contacts[: frames - 1, list(FEET)]
    slip = own[:, list(FEET), :2].diff(dim=0).norm(dim=-1) * FPS
    fast, peak = (_peaks(joints) for joints in (true, own))
    quick = fast > FAST
    ratio = (peak / fast)[quick]
    return {
        "joints": float((own - true).norm(dim=-1).mean()),
        "about_pelvis": float(about.norm(dim=-1).mean()),
        "acceleration": float(bends.norm(dim=-1).mean()),
        "slip": float(slip[stands].mean()) if stands.any() else None,
        "peak": float(ratio.mean()) if quick.any() else None,
        "peak_error": float((ratio - 1).abs().mean()) if quick.any() else None,
    }


def _peaks(joints: Float[Tensor, "time 22 3"]) -> Float[Tensor, " ends"]:
    """Highest speed of hands and toes, m/s."""
    return (joints[:, list(_ENDS)].diff(dim=0).norm(dim=-1) * FPS).amax(0)


if __name__ == "__main__":
    main()

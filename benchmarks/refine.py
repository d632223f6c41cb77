"""Measures how `recon.refine` improves a network's estimates of test windows.

    python -m benchmarks.refine CORPUS --out FOLDER
    python -m benchmarks.refine CORPUS --part validation --only 8

Estimates have the errors of `RegressorErrors`: biased and wandering joints, jitter, a limb hidden
for a second, legs exchanged for moments, a path that drifts. Columns: mean error of joints in the
world and about the pelvis, of accelerations; horizontal speed of feet that stand; and, of hands
and toes that are faster than 3 m/s in truth, the ratio of their highest speed to the true one, and
its deviation from one. Baselines: the estimate itself, and fits by `recon.fit` (pose prior, HuMoR)
that take its joints as having independent noise.

Files of SAM 3D Body are made from the same windows: 70 points as one camera sees them, with 15 mm
of noise; sizes, depths and focal lengths of single images have errors of 2, 3 and 2 %. Their
columns are computed for these points after one rotation and shift of the clip, with wrists and
ankles in place of toes.
"""

import re
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Generator, Tensor

import recon
from benchmarks.protocol import Metrics, Table, cells, columns_of, evenly, over_windows, tell_of
from observations.correspondences import PLACES, BodyPoints
from recon import BodyModel, Joints3D, Motion
from recon.benchmark.dataset import Splits
from recon.benchmark.windows import FPS, load_windows
from recon.core import rotations as so3
from recon.core.camera import full_hd_camera
from recon.core.skeleton import FEET, JOINTS, TOES
from recon.keypoints3d.layouts import MHR70
from recon.simulation.images import camera_ring
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
    """Sizes of simulated errors; the defaults resemble published ones of networks on video.

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
    """Error of every joint's rotation, independent in every frame at 30 Hz, radians."""
    heading: float = 0.02
    """Drift of the heading, radians for every square root of a second."""
    drift: float = 0.08
    """Standard deviation per axis of the error of the path's velocity, m/s."""
    drift_seconds: float = 1.0
    """Time after which the correlation of the path's velocity error has fallen to one half."""
    place_jitter: float = 0.003
    """Error of the position, independent in every frame, metres per axis."""
    swaps: float = 0.1
    """Number of exchanges of the legs per second, each lasting 0.1 to 0.2 s."""
    occlusion: float = 1.0
    """Seconds for which one limb is hidden: it keeps its posture of the first frame."""
    occluded: float = 2.0
    """Factor by which the errors of the hidden joints are larger."""


def estimated(motion: Motion, errors: RegressorErrors, seed: int = 0) -> Motion:
    """Return a clip's motion with the simulated errors of a network.

    Args:
        motion: true motion, without a batch axis.
        errors: sizes of the errors.
        seed: seed of the random errors.
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
    """Filter unit white noise to unit noise that changes smoothly (Matérn, smoothness 3/2)."""
    times = torch.arange(len(white), dtype=torch.float64) / fps
    away = 3**0.5 * (times[:, None] - times).abs() / seconds
    covariance = (1 + away) * (-away).exp()
    root = torch.linalg.cholesky(covariance + 1e-9 * torch.eye(len(white), dtype=torch.float64))
    return torch.einsum("ts,s...->t...", root.to(white), white)


def _occluded(
    motion: Motion, errors: RegressorErrors, generator: Generator
) -> tuple[Float[Tensor, "time 22 3 3"], Float[Tensor, "time 22"]]:
    """Hide one limb for a while; also return the factor of every joint's errors."""
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
    """Exchange the legs for some moments: each moves like the other one, mirrored."""
    swapped, mirrored = rotations.clone(), mirrored_rotations(rotations)
    for start in range(len(rotations)):
        if float(torch.rand((), generator=generator)) < errors.swaps / fps:
            length = float(torch.rand((), generator=generator)) * 0.1 + 0.1
            frames = slice(start, start + max(round(length * fps), 1))
            swapped[frames, list(_LEGS)] = mirrored[frames, list(_LEGS)]
    return swapped


SEED = 0
FAST = 3.0
"""True speed (m/s) above which a hand or toe counts as fast."""
_ROWS = ([0], FEET, (JOINTS.index("left_wrist"), JOINTS.index("right_wrist"), *TOES))
"""Indices of joints: middle of the body, feet, and ends that may be fast."""
_POINTS = [name for name in MHR70 if name in PLACES]
_POINT_ROWS = [
    [_POINTS.index(f"{side}_{part}") for part in parts for side in ("left", "right")]
    for parts in (("hip",), ("ankle", "big_toe"), ("wrist", "ankle"))
]
_NOISE, _SIZE, _DEPTH, _LENS = 0.015, 0.02, 0.03, 0.02
COLUMNS: Metrics = {
    "joints": ("joints, cm", 100, 1), "about_pelvis": ("about the pelvis, cm", 100, 2),
    "acceleration": ("acceleration, m/s²", 1, 1), "slip": ("slip, cm/s", 100, 1),
    "peak": ("peak speed / true", 1, 2), "peak_error": ("off by, %", 100, 0),
    "focal": ("focal length, %", 100, 2), "seconds": ("CPU s", 1, 1),
}  # fmt: skip

Row = dict[str, float | None]
Method = Callable[[Motion, BodyModel], Motion]


def as_joints(prior: str) -> Method:
    """Return a method that fits the estimate's joints as having independent noise."""

    def fitted(motion: Motion, body: BodyModel) -> Motion:
        joints = body.pose(motion).joints.detach()
        seen = Joints3D(
            joints, torch.ones(joints.shape[:-1], dtype=torch.bool), tuple(range(22)), motion.fps,
            ground_known=False,
        )  # fmt: skip
        return recon.fit(seen, prior, body=body, shape=motion.shape, start=motion).motion

    return fitted


def refined(prior: str) -> Method:
    """Return a method that calls `recon.refine` with a prior."""
    return lambda motion, body: recon.refine(motion, prior, body=body).motion


METHODS: dict[str, Method] = {
    "the estimate": lambda motion, body: motion,
    "its joints, pose prior": as_joints("pose"),
    "its joints, HuMoR": as_joints("humor"),
    "refined, pose prior": refined("pose"),
    "refined, HuMoR": refined("humor"),
}


def main() -> None:
    """Simulate estimates, refine them, print and write the table."""
    arguments = over_windows(__doc__)
    arguments.set_defaults(only=12)
    given = arguments.parse_args()
    torch.set_num_threads(1)
    body = BodyModel.load()
    windows = load_windows(given.corpus, Splits.load(given.splits), given.part, body)
    chosen = evenly(windows, given.only)
    some = windows.take(chosen)
    found: dict[str, list[Row]] = {}
    for number, clip in enumerate(chosen):
        truth, touching = some.truth[number], some.contacts[number][:, list(FEET)]
        joints = body.pose(truth).joints.detach()
        seen = estimated(truth, RegressorErrors(), SEED + clip)
        for name, method in METHODS.items():
            began = time.process_time()
            own = body.pose(method(seen, body)).joints.detach()
            row: Row = {"seconds": time.process_time() - began}
            found.setdefault(name, []).append(row | judged(own, joints, touching, _ROWS))
        for name, row in of_sam3d_body(truth, touching, SEED + clip, body):
            found.setdefault(name, []).append(row)
    rows = [[name, *cells(own, some, COLUMNS)] for name, own in found.items()]
    tell_of(given, SEED, {"refine": Table(columns_of("", COLUMNS), rows)}, windows.files)


def of_sam3d_body(
    truth: Motion, touching: Bool[Tensor, "time 4"], seed: int, body: BodyModel
) -> Iterator[tuple[str, Row]]:
    """Simulate a file of SAM 3D Body; yield its errors and those after `recon.refine`."""
    points, random = BodyPoints.of_names(_POINTS, body), np.random.default_rng(seed)
    true = points.of(body.pose(truth)).detach()
    camera = camera_ring(truth, body, full_hd_camera(), 1, first=2.4 * seed)[0]
    seen = so3.transform(camera.T_camera_world, true).double().numpy()
    (focal, _, x), (_, _, y), _ = camera.camera_matrix.double().tolist()
    stds = (_SIZE, _DEPTH, _LENS)
    size, depth, lens = (np.exp(std * random.normal(size=(len(seen), 1, 1))) for std in stds)
    hips = seen[:, _POINT_ROWS[0]].mean(1, keepdims=True)
    place = hips * size * depth * np.concatenate((lens**0, lens**0, lens), -1)
    every = np.zeros((len(seen), len(MHR70), 3))
    shown = [MHR70.index(name) for name in _POINTS]
    every[:, shown] = (seen - hips) * size + _NOISE * random.normal(size=seen.shape)
    there = every + place
    pixels = focal * lens * there[..., :2] / there[..., 2:] + (x, y)
    told = {"pred_keypoints_3d": every, "pred_cam_t": place[:, 0], "pred_keypoints_2d": pixels}

    def row(own: Tensor) -> Row:
        own, goal = own.double() - own.double().mean((0, 1)), (true - true.mean((0, 1))).double()
        turn = so3.nearest_rotation(goal.flatten(0, 1).mT @ own.flatten(0, 1))
        return judged(own @ turn.mT, goal, touching, _POINT_ROWS)

    yield "a file of SAM 3D Body", row(torch.from_numpy(there[:, shown]))
    with tempfile.TemporaryDirectory() as folder:
        np.savez(path := Path(folder) / "made.npz", **told)
        for prior, name in (("pose", "pose prior"), ("humor", "HuMoR")):
            began = time.process_time()
            result = recon.refine(path, prior, body=body, frame_rate=FPS)
            (said,) = re.findall(r"focal length (\d+)", " ".join(result.notes))
            more = {"seconds": time.process_time() - began, "focal": abs(int(said) / focal - 1)}
            yield f"refined, {name}, of it", row(points.of(body.pose(result.motion))) | more


def judged(
    own: Float[Tensor, "time points 3"],
    true: Float[Tensor, "time points 3"],
    touching: Bool[Tensor, "time 4"],
    rows: Sequence[Sequence[int]],
) -> Row:
    """Return the errors of one window in SI units."""
    frames = min(len(own), len(true))
    own, true = own[:frames].double(), true[:frames].double()
    middle, feet, ends = (list(some) for some in rows)
    about = (own - true) - (own - true)[:, middle].mean(1, keepdim=True)
    bends = (own - true).diff(n=2, dim=0) * FPS**2
    stands = touching[1:frames] & touching[: frames - 1]
    slip = own[:, feet, :2].diff(dim=0).norm(dim=-1) * FPS
    fast, peak = (
        (joints[:, ends].diff(dim=0).norm(dim=-1) * FPS).amax(0) for joints in (true, own)
    )
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


if __name__ == "__main__":
    main()

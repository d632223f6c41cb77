"""Errors of a network's estimates of test windows, refined, and of plain fits to them.

    python -m benchmarks.refine CORPUS --out FOLDER
    python -m benchmarks.refine CORPUS --part validation --only 8

Estimates have the errors of `benchmarks.regressor`: biased and wandering joints, jitter, a
limb hidden for a second, legs exchanged for moments, a path that drifts. Columns: mean error of
joints in the world and about the pelvis, of accelerations; speed of feet that stand along the
ground; and, of hands and toes that are faster than 3 m/s in truth, the ratio of their highest
speed to the true one and how far it is from one. Baselines: the estimate itself, and its joints
taken as independent noise by `recon.fit` (pose prior, HuMoR).
"""

import time
from collections.abc import Callable

import torch
from jaxtyping import Bool, Float
from torch import Tensor

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
from benchmarks.regressor import RegressorErrors, estimated
from recon import BodyModel, Joints3D, Motion
from recon.benchmark.dataset import Splits
from recon.benchmark.windows import FPS, load_windows
from recon.core.skeleton import FEET, JOINTS, TOES

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

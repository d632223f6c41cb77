"""Errors of a network's estimates of test windows, refined, and of plain fits to them.

    python -m benchmarks.refine CORPUS --json refine.json
    python -m benchmarks.refine CORPUS --part validation --clips 8

Estimates have the errors of `benchmarks.regressor`: biased and wandering joints, jitter, a
limb hidden for a second, legs exchanged for moments, a path that drifts. Columns: mean error of
joints in the world and about the pelvis, of accelerations; speed of feet that stand along the
ground; and, of hands and toes that are faster than 3 m/s in truth, the ratio of their highest
speed to the true one and how far it is from one. Baselines: the estimate itself, and its joints
taken as independent noise by `recon.fit` (pose prior, HuMoR).
"""

import argparse
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from benchmarks.regressor import RegressorErrors, estimated
from benchmarks.results import corpus_source, write
from benchmarks.slips.recordings import evenly, windows_of
from observations.joints3d import Joints3D
from recon.api.fit import fit
from recon.api.refine import refine
from recon.benchmark.windows import FPS
from recon.body.model import BodyModel
from recon.core.motion import Motion
from recon.core.skeleton import FEET, JOINTS, TOES

FAST = 3.0
"""Speed above which a hand or toe counts as fast, metres per second."""
_ENDS = (JOINTS.index("left_wrist"), JOINTS.index("right_wrist"), *TOES)

Method = Callable[[Motion, BodyModel], Motion]
Row = dict[str, float | None]


def as_it_is(motion: Motion, body: BodyModel) -> Motion:
    """The estimate itself."""
    del body
    return motion


def as_joints(prior: str) -> Method:
    """Its joints as independent noise."""

    def fitted(motion: Motion, body: BodyModel) -> Motion:
        joints = body.pose(motion).joints.detach()
        seen = Joints3D(
            joints, torch.ones(joints.shape[:-1], dtype=torch.bool), tuple(range(22)), motion.fps,
            ground_known=False,
        )  # fmt: skip
        return fit(seen, prior, body=body, shape=motion.shape, start=motion).motion

    return fitted


def refined(prior: str) -> Method:
    """`recon.refine`."""
    return lambda motion, body: refine(motion, prior, body=body).motion


METHODS: dict[str, Method] = {
    "the estimate": as_it_is,
    "its joints, pose prior": as_joints("pose"),
    "its joints, HuMoR": as_joints("humor"),
    "refined, pose prior": refined("pose"),
    "refined, HuMoR": refined("humor"),
}


def main() -> None:
    """Estimate, refine, judge, print and write."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("corpus", type=Path)
    parser.add_argument("--part", choices=("test", "validation"), default="test")
    parser.add_argument("--clips", type=int, default=24, help="windows, evenly from all subjects")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", type=Path, default=None)
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    body = BodyModel.load()
    windows = windows_of(arguments.corpus, arguments.part, body)
    clips = evenly(windows, arguments.clips)
    rows: dict[str, list[Row]] = {name: [] for name in METHODS}
    for clip in clips:
        truth = windows.truth[clip]
        seen = estimated(truth, RegressorErrors(), arguments.seed + clip)
        for name, method in METHODS.items():
            began = time.process_time()
            found = method(seen, body)
            row = judged(found, truth, windows.contacts[clip], body)
            rows[name].append(row | {"seconds": time.process_time() - began})
    subjects = [windows.subjects[clip] for clip in clips]
    table = {name: summary(own, subjects) for name, own in rows.items()}
    for name, row in table.items():
        print(name, row)
    if arguments.json is not None:
        names = [windows.names[clip] for clip in clips]
        write(
            arguments.json, arguments.seed, corpus_source(arguments.corpus, windows.files),
            part=arguments.part, windows=names, subjects=subjects, rows=rows, table=table,
        )  # fmt: skip


def judged(
    found: Motion, truth: Motion, contacts: Bool[Tensor, "time 22"], body: BodyModel
) -> Row:
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


def summary(rows: Sequence[Row], subjects: Sequence[str]) -> dict[str, float | None]:
    """Means over a subject's windows, then over subjects."""
    found: dict[str, float | None] = {}
    for column in rows[0]:
        means: list[float] = []
        for subject in sorted(set(subjects)):
            values = [
                value
                for row, own in zip(rows, subjects, strict=True)
                if own == subject and (value := row[column]) is not None
            ]
            if values:
                means.append(sum(values) / len(values))
        found[column] = sum(means) / len(means) if means else None
    return found


if __name__ == "__main__":
    main()

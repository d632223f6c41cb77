"""Do errors keep to the standard deviations that fits state?

    python -m benchmarks.uncertainty CORPUS --json uncertainty.json
    python -m benchmarks.uncertainty CORPUS --part validation --clips 6 --prior pose

For joints, markers, three cameras and one with a known pose, in windows of two seconds: the share
of errors along an axis of at most 1.645 standard deviations (0.90 where they are right), the
median standard deviation over the root mean square error of an axis, the rank correlation
of standard deviations with the errors of joints, and CPU seconds beside those of the fit. Joints
that were seen and joints that nobody saw are judged apart. Constants were chosen on validation.
"""

import argparse
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from benchmarks.results import corpus_source, write
from benchmarks.slips.recordings import Sensor, evenly, recording_of, windows_of
from benchmarks.windows import Windows
from recon.body.model import BodyModel
from recon.diagnosis.fits.certainty import certainty
from recon.diagnosis.fits.seen_joints import observed_joints
from recon.fitting.clip import fit_clip
from recon.fitting.options import FitOptions
from recon.method.laplace import Deviations
from recon.simulation.points import Corruption

NINE_TENTHS = 1.645
"""Standard deviations within which nine of ten normal errors lie."""
PROTOCOLS: tuple[tuple[str, Sensor, int, Corruption], ...] = (
    ("joints, 4 cm", "joints3d", 1, Corruption(noise=0.04)),
    ("joints, 2 cm, hidden below 0.9 m for a third", "joints3d", 1,
     Corruption(noise=0.02, hide_below=0.9, during=(0.67, 1.33))),
    ("markers, 1 cm, hidden below 0.9 m", "markers3d", 1, Corruption(noise=0.01, hide_below=0.9)),
    ("three cameras, 4 px", "cameras", 3, Corruption(noise=4.0)),
    ("one camera of known pose, 4 px", "cameras", 1, Corruption(noise=4.0)),
)  # fmt: skip


@dataclass(frozen=True)
class Judged:
    """Errors of one fit beside what it said of them."""

    error: Float[Tensor, "time 22 3"]
    std: Float[Tensor, "time 22"]
    observed: Bool[Tensor, "time 22"]
    fit_seconds: float
    seconds: float


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("corpus", type=Path)
    parser.add_argument("--part", choices=("test", "validation"), default="test")
    parser.add_argument("--clips", type=int, default=12, help="windows of each protocol")
    parser.add_argument("--prior", choices=("pose", "humor"), nargs="+", default=["pose", "humor"])
    parser.add_argument("--json", type=Path, default=None)
    arguments = parser.parse_args()
    body = BodyModel.load()
    windows = windows_of(arguments.corpus, arguments.part, body)
    clips = evenly(windows, arguments.clips)
    rows: dict[str, dict[str, dict[str, float]]] = {}
    for prior in arguments.prior:
        for name, sensor, count, corruption in PROTOCOLS:
            found = [judged(windows, k, sensor, count, corruption, prior, body) for k in clips]
            rows[f"{name}; {prior}"] = row = summary(found)
            print(f"{name}; {prior}", row, flush=True)
            if arguments.json is not None:
                sources = corpus_source(arguments.corpus, windows.files)
                names = [windows.names[k] for k in clips]
                write(arguments.json, 0, sources, part=arguments.part, windows=names, rows=rows)


def judged(
    windows: Windows,
    clip: int,
    sensor: Sensor,
    count: int,
    corruption: Corruption,
    prior: str,
    body: BodyModel,
) -> Judged:
    """Fit one window and compare its errors with their standard deviations."""
    seen = recording_of(windows, clip, sensor, body, corruption).clean[:count]
    began = time.process_time()
    fit = fit_clip(seen, FitOptions(prior=prior), body)
    fitted = time.process_time()
    found = certainty(fit)
    done = time.process_time()
    assert isinstance(found, Deviations)
    truth = body.pose(windows.truth[[clip]]).joints[0]
    frames = min(len(truth), len(found.joints))
    error = (fit.result.body.joints[0] - truth)[:frames].detach()
    observed = observed_joints(fit.observations, fit.result.estimate)[:frames]
    return Judged(
        error, found.joints[:frames], torch.from_numpy(observed), fitted - began, done - fitted
    )


def summary(found: Sequence[Judged]) -> dict[str, dict[str, float]]:
    """Numbers of joints that were seen, and of those that were not, over all windows."""
    error, std = torch.cat([one.error for one in found]), torch.cat([one.std for one in found])
    observed = torch.cat([one.observed for one in found])
    cost = sum(one.seconds for one in found) / sum(one.fit_seconds for one in found)
    rows = {"cost": {"share_of_fit": cost}}
    for name, some in (("seen", observed), ("hidden", ~observed)):
        if some.any():
            rows[name] = _numbers(error[some], std[some])
    return rows


def _numbers(error: Float[Tensor, "rows 3"], std: Float[Tensor, " rows"]) -> dict[str, float]:
    within = (error.abs() <= NINE_TENTHS * std[:, None]).double().mean()
    rms = error.double().square().mean().sqrt()
    ranks = torch.stack((error.norm(dim=-1), std.to(error))).argsort(-1).argsort(-1).double()
    return {
        "within": float(within),
        "rms": float(rms),
        "median_std": float(std.median()),
        "rank_correlation": float(torch.corrcoef(ranks)[0, 1]),
    }


if __name__ == "__main__":
    main()

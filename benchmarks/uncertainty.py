"""Do errors keep to the standard deviations that fits state?

    python -m benchmarks.uncertainty CORPUS --json uncertainty.json
    python -m benchmarks.uncertainty CORPUS --part validation --clips 6 --prior pose

Windows of two seconds of joints, markers, three cameras, one camera with and one without a known
pose, and depth. The table has the share of errors along an axis of at most 1.645 standard
deviations (0.90 where they are right), the median standard deviation beside the root mean square
error of an axis, the rank correlation of standard deviations with the errors of joints, and CPU
seconds beside those of the fit. Joints that were seen and joints that nobody saw are judged apart,
in the frame of the recording. Where the ground was found, its height below that frame's origin
(the camera) and its normal are judged likewise, a row per clip. The table has how often feet touch
where they are said to with some probability. Constants were chosen on validation.
"""

import argparse
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from benchmarks.cameras import depth
from benchmarks.results import corpus_source, write
from benchmarks.slips.recordings import Sensor, evenly, recording_of, windows_of
from observations.joints3d import Joints3D
from recon.benchmark.windows import TrueWindows
from recon.body.model import BodyModel
from recon.core.skeleton import FEET
from recon.diagnosis.certainty import certainty, fitted_contacts
from recon.diagnosis.doubts import observed_joints
from recon.fitting.clip import fit_clip
from recon.fitting.fitted import ClipFit
from recon.fitting.methods import FitOptions
from recon.method.laplace import Deviations
from recon.method.protocols import Sensor as Observed
from recon.simulation.points import Corruption

NINE_TENTHS = 1.645
"""Standard deviations within which nine of ten normal errors lie."""


@dataclass(frozen=True)
class Recorded:
    """What was seen of a window, and where it was."""

    observations: tuple[Observed, ...]
    T_world_recording: Float[Tensor, "4 4"]
    """Maps the frame of the observations to the true world."""


Film = Callable[[TrueWindows, int, BodyModel], Recorded]


def by_sensor(sensor: Sensor, count: int, corruption: Corruption) -> Film:
    """Windows before the first sensors of a kind."""

    def film(windows: TrueWindows, clip: int, body: BodyModel) -> Recorded:
        found = recording_of(windows, clip, sensor, body, corruption)
        return Recorded(found.clean[:count], found.T_world_recording)

    return film


def joints_above_nothing(windows: TrueWindows, clip: int, body: BodyModel) -> Recorded:
    """Joints with z up, whose ground is not known."""
    (seen,) = by_sensor("joints3d", 1, Corruption(noise=0.02))(windows, clip, body).observations
    assert isinstance(seen, Joints3D)
    return Recorded((replace(seen, ground_known=False),), torch.eye(4))


def depth_alone(windows: TrueWindows, clip: int, body: BodyModel) -> Recorded:
    """A depth sensor of unknown pose that sees the ground; legs are hidden for a third."""
    found = depth(windows.truth[clip], body, clip)
    assert found.T_world_camera is not None
    assert found.T_recording_camera is not None
    back = torch.linalg.inv(found.T_recording_camera[0])
    return Recorded(found.observations, found.T_world_camera[0].float() @ back)


PROTOCOLS: dict[str, Film] = {
    "joints, 4 cm": by_sensor("joints3d", 1, Corruption(noise=0.04)),
    "joints, 2 cm, hidden below 0.9 m for a third": by_sensor(
        "joints3d", 1, Corruption(noise=0.02, hide_below=0.9, during=(0.67, 1.33))
    ),
    "joints, 2 cm, ground not known": joints_above_nothing,
    "markers, 1 cm, hidden below 0.9 m": by_sensor(
        "markers3d", 1, Corruption(noise=0.01, hide_below=0.9)
    ),
    "three cameras, 4 px": by_sensor("cameras", 3, Corruption(noise=4.0)),
    "one camera of known pose, 4 px": by_sensor("cameras", 1, Corruption(noise=4.0)),
    "one camera, ground not known, 4 px": by_sensor("camera", 1, Corruption(noise=4.0)),
    "depth, hidden below 0.9 m for a third": depth_alone,
}


@dataclass(frozen=True)
class Judged:
    """Errors of one fit beside what it said of them."""

    error: Float[Tensor, "time 22 3"]
    std: Float[Tensor, "time 22"]
    observed: Bool[Tensor, "time 22"]
    fit_seconds: float
    seconds: float
    height: tuple[float, float] | None = None
    """Error and standard deviation of the height of a ground that was found, metres."""
    normal: tuple[float, float, float] | None = None
    """Errors of its normal about two axes, and their standard deviation, radians; None where the
    vertical is known."""
    contacts: tuple[Tensor, Tensor] | None = None
    """Probabilities that feet touch, and whether they do."""


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("corpus", type=Path)
    parser.add_argument("--part", choices=("test", "validation"), default="test")
    parser.add_argument("--clips", type=int, default=12, help="windows of each protocol")
    parser.add_argument("--prior", choices=("pose", "humor"), nargs="+", default=["pose", "humor"])
    parser.add_argument("--only", choices=PROTOCOLS, nargs="+", default=list(PROTOCOLS))
    parser.add_argument("--json", type=Path, default=None)
    arguments = parser.parse_args()
    body = BodyModel.load()
    windows = windows_of(arguments.corpus, arguments.part, body)
    clips = evenly(windows, arguments.clips)
    rows: dict[str, dict[str, dict[str, float]]] = {}
    for prior in arguments.prior:
        for name in arguments.only:
            found = [judged(windows, k, PROTOCOLS[name], prior, body) for k in clips]
            rows[f"{name}; {prior}"] = row = summary(found)
            print(f"{name}; {prior}", row, flush=True)
            if arguments.json is not None:
                sources = corpus_source(arguments.corpus, windows.files)
                names = [windows.names[k] for k in clips]
                write(arguments.json, 0, sources, part=arguments.part, windows=names, rows=rows)


def judged(windows: TrueWindows, clip: int, film: Film, prior: str, body: BodyModel) -> Judged:
    """Fit one window and compare its errors with their standard deviations."""
    seen = film(windows, clip, body)
    began = time.process_time()
    fit = fit_clip(seen.observations, FitOptions(prior=prior), body)
    fitted = time.process_time()
    found = certainty(fit)
    done = time.process_time()
    assert isinstance(found, Deviations)
    truth = body.pose(windows.truth[[clip]]).joints[0]
    frames = min(len(truth), len(found.joints))
    there = fit.result.estimate.scene.to_recording(fit.result.body.joints)[0].detach()
    T = seen.T_world_recording
    error = (there @ T[:3, :3].mT + T[:3, 3] - truth)[:frames]
    observed = observed_joints(fit.observations, fit.result.estimate)[:frames]
    judged = Judged(
        error, found.joints[:frames], torch.from_numpy(observed), fitted - began, done - fitted
    )
    return replace(
        _with_ground(judged, fit, found, T), contacts=_contacts(fit, found, windows.contacts[clip])
    )


def _with_ground(
    judged: Judged, fit: ClipFit, found: Deviations, T_world_recording: Float[Tensor, "4 4"]
) -> Judged:
    """The clip with the errors of the ground, where the fit found it and says how well."""
    if found.ground is None:
        return judged
    T = fit.T_world_recording[0].to(T_world_recording)
    height = float(T[2, 3] - T_world_recording[2, 3])
    judged = replace(judged, height=(height, found.ground.height))
    if found.ground.normal == 0:
        return judged
    x, y, _ = (T_world_recording[:3, :3] @ T[:3, :3].mT)[:, 2].tolist()
    return replace(judged, normal=(x, y, found.ground.normal))


def _contacts(fit: ClipFit, sure: Deviations, truth: Tensor) -> tuple[Tensor, Tensor] | None:
    """How likely feet touch the ground, by their motion and how sure it is, and the truth."""
    if not fit.grounded:
        return None
    said = fitted_contacts(fit, sure)
    frames, feet = min(len(said), len(truth)), list(FEET)
    return said[:frames, feet].flatten(), truth[:frames, feet].flatten() > 0.5


def summary(found: Sequence[Judged]) -> dict[str, dict[str, float]]:
    """Numbers of joints that were seen, and of those that were not, over all windows."""
    error, std = torch.cat([one.error for one in found]), torch.cat([one.std for one in found])
    observed = torch.cat([one.observed for one in found])
    cost = sum(one.seconds for one in found) / sum(one.fit_seconds for one in found)
    rows = {"cost": {"share_of_fit": cost}}
    for name, some in (("seen", observed), ("hidden", ~observed)):
        if some.any():
            rows[name] = _numbers(error[some], std[some])
    heights = [one.height for one in found if one.height is not None]
    if heights:
        away, sure = torch.tensor(heights).T
        rows["height"] = _few(away[:, None], sure)
    normals = [one.normal for one in found if one.normal is not None]
    if normals:
        angles = torch.tensor(normals) * (180 / math.pi)
        rows["normal, degrees"] = _few(angles[:, :2], angles[:, 2])
    told = [one.contacts for one in found if one.contacts is not None]
    if told:
        rows["contacts"] = _touching(*map(torch.cat, zip(*told, strict=True)))
    return rows


def _few(error: Float[Tensor, "clips axes"], std: Float[Tensor, " clips"]) -> dict[str, float]:
    """Numbers of what there is once a clip."""
    return {
        "within": float((error.abs() <= NINE_TENTHS * std[:, None]).double().mean()),
        "within_two": float((error.abs() <= 2 * std[:, None]).double().mean()),
        "rms": float(error.square().mean().sqrt()),
        "median_error": float(error.abs().median()),
        "median_std": float(std.median()),
    }


def _touching(said: Float[Tensor, " rows"], truth: Bool[Tensor, " rows"]) -> dict[str, float]:
    """Mean squared error of probabilities, and how often feet touch where it says so."""
    rows = {
        "brier": float((said - truth.float()).square().mean()),
        "touch": float(truth.double().mean()),
    }
    for low, high in ((0.0, 0.2), (0.2, 0.4), (0.4, 0.6), (0.6, 0.8), (0.8, 1.01)):
        some = (said >= low) & (said < high)
        if bool(some.any()):
            rows[f"said {low:.1f}-{min(high, 1.0):.1f}"] = float(truth[some].double().mean())
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

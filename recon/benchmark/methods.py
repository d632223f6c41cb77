"""The methods of the benchmark: built-in ones by name, or a user's class."""

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, Protocol, runtime_checkable

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from priors.humor.prior import Humor
from priors.pose.prior import PosePrior
from recon.benchmark.protocols import noise_of, sensor_of
from recon.body.model import BodyModel
from recon.core.errors import ReconError
from recon.core.motion import MotionFile
from recon.core.plugins import imported_object
from recon.core.skeleton import JOINTS
from recon.formats.observations import PositionsFile
from recon.method.priors import Prior
from recon.method.reconstruction import solve


def butterworth(
    positions: Float[Tensor, "clips time points 3"], fps: float, cutoff: float
) -> Float[Tensor, "clips time points 3"]:
    """Low-pass by a second-order Butterworth filter, run forwards and backwards.

    Args:
        positions: metres.
        fps: frames per second.
        cutoff: frequency that a single pass lets through by half its power, Hz.
    """
    from scipy.signal import butter, filtfilt

    coefficients: Any = butter(2, cutoff, fs=fps)
    smooth = filtfilt(coefficients[0], coefficients[1], positions.double().numpy(), axis=1)
    return torch.from_numpy(np.ascontiguousarray(smooth)).to(positions)


def whittaker(
    positions: Float[Tensor, "clips time points 3"], stiffness: float
) -> Float[Tensor, "clips time points 3"]:
    """Smooth by penalised second differences: min |x - y|² + stiffness |D²x|²."""
    frames = positions.shape[1]
    bend = torch.eye(frames, dtype=torch.float64).diff(n=2, dim=0)
    system = torch.eye(frames, dtype=torch.float64) + stiffness * bend.mT @ bend
    flat = positions.double().transpose(0, 1).reshape(frames, -1)
    smooth = torch.linalg.solve(system, flat).unflatten(1, (len(positions), *positions.shape[2:]))
    return smooth.transpose(0, 1).to(positions)


CUTOFF = 2.0
"""Hz; it had the least error on the validation windows with 4 cm of noise."""
STIFFNESS = 42.2
"""Weight of squared second differences; chosen as the cutoff was."""


@runtime_checkable
class BenchMethod(Protocol):
    """A method for the benchmark: a callable that takes one window's observation.

    A class "package.module:Class" is made without arguments, once, before time is taken.
    """

    def __call__(self, seen: PositionsFile) -> Any:
        """Estimate the motion of a window.

        Args:
            seen: named points in the world, z up, the ground at z = 0: `positions` (time, points,
                3) in metres, `visible` (time, points), `names`, `fps`, and `std`, their standard
                deviation in metres or None where they are exact.

        Returns:
            One row per frame of `seen`: joints (time, 22, 3) in metres in the order of
            `recon.core.skeleton.JOINTS`; a dict of `joints` and, if known, `points` (where the
            points that were seen or hidden are) and `contacts`; or a motion: a `recon.Motion`, a
            result of `recon.fit`, or the path of a motion file.
        """
        ...


def method_named(name: str, body: BodyModel) -> BenchMethod:
    """Return the built-in method of this name, or an instance of "package.module:Class".

    Raises:
        ReconError: names the built-in methods, or says why a class cannot be had.
    """
    if ":" in name:
        made = imported_object(name, "--method")()
        if not callable(made):
            raise ReconError(
                f"--method: objects of {name} cannot be called; expected a method "
                "__call__(self, seen) that gives joints or a motion"
            )
        return made
    if name not in BUILT_IN:
        raise ReconError(
            f"there is no method {name!r}; there are {', '.join(BUILT_IN)}, and "
            "package.module:Class of your own"
        )
    return BUILT_IN[name](body)


def _fit_under_prior(body: BodyModel, prior: Prior[Any], method: str | None = None) -> BenchMethod:
    """Return a method that fits a motion under a prior, with the noise stated in the window."""

    def run(seen: PositionsFile) -> MotionFile:
        stages = partial(prior.stages, noise=noise_of(seen), body=body, method=method)
        found = solve([sensor_of(seen)], stages, body)
        return MotionFile(found.motion[0].detach())

    return run


def _interpolated_joints(seen: PositionsFile) -> np.ndarray:
    """Return the observed positions of all 22 joints, linearly interpolated across gaps."""
    if seen.names != tuple(JOINTS):
        raise ReconError(
            "linear has no body model: it needs protocols with all 22 joints (noisy-joints, gap)"
        )
    filled, times = seen.positions.copy(), np.arange(len(seen.positions))
    for point, shown in enumerate(seen.visible.T):
        if not shown.any():
            raise ReconError(
                f"linear: expected every joint to be seen, but {seen.names[point]} never is"
            )
        for axis in range(3):
            known = seen.positions[shown, point, axis]
            filled[:, point, axis] = np.interp(times, times[shown], known)
    return filled


def _smoothing_method(smooth: Callable[[torch.Tensor, float], torch.Tensor]) -> BenchMethod:
    """Return a method that interpolates gaps linearly, then filters all coordinates."""

    def run(seen: PositionsFile) -> np.ndarray:
        return smooth(torch.from_numpy(_interpolated_joints(seen))[None], seen.fps)[0].numpy()

    return run


def _fit_under_humor(fit_method: str) -> Callable[[BodyModel], BenchMethod]:
    return lambda body: _fit_under_prior(body, Humor.load(body=body), fit_method)


def _fit_under_pose_prior(body: BodyModel) -> BenchMethod:
    return _fit_under_prior(body, PosePrior.load(body=body))


BUILT_IN: Mapping[str, Callable[[BodyModel], BenchMethod]] = {
    "linear": lambda _: _interpolated_joints,
    "butterworth": lambda _: _smoothing_method(lambda x, fps: butterworth(x, fps, CUTOFF)),
    "least-squares": lambda _: _smoothing_method(lambda x, _: whittaker(x, STIFFNESS)),
    "pose": _fit_under_pose_prior,
    **{way: _fit_under_humor(way) for way in Humor.methods},
}
"""Names of the built-in methods: the data on straight lines, two smoothers, stages 1-2 under the
pose prior, and the ways to fit under HuMoR."""

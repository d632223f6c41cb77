"""What a user would pick instead of a body: smoothers of points, each coordinate for itself."""

from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor


def butterworth(
    positions: Float[Tensor, "clips time points 3"], fps: float, cutoff: float
) -> Float[Tensor, "clips time points 3"]:
    """Second-order Butterworth low-pass run forwards and backwards: no delay.

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
    """Least squares with penalised second differences: min |x - y|² + stiffness |D²x|²."""
    frames = positions.shape[1]
    bend = torch.eye(frames, dtype=torch.float64).diff(n=2, dim=0)
    system = torch.eye(frames, dtype=torch.float64) + stiffness * bend.mT @ bend
    flat = positions.double().transpose(0, 1).reshape(frames, -1)
    smooth = torch.linalg.solve(system, flat).unflatten(1, (len(positions), *positions.shape[2:]))
    return smooth.transpose(0, 1).to(positions)

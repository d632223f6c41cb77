"""A walk as sensors see it, and streams that it is pushed into."""

import numpy as np
import pytest
import torch

import recon
from recon.live.tracking import LiveEstimate
from tests.filmed import walk

BEGINNING = 8
FPS, FRAMES, NOISE = 30.0, 36, 0.02


@pytest.fixture(autouse=True)
def soon(monkeypatch):
    """Streams begin after eight moments, to be quick."""
    monkeypatch.setattr("recon.live.tracking.BEGINNING", BEGINNING)


@pytest.fixture(scope="module")
def truth() -> torch.Tensor:
    """Joints of a walk."""
    return recon.BodyModel.load().pose(walk(FRAMES)).joints


@pytest.fixture(scope="module")
def seen(truth) -> np.ndarray:
    noise = np.random.default_rng(0).normal(0, NOISE, truth.shape)
    return (truth.numpy() + noise).astype(np.float32)


def stream(**settings) -> recon.Stream:
    template = recon.Joints3D(np.zeros((1, 22, 3)), np.zeros((1, 22), bool), range(22), FPS)
    return recon.Stream(template=template, noise=NOISE, **settings)


def played(live: recon.Stream, moments, times=None) -> list[LiveEstimate]:
    """All estimates of moments that are pushed in turn."""
    found: list[LiveEstimate] = []
    for k, moment in enumerate(moments):
        estimate = live.push(moment, None if times is None else times[k])
        found += () if estimate is None else estimate.every
    return [*found, *live.finish()]


def joints_of(estimates) -> torch.Tensor:
    return torch.stack([one.joints for one in estimates])


def codes(estimates) -> list[str]:
    return [finding.code for one in estimates for finding in one.findings]

"""Fits on a GPU give the processor's result; run where there is CUDA (`pytest -m gpu`)."""

from typing import Any

import pytest
import torch

import recon
from tests.filmed import bundled, seen_of, walk

pytestmark = [
    pytest.mark.gpu,
    pytest.mark.skipif(not torch.cuda.is_available(), reason="there is no CUDA device"),
]


@pytest.mark.parametrize("prior", ["pose", "humor"])
@pytest.mark.parametrize("kind", ["joints3d", "landmarks", "views", "hidden", "depth"])
def test_a_fit_on_the_gpu(kind: str, prior: Any) -> None:
    seen = seen_of(walk(30), kind)
    here = recon.fit(seen, prior)
    there = recon.fit(seen, prior, device="cuda")
    assert there.motion.translation.device.type == "cpu"
    away = (there.joints - here.joints).norm(dim=-1)
    # hidden legs may end elsewhere where two motions are about as likely
    assert float(away.mean()) < (0.05 if kind == "hidden" else 0.005)
    assert bool(there.joints.isfinite().all())


def test_clips_together_on_the_gpu() -> None:
    many = [recon.simulate(walk(20), "joints3d", noise=0.02, seed=k) for k in range(3)]
    here = recon.fit_clips(many, "pose")
    there = recon.fit_clips(many, "pose", device="cuda")
    for a, b in zip(here, there, strict=True):
        assert float((a.joints - b.joints).norm(dim=-1).mean()) < 0.005


def test_the_body_on_the_gpu() -> None:
    body, motion = bundled(), walk(5)
    here = body.pose(motion).vertices
    there = body.to(device="cuda").pose(motion.to(device="cuda")).vertices
    assert float((there.cpu() - here).abs().max()) < 1e-4

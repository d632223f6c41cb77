"""A network of somebody else that proposes motions: people who stand, and one who does not."""

from collections.abc import Sequence

import torch

from recon.body.model import BodyModel
from recon.core.motion import Motion
from recon.method import ProposedMotions, Sensor


class Standing:
    """Proposes that the first sensor's person stands, or has the arms where the points are."""

    def __call__(self, observations: Sequence[Sensor], body: BodyModel) -> ProposedMotions:
        likely = observations[0].start(body)
        still = likely.replace(rotations=likely.rotations[:1].expand_as(likely.rotations))
        motions = Motion.create(
            torch.stack((still.translation, likely.translation)),
            torch.stack((still.rotations, likely.rotations)),
            likely.shape.expand(2, -1), likely.fps, likely.start_time,
        )  # fmt: skip
        return ProposedMotions(motions, torch.tensor([-1.0, 0.0]))

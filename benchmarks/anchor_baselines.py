"""What the anchor-frame prior is compared with: principal components of cycles, and slerp."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from priors.anchor.frames import ANCHORS, ROW_NUMBERS, Anchors
from recon.core import rotations as so3
from recon.core.struct import TensorStruct
from training.anchor.corpus import CycleBatch

COMPONENTS = 72
"""64 for the code and 8 for the shape, as in the paper."""


@dataclass(frozen=True)
class LinearCycles(TensorStruct):
    """Principal components of [chi, shape], motion and body together (Marsot et al., section 5.1).

    Rows chi are in metres and seconds, not normalised: translations then weigh as much as they do
    in distances of the surface, which makes this the stronger baseline.
    """

    mean: Float[Tensor, " numbers"]
    directions: Float[Tensor, "components numbers"]
    """Orthonormal."""

    @classmethod
    def fit(cls, cycles: CycleBatch, components: int = COMPONENTS) -> "LinearCycles":
        """The principal components of training cycles.

        Raises:
            ValueError: when there are fewer cycles than components.
        """
        from sklearn.decomposition import PCA

        numbers = _numbers(cycles)
        if len(numbers) <= components:
            raise ValueError(f"{components} components need more cycles than {len(numbers)}")
        found = PCA(components, svd_solver="randomized", random_state=0)
        found.fit(numbers.numpy())
        return cls(torch.from_numpy(found.mean_), torch.from_numpy(found.components_))

    def codes(self, cycles: CycleBatch) -> Float[Tensor, "cycles components"]:
        """Coefficients."""
        return (_numbers(cycles) - self.mean) @ self.directions.mT

    def decode(self, codes: Float[Tensor, "cycles components"]) -> CycleBatch:
        """Cycles and shapes of coefficients."""
        numbers = self.mean + codes @ self.directions
        rows = numbers[:, : ANCHORS * ROW_NUMBERS].unflatten(1, (ANCHORS, ROW_NUMBERS))
        return CycleBatch(Anchors.unpack(rows), numbers[:, ANCHORS * ROW_NUMBERS :])

    def between(self, a: CycleBatch, b: CycleBatch, share: float) -> CycleBatch:
        """Linear in the coefficients."""
        return self.decode(torch.lerp(self.codes(a), self.codes(b), share))


def slerp(a: CycleBatch, b: CycleBatch, share: float) -> CycleBatch:
    """Anchor by anchor: rotations along the shortest arc; translation, time and shape linearly."""
    one, other = a.anchors, b.anchors
    fraction = one.times.new_full(one.rotations.shape[:-2], share)
    anchors = Anchors(
        rotations=so3.interpolate(one.rotations, other.rotations, fraction),
        translation=torch.lerp(one.translation, other.translation, share),
        times=torch.lerp(one.times, other.times, share),
    )
    return CycleBatch(anchors, torch.lerp(a.shape, b.shape, share))


def _numbers(cycles: CycleBatch) -> Float[Tensor, "cycles numbers"]:
    return torch.cat((cycles.anchors.pack().flatten(1), cycles.shape), 1)

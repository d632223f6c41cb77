"""What is believed of every point of a cloud: its region, its place on the body, how surely."""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from priors.labels.regions import REGIONS, Regions
from recon.body.model import BodyModel
from recon.core.struct import TensorStruct


@dataclass(frozen=True)
class PointLabels(TensorStruct):
    """Region and place of the points of a cloud; all numbers are zero where there is no point.

    Left and right, front and back look alike in a single moment: where a region's probability is
    divided between its two sides, `places` holds the more likely of both.
    """

    present: Bool[Tensor, "*batch moments points"]
    """Whether a row holds a point, as in the cloud that was labelled."""
    regions: Float[Tensor, "*batch moments points 12"]
    """Probability of each of `REGIONS`, given that the point lies on the body: they sum to one."""
    on_body: Float[Tensor, "*batch moments points"]
    """Probability that the point lies on the body, not on the floor, furniture, another thing, or
    in the air as a flying pixel does."""
    places: Float[Tensor, "*batch moments points 3"]
    """Most likely place on the unposed body of average shape, metres, in the frame of
    `BodyModel.template` (y up, facing z, left +x), given that the point lies on the body."""
    log_std: Float[Tensor, "*batch moments points"]
    """Natural logarithm of the standard deviation of every coordinate of `places`, metres, given
    that left and right of the moment are not exchanged."""

    @property
    def region(self) -> Int[Tensor, "*batch moments points"]:
        """Number in `REGIONS` of the most likely region; -1 where there is no point."""
        return self.regions.argmax(-1).where(self.present, -1)

    @property
    def confidence(self) -> Float[Tensor, "*batch moments points"]:
        """Probability that the point lies on the body and in its most likely region."""
        return self.on_body * self.regions.amax(-1)

    @property
    def std(self) -> Float[Tensor, "*batch moments points"]:
        """Standard deviation of every coordinate of `places`, metres; zero without a point."""
        return self.log_std.exp().where(self.present, 0.0)

    @classmethod
    def known(
        cls,
        body: BodyModel,
        vertices: Int[Tensor, "*batch moments points"],
        present: Bool[Tensor, "*batch moments points"],
        std: float = 0.01,
    ) -> "PointLabels":
        """Labels without error, of points that simulation put at known vertices.

        Args:
            body: whose vertices they are.
            vertices: nearest to each point; -1 for a point that is not on the body.
            present: whether a row holds a point.
            std: that the labels state for places, metres.
        """
        regions = Regions.of(body)
        on_body = present & (vertices >= 0)
        index = vertices.clamp(min=0)
        one = torch.nn.functional.one_hot(regions.of_vertex[index], len(REGIONS))
        exact = torch.log(regions.places.new_tensor(std)).expand(present.shape)
        return cls(
            present=present,
            regions=one.to(regions.places).where(present[..., None], 0.0),
            on_body=on_body.to(regions.places),
            places=regions.places[index].where(on_body[..., None], 0.0),
            log_std=exact.where(present, 0.0),
        )

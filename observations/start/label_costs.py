"""What it costs to take a labelled point for another part of the surface than its label says."""

import torch
from jaxtyping import Float
from torch import Tensor

from observations.surfels import Surfels
from priors.labels.record import PointLabels
from priors.labels.regions import REGIONS, Regions
from recon.body.model import BodyModel

_PLACE = 0.005
"""Metres² per metre² between two places on the unposed body. Labels are off by some centimetres,
which must not draw a point along the surface; what is a metre away costs as much as a surface that
is 7 cm away."""
_REGION = 0.01
"""Metres² of a region that the labels take for impossible, as of a surface 10 cm away. On three
validation windows with a fifth of the labels wrong, joints that are seen are 4.1 cm off; 4.7 where
labels do not count, and 5.6 and more where they count six times as much."""


def costs_of_points(labels: PointLabels) -> Float[Tensor, "*batch points 16"]:
    """Rows for `recon.core.geometry.alike.nearest_alike`, less a constant of every point."""
    sure = labels.on_body[..., None]
    place = -2 * _PLACE * labels.places
    size = torch.full_like(sure, _PLACE)
    region = _REGION * (1 - labels.regions)
    return sure * torch.cat((place, size, region), -1)


def kinds_of_surfels(surfels: Surfels, body: BodyModel) -> Float[Tensor, "surfels 16"]:
    """Rows of the surface that these are multiplied by."""
    index = torch.from_numpy(surfels.vertices).to(body.template.device)
    regions = Regions.of(body)
    place = regions.places[index]
    region = torch.nn.functional.one_hot(regions.of_vertex[index], len(REGIONS)).to(place)
    return torch.cat((place, place.square().sum(-1, keepdim=True), region), -1)

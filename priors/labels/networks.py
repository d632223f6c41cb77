"""The network that looks first: points to regions of the body and places on its surface.

64 points far from each other look at the points around them; a transformer lets these centres look
at each other and, through one token for each moment, at other moments; then every point takes
what the centres around it found out. Which of two alike sides is the left one, all points of a
moment have in common: it is said apart, by the direction from right to left that the moment's
token finds (`priors.labels.sides`).
"""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn
from torch.nn.functional import gelu, normalize, scaled_dot_product_attention

from priors.labels.neighbours import Patch, kernel, patches, spread_points, squared_distances
from priors.labels.regions import REGIONS
from priors.labels.sides import from_right_to_left
from recon.core.struct import TensorStruct

STEPS = 5
"""Moments that are looked at together: two before, the moment itself, two after."""
SPACING = 0.3
"""Seconds between them."""
_CENTRES, _NEAR, _MIDDLE, _WIDE = 64, 0.05, 0.08, 0.15
"""Number of centres; standard deviations of kernels around them, metres."""
_POINT, _TOKEN, _HEADS, _LAYERS = 48, 96, 4, 4
_TOGETHER = 2
"""The layer after which moments look at each other."""
_SIZE, _SIGN = 100.0, 10.0
"""Scale of covariances, 1/m²; how fast a normal's sign becomes sure as it turns to the sensor."""
_WAVES = (1.0, 2.0, 4.0, 8.0, 16.0)
"""Wave numbers of the sines and cosines that stand for the places of centres, 1/m."""
_RADII = (0.1, 0.25, 0.6, 2.0)
"""Metres within which the heads of the transformer look at first."""
_UNKNOWN = 1e8
"""Stands for the squared distance of a moment that there is not, m²."""
_LEAST_STD, _MOST_STD = -5.5, 0.0
"""Logarithms of standard deviations of places, 4 mm to 1 m."""


@dataclass(frozen=True)
class SeenClouds(TensorStruct):
    """Clouds of single moments as the network takes them; metres."""

    points: Float[Tensor, "moments points 3"]
    """Positions about the median of each cloud, zero where not present."""
    present: Bool[Tensor, "moments points"]
    eyes: Float[Tensor, "moments 3"]
    """Place of the sensor about the same median; zero where there is none."""
    has_eye: Bool[Tensor, " moments"]
    level: Bool[Tensor, " moments"]
    """Whether z points up."""

    @property
    def flags(self) -> Float[Tensor, "moments 1 2"]:
        """What is known besides points, as numbers."""
        return torch.stack((self.level, self.has_eye), -1).to(self.points)[:, None]

    def view(self, places: Float[Tensor, "moments places 3"]) -> Tensor:
        """Directions from places to the sensor; zero where there is none."""
        return normalize(self.eyes[:, None] - places, dim=-1) * self.has_eye[:, None, None]


@dataclass(frozen=True)
class RawLabels(TensorStruct):
    """What the network says of every point."""

    regions: Float[Tensor, "moments points 12"]
    """Logarithms of odds of the regions."""
    on_body: Float[Tensor, "moments points"]
    """Logarithm of the odds that the point is on a body."""
    places: Float[Tensor, "moments points 3"]
    """Places on the unposed average body, metres."""
    log_std: Float[Tensor, "moments points"]
    """Logarithm of the standard deviation of each coordinate of a place, metres."""
    sides: Float[Tensor, " moments"]
    """Logarithm of the odds that left and right are not exchanged, in regions and places."""
    across: Float[Tensor, "moments tokens 3"]
    """Direction from right to left as the moment (first) and every centre expect it; shorter than
    one where they do not know."""


class Layer(nn.Module):
    """A layer of a transformer: attention among tokens, then each by itself."""

    def __init__(self, width: int) -> None:
        """Random weights."""
        super().__init__()
        self.before = nn.LayerNorm(width)
        self.asked = nn.Linear(width, 3 * width)
        self.answer = nn.Linear(width, width)
        self.radii = nn.Parameter(torch.tensor(_RADII).log())
        self.after = nn.LayerNorm(width)
        self.wide = nn.Linear(width, 2 * width)
        self.back = nn.Linear(2 * width, width)

    def forward(
        self,
        tokens: Float[Tensor, "rows tokens width"],
        squared: Float[Tensor, "rows tokens tokens"],
    ) -> Float[Tensor, "rows tokens width"]:
        """Tokens that have seen each other, near ones rather than far ones.

        Args:
            tokens: of every row.
            squared: squared distances between them, which every head divides by its radius².
        """
        heads = self.asked(self.before(tokens)).unflatten(-1, (3, _HEADS, -1))
        q, k, v = heads.movedim(-3, 0).transpose(-2, -3)
        far = squared[:, None] * (-2 * self.radii).exp()[:, None, None]
        found = scaled_dot_product_attention(q, k, v, attn_mask=-0.5 * far)
        tokens = tokens + self.answer(found.transpose(-2, -3).flatten(-2))
        return tokens + self.back(gelu(self.wide(self.after(tokens))))


class LabelNetwork(nn.Module):
    """Regions and places of the points of clouds."""

    def __init__(self) -> None:
        """Random weights."""
        super().__init__()
        self.point = nn.Sequential(nn.Linear(8, _POINT), nn.GELU(), nn.Linear(_POINT, _POINT))
        self.centre = nn.Sequential(
            nn.Linear(2 * _POINT + 36 + 6 * len(_WAVES), _TOKEN), nn.GELU(),
            nn.Linear(_TOKEN, _TOKEN),
        )  # fmt: skip
        self.whole = nn.Parameter(torch.zeros(_TOKEN))
        self.layers = nn.ModuleList(Layer(_TOKEN) for _ in range(_LAYERS))
        self.step = nn.Parameter(0.02 * torch.randn(STEPS, _TOKEN))
        self.moments = Layer(_TOKEN)
        self.learned = nn.Linear(_TOKEN, _TOKEN)
        self.across = nn.Sequential(nn.LayerNorm(_TOKEN), nn.Linear(_TOKEN, 3))
        self.sureness = nn.Parameter(torch.tensor(3.0))
        self.own = nn.Linear(_POINT + 14, _TOKEN)
        self.joined = nn.Sequential(
            nn.LayerNorm(_TOKEN), nn.Linear(_TOKEN, _TOKEN), nn.GELU(), nn.Linear(_TOKEN, _TOKEN)
        )
        self.out = nn.Sequential(
            nn.LayerNorm(_TOKEN), nn.Linear(_TOKEN, _TOKEN), nn.GELU(),
            nn.Linear(_TOKEN, len(REGIONS) + 5),
        )  # fmt: skip

    def forward(
        self,
        clouds: SeenClouds,
        neighbours: Int[Tensor, "moments steps"],
        known: Bool[Tensor, "moments steps"],
    ) -> RawLabels:
        """Labels of all points.

        Args:
            clouds: of all moments.
            neighbours: number of the moment at each of `STEPS` steps of `SPACING`; the middle one
                is the moment itself.
            known: whether there is such a moment.
        """
        points = clouds.points
        # distances need single precision where the products of a training do not
        with torch.no_grad(), torch.autocast(points.device.type, enabled=False):
            pick = spread_points(points, clouds.present, _CENTRES)
            centres = points.take_along_dim(pick[..., None], -2)
            squared = squared_distances(centres, points)
            near, wide = (
                patches(points, kernel(squared, width, clouds.present)) for width in (_NEAR, _WIDE)
            )
            around = kernel(squared, _MIDDLE, clouds.present)
            share = kernel(squared.mT, _NEAR)
            described, normals = _described(clouds, centres, near, wide)
            # the token of the whole moment is as near to all others as they are to themselves
            between = torch.nn.functional.pad(squared_distances(centres, centres), (1, 0, 1, 0))
        flags = clouds.flags.expand(*points.shape[:-1], 2)
        own = self.point(torch.cat((points, clouds.view(points), flags), -1))
        pooled = around @ own
        mine = own.take_along_dim(pick[..., None], -2)
        tokens = self.centre(torch.cat((described, pooled, mine), -1))
        tokens = torch.cat((self.whole.expand(len(tokens), 1, -1), tokens), 1)
        for number, layer in enumerate(self.layers):
            tokens = layer(tokens, between)
            if number + 1 == _TOGETHER:
                tokens = self._together(tokens, neighbours, known)
        told = share @ torch.cat((self.learned(tokens[:, 1:]), centres, normals, near.mean), -1)
        told, middle, normal, mean = told.split((_TOKEN, 3, 3, 3), -1)
        seen = torch.cat((own, points, points - middle, points - mean, normal, flags), -1)
        joined = gelu(self.own(seen) + told)
        joined = joined + self.joined(joined)
        said = self.out(joined).float()
        regions, on_body, places, log_std = said.split((len(REGIONS), 1, 3, 1), -1)
        log_std = (log_std[..., 0] - 3).clamp(_LEAST_STD, _MOST_STD)
        on_body, across = on_body[..., 0], self.across(tokens).float()
        weights = on_body.detach().sigmoid() * clouds.present
        told_so = from_right_to_left(points, places.detach(), weights)
        sides = self.sureness * (across[:, 0] * told_so).sum(-1)
        return RawLabels(regions, on_body, places, log_std, sides, across)

    def _together(self, tokens: Tensor, neighbours: Tensor, known: Tensor) -> Tensor:
        """Tokens of moments that have seen the moments around them."""
        around = tokens[:, 0][neighbours] + self.step
        unknown = torch.where(known, 0.0, _UNKNOWN)[:, None].expand(-1, STEPS, STEPS)
        seen = self.moments(around, unknown)[:, STEPS // 2]
        return torch.cat((seen[:, None], tokens[:, 1:]), 1)


def _described(
    clouds: SeenClouds, centres: Tensor, near: Patch, wide: Patch
) -> tuple[Float[Tensor, "moments centres numbers"], Float[Tensor, "moments centres 3"]]:
    """Numbers that describe the surface around centres, and its normals towards the sensor."""
    view = clouds.view(centres)
    angles = (centres[..., None] * centres.new_tensor(_WAVES)).flatten(-2)
    rows, normals = [centres, view, clouds.flags.expand(*centres.shape[:-1], 2)], []
    rows += [angles.sin(), angles.cos()]
    for patch in (near, wide):
        facing = (patch.normal * view).sum(-1, keepdim=True)
        # without a sensor the sign of a normal means nothing; seen from the side, little
        normal = patch.normal * (_SIGN * facing).tanh()
        normals.append(normal)
        rows += [normal, facing.abs(), _SIZE * patch.covariance, 10 * patch.flatness[..., None]]
    rows += [10 * (near.mean - centres), 10 * (wide.mean - centres)]
    return torch.cat(rows, -1), normals[0]

"""The labelling network: points of clouds to regions of the body and places on its surface.

64 points far from each other look at the points around them; a transformer lets these centres look
at each other and, through one token for each moment, at other moments; then every point takes
what the centres around it found out. Which of two sides that look alike is the left one is the
same for all points of a moment: so it is one output per moment, `RawLabels.sides`, which compares
the direction from right to left of the points' places with the one that the moment's token finds.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn
from torch.nn.functional import gelu, normalize, scaled_dot_product_attention

from priors.labels.regions import REGIONS
from recon.core.struct import TensorStruct

_NOWHERE = -1e4
"""Logarithm of the weight of a point that is not present."""
_LEAST_VARIANCE = 4e-5
"""Variance across a patch beyond that along its normal, m², below which the normal means little:
points that lie alone or on a line have none, whatever rounding says."""


def squared_distances(
    a: Float[Tensor, "moments first 3"], b: Float[Tensor, "moments second 3"]
) -> Float[Tensor, "moments first second"]:
    """Squared distances of all points of two clouds, m²."""
    sums = a.square().sum(-1)[..., :, None] + b.square().sum(-1)[..., None, :]
    return torch.baddbmm(sums, a, b.mT, alpha=-2.0).clamp(min=0)


def kernel_weights(
    squared: Float[Tensor, "moments first second"],
    width: float,
    present: Bool[Tensor, "moments second"] | None = None,
) -> Float[Tensor, "moments first second"]:
    """Weights exp(-d² / (2 width²)) over the second cloud's points, normalised to sum one."""
    exponent = squared * (-0.5 / width**2)
    if present is not None:
        exponent = exponent.masked_fill(~present[..., None, :], _NOWHERE)
    return exponent.softmax(-1)


def farthest_point_samples(
    points: Float[Tensor, "moments points 3"],
    present: Bool[Tensor, "moments points"],
    count: int,
) -> Int[Tensor, "moments count"]:
    """Return indices of `count` points far from each other (farthest point sampling).

    The first is the farthest from the origin, so that the order of points does not matter. Where
    fewer points are present than asked for, some come more than once.
    """
    rows = torch.arange(len(points), device=points.device)
    length = points.square().sum(-1)
    nearest = length.where(present, -1.0)
    chosen = nearest.argmax(-1)
    found = [chosen]
    nearest = torch.where(present, torch.inf, -1.0).to(points)
    for _ in range(count - 1):
        last = points[rows, chosen]
        away = torch.baddbmm(length[..., None], points, last[..., None], alpha=-2.0)[..., 0]
        nearest = torch.minimum(nearest, away + length[rows, chosen][:, None])
        chosen = nearest.argmax(-1)
        found.append(chosen)
    return torch.stack(found, -1)


@dataclass(frozen=True)
class Patch(TensorStruct):
    """Local surface statistics around centres: kernel-weighted mean, covariance, normal."""

    mean: Float[Tensor, "moments centres 3"]
    """Mean of the points, metres."""
    covariance: Float[Tensor, "moments centres 6"]
    """Entries xx, xy, xz, yy, yz, zz of the points' covariance, m²."""
    normal: Float[Tensor, "moments centres 3"]
    """Direction in which the points vary least, its sign unknown; shorter than one where they vary
    in other directions as little."""
    flatness: Float[Tensor, "moments centres"]
    """Least variance over the sum of variances: 0 for a plane, a line or a point, 1/3 for a ball,
    less where they lie close together."""


def local_patches(
    points: Float[Tensor, "moments points 3"], weights: Float[Tensor, "moments centres points"]
) -> Patch:
    """Means, covariances and normals of weighted points."""
    x, y, z = points.unbind(-1)
    products = torch.stack((x * x, x * y, x * z, y * y, y * z, z * z), -1)
    found = weights @ torch.cat((points, products), -1)
    mean, second = found.split((3, 6), -1)
    x, y, z = mean.unbind(-1)
    covariance = second - torch.stack((x * x, x * y, x * z, y * y, y * z, z * z), -1)
    normal, least, middle = smallest_axes(covariance)
    gap = (middle - least).clamp(min=0)
    trace = covariance[..., 0] + covariance[..., 3] + covariance[..., 5]
    flatness = least.clamp(min=0) / (trace.clamp(min=0) + _LEAST_VARIANCE)
    return Patch(mean, covariance, normal * (gap / (gap + _LEAST_VARIANCE))[..., None], flatness)


def smallest_axes(
    entries: Float[Tensor, "*shape 6"],
) -> tuple[Float[Tensor, "*shape 3"], Float[Tensor, "*shape"], Float[Tensor, "*shape"]]:
    """Smallest eigenvalue with its eigenvector, and middle eigenvalue, of 3x3 symmetric matrices.

    Eigenvalues by the trigonometric solution of the cubic (Smith 1961), the vector as the longest
    cross product of two rows of A - λI: thousands at once, where a library would take them one by
    one.
    """
    a, b, c, d, e, f = entries.unbind(-1)
    q = (a + d + f) / 3
    shifted = ((a - q).square() + (d - q).square() + (f - q).square()) / 6
    p = (shifted + (b.square() + c.square() + e.square()) / 3).clamp(min=1e-20).sqrt()
    x, y, z = (a - q) / p, (d - q) / p, (f - q) / p
    u, v, w = b / p, c / p, e / p
    half = (x * (y * z - w * w) - u * (u * z - w * v) + v * (u * w - y * v)) / 2
    angle = half.clamp(-1, 1).arccos() / 3
    least = q + 2 * p * torch.cos(angle + 2 * torch.pi / 3)
    middle = 3 * q - least - (q + 2 * p * torch.cos(angle))
    first = torch.stack((a - least, b, c), -1)
    second = torch.stack((b, d - least, e), -1)
    third = torch.stack((c, e, f - least), -1)
    crossed = torch.stack(
        (
            torch.linalg.cross(first, second, dim=-1),
            torch.linalg.cross(second, third, dim=-1),
            torch.linalg.cross(third, first, dim=-1),
        ),
        -2,
    )
    best = crossed.square().sum(-1).argmax(-1, keepdim=True)
    axis = crossed.take_along_dim(best[..., None], -2)[..., 0, :]
    length = axis.norm(dim=-1, keepdim=True).clamp(min=1e-30)
    return axis / length, least, middle


_WIDEST = 0.15
"""Metres beside the middle of the unposed body beyond which a place counts no more: hands are far
from it there, and anywhere when posed."""


def direction_from_right_to_left(
    points: Float[Tensor, "moments points 3"],
    places: Float[Tensor, "moments points 3"],
    weights: Float[Tensor, "moments points"],
) -> Float[Tensor, "moments 3"]:
    """Unit vector per frame from the body's right to its left, found from labelled points.

    It is that of the covariance Σ w (s - s̄) (p - p̄) of points p and the coordinate s of their
    places from right to left, at most 15 cm. With left and right of all places exchanged, it is
    the opposite one. Where nothing tells, it is zero.

    Args:
        points: positions, metres.
        places: where on the unposed body they lie, metres.
        weights: how much each counts; zero for points off the body.
    """
    aside = places[..., 0].clamp(-_WIDEST, _WIDEST)
    share = weights / weights.sum(-1, keepdim=True).clamp(min=1e-6)
    middle = (share * aside).sum(-1, keepdim=True)
    return normalize(((share * (aside - middle))[..., None] * points).sum(-2), dim=-1)


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
    """Clouds of single frames in the form of the network's input; metres."""

    points: Float[Tensor, "moments points 3"]
    """Positions relative to the median of each cloud, zero where not present."""
    present: Bool[Tensor, "moments points"]
    eyes: Float[Tensor, "moments 3"]
    """Position of the sensor relative to the same median; zero where there is none."""
    has_eye: Bool[Tensor, " moments"]
    level: Bool[Tensor, " moments"]
    """Whether z points up."""

    @property
    def flags(self) -> Float[Tensor, "moments 1 2"]:
        """Inputs (0 or 1): whether z points up, and whether a sensor's place is known."""
        return torch.stack((self.level, self.has_eye), -1).to(self.points)[:, None]

    def directions_to_sensor(self, places: Float[Tensor, "moments places 3"]) -> Tensor:
        """Unit vectors from given places to the sensor; zero where no sensor is known."""
        return normalize(self.eyes[:, None] - places, dim=-1) * self.has_eye[:, None, None]


@dataclass(frozen=True)
class RawLabels(TensorStruct):
    """The network's raw outputs for every point, before they become probabilities."""

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


class AttentionLayer(nn.Module):
    """A transformer layer: attention between tokens, then a network applied to each token."""

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
        """Apply the layer; a token attends less to tokens that are farther away in space.

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
    """The network that finds the body region and place of every point of a cloud."""

    def __init__(self) -> None:
        """Random weights."""
        super().__init__()
        self.point = nn.Sequential(nn.Linear(8, _POINT), nn.GELU(), nn.Linear(_POINT, _POINT))
        self.centre = nn.Sequential(
            nn.Linear(2 * _POINT + 36 + 6 * len(_WAVES), _TOKEN), nn.GELU(),
            nn.Linear(_TOKEN, _TOKEN),
        )  # fmt: skip
        self.whole = nn.Parameter(torch.zeros(_TOKEN))
        self.layers = nn.ModuleList(AttentionLayer(_TOKEN) for _ in range(_LAYERS))
        self.step = nn.Parameter(0.02 * torch.randn(STEPS, _TOKEN))
        self.moments = AttentionLayer(_TOKEN)
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
        """Compute raw labels (region, surface position, its noise, on the body) of all points.

        Args:
            clouds: of all moments.
            neighbours: number of the moment at each of `STEPS` steps of `SPACING`; the middle one
                is the moment itself.
            known: whether there is such a moment.
        """
        points = clouds.points
        # distances are computed in single precision even where training uses bfloat16
        with torch.no_grad(), torch.autocast(points.device.type, enabled=False):
            pick = farthest_point_samples(points, clouds.present, _CENTRES)
            centres = points.take_along_dim(pick[..., None], -2)
            squared = squared_distances(centres, points)
            near, wide = (
                local_patches(points, kernel_weights(squared, width, clouds.present))
                for width in (_NEAR, _WIDE)
            )
            around = kernel_weights(squared, _MIDDLE, clouds.present)
            share = kernel_weights(squared.mT, _NEAR)
            described, normals = _surface_features(clouds, centres, near, wide)
            # the token of the whole frame has distance zero to all others
            between = torch.nn.functional.pad(squared_distances(centres, centres), (1, 0, 1, 0))
        flags = clouds.flags.expand(*points.shape[:-1], 2)
        own = self.point(torch.cat((points, clouds.directions_to_sensor(points), flags), -1))
        pooled = around @ own
        mine = own.take_along_dim(pick[..., None], -2)
        tokens = self.centre(torch.cat((described, pooled, mine), -1))
        tokens = torch.cat((self.whole.expand(len(tokens), 1, -1), tokens), 1)
        for number, layer in enumerate(self.layers):
            tokens = layer(tokens, between)
            if number + 1 == _TOGETHER:
                tokens = self._with_neighbours(tokens, neighbours, known)
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
        told_so = direction_from_right_to_left(points, places.detach(), weights)
        sides = self.sureness * (across[:, 0] * told_so).sum(-1)
        return RawLabels(regions, on_body, places, log_std, sides, across)

    def _with_neighbours(self, tokens: Tensor, neighbours: Tensor, known: Tensor) -> Tensor:
        """Replace each frame's first token by one that attends to the frames around it."""
        around = tokens[:, 0][neighbours] + self.step
        unknown = torch.where(known, 0.0, _UNKNOWN)[:, None].expand(-1, STEPS, STEPS)
        seen = self.moments(around, unknown)[:, STEPS // 2]
        return torch.cat((seen[:, None], tokens[:, 1:]), 1)


def _surface_features(
    clouds: SeenClouds, centres: Tensor, near: Patch, wide: Patch
) -> tuple[Float[Tensor, "moments centres numbers"], Float[Tensor, "moments centres 3"]]:
    """Network inputs that describe the surface around centres, and its normals there."""
    view = clouds.directions_to_sensor(centres)
    angles = (centres[..., None] * centres.new_tensor(_WAVES)).flatten(-2)
    rows, normals = [centres, view, clouds.flags.expand(*centres.shape[:-1], 2)], []
    rows += [angles.sin(), angles.cos()]
    for patch in (near, wide):
        facing = (patch.normal * view).sum(-1, keepdim=True)
        # normals whose sign is unsure (no sensor, or a surface seen edge-on) become zero
        normal = patch.normal * (_SIGN * facing).tanh()
        normals.append(normal)
        rows += [normal, facing.abs(), _SIZE * patch.covariance, 10 * patch.flatness[..., None]]
    rows += [10 * (near.mean - centres), 10 * (wide.mean - centres)]
    return torch.cat(rows, -1), normals[0]

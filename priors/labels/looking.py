"""Labels of points of clouds, computed by the trained network."""

from dataclasses import dataclass
from pathlib import Path

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor
from torch.nn.functional import normalize

from priors.checkpoints import named_checkpoint
from priors.labels.networks import SPACING, STEPS, LabelNetwork, RawLabels, SeenClouds
from priors.labels.regions import MIRRORED_REGIONS, REGIONS, Regions, mirrored_places
from recon.body.model import BodyModel
from recon.core.residuals import lower_median
from recon.core.struct import TensorStruct, concatenate, stack


@dataclass(frozen=True)
class PointLabels(TensorStruct):
    """Body region and surface position of every point of a cloud; zero where there is no point.

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
        """Index in `REGIONS` of each point's most likely region; -1 where there is no point."""
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
    def of_vertices(
        cls,
        body: BodyModel,
        vertices: Int[Tensor, "*batch moments points"],
        present: Bool[Tensor, "*batch moments points"],
        std: float = 0.01,
    ) -> "PointLabels":
        """Make exact labels for simulated points whose nearest vertices are known.

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


_STEEP = 1e-2
"""Horizontal share of a view from which on the sensor stands above the cloud."""


def in_network_frame(
    points: Float[Tensor, "moments points 3"],
    present: Bool[Tensor, "moments points"],
    eyes: Float[Tensor, "moments 3"],
    has_eye: Bool[Tensor, " moments"],
    level: Bool[Tensor, " moments"],
) -> SeenClouds:
    """Clouds relative to their medians, rotated by `turns_to_network_frame`.

    Args:
        points: positions, metres; zero where not present.
        present: whether a row holds a point.
        eyes: place of the sensor, metres; anything where there is none.
        has_eye: whether there is a sensor.
        level: whether z is known to point up.
    """
    middle = lower_median(points.mT, present[:, None].expand(points.mT.shape))
    about = (points - middle[:, None]).where(present[..., None], 0.0)
    views = (eyes - middle).where(has_eye[:, None], 0.0)
    turns = turns_to_network_frame(about, present, views, has_eye, level)
    return SeenClouds(
        points=about @ turns.mT,
        present=present,
        eyes=(turns @ views[..., None])[..., 0],
        has_eye=has_eye,
        level=level,
    )


def turns_to_network_frame(
    points: Float[Tensor, "moments points 3"],
    present: Bool[Tensor, "moments points"],
    views: Float[Tensor, "moments 3"],
    has_eye: Bool[Tensor, " moments"],
    level: Bool[Tensor, " moments"],
) -> Float[Tensor, "moments 3 3"]:
    """Rotations of clouds into the network's frame: z up, x towards the sensor.

    One of both that is not known lies along the longest axis of the points across the other. Where
    there is no sensor, the longest axis of the points across z is y; where nothing is known, their
    longest axis of all is z. Axes point to where the points reach farther.
    """
    vertical = points.new_tensor([0.0, 0.0, 1.0]).expand(len(points), 3)
    view = normalize(views, dim=-1)
    first = torch.where(has_eye[:, None], view, widest_direction(points, present, None))
    first = torch.where(level[:, None], vertical, first)
    across = view - (view * first).sum(-1, keepdim=True) * first
    seen = level & has_eye & (across.norm(dim=-1) > _STEEP)
    second = torch.where(
        seen[:, None], normalize(across, dim=-1), widest_direction(points, present, first)
    )
    third = torch.linalg.cross(first, second, dim=-1)
    towards = (has_eye & ~level)[:, None, None]
    turned = torch.where(
        towards,
        torch.stack((first, -third, second), -2),
        torch.stack((-third, second, first), -2),
    )
    return torch.where(seen[:, None, None], torch.stack((second, third, first), -2), turned)


def widest_direction(
    points: Float[Tensor, "moments points 3"],
    present: Bool[Tensor, "moments points"],
    across: Float[Tensor, "moments 3"] | None,
) -> Float[Tensor, "moments 3"]:
    """Direction of the points' greatest variance, perpendicular to `across` if that is given."""
    count = present.sum(-1, keepdim=True).clamp(min=1)[..., None]
    away = (points - points.sum(-2, keepdim=True) / count).where(present[..., None], 0.0)
    if across is not None:
        away = away - (away * across[:, None]).sum(-1, keepdim=True) * across[:, None]
    axis = torch.linalg.eigh(away.mT @ away / count).eigenvectors[..., -1]
    if across is not None:
        # where all points lie on one line, `axis` may be any direction perpendicular to it
        axis = axis - (axis * across).sum(-1, keepdim=True) * across
        other = torch.eye(3).to(points)[across.abs().argmin(-1)]
        other = other - (other * across).sum(-1, keepdim=True) * across
        axis = torch.where(axis.norm(dim=-1, keepdim=True) > 0.1, axis, other)
        axis = normalize(axis, dim=-1)
    reach = (away * axis[:, None]).sum(-1).pow(3).sum(-1, keepdim=True)
    return torch.where(reach < 0, -axis, axis)


_CHUNK = 256
"""Moments that are looked at at once."""
_LATE = 0.1
"""Seconds by which a moment may miss the time at which another one is looked for."""


@dataclass(frozen=True)
class CloudLabeller:
    """Computes for every point of a cloud which part of the body it lies on, if any."""

    network: LabelNetwork

    @classmethod
    def load(cls, path: str | Path | None = None) -> "CloudLabeller":
        """Load the bundled network, or one trained by `python -m training labels`.

        Raises:
            FileNotFoundError: when there is no such file.
            ValueError: when it is damaged or of another network.
        """
        network = LabelNetwork().eval().requires_grad_(False)
        found = named_checkpoint("open" if path is None else path, "labels")
        found.without_prefixes().copy_into(network)
        return cls(network)

    @torch.no_grad()
    def __call__(
        self,
        points: Float[Tensor, "*batch moments points 3"],
        present: Bool[Tensor, "*batch moments points"],
        fps: float,
        eyes: Float[Tensor, "*#batch #moments 3"] | None = None,
        *,
        level: bool = True,
    ) -> PointLabels:
        """Label all points of a sequence of clouds, using frames up to 0.6 s around each frame.

        A few hundred points of a person are enough: see `PointCloud.with_at_most_points`.

        Args:
            points: positions, metres; zero where not present.
            present: whether a row holds a point.
            fps: rate of the moments, Hz.
            eyes: place of the sensor at every moment, metres; None for scans from all sides.
            level: whether z is known to point up.
        """
        batch, moments = points.shape[:-3], points.shape[-3]
        clouds = points.reshape(-1, *points.shape[-3:]).float()
        masks = present.reshape(-1, *present.shape[-2:])
        at = None if eyes is None else eyes.expand(*batch, moments, 3).reshape(-1, moments, 3)
        eyes_of_clouds = [None] * len(clouds) if at is None else list(at.to(clouds))
        labels = stack(
            [
                label_probabilities(self._labels_of_clip(cloud, shown, fps, eye, level), shown)
                for cloud, shown, eye in zip(clouds, masks, eyes_of_clouds, strict=True)
            ]
        ).to(dtype=points.dtype)
        return labels.map(lambda rows: rows.reshape(*batch, *rows.shape[1:]))

    def _labels_of_clip(
        self, points: Tensor, present: Tensor, fps: float, eyes: Tensor | None, level: bool
    ) -> RawLabels:
        """Raw outputs of the network for one clip, computed a few frames at a time."""
        steps = [round(step * SPACING * fps) for step in _OFFSETS]
        reach = max(steps)
        parts = []
        for first in range(0, len(points), _CHUNK):
            begin, end = max(first - reach, 0), min(first + _CHUNK + reach, len(points))
            some = slice(begin, end)
            flag = torch.ones_like(present[some, 0])
            clouds = in_network_frame(
                points[some],
                present[some],
                torch.zeros_like(points[some, 0]) if eyes is None else eyes[some],
                flag & (eyes is not None),
                flag & level,
            )
            neighbours, known = neighbouring_moments(clouds.present.any(-1), steps, fps)
            own = slice(first - begin, first - begin + min(_CHUNK, len(points) - first))
            parts.append(self.network(clouds, neighbours, known)[own])
        return concatenate(parts)


_OFFSETS = range(-(STEPS // 2), STEPS // 2 + 1)


def neighbouring_moments(
    shown: Bool[Tensor, " moments"], steps: list[int], fps: float
) -> tuple[Int[Tensor, "moments steps"], Bool[Tensor, "moments steps"]]:
    """Indices of each frame's neighbouring frames, and a mask of those that can be used."""
    offset = torch.tensor(steps, device=shown.device)
    neighbour = torch.arange(len(shown), device=shown.device)[:, None] + offset
    inside = (neighbour >= 0) & (neighbour < len(shown))
    index = neighbour.clamp(0, len(shown) - 1)
    wanted = torch.tensor([step * SPACING for step in _OFFSETS], device=shown.device)
    in_time = (offset / fps - wanted).abs() <= _LATE
    return index, (inside & shown[index] & in_time) | (offset == 0) & (wanted == 0)


def label_probabilities(raw: RawLabels, present: Bool[Tensor, "moments points"]) -> PointLabels:
    """Convert the network's outputs to labels, mixing left and right by their probability."""
    exists = present[..., None]
    unswapped = raw.sides.sigmoid()[:, None, None]
    regions = raw.regions.softmax(-1)
    regions = unswapped * regions + (1 - unswapped) * regions[..., list(MIRRORED_REGIONS)]
    places = torch.where(unswapped < 0.5, mirrored_places(raw.places), raw.places)
    return PointLabels(
        present=present,
        regions=regions.where(exists, 0.0),
        on_body=raw.on_body.sigmoid().where(present, 0.0),
        places=places.where(exists, 0.0),
        log_std=raw.log_std.where(present, 0.0),
    )

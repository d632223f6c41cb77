"""Labels of the points of clouds, as the trained network gives them."""

from dataclasses import dataclass
from pathlib import Path

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from priors.checkpoints import named_checkpoint
from priors.labels.networks import SPACING, STEPS, LabelNetwork, RawLabels
from priors.labels.record import PointLabels
from priors.labels.regions import MIRRORED_REGIONS, mirrored_places
from priors.labels.standard import standard
from recon.core.struct import concatenate, stack

_CHUNK = 256
"""Moments that are looked at at once."""
_LATE = 0.1
"""Seconds by which a moment may miss the time at which another one is looked for."""


@dataclass(frozen=True)
class CloudLabeller:
    """What says of every point of a cloud which part of a body it shows, if any."""

    network: LabelNetwork

    @classmethod
    def load(cls, path: str | Path | None = None) -> "CloudLabeller":
        """The bundled network, or one trained by `recon train labels`.

        Raises:
            FileNotFoundError: when there is no such file.
            ValueError: when it is damaged or of another network.
        """
        network = LabelNetwork().eval().requires_grad_(False)
        found = named_checkpoint("open" if path is None else path, "labels")
        found.besides().into(network)
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
        """Labels of all points; each moment is looked at together with those 0.6 s around it.

        A few hundred points of a person are as many as it takes: give `PointCloud.thinned` clouds.

        Args:
            points: positions, metres; zero where not present.
            present: whether a row holds a point.
            fps: rate of the moments, Hz.
            eyes: place of the sensor at every moment, metres; None for scans from all sides.
            level: whether z is known to point up.
        """
        batch, moments = points.shape[:-3], points.shape[-3]
        flat = points.reshape(-1, *points.shape[-3:]).float()
        here = present.reshape(-1, *present.shape[-2:])
        at = None if eyes is None else eyes.expand(*batch, moments, 3).reshape(-1, moments, 3)
        places = [None] * len(flat) if at is None else list(at.to(flat))
        said = stack(
            [
                believed(self._clip(cloud, shown, fps, eye, level), shown)
                for cloud, shown, eye in zip(flat, here, places, strict=True)
            ]
        ).to(dtype=points.dtype)
        return said.map(lambda rows: rows.reshape(*batch, *rows.shape[1:]))

    def _clip(
        self, points: Tensor, present: Tensor, fps: float, eyes: Tensor | None, level: bool
    ) -> RawLabels:
        """What the network says of one clip, some moments at a time."""
        steps = [round(step * SPACING * fps) for step in _OFFSETS]
        reach = max(steps)
        parts = []
        for first in range(0, len(points), _CHUNK):
            begin, end = max(first - reach, 0), min(first + _CHUNK + reach, len(points))
            some = slice(begin, end)
            flag = torch.ones_like(present[some, 0])
            clouds = standard(
                points[some],
                present[some],
                torch.zeros_like(points[some, 0]) if eyes is None else eyes[some],
                flag & (eyes is not None),
                flag & level,
            )
            neighbours, known = around(clouds.present.any(-1), steps, fps)
            own = slice(first - begin, first - begin + min(_CHUNK, len(points) - first))
            parts.append(self.network(clouds, neighbours, known)[own])
        return concatenate(parts)


_OFFSETS = range(-(STEPS // 2), STEPS // 2 + 1)


def around(
    shown: Bool[Tensor, " moments"], steps: list[int], fps: float
) -> tuple[Int[Tensor, "moments steps"], Bool[Tensor, "moments steps"]]:
    """Numbers of the moments around each, and whether there are such moments with points."""
    offset = torch.tensor(steps, device=shown.device)
    asked = torch.arange(len(shown), device=shown.device)[:, None] + offset
    inside = (asked >= 0) & (asked < len(shown))
    index = asked.clamp(0, len(shown) - 1)
    wanted = torch.tensor([step * SPACING for step in _OFFSETS], device=shown.device)
    in_time = (offset / fps - wanted).abs() <= _LATE
    return index, (inside & shown[index] & in_time) | (offset == 0) & (wanted == 0)


def believed(raw: RawLabels, present: Bool[Tensor, "moments points"]) -> PointLabels:
    """Probabilities of what the network says, left and right exchanged where that is likelier."""
    there = present[..., None]
    as_said = raw.sides.sigmoid()[:, None, None]
    regions = raw.regions.softmax(-1)
    regions = as_said * regions + (1 - as_said) * regions[..., list(MIRRORED_REGIONS)]
    places = torch.where(as_said < 0.5, mirrored_places(raw.places), raw.places)
    return PointLabels(
        present=present,
        regions=regions.where(there, 0.0),
        on_body=raw.on_body.sigmoid().where(present, 0.0),
        places=places.where(there, 0.0),
        log_std=raw.log_std.where(present, 0.0),
    )

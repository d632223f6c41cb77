"""Labelled clouds on disk and in memory, and their augmentation."""

import math
from dataclasses import dataclass, fields
from pathlib import Path

import torch
from jaxtyping import Bool, Float, Int
from torch import Generator, Tensor

from priors.labels.regions import MIRRORED_REGIONS, REGIONS
from recon.core import rotations as so3
from recon.core.struct import TensorStruct, concatenate
from recon.formats.opening import load_arrays
from recon.formats.replacing import save_arrays

POINTS = 768
"""Most points of a moment in a file."""


@dataclass(frozen=True)
class LabelledClouds(TensorStruct):
    """Windows of simulated clouds with true labels of their points; metres, z up."""

    points: Float[Tensor, "windows moments points 3"]
    """About the middle of each window."""
    present: Bool[Tensor, "windows moments points"]
    places: Float[Tensor, "windows moments points 3"]
    """Places on the unposed body of average shape; zero off the body."""
    regions: Int[Tensor, "windows moments points"]
    """Number of the region; -1 off the body."""
    eyes: Float[Tensor, "windows 3"]
    """Place of the sensor; zero where there is none."""
    has_eye: Bool[Tensor, " windows"]
    level: Bool[Tensor, " windows"]
    """Whether z is known to point up."""

    def save(self, path: Path) -> None:
        """Write the clouds to a file, whole or not at all."""
        save_arrays(path, {name: tensor.numpy() for name, tensor in self.tensors().items()})

    @classmethod
    def load(cls, path: Path) -> "LabelledClouds":
        """Read labelled clouds from a file that `save` has written.

        Raises:
            ValueError: when it is damaged or none of these.
        """
        arrays, names = load_arrays(path), [field.name for field in fields(cls)]
        if missing := [name for name in names if name not in arrays]:
            raise ValueError(f"{path}: expected labelled clouds, {', '.join(missing)} are missing")
        return cls(**{name: torch.from_numpy(arrays[name]) for name in names})


@dataclass(frozen=True)
class CloudVariation:
    """Settings of the augmentation of windows, besides headings and mirror images."""

    tilted: float = 0.25
    """Share of windows that are turned in any way, so that nothing is known of gravity."""
    hidden: float = 0.4
    """Share of windows of which something is hidden besides."""
    lost_limb: float = 0.2
    """Share of windows whose points lack some regions."""
    fewest: int = 80
    most: int = 448
    """Range of the number of points of a moment (logarithmically uniform)."""
    blind: float = 0.05
    """Share of windows whose sensor's place is withheld."""
    lone: float = 0.5
    """Share of the steps that learn from single moments, of as many more windows."""


@dataclass(frozen=True)
class CloudCorpus:
    """All windows of a folder's files, in memory; existing points come first in each frame."""

    clouds: LabelledClouds

    @classmethod
    def load(cls, folder: Path) -> "CloudCorpus":
        """Load all labelled clouds of a folder.

        Raises:
            FileNotFoundError: when there are none.
        """
        paths = sorted(folder.glob("clouds_*.npz"))
        if len(paths) == 0:
            raise FileNotFoundError(f"{folder}: no clouds_*.npz there; make them first")
        return cls(concatenate([LabelledClouds.load(path) for path in paths]))

    def __len__(self) -> int:
        return len(self.clouds.points)

    def draw(self, windows: int, variation: CloudVariation, random: Generator) -> LabelledClouds:
        """Draw random windows and augment them; all get the same number of points per frame.

        At times their moments are windows of their own, of as many more windows.
        """
        moments = self.clouds.points.shape[1]
        lone = torch.rand((), generator=random).item() < variation.lone
        count = windows * moments if lone else windows
        chosen = torch.randint(len(self), (count,), generator=random)
        span = math.log(variation.most / variation.fewest)
        share = torch.rand((), generator=random).item()
        rows = min(round(variation.fewest * math.exp(span * share)), POINTS)
        moment = torch.randint(moments, (count, 1), generator=random)
        plain = self.windows(chosen, min(2 * rows, POINTS), random, moment if lone else None)
        return at_most_points(augmented(plain, variation, random), rows)

    def windows(
        self,
        windows: Int[Tensor, " windows"],
        rows: int,
        random: Generator | None,
        moment: Int[Tensor, "windows 1"] | None = None,
    ) -> LabelledClouds:
        """Return the given windows without augmentation, with at most `rows` points per frame."""
        every = self.clouds
        moments = torch.arange(every.points.shape[1])[None] if moment is None else moment
        count = every.present[windows[:, None], moments].sum(-1)
        first = torch.zeros_like(count)
        # points are in random order, so consecutive ones from a random place are a random sample
        if random is not None:
            first = torch.rand(count.shape, generator=random) * (count - rows + 1).clamp(min=0)
            first = first.long()
        row = first[..., None] + torch.arange(rows)
        present = row < count[..., None]
        pick = (windows[:, None, None], moments[..., None], row.clamp(max=POINTS - 1))
        return every[windows].replace(
            points=every.points[pick].float(),
            present=present,
            places=every.places[pick].float(),
            regions=every.regions[pick].long().where(present, -1),
        )


def augmented(
    clouds: LabelledClouds, variation: CloudVariation, random: Generator
) -> LabelledClouds:
    """Augment clouds: rotate, mirror, hide parts, rescale."""
    windows = len(clouds.points)

    def chance(share: float) -> Bool[Tensor, " windows"]:
        return torch.rand(windows, generator=random) < share

    clouds = mirrored_where(chance(0.5), clouds)
    tilted = chance(variation.tilted)
    angle = math.tau * torch.rand(windows, generator=random)
    turns = torch.where(
        tilted[:, None, None], _random_rotations(windows, random), so3.about_z(angle)
    )
    blind = chance(variation.blind)
    present = clouds.present & ~_beyond_plane_or_box(clouds, chance(variation.hidden), random)
    present &= ~_in_hidden_regions(clouds, chance(variation.lost_limb), random)
    # do not crop when the crop would keep too few points
    enough = present.flatten(1).sum(-1) >= 0.25 * clouds.present.flatten(1).sum(-1)
    present = torch.where(enough[:, None, None], present, clouds.present)
    return clouds.replace(
        points=clouds.points @ turns.mT[:, None],
        eyes=(turns @ clouds.eyes[..., None])[..., 0],
        has_eye=clouds.has_eye & ~blind,
        level=clouds.level & ~tilted,
        present=present,
        regions=clouds.regions.where(present, -1),
    )


def at_most_points(clouds: LabelledClouds, rows: int) -> LabelledClouds:
    """Keep at most `rows` points per frame of clouds; points that exist come first."""
    order = (~clouds.present).byte().argsort(dim=-1, stable=True)[..., :rows]
    wide = order[..., None].expand(*order.shape, 3)
    present = clouds.present.gather(-1, order)
    return clouds.replace(
        points=clouds.points.gather(-2, wide).where(present[..., None], 0.0),
        places=clouds.places.gather(-2, wide),
        regions=clouds.regions.gather(-1, order),
        present=present,
    )


def mirrored_where(which: Bool[Tensor, " windows"], clouds: LabelledClouds) -> LabelledClouds:
    """Mirror the chosen windows at the plane x = 0, with left and right labels exchanged."""
    flip = torch.where(which[:, None], torch.tensor([-1.0, 1.0, 1.0]), torch.ones(3))
    other = torch.tensor([*MIRRORED_REGIONS, -1])[clouds.regions]
    regions = torch.where(which[:, None, None], other, clouds.regions)
    return clouds.replace(
        points=clouds.points * flip[:, None, None],
        places=clouds.places * flip[:, None, None],
        eyes=clouds.eyes * flip,
        regions=regions,
    )


def with_half_hidden(clouds: LabelledClouds, random: Generator) -> LabelledClouds:
    """Hide the points on one side of a random plane through the body's middle.

    The plane halves the points on the body of all moments of a window together.
    """
    normal = torch.randn(len(clouds.points), 3, generator=random)
    along = (clouds.points * normal[:, None, None]).sum(-1)
    on_body = clouds.regions >= 0
    middle = along.where(on_body, torch.nan).flatten(1).nanmedian(-1).values
    present = clouds.present & (along < middle[:, None, None])
    return clouds.replace(present=present, regions=clouds.regions.where(present, -1))


def _beyond_plane_or_box(clouds: LabelledClouds, which: Tensor, random: Generator) -> Tensor:
    """Mask of points beyond a random plane or inside a random box, constant over time."""
    windows = len(clouds.points)
    normal = torch.randn(windows, 3, generator=random)
    # half of the planes are horizontal, like tables
    level = torch.rand(windows, generator=random) < 0.5
    normal = torch.where(level[:, None], torch.tensor([0.0, 0.0, -1.0]), normal)
    normal = torch.nn.functional.normalize(normal, dim=-1)
    along = (clouds.points * normal[:, None, None]).sum(-1)
    spread = along.where(clouds.present, 0.0).flatten(1).std(-1).clamp(min=0.05)
    cut = spread * (2.0 * torch.rand(windows, generator=random) - 0.6)
    beyond = along > cut[:, None, None]
    pick = (
        torch.rand(windows, 1, 1, generator=random) * clouds.present[:, 0].sum(-1)[:, None, None]
    )
    centre = clouds.points[:, 0].gather(
        1, pick.long().clamp(max=clouds.points.shape[2] - 1).expand(-1, 1, 3)
    )
    size = 0.1 + 0.4 * torch.rand(windows, 1, 1, 3, generator=random)
    inside = ((clouds.points - centre[:, None]).abs() < size).all(-1)
    by_box = torch.rand(windows, generator=random) < 0.5
    return torch.where(by_box[:, None, None], inside, beyond) & which[:, None, None]


def _in_hidden_regions(clouds: LabelledClouds, which: Tensor, random: Generator) -> Tensor:
    """Mask of points in body regions that are hidden, which are drawn for every window."""
    gone = torch.rand(len(which), len(REGIONS) + 1, generator=random) < 0.25
    gone[:, -1] = False
    lost = gone.gather(1, clouds.regions.flatten(1) % (len(REGIONS) + 1))
    return lost.unflatten(1, clouds.regions.shape[1:]) & which[:, None, None]


def _random_rotations(count: int, random: Generator) -> Float[Tensor, "count 3 3"]:
    """Uniformly random rotations, from normalised Gaussian quaternions."""
    w, x, y, z = torch.nn.functional.normalize(
        torch.randn(count, 4, generator=random), dim=-1
    ).unbind(-1)
    rows = [
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
    ]  # fmt: skip
    return torch.stack(rows, -1).unflatten(-1, (3, 3))

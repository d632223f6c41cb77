"""Labels of points: regions of the body, their mirror images, labels that simulation knows."""

import torch

from priors.labels.looking import PointLabels
from priors.labels.regions import MIRRORED_REGIONS, REGION_OF_JOINT, REGIONS, Regions
from recon.core.skeleton import JOINTS, MIRROR


def test_joints_of_both_sides_have_regions_of_both_sides():
    mirrored = [REGION_OF_JOINT[MIRROR[joint]] for joint in range(len(JOINTS))]
    assert mirrored == [MIRRORED_REGIONS[region] for region in REGION_OF_JOINT]
    assert set(REGION_OF_JOINT) == set(range(len(REGIONS)))
    for name, other in zip(REGIONS, MIRRORED_REGIONS, strict=True):
        side = name.replace("left", "R").replace("right", "left").replace("R", "right")
        assert REGIONS[other] == side


def test_regions_lie_where_their_names_say(body):
    regions = Regions.of(body)
    middle = {
        name: regions.places[regions.of_vertex == number].mean(0)
        for number, name in enumerate(REGIONS)
    }
    heights = [middle[name][1] for name in ("head", "chest", "belly", "pelvis", "left_thigh")]
    assert heights == sorted(heights, reverse=True)
    assert middle["left_thigh"][1] > middle["left_lower_leg"][1]
    assert middle["left_forearm"][0] > middle["left_upper_arm"][0] > 0.1
    assert middle["right_forearm"][0] < middle["right_upper_arm"][0] < -0.1


def test_known_labels_are_those_of_their_vertices(body):
    vertices = torch.tensor([[[0, 4000, -1, 17]]])
    present = torch.tensor([[[True, True, True, False]]])
    labels = PointLabels.of_vertices(body, vertices, present, std=0.02)
    regions = Regions.of(body)
    assert labels.region.tolist() == [
        [
            [
                int(regions.of_vertex[0]),
                int(regions.of_vertex[4000]),
                int(labels.region[0, 0, 2]),
                -1,
            ]
        ]
    ]
    assert labels.on_body.tolist() == [[[1.0, 1.0, 0.0, 0.0]]]
    assert torch.equal(labels.places[0, 0, 1], body.template[4000])
    assert torch.equal(labels.places[0, 0, 3], torch.zeros(3, dtype=torch.float64))
    torch.testing.assert_close(
        labels.std, torch.tensor([[[0.02, 0.02, 0.02, 0.0]]], dtype=torch.float64)
    )
    assert labels.confidence[0, 0, 3] == 0

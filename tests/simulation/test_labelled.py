"""Labelled clouds: points lie where their labels say, in rooms, on people in any posture."""

import numpy as np
import pytest
import torch

from priors.labels.looking import CloudLabeller
from priors.labels.regions import MIRRORED_REGIONS, Regions
from recon.body.model import BodyModel
from recon.core import rotations as so3
from tests.filmed import walk
from training.labels.rooms import body_points, drawn_room, simulated_room_points
from training.labels.shards import (
    Postures,
    Source,
    clothed_bodies,
    draw_clouds,
    drawn_shape,
    random_motion,
    random_orientation,
    with_hair,
)


@pytest.fixture(scope="module")
def people():
    return clothed_bodies(BodyModel.load(), 3, 0)


def a_source(people):
    turns = so3.exp(0.2 * torch.randn(40, 22, 3, generator=torch.Generator().manual_seed(0)))
    return Source(Postures.of([("anna", turns), ("ben", turns[:9])], 30.0), people, people[0])


def test_points_lie_where_their_labels_say(people):
    """A point of a bare body at rest is its own place, up to the noise of the sensor."""
    body = people[0]
    random = np.random.default_rng(0)
    places = body.template.double().numpy()
    upright = places[:, [2, 0, 1]] + [0.0, 0.0, 1.3]
    room = drawn_room(upright[None], random)
    for background in ("nothing", "ball", "box"):
        seen = simulated_room_points(upright, body.faces.numpy(), places, room, background, random)
        on = seen.on_body > 0
        assert on.sum() > 200
        away = np.linalg.norm(
            seen.points[on] - seen.places[on][:, [2, 0, 1]] - [0, 0, 1.3], axis=1
        )
        # noise lies along the view, and grows with the distance
        assert np.median(away) < 0.04
        assert np.abs(seen.places[~on]).max(initial=0) == 0
        if background == "box":
            assert (~on).sum() > 10
    scanned = body_points(upright, body.faces.numpy(), places, 500, random)
    on = scanned.on_body > 0
    gap = scanned.points[on] - scanned.places[on][:, [2, 0, 1]] - [0.0, 0.0, 1.3]
    assert np.abs(gap).max() < 0.06


def test_windows_have_points_regions_and_eyes(people):
    clouds = draw_clouds(a_source(people), 3, np.random.default_rng(5))
    assert (clouds.present.flatten(1).sum(-1) > 180).all()
    for window in range(3):
        present, regions = clouds.present[window, 0], clouds.regions[window, 0]
        count = int(present.sum())
        assert bool(present[:count].all())
        assert len(regions[:count][regions[:count] >= 0].unique()) >= 3
        assert (regions[count:] == -1).all()
    again = draw_clouds(a_source(people), 3, np.random.default_rng(5))
    assert torch.equal(clouds.points, again.points)


def test_made_up_limbs_bend_as_joints_do():
    """Knees bend backwards and elbows forwards, which mirrored signs would break."""
    body = BodyModel.load()
    random = np.random.default_rng(0)
    for _ in range(20):
        turns = torch.from_numpy(random_motion(1, random))
        rest = body.joint_template
        for side, knee, ankle, hip in (("left", 4, 7, 1), ("right", 5, 8, 2)):
            shank = turns[0, knee] @ (rest[ankle] - rest[knee])
            assert shank[2] < 0.05, side
            assert turns[0, hip].isfinite().all()
        for elbow, wrist in ((18, 20), (19, 21)):
            forearm = turns[0, elbow] @ (rest[wrist] - rest[elbow])
            assert forearm[2] > -0.05


def test_people_are_turned_over_at_times():
    random = np.random.default_rng(0)
    up = np.array([random_orientation(random)[2, 2] for _ in range(300)])
    assert 0.5 < (up > 0.99).mean() < 0.8
    assert (up < -0.5).mean() > 0.02


def test_hair_grows_on_heads_only():
    body = BodyModel.load()
    grown = [with_hair(body, seed).template - body.template for seed in range(6)]
    away = torch.stack([each.norm(dim=-1) for each in grown])
    assert away.max() > 0.01
    assert away[:, body.weights[:, 15] < 0.01].max() < 1e-3
    assert drawn_shape(body, np.random.default_rng(0)).abs().max() <= 3.5


@pytest.mark.numerics
def test_the_bundled_network_tells_the_regions_of_a_walker_but_for_sides():
    body, random = BodyModel.load(), np.random.default_rng(2)
    vertices = body.pose(walk(30)).vertices[::9].double().numpy()
    room = drawn_room(vertices, random)
    places = body.template.double().numpy()
    regions = Regions.of(body).of_vertex
    labeller, right, strays = CloudLabeller.load(), [], []
    seen = [
        simulated_room_points(row, body.faces.numpy(), places, room, "nothing", random)
        for row in vertices
    ]
    for each in seen:
        pick = random.permutation(len(each.points))[:512]
        said = labeller(
            torch.from_numpy(each.points[pick]).float()[None],
            torch.ones(1, len(pick), dtype=torch.bool),
            30.0,
            torch.from_numpy(room.eye).float()[None],
        )
        on = torch.from_numpy(each.on_body[pick]) > 0
        shown = torch.from_numpy(each.places[pick]).float()
        true = regions[torch.cdist(shown, body.template).argmin(-1)]
        region = said.region[0]
        exchanged = torch.tensor(MIRRORED_REGIONS)[region]
        shares = [(one == true)[on].float().mean().item() for one in (region, exchanged)]
        right.append(max(shares))
        strays.append(((said.on_body[0] > 0.5) == on).float().mean().item())
    assert np.mean(right) > 0.65
    assert np.mean(strays) > 0.9

"""Hands in films: where they are looked for, whose they are, and where their points are."""

from pathlib import Path

import numpy as np
import pytest

import recon
from observations.keypoints2d import Keypoints2D
from recon import cli
from recon.body.hands import WRISTS, hand_arrays
from recon.core.layouts import keypoint_names
from recon.detections.records import Detections
from recon.films import hand_networks
from recon.films.blazepose import Region
from recon.films.clock import FilmClock
from recon.films.decoding import Film, FilmFrame, open_film
from recon.films.hand_networks import Hand, HandNetworks, Palm
from recon.films.hands import with_hands
from recon.films.reader import read_film
from recon.formats.opening import load_arrays
from recon.view.painter import paint
from recon.view.scene import Figure, Show
from recon.view.viewpoint import following_viewpoints
from tests.filmed import bundled, walk
from tests.films.painted import write

SHAPE = np.array([
    (0, 0), (15, -15), (28, -28), (38, -38), (46, -46),
    *((x, -y) for x, top in ((16, 90), (4, 96), (-8, 92), (-19, 84)) for y in
      (top - 43, top - 22, top - 10, top)),
], float)  # fmt: skip
"""Points of a hand that points up, pixels from its wrist."""
NAMES = keypoint_names("coco17")
BODY = {
    "left_shoulder": (330, 200), "right_shoulder": (270, 200), "left_elbow": (400, 330),
    "right_elbow": (200, 330), "left_wrist": (400, 440), "right_wrist": (200, 440),
    "left_hip": (325, 420), "right_hip": (275, 420),
}  # fmt: skip
"""Keypoints of a body; a hand of it is some 83 pixels long."""
SIZE = (640, 640)


def hand_at(place, angle=np.pi, score=1.0) -> Hand:
    """A hand whose fingers point up, or down, as its angle says; by its wrist."""
    cos, sin = np.cos(angle), np.sin(angle)
    return Hand(SHAPE @ np.array([[cos, sin], [-sin, cos]]) + place, score)


class Seeing(HandNetworks):
    """Networks that see given hands, by frame, in regions that reach them."""

    def __init__(self, hands):
        self.hands, self.frame, self.searches = hands, 0, 0

    def _nearest(self, place):
        hands = self.hands[self.frame]
        return min(hands, key=lambda one: np.linalg.norm(one.pixels[9] - place), default=None)

    def palms_in(self, image, square):  # noqa: ARG002
        self.searches += 1
        return [
            Palm(one.next_region, one.pixels[0], 0.9)
            for one in self.hands[self.frame]
            if np.abs(one.pixels[9] - square.centre).max() < square.side / 2
        ]

    def hand_in(self, image, region):  # noqa: ARG002
        one = self._nearest(region.centre)
        if one is None or np.linalg.norm(one.pixels[9] - region.centre) > region.side / 2:
            return Hand(np.tile(region.centre, (21, 1)), 0.0)
        return one


def found_with(hands, bodies, *, size=SIZE, rate=30.0, shrunk=1):
    """Detections with hands, and how often palms were looked for.

    Args:
        hands: that the networks see, by frame.
        bodies: keypoints of every detection, by frame.
        size: of the film.
        rate: frames per second.
        shrunk: pixels of the film per pixel of an image.
    """
    rows = [(frame, body) for frame, own in enumerate(bodies) for body in own]
    pixels = np.zeros((len(rows), len(NAMES), 2))
    confidence = np.zeros(pixels.shape[:2])
    for row, (_, body) in enumerate(rows):
        for name, place in body.items():
            pixels[row, NAMES.index(name)] = place
            confidence[row, NAMES.index(name)] = 1.0
    detections = Detections(
        "film", "coco17", np.arange(len(bodies)), np.array([frame for frame, _ in rows]), pixels,
        confidence, np.full(len(rows), -1),
    )  # fmt: skip
    clock = FilmClock(rate, len(bodies), 1.0, 0.0)
    film = Film(Path("film.mp4"), size, shrunk, 0, clock)
    networks = Seeing(hands)

    def frames():
        for number in range(len(bodies)):
            networks.frame = number
            yield FilmFrame(np.zeros((4, 4, 3), np.uint8), number / rate, number, 0)

    found = with_hands(film, frames(), detections, networks)
    points = np.zeros((len(rows), 42, 3)) if found.hands is None else found.hands
    return points.reshape(-1, 2, 21, 3), found.decisions, networks.searches


def moved(body, by):
    return {name: np.add(place, by) for name, place in body.items()}


def test_the_next_region_turns_and_grows_with_the_hand():
    one = hand_at((300, 300), angle=0.0).next_region
    palm = SHAPE[[0, 1, 2, 3, 5, 6, 9, 10, 13, 14, 17, 18]]
    low, high = palm.min(0), palm.max(0)
    ahead = SHAPE[[5, 13]].mean(0) / 2 + SHAPE[9] / 2
    assert one.angle == pytest.approx(np.arctan2(ahead[0], -ahead[1]))
    assert one.side == pytest.approx(2 * (high - low).max(), rel=0.05)
    other = hand_at((300, 300), angle=1.0).next_region
    cos, sin = np.cos(1.0), np.sin(1.0)
    turned = (one.centre - 300) @ np.array([[cos, sin], [-sin, cos]]) + 300
    assert other.angle == pytest.approx(one.angle + 1.0)
    assert other.side == pytest.approx(one.side)
    assert other.centre == pytest.approx(turned)


def test_a_palm_tells_where_its_hand_is(monkeypatch):
    """One box of 30 pixels of the cut-out, in the second grid, of a turned square of the image."""
    networks = HandNetworks()
    boxes, logits = np.zeros((2016, 18), np.float32), np.full((2016, 1), -9.0, np.float32)
    row = 2 * 24 * 24 + 6 * (5 * 12 + 7)
    anchor = np.array([7.5, 5.5]) / 12 * 192
    keypoints = np.zeros((7, 2))
    keypoints[2] = (20.0, 0.0)  # the knuckle of the middle finger is to the right of the wrist
    boxes[row] = np.concatenate(((10, 0), (30, 30), keypoints.ravel()))
    logits[row] = 3.0
    monkeypatch.setattr(networks, "_detector", lambda *_: [boxes, logits])
    square = Region(np.array([100.0, 120.0]), 384.0, np.pi / 2)
    (palm,) = networks.palms_in(np.zeros((200, 200, 3), np.uint8), square)
    # turned by 90 degrees clockwise, what is to the right in the cut-out is below in the image
    x, y = 2 * (anchor - 96)
    assert palm.wrist == pytest.approx((100 - y, 120 + x))
    assert palm.region.angle % (2 * np.pi) == pytest.approx(np.pi)
    assert palm.region.side == pytest.approx(2.6 * 60)
    assert palm.region.centre == pytest.approx((100 - y, 120 + x + 20 + 30))
    assert palm.score == pytest.approx(1 / (1 + np.exp(-3)))


def test_hands_are_those_of_their_wrists_and_followed_without_another_search():
    bodies = [[moved(BODY, (12 * t, 0))] for t in range(8)]
    both = [
        [hand_at(body[f"{side}_wrist"] + np.array([3, 2])) for side in ("right", "left")]
        for (body,) in bodies
    ]
    points, notes, searches = found_with(both, bodies)
    assert searches == 2
    for t, (right, left) in enumerate(both):
        assert points[t, 0, :, :2] == pytest.approx(left.pixels)
        assert points[t, 1, :, :2] == pytest.approx(right.pixels)
    assert (points[..., 2] == 1).all()
    assert "100 % (left) and 100 % (right)" in notes[0]


def test_a_lost_hand_is_looked_for_again():
    bodies = [[BODY]] * 6
    hand = hand_at(BODY["left_wrist"])
    seen = [[hand], [hand], [], [], [hand], [hand]]
    points, _, searches = found_with(seen, bodies)
    assert (points[:, 0, 0, 2] > 0).tolist() == [True, True, False, False, True, True]
    assert not points[:, 1].any()
    assert searches == 6 + 4
    points, _, fast = found_with([[hand]] * 12, [[BODY]] * 12, rate=120.0)
    assert fast == 1 + 3
    assert (points[:, 0, 0, 2] > 0).all()


def test_a_hand_that_is_far_too_large_or_unsure_is_not_taken():
    wrist = np.array(BODY["left_wrist"])
    for other in (
        hand_at(wrist + np.array([65, 0])),
        Hand(hand_at((0, 0)).pixels * 2 + wrist, 1.0),
        hand_at(wrist, score=0.45),
    ):
        points, _, _ = found_with([[other]], [[BODY]])
        assert not points.any()
    points, _, _ = found_with([[hand_at(wrist, score=0.75)]], [[BODY]])
    assert points[0, 0, :, 2] == pytest.approx(0.25)


def test_one_hand_at_two_wrists_is_that_of_the_nearer():
    body = BODY | {"left_wrist": (300, 440), "right_wrist": (280, 440)}
    points, _, _ = found_with([[hand_at((283, 440))]], [[body]])
    assert points[0, 1].all()
    assert not points[0, 0].any()


def test_two_people_keep_their_own_hands():
    other = moved(BODY, (170, 30))
    hands = [hand_at(one[f"{side}_wrist"]) for one in (BODY, other) for side in ("left", "right")]
    points, _, _ = found_with([hands] * 3, [[BODY, other]] * 3, size=(900, 700))
    for row in range(6):
        for side in (0, 1):
            assert points[row, side, :, :2] == pytest.approx(hands[2 * (row % 2) + side].pixels)


def test_small_people_have_no_hands_and_it_is_said():
    small = {name: np.array(place) / 5 for name, place in BODY.items()}
    points, notes, searches = found_with([[]], [[BODY, small]])
    assert searches == 2
    assert not points.any()
    assert "in 50 % of them, where a hand is shorter than 20 pixels" in notes[1]


def test_what_lies_beyond_the_border_is_not_seen_and_pixels_are_those_of_the_film():
    body = moved(BODY, (0, 120))
    hand = hand_at(body["left_wrist"])
    points, _, _ = found_with([[hand]], [[body]])
    inside = hand.pixels[:, 1] <= 639
    assert 0 < inside.sum() < 21
    assert ((points[0, 0, :, 2] > 0) == inside).all()
    assert not points[0, 0, ~inside].any()
    twice = {name: np.multiply(place, 2) + 0.5 for name, place in BODY.items()}
    hand = hand_at(BODY["left_wrist"])
    points, _, _ = found_with([[hand]], [[twice]], size=(1280, 1280), shrunk=2)
    assert points[0, 0, :, :2] == pytest.approx(2 * hand.pixels + 0.5)


@pytest.fixture(scope="module")
def drawn(tmp_path_factory) -> tuple[Path, np.ndarray]:
    """A film of the bundled body, and where its points of hands are, (frames, 2, 21, 2)."""
    motion = walk(6)
    show = Show("walk", (Figure(bundled(), motion),))
    views = following_viewpoints(show.figures, (900, 1000))
    posed, asset = bundled().pose(motion), hand_arrays()
    rest = bundled().rest_joints(motion.shape)[list(WRISTS)].double()
    directions = asset["joint_directions"][..., : len(motion.shape)]
    bones = asset["joint_template"] + directions @ motion.shape.double() - rest[:, None]
    wrists = posed.joints[:, list(WRISTS)].double()
    turns = posed.orientations[:, list(WRISTS)].double()
    points = (turns[:, :, None] @ bones[..., None])[..., 0] + wrists[:, :, None]
    points = np.concatenate((wrists[:, :, None], points), 2)
    images = [paint(show, frame, view) for frame, view in enumerate(views)]
    truth = [view.project(own.reshape(-1, 3))[0] for view, own in zip(views, points, strict=True)]
    path = write(tmp_path_factory.mktemp("hands") / "walk.mp4", np.stack(images))
    return path, np.stack(truth).reshape(-1, 2, 21, 2) - 0.5


def test_fingers_of_a_drawn_body_are_where_they_are(drawn, tmp_path):
    """Its right hand is seen from the front, the left one from the side."""
    path, truth = drawn
    found = read_film(path, fingers=True, kept=tmp_path)
    assert found.hands is not None
    hands = found.hands.reshape(-1, 2, 21, 3)
    assert (hands[:, 1, :, 2] > 0.7).all()
    length = np.linalg.norm(truth[:, 1, 12] - truth[:, 1, 0], axis=-1).mean()
    away = np.linalg.norm(hands[:, 1, :, :2] - truth[:, 1], axis=-1) / length
    assert np.median(away) < 0.08
    assert away.max() < 0.3
    again = read_film(path, fingers=True, kept=tmp_path)
    assert again.hands == pytest.approx(found.hands)
    assert again.decisions == found.decisions
    plain = read_film(path, kept=tmp_path)
    assert plain.hands is None
    assert plain.pixels == pytest.approx(found.pixels)
    assert len(list(tmp_path.iterdir())) == 2


def test_commands_and_python_look_for_fingers_when_they_are_asked_to(drawn, tmp_path):
    read = recon.read(drawn[0], fingers=True)
    assert isinstance(read, Keypoints2D)
    assert read.fingers is not None
    assert read.fingers.shape == (1, 6, 42, 3)
    for more in ((), ("--fingers",)):
        out = tmp_path / f"{len(more)}.npz"
        assert cli.run(["detect", str(drawn[0]), "--out", str(out), *more]) == cli.OK
        assert ("hands" in load_arrays(out)) == bool(more)


def test_models_without_hands_are_too_old(monkeypatch, tmp_path):
    monkeypatch.setattr(hand_networks, "bundled_folder", lambda: tmp_path)
    with pytest.raises(recon.ReconError, match="too old to find hands"):
        HandNetworks()


def test_keypoints_without_wrists_have_no_hands(drawn):
    film = open_film(drawn[0])
    one = Detections(
        "x", "halpe26", np.arange(1), np.zeros(1, int), np.zeros((1, 26, 2)), np.zeros((1, 26)),
        np.zeros(1, int),
    )  # fmt: skip
    assert with_hands(film, [], one, Seeing([])).hands is None

"""Finds the hands of people whose bodies were found in a film.

A hand is looked for about every wrist of a body, which tells its person, its side, and the size
to expect. It is followed from frame to frame by its own points; where none is followed, palms are
looked for.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from recon.core.errors import ReconError
from recon.core.layouts import keypoint_names
from recon.detections.records import Detections
from recon.films.blazepose import Image, Region
from recon.films.decoding import Film, FilmFrame
from recon.films.hand_networks import POINTS, Hand, HandNetworks

_SIDES = ("left", "right")
_SEGMENTS = {
    ("shoulder", "elbow"): 0.186, ("elbow", "wrist"): 0.146, ("shoulder", "hip"): 0.288,
    ("hip", "knee"): 0.245, ("knee", "ankle"): 0.246,
}  # fmt: skip
"""Lengths of segments as shares of the body's height (Winter, 2009)."""
_HAND_LENGTH = 0.108
"""Length of a hand, from wrist to tip of the middle finger, as a share of the body's height."""
_LEAST_PIXELS = 20.0
"""Length of a hand (pixels) below which its fingers cannot be told apart."""
_SEEN = 0.1
"""Confidence above which a keypoint of the body is used."""
_SQUARE, _AHEAD = 3.2, 0.35
"""Side of the square in which a palm is looked for, and how far its middle is from the wrist along
the forearm, lengths of a hand."""
_SEARCH_S = 1 / 30
"""Seconds between two searches for a palm at a wrist whose hand is not followed."""
_FAR = 0.6
"""Distance from the body's wrist above which a hand is another person's, lengths of a hand."""
_SMALLEST, _LARGEST = 0.25, 1.6
"""Bounds of the distance of a hand's farthest point from its wrist, in expected lengths."""
_LEAST_SCORE, _LEAST_CONFIDENCE = 0.5, 0.05
"""Score of a region below which it holds no hand, and least confidence of points of a hand."""
_SAME_HAND = 0.3
"""Mean distance of the points of two hands, lengths of a hand, below which they are the same."""


@dataclass(frozen=True)
class _Wrist:
    """A wrist of a body in one frame, at which a hand is looked for."""

    row: int
    """Row of the person in the detections."""
    side: int
    """Index in `_SIDES`."""
    place: Float[np.ndarray, "2"]
    """Position in the image, pixels."""
    length: float
    """Expected length of the hand by the size of the body, pixels."""
    ahead: Float[np.ndarray, "2"]
    """Unit vector from the elbow to the wrist; zero where the forearm points at the camera."""

    def hand_lengths_to(self, place: Float[np.ndarray, "2"]) -> float:
        """Return the distance of a position from this wrist, in expected lengths of the hand."""
        return float(np.linalg.norm(place - self.place)) / self.length

    def may_own(self, hand: Hand) -> bool:
        """Return whether a found hand may be this wrist's, by its score, position and size."""
        reach = float(np.linalg.norm(hand.pixels - hand.pixels[0], axis=1).max()) / self.length
        near = self.hand_lengths_to(hand.pixels[0]) < _FAR
        return hand.score >= _LEAST_SCORE and near and _SMALLEST < reach < _LARGEST

    def palm_region(self) -> Region:
        """Return the square of the image in which this wrist's palm is looked for."""
        middle = self.place + _AHEAD * self.length * self.ahead
        return Region(middle, _SQUARE * self.length, 0.0)


def with_hands(
    film: Film, frames: Iterable[FilmFrame], found: Detections, networks: HandNetworks
) -> Detections:
    """Find hands in a film; return `found` with the points of hands, and notes, added.

    All points of a hand have the same confidence. Of a film whose pictures were taken unevenly,
    points are those of the picture nearest to the frame.

    Args:
        film: in which people were detected.
        frames: its frames, in which hands are looked for.
        found: the detections of people.
        networks: that find palms and points of hands.

    Raises:
        ReconError: when the keypoints have no wrists.
    """
    wrists, small = _wrists_and_small_people(film, found)
    of_frame: dict[int, list[_Wrist]] = {}
    for one in wrists:
        of_frame.setdefault(int(found.frame[one.row]), []).append(one)
    hands = np.zeros((len(found.frame), len(_SIDES), POINTS, 3))
    every = max(1, round(_SEARCH_S * film.frame_rate))
    followed, most = list[tuple[_Wrist, Hand]](), np.array(film.image_size) - 1
    for frame in frames:
        search = frame.number % every == 0
        here = of_frame.get(frame.number, [])
        followed = _without_duplicates(
            list(_hands_at(here, frame.image, followed, networks, search=search))
        )
        for wrist, hand in followed:
            pixels = film.in_film(hand.pixels)
            inside = np.all((pixels >= 0) & (pixels <= most), axis=1, keepdims=True)
            points = np.column_stack((pixels, np.full(POINTS, _confidence_of_hand(hand))))
            hands[wrist.row, wrist.side] = np.where(inside, points, 0.0)
    with_points = np.any(hands[..., 2] > 0, axis=2)
    shares = " and ".join(
        f"{100 * np.mean(with_points[:, k]):.0f} % ({side})" for k, side in enumerate(_SIDES)
    )
    notes = [f"hands were found in {shares} of the images of people"]
    if small.any():
        notes.append(
            f"hands were not looked for in {100 * small.mean():.0f} % of them, where a hand is "
            f"shorter than {_LEAST_PIXELS:.0f} pixels"
        )
    points = hands.reshape(len(hands), -1, 3) if with_points.any() else None
    return replace(found, hands=points, decisions=(*notes, *found.decisions))


def _confidence_of_hand(hand: Hand) -> float:
    """Return a hand's confidence: the usual error of points over that expected at its score.

    In real films of three calibrated cameras, points of hands with scores from 0.6 to 0.9 were
    about three times as far from where the two other views see them as those of higher scores.
    """
    return max((2 * hand.score - 1) ** 2, _LEAST_CONFIDENCE)


def _wrists_and_small_people(
    film: Film, found: Detections
) -> tuple[list[_Wrist], Bool[np.ndarray, " rows"]]:
    """Return all wrists whose hands are large enough to find, and which people are too small.

    A hand's length follows from the segment of the body that appears largest in relation to its
    usual length, since foreshortening makes segments shorter in an image, never longer.
    """
    at = {name: k for k, name in enumerate(keypoint_names(found.layout))}
    if any(f"{side}_wrist" not in at for side in _SIDES):
        raise ReconError(f"fingers need keypoints with wrists; the layout {found.layout} has none")
    pixels = film.in_image(found.pixels)
    seen = found.confidence > _SEEN
    lengths = [np.zeros(len(pixels))]
    for (upper, lower), share in _SEGMENTS.items():
        for side in _SIDES:
            a, b = (at.get(f"{side}_{joint}") for joint in (upper, lower))
            if a is not None and b is not None:
                length = np.linalg.norm(pixels[:, a] - pixels[:, b], axis=-1) / share
                lengths.append(np.where(seen[:, a] & seen[:, b], length, 0.0))
    length = _HAND_LENGTH * np.max(lengths, 0)
    large = length >= _LEAST_PIXELS
    wrists = []
    for number, side in enumerate(_SIDES):
        wrist, elbow = at[f"{side}_wrist"], at.get(f"{side}_elbow", at[f"{side}_wrist"])
        forearm = pixels[:, wrist] - pixels[:, elbow]
        size = np.linalg.norm(forearm, axis=-1)
        shown = seen[:, elbow] & (size > length / 2)
        ahead = np.where(shown[:, None], forearm / np.maximum(size, 1e-9)[:, None], 0.0)
        wrists += [
            _Wrist(row, number, pixels[row, wrist], float(length[row]), ahead[row])
            for row in np.flatnonzero(seen[:, wrist] & large).tolist()
        ]
    return wrists, ~large


def _hands_at(
    wrists: Sequence[_Wrist],
    image: Image,
    followed: Sequence[tuple[_Wrist, Hand]],
    networks: HandNetworks,
    *,
    search: bool,
) -> Iterator[tuple[_Wrist, Hand]]:
    """Yield each wrist where a hand is found, and the hand: from the last frame's or a palm.

    Args:
        wrists: of all people in one image.
        image: in which the hands are looked for.
        followed: hands of the last frame and their wrists.
        networks: that find palms and points of hands.
        search: whether palms are looked for where no hand is followed.
    """
    for wrist in wrists:
        own = [hand for one, hand in followed if one.side == wrist.side]
        near = [one for one in own if wrist.hand_lengths_to(one.pixels[0]) < 2 * _FAR]
        near.sort(key=lambda one: wrist.hand_lengths_to(one.pixels[0]))
        hands = [networks.hand_in(image, one.next_region) for one in near[:1]]
        if not any(map(wrist.may_own, hands)) and (search or near):
            palms = networks.palms_in(image, wrist.palm_region())
            palms = [one for one in palms if wrist.hand_lengths_to(one.wrist) < _FAR]
            palms.sort(key=lambda one: wrist.hand_lengths_to(one.wrist))
            hands = [networks.hand_in(image, one.region) for one in palms[:1]]
        yield from ((wrist, hand) for hand in hands if wrist.may_own(hand))


def _without_duplicates(hands: list[tuple[_Wrist, Hand]]) -> list[tuple[_Wrist, Hand]]:
    """Return hands without duplicates: one found at two wrists is left to the nearer wrist."""
    hands.sort(key=lambda it: it[0].hand_lengths_to(it[1].pixels[0]))
    kept: list[tuple[_Wrist, Hand]] = []
    for wrist, hand in hands:
        apart = [np.linalg.norm(hand.pixels - one.pixels, axis=1).mean() for _, one in kept]
        if all(away > _SAME_HAND * wrist.length for away in apart):
            kept.append((wrist, hand))
    return kept

"""Cuts are found; what merely changes a lot from picture to picture is none."""

import cv2
import numpy as np
import pytest

from recon.films.shots import with_shots

SIZE = 128


def place(seed):
    """A picture of a place: smooth patches of colour, larger than what is looked at."""
    rough = np.random.default_rng(seed).integers(0, 256, (16, 16, 3), np.uint8)
    return cv2.resize(rough, (4 * SIZE, 4 * SIZE), interpolation=cv2.INTER_CUBIC)


def looked_at(seed, k, x=64.0, y=64.0, walker=True):
    """A place from a camera that looks at x, y; a grey figure walks through."""
    turn = np.array([[1, 0, -x], [0, 1, -y]], np.float32)
    image = cv2.warpAffine(place(seed), turn, (SIZE, SIZE))
    if walker:
        image[40:110, 20 + k : 44 + k] = 90
    noise = np.random.default_rng(k).normal(0, 4, image.shape)
    return np.clip(image + noise, 0, 255).astype(np.uint8)


def starts(images):
    """Pictures with which a shot begins, the first one apart."""
    shots = [shot for _, shot in with_shots((image, 0.0) for image in images)]
    assert len(shots) == len(images)
    return [k for k in range(1, len(shots)) if shots[k] != shots[k - 1]]


def still(seed, frames):
    return [looked_at(seed, k) for k in frames]


BLACK = np.zeros((SIZE, SIZE, 3), np.uint8)


def fade(images, shares):
    return [(image * share).astype(np.uint8) for image, share in zip(images, shares, strict=True)]


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize(
    ("kind", "found"),
    [
        ("cut", [20]), ("two cuts", [20, 30]), ("cut from a hand to a pan", [20]),
        ("cut near the end", [38]), ("cut near the beginning", [2]), ("cut over black", [26]),
        ("fade over black", [30]),
    ],
)  # fmt: skip
def test_cuts_are_found(kind, found, seed):
    a, b, rng = 2 * seed, 2 * seed + 1, np.random.default_rng(seed)
    hand = np.cumsum(rng.normal(0, 2, (20, 2)), 0) + 64
    films = {
        "cut": lambda: still(a, range(20)) + still(b, range(20)),
        "two cuts": lambda: still(a, range(20)) + still(b, range(10)) + still(a, range(20)),
        "cut from a hand to a pan": lambda: (
            [looked_at(a, k, *hand[k]) for k in range(20)]
            + [looked_at(b, k, 5 * k) for k in range(20)]
        ),
        "cut near the end": lambda: still(a, range(38)) + still(b, range(2)),
        "cut near the beginning": lambda: still(a, range(2)) + still(b, range(38)),
        "cut over black": lambda: still(a, range(20)) + [BLACK] * 6 + still(b, range(20)),
        "fade over black": lambda: (
            fade(still(a, range(25)), np.clip(np.arange(25, 0, -1) / 12.0, 0, 1))
            + [BLACK] * 4
            + fade(still(b, range(25)), np.clip(np.arange(25) / 12, 0, 1))
        ),
    }
    assert starts(films[kind]()) == found


def _object(seed, k):
    image = looked_at(seed, k)
    if 15 <= k < 21:
        image[:, 25 * (k - 15) : 25 * (k - 15) + 40] = (200, 40, 30)
    return image


def _flash(image, k, frames):
    return np.clip(image * 3.0 + 40, 0, 255).astype(np.uint8) if k in frames else image


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize(
    "change",
    [
        lambda s, k: looked_at(s, k),
        lambda s, k: looked_at(s, k, 5.0 * k),
        lambda s, k: looked_at(s, k, 64 + np.clip(k - 15, 0, 8) * 30.0),
        lambda s, k: looked_at(s, k, 64, 64 + 6 * (k >= 15)),
        lambda s, k: _flash(looked_at(s, k), k, (15,)),
        lambda s, k: _flash(looked_at(s, k), k, (15, 16, 17)),
        lambda s, k: (looked_at(s, k) * (0.4 if k >= 15 else 1)).astype(np.uint8),
        _object,
        lambda s, k: BLACK if 15 <= k < 18 else looked_at(s, k),
        lambda s, k: looked_at(s, 4 * k // 5),
        lambda s, k: looked_at(s, k + 6 * (k >= 15)),
        lambda s, k: looked_at(s, 12 * (k % 7)),
    ],
    ids=[
        "nothing", "pan", "whip pan", "knock", "flash", "long flash", "light off", "fast object",
        "blackout", "repeated pictures", "dropped pictures", "one picture a second",
    ],
)  # fmt: skip
def test_other_changes_are_no_cuts(change, seed):
    assert starts([change(seed, k) for k in range(40)]) == []


def test_pictures_come_in_order_and_few_are_held_back():
    out, held = [], []

    def pictures():
        for k in range(30):
            held.append(k - len(out))
            yield looked_at(0, k), float(k)

    for (_, time), _ in with_shots(pictures()):
        out.append(time)
    assert out == list(range(30))
    assert max(held) <= 4

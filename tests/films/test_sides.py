"""Names of left and right that a network mistakes for whole stretches, and what is sure."""

import numpy as np

from recon.films.blazepose import MIRRORED, Pose, Region
from recon.films.sides import rows_of_sights
from recon.films.tracking import Sight

FRAMES, SIDE = 60, 400.0
EXCHANGED = [*range(5, 9), *range(20, 40)]
"""Frames of which both images are given wrong names."""
AT_ODDS = [9, 45, 46]
"""Frames of which the mirror image alone is given wrong names."""


def body() -> np.ndarray:
    """Landmarks (frames, 33, 2) of somebody who waves and walks through the image, pixels."""
    rng = np.random.default_rng(3)
    rest = rng.uniform(-60, 60, (33, 2))
    rest[11:, 0] = np.where(np.arange(11, 33) % 2, 50, -50) + rng.uniform(-15, 15, 22)
    time = np.arange(FRAMES)[:, None, None]
    phase = rng.uniform(0, 6, (33, 2))
    return 300 + rest + 15 * np.sin(time / 8 + phase) + time * (2.0, 0.0)


def pose(pixels, visibility=1.0, inside=True) -> Pose:
    full = np.full(33, 1.0)
    region = Region(pixels.mean(0), SIDE, 0.0)
    return Pose(
        pixels, full * visibility, full, np.full(33, inside), 1.0, region, np.zeros((2, 2))
    )


def seen(images, mirrored) -> list[Sight]:
    pairs = zip(images, mirrored, strict=True)
    return [Sight(t, 0, pose(one), pose(other)) for t, (one, other) in enumerate(pairs)]


def test_exchanged_sides_are_put_right_over_the_whole_film():
    truth = body()
    image, mirrored = truth.copy(), truth.copy()
    image[EXCHANGED] = truth[EXCHANGED][:, MIRRORED]
    mirrored[EXCHANGED + AT_ODDS] = truth[EXCHANGED + AT_ODDS][:, MIRRORED]
    rows = rows_of_sights(seen(image, mirrored))
    assert [row[0] for row in rows] == list(range(FRAMES))
    np.testing.assert_allclose([row[1][:, :2] for row in rows], truth, atol=1e-9)


def test_most_frames_say_which_side_is_left():
    truth = body()[:, MIRRORED]
    image = truth.copy()
    image[:20] = truth[:20][:, MIRRORED]
    rows = rows_of_sights(seen(image, image))
    np.testing.assert_allclose([row[1][:, :2] for row in rows], truth, atol=1e-9)


def test_of_two_images_the_one_that_moves_on_is_believed():
    truth = body()
    image = truth.copy()
    image[30] = truth[30].mean(0)
    rows = rows_of_sights(seen(image, truth))
    far = np.linalg.norm(image[30] - truth[30], axis=1) > 0.2 * SIDE / 2
    assert far.sum() > 5
    np.testing.assert_allclose(rows[30][1][far, :2], truth[30][far])
    assert (rows[30][1][far, 2] < 0.4).all()
    assert (rows[29][1][:, 2] > 0.8).all()


def test_confidence_falls_with_what_is_hidden_and_is_zero_beyond_the_crop():
    truth = body()[:4]
    sure = []
    for visibility, inside in ((1.0, True), (0.6, True), (0.2, True), (0.01, True), (1.0, False)):
        one = [
            Sight(t, 0, pose(p, visibility, inside), pose(p, visibility))
            for t, p in enumerate(truth)
        ]
        sure.append(float(np.mean([row[1][:, 2] for row in rows_of_sights(one)])))
    assert sure[0] > 0.99
    assert sure[0] > sure[1] > sure[2] > 0.1
    assert sure[3] == sure[4] == 0.0


def test_a_landmark_that_leaves_its_place_for_a_frame_is_not_sure():
    truth = body()
    image = truth.copy()
    image[30, 15] += 80
    confidence = np.array([row[1][:, 2] for row in rows_of_sights(seen(image, image))])
    assert confidence[30, 15] < 0.3
    assert confidence[[29, 31], 15].min() > 0.8

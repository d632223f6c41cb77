"""Clouds that show two people, or a person and other things."""

import numpy as np

from observations.files.one_person import alone


def people(frames: int = 12, apart: float = 1.5):
    """Two standing boxes of points; which of them has more points changes in every frame."""
    random = np.random.default_rng(0)
    clouds = []
    for k in range(frames):
        counts = (600, 500) if k % 2 else (500, 600)
        one, other = (
            random.uniform((-0.2, -0.2, 0.0), (0.2, 0.2, 1.7), (n, 3))
            + np.eye(3)[0] * (x + 0.02 * k)
            for n, x in zip(counts, (0.0, apart), strict=True)
        )
        clouds.append(np.concatenate((one, other)))
    return clouds


def test_one_of_two_people_is_followed():
    """The largest thing of every frame was taken, so the body flew between two people."""
    clouds = people()
    found = alone(clouds, 0.2)
    assert found.beside == len(clouds)
    middles = np.array([cloud.mean(0)[0] - 0.02 * k for k, cloud in enumerate(found.clouds)])
    assert np.ptp(middles) < 0.1


def test_a_person_alone_and_limbs_cut_off_by_an_occluder_are_no_company():
    whole = [cloud[cloud[:, 0] < 0.75] for cloud in people()]
    assert alone(whole, 0.2).beside == 0
    lying = [cloud[:, [2, 1, 0]] for cloud in whole]
    divided = [cloud[np.abs(cloud[:, 0] - 1.0) > 0.15] for cloud in lying]
    assert alone(divided, 0.2).beside == 0


def test_empty_frames_stay_empty():
    clouds = people()
    clouds[3] = clouds[3][:0]
    found = alone(clouds, 0.2)
    assert len(found.clouds[3]) == 0
    assert alone([clouds[3]], 0.2).beside == 0

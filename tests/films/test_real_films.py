"""Real films against the keypoints that OpenPose found in them (Pose2Sim's demo)."""

import zipfile

import numpy as np
import pytest

from recon.core.layouts import keypoint_names
from recon.detections.reader import read_keypoints
from recon.films.reader import read_film
from recon.reading.tracks import tracks_of_people

JOINTS = [
    f"{side}_{joint}"
    for side in ("left", "right")
    for joint in ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")
]
OTHER_SIDE = [*range(6, 12), *range(6)]


def places(layout: str, pixels, confidence):
    columns = [keypoint_names(layout).index(name) for name in JOINTS]
    return pixels[:, columns], confidence[:, columns]


@pytest.mark.slow
@pytest.mark.parametrize("camera", [1, 2, 3])
def test_joints_are_where_openpose_sees_them_and_sides_are_not_exchanged(data, tmp_path, camera):
    """A third of the frames of camera 2 had left and right exchanged."""
    folder = data / "observations" / "pose2sim"
    with zipfile.ZipFile(folder / "single_balancing.zip") as archive:
        archive.extractall(tmp_path)
    seen = read_keypoints(tmp_path / "pose-associated" / f"cam{camera:02d}_json")
    truth, sure = places(seen.layout, seen.pixels, seen.confidence)
    film = read_film(folder / "films" / f"singleperson_cam{camera:02d}.mp4")
    ours, shown = places(film.layout, film.pixels, film.confidence)
    assert film.frame.tolist() == list(range(100))
    later = np.minimum(seen.frame + 1, 99)  # the films begin a frame earlier
    ours, shown = ours[later], shown[later]
    both = (shown > 0) & (sure > 0.2)
    away = np.linalg.norm(ours - truth, axis=-1)
    crossed = np.linalg.norm(ours - truth[:, OTHER_SIDE], axis=-1)
    height = np.ptp(truth[..., 1], axis=1).mean()
    assert np.median(away[both]) < 0.03 * height
    nearer = [(away[t, b].mean() - crossed[t, b].mean()) > 10 for t, b in enumerate(both)]
    assert np.mean(nearer) <= 0.02
    doubtful = both & (shown < 0.4)
    assert np.median(away[doubtful]) > np.median(away[both & (shown > 0.7)])


@pytest.mark.slow
@pytest.mark.parametrize(("camera", "least"), [(1, 95), (2, 95), (3, 75)])
def test_two_people_are_followed_past_each_other(data, camera, least):
    """One of them was lost where their faces came near to each other, and never found again."""
    path = data / "observations" / "pose2sim" / "films" / f"multiperson_cam{camera:02d}.mp4"
    tracks = tracks_of_people(read_film(path))
    assert len(tracks) == 2
    assert min(len(one.frame) for one in tracks) >= least

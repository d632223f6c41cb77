"""Following people: through gaps and past each other; persons are never mixed."""

import numpy as np
import pytest

from recon.detections.records import Detections, Row, detections_of_rows
from recon.reading.tracks import Track, chosen_track, tracks_of_people
from tests.keypoint_scene import camera, figure, image


def seen(place: tuple[float, float], keep: slice = slice(None)) -> np.ndarray:
    points = image(figure("coco17", place), camera(0, distance=6.0))
    hidden = np.ones(len(points), bool)
    hidden[keep] = False
    points[hidden] = 0
    return points


def scene(rows: list[Row], frames: int = 20) -> Detections:
    return detections_of_rows("cam", range(frames), rows, layout="coco17")


def test_two_people_in_any_order_stay_themselves():
    rng = np.random.default_rng(0)
    rows: list[Row] = []
    for t in range(20):
        people = [seen((0, -1 + 0.02 * t)), seen((0, 1 - 0.02 * t))]
        order = [0, 1] if t == 0 else rng.permutation(2).tolist()
        rows += [(t, people[k], -1) for k in order]
    tracks = tracks_of_people(scene(rows))
    assert [track.number for track in tracks] == [0, 1]
    for track, side in zip(tracks, (-1, 1), strict=True):
        assert track.frame.tolist() == list(range(20))
        true = np.stack([seen((0, side * (1 - 0.02 * t)))[:, :2] for t in range(20)])
        assert np.allclose(track.pixels, true)
    with pytest.raises(ValueError, match=r"persons 0 and 1 .*--person.*20 frames from 0 to 19"):
        chosen_track(tracks, None, "cam")
    assert chosen_track(tracks, 1, "cam") is tracks[1]
    with pytest.raises(ValueError, match=r"no person 2; there are person 0: 20 frames"):
        chosen_track(tracks, 2, "cam")


def test_somebody_who_moves_is_preferred_to_a_bystander():
    """A judge stands in the picture all the time; the one who walks by is who was filmed."""
    rng = np.random.default_rng(0)

    def both(steps: float) -> tuple[Track, ...]:
        rows: list[Row] = []
        for t in range(20):
            judge = seen((0, -2))
            judge[:, :2] += rng.normal(scale=4.0, size=judge[:, :2].shape)
            rows.append((t, judge, -1))
            if t > 0:  # the judge is even more complete
                rows.append((t, seen((0, steps * t)), -1))
        return tracks_of_people(scene(rows))

    walker = chosen_track(both(0.05), None, "cam")
    assert walker.number == 1
    assert walker.movement > 0.1
    assert both(0.05)[0].movement < 0.04
    with pytest.raises(ValueError, match="--person"):
        chosen_track(both(0.0), None, "cam")


def test_gaps_and_hidden_legs_do_not_break_a_track_and_the_more_complete_is_chosen():
    rows: list[Row] = [
        (t, seen((0, 0.03 * t), slice(0, 11 if t % 2 else 17)), -1)
        for t in range(20)
        if not 8 <= t < 12
    ]
    rows += [(t, seen((0, -1.5)), -1) for t in range(5)]
    tracks = tracks_of_people(scene(rows))
    assert [len(track.frame) for track in tracks] == [16, 5]
    assert chosen_track(tracks, None, "cam").number == 0


def test_people_who_pass_each_other_are_followed():
    """Tracks used to end where two people passed each other, though both went straight on."""
    rows: list[Row] = []
    for t in range(21):
        if t != 10:
            rows += [(t, seen((0, 1 - 0.1 * t)), -1), (t, seen((0, -1 + 0.1 * t)), -1)]
        else:
            rows.append((t, seen((0, 0)), -1))
    tracks = tracks_of_people(scene(rows, 21))
    assert sorted(len(track.frame) for track in tracks) == [20, 21]
    assert all(track.ended_by is None for track in tracks)
    for track in tracks:
        steps = np.diff(track.pixels[:, :, 0].mean(1))
        assert (steps > 0).all() or (steps < 0).all()


def test_the_one_behind_is_followed_though_only_some_keypoints_are_found():
    """Where one person covers another, a double of the front one used to be taken for both."""
    rng = np.random.default_rng(0)
    rows: list[Row] = []
    given: list[tuple[np.ndarray, np.ndarray]] = []
    for t in range(30):
        front, behind = seen((0.5, -0.6 + 0.04 * t)), seen((-0.5, -0.9 + 0.06 * t))
        for person in (front, behind):
            person[:, :2] += rng.normal(scale=2.0, size=(17, 2))
        covered = np.linalg.norm(front[:, :2] - behind[:, :2], axis=-1) < 60
        behind[covered & (rng.random(17) < 0.6)] = 0.0
        both = [(t, front, -1), (t, behind, -1)]
        given.append((front, behind))
        rows += both if rng.random() < 0.5 else both[::-1]
    tracks = tracks_of_people(scene(rows, 30))
    assert len(tracks) == 2
    assert min(len(track.frame) for track in tracks) >= 29
    for track in tracks:
        who = {
            one
            for frame, pixels in zip(track.frame, track.pixels, strict=True)
            for one in (0, 1)
            if np.array_equal(pixels, given[frame][one][:, :2])
        }
        assert len(who) == 1


def test_people_who_stand_together_end_their_tracks_instead_of_swapping():
    """Two meet, are found as one for two seconds, and part: who is who cannot be told then."""
    rows: list[Row] = []
    for t in range(80):
        if 20 <= t < 60:
            rows.append((t, seen((0, 0)), -1))
        else:
            away = 0.1 * (20 - t if t < 20 else t - 59)
            rows += [(t, seen((0, -away)), -1), (t, seen((0, away)), -1)]
    tracks = tracks_of_people(scene(rows, 80))
    assert len(tracks) >= 4
    assert any(track.ended_by is not None for track in tracks)
    sides = [np.sign((track.pixels[:, :, 0].mean(1) - 640).round()) for track in tracks]
    assert all(len(set(side.tolist()) - {0}) <= 1 for side in sides)
    assert "lost at frame 60 near another" in str(tracks[0])


def test_one_body_found_twice_or_in_two_pieces_is_one_person():
    """OpenPose sometimes gives one body twice, or its upper and its lower half apart."""
    rows: list[Row] = [(t, seen((0, 0)), -1) for t in range(20) if t != 9]
    rows += [(9, seen((0, 0), slice(0, 11)), -1), (9, seen((0, 0), slice(11, 17)), -1)]
    rows += [(4, seen((0, 0.01)), -1), (5, seen((0, 0), slice(0, 3)), -1)]
    tracks = tracks_of_people(scene(sorted(rows, key=lambda row: row[0])))
    assert [len(track.frame) for track in tracks] == [20]


def test_numbers_of_the_producer_are_believed_unless_they_count_the_people_of_a_frame():
    crossing: list[Row] = []
    for t in range(20):
        crossing += [(t, seen((0, -1 + 0.1 * t)), 7), (t, seen((-2, 1 - 0.1 * t)), 3)]
    tracks = tracks_of_people(scene(crossing))
    assert [len(track.frame) for track in tracks] == [20, 20]
    counted: list[Row] = []
    for t in range(20):
        people = [seen((0, -1)), seen((0, 1))]
        counted += [(t, one, k) for k, one in enumerate(people[:: 1 if t % 2 else -1])]
    tracks = tracks_of_people(scene(counted))
    assert all(np.ptp(track.pixels[:, 0, 0]) < 1 for track in tracks)


def test_detections_of_a_few_points_are_nobody():
    tracks = tracks_of_people(scene([(0, seen((0, 0), slice(0, 3)), -1)]))
    assert tracks == ()
    with pytest.raises(ValueError, match="nobody shows 4 keypoints"):
        chosen_track(tracks, None, "cam")

"""`recon.Stream`: accuracy, seams, and everything that can go wrong with a live recording."""

import json
from dataclasses import replace

import numpy as np
import pytest
import torch

import recon
from recon.body.landmarks import KEYPOINTS_43, landmark
from recon.live.lines import stream_lines
from recon.live.smoother import SmoothedWindow
from recon.solver.banded import Factor
from tests.filmed import cameras, view, walk
from tests.live.conftest import BEGINNING, FPS, FRAMES, codes, joints_of, played, stream


def test_every_moment_is_told_once_in_its_turn_and_well(seen, truth):
    found = played(stream(lag=5), seen)
    assert [one.time for one in found] == pytest.approx([k / FPS for k in range(FRAMES)])
    error = (joints_of(found) - truth).norm(dim=-1).mean()
    assert error < 0.6 * np.linalg.norm(seen - truth.numpy(), axis=-1).mean()
    assert all(bool(one.observed.all()) for one in found)


def test_a_prior_over_steps_is_nearer_and_tells_contacts(seen, truth):
    """A stream knew the pose prior alone."""
    plain, better = (played(stream(prior=prior, lag=10), seen) for prior in ("pose", "humor"))
    assert [one.time for one in better] == pytest.approx([k / FPS for k in range(FRAMES)])
    assert all(one.contacts is None for one in plain)
    contacts = torch.stack([one.contacts for one in better])
    assert ((contacts >= 0) & (contacts <= 1)).all()
    feet = [recon.core.skeleton.joint_index(f"{side}_foot") for side in ("left", "right")]
    assert (contacts[:, feet].max(-1).values > 0.5).float().mean() > 0.8
    errors = [(joints_of(found) - truth).norm(dim=-1).mean() for found in (plain, better)]
    assert errors[1] < errors[0]
    steps = joints_of(better).diff(dim=0).norm(dim=-1)
    assert steps.max() < 1.5 * truth.diff(dim=0).norm(dim=-1).max()
    changes = joints_of(better).diff(n=2, dim=0).norm(dim=-1)  # hands jumped by 10 cm
    assert changes.mean() < 0.8 * truth.diff(n=2, dim=0).norm(dim=-1).mean()


def test_no_step_under_humor_raises_the_energy(seen, monkeypatch):
    """Unchecked steps made joints of somebody who lies down 70 cm wrong for a second."""
    refined, rises = SmoothedWindow.refined, []

    def watched(window: SmoothedWindow, steps: int) -> SmoothedWindow:
        after = refined(window, steps)
        before, found = (one.objective.energy(one.window, one.seen) + one.value_of_shape()
                         for one in (window, after))  # fmt: skip
        rises.append((found - before) / abs(before))
        return after

    monkeypatch.setattr(SmoothedWindow, "refined", watched)
    jumps = seen + 0.5 * (np.arange(len(seen)) % 7 == 6)[:, None, None]
    assert torch.isfinite(joints_of(played(stream(prior="humor", lag=10), jumps))).all()
    assert max(rises) < 1e-5
    assert np.mean(np.array(rises) < -1e-5) > 0.5


def test_a_step_that_is_not_finite_leaves_the_window(seen, monkeypatch):
    live = stream(prior="humor", lag=10)
    played_on = [live.push(moment) for moment in seen[:20]]
    assert played_on[-1] is not None
    window = live._tracking.smoothed
    monkeypatch.setattr(Factor, "solve", lambda _, right: torch.full_like(right, torch.nan))
    assert window.refined(1).window is window.window


def test_no_shape_is_learned_from_equations_that_are_not_finite(seen):
    live = stream(lag=10)
    for moment in seen[:20]:
        live.push(moment)
    window = live._tracking.smoothed
    bad = torch.full_like(window.equations.gradient_alone, torch.nan)
    equations = replace(window.equations, gradient_alone=bad)
    shape = window.objective.shape
    assert window.knowledge.with_first_frame(equations, shape, 0.1) is window.knowledge
    learned = window.knowledge.with_first_frame(window.equations, shape, 0.1)
    assert learned.frames == window.knowledge.frames + 1


def test_the_pose_density_leads_newest_frames_to_the_data(seen):
    """Under HuMoR alone, frames that it does not know stayed 8 cm from joints that were seen."""
    live = stream(prior="humor", lag=10)
    for moment in seen[:20]:
        live.push(moment)
    window = live._tracking.smoothed
    pose = torch.cat((window.window.pose[:-4], window.window.pose[-4:] + 0.5))
    astray = replace(window, window=replace(window.window, pose=pose))
    led = astray.newest_refined_by_poses()

    def distances(of: SmoothedWindow) -> torch.Tensor:
        joints = of.objective.posed(of.window)[2][-4:]
        return (joints - torch.as_tensor(seen[16:20]).to(joints)).norm(dim=-1)

    assert distances(led).mean() < 0.7 * distances(astray).mean()
    assert led.window.frames == astray.window.frames
    assert torch.equal(led.window[:-6].pose, astray.window[:-6].pose)
    assert led.objective is astray.objective


def test_steps_of_other_lengths_are_refused(seen):
    faster = recon.Joints3D(seen[:1], np.ones((1, 22), bool), range(22), 60.0)
    with pytest.raises(recon.ReconError, match="30 moments a second"):
        recon.Stream("humor").push(faster)


def test_a_lag_shorter_than_the_beginning(seen, truth):
    """The data of the first moments were compared with later frames where the window shrank."""
    found = played(stream(lag=0), seen[:18])
    assert [one.time for one in found] == pytest.approx([k / FPS for k in range(18)])
    assert (joints_of(found) - truth[:18]).norm(dim=-1).mean(-1).max() < 0.04


def test_estimates_come_after_the_lag_and_do_not_change(seen):
    live = stream(lag=4)
    answers = [live.push(moment) for moment in seen[:14]]
    first = next(k for k, answer in enumerate(answers) if answer is not None)
    assert first == BEGINNING - 1
    assert [len(one.earlier) for one in answers if one][:2] == [first - 4, 0]
    assert all(one.time == pytest.approx((k - 4) / FPS) for k, one in enumerate(answers) if one)


@pytest.mark.slow
def test_there_is_no_seam(seen, truth):
    found = joints_of(played(stream(lag=5), seen))
    steps, true = (x.diff(dim=0).norm(dim=-1) for x in (found, truth))
    assert steps.quantile(0.99) <= 1.1 * true.quantile(0.99)
    jumps = found.diff(n=2, dim=0).norm(dim=-1)
    assert jumps.max() < 2 * truth.diff(n=2, dim=0).norm(dim=-1).max()


def test_the_shape_is_learned_and_then_held(seen, monkeypatch):
    monkeypatch.setattr("recon.live.tracking._LEARNED", 6)
    found = played(stream(lag=3), seen)
    shapes = torch.stack([one.shape for one in found])
    moved = shapes.diff(dim=0).abs().amax(-1)
    assert moved[: BEGINNING + 4].max() > 0
    assert moved[-10:].max() == 0


def test_a_given_shape_is_held(seen):
    shape = np.array([1.0, -0.5])
    found = played(stream(lag=3, shape=shape), seen[:20])
    for one in found:
        assert one.shape[:2].tolist() == pytest.approx(shape.tolist())


def test_hidden_points_and_gaps_are_bridged(seen, truth):
    moments = seen.copy()
    moments[:, [4, 18]] = np.nan
    moments[24:28] = np.nan
    found = played(stream(lag=6), moments)
    assert len(found) == FRAMES
    assert not found[26].observed.any()
    error = (joints_of(found) - truth).norm(dim=-1)
    assert error[24:28].mean() < 0.06
    assert error[:, [4, 18]].mean() < 0.06


def test_dropped_moments_are_filled_in_and_told(seen, truth):
    kept = [k for k in range(FRAMES) if k not in (14, 20, 21)]
    found = played(stream(lag=4), seen[kept], [k / FPS for k in kept])
    assert [one.time for one in found] == pytest.approx([k / FPS for k in range(FRAMES)])
    assert codes(found).count("gap") == 2
    assert (joints_of(found) - truth).norm(dim=-1)[[14, 20, 21]].mean() < 0.05


def test_a_late_moment_takes_its_place(seen):
    order = [*range(12), 13, 14, 12, *range(15, 24)]
    found = played(stream(lag=6), seen[order], [k / FPS for k in order])
    assert [one.time for one in found] == pytest.approx([k / FPS for k in range(24)])
    assert found[12].observed.all()
    assert "frame order" in codes(found)


@pytest.mark.slow
def test_a_repeated_moment_is_left_out(seen):
    order = [*range(12), 11, 10, *range(12, 20)]
    found = played(stream(lag=6), seen[order], [k / FPS for k in order])
    assert len(found) == 20
    assert codes(found).count("frame order") == 2


def test_one_wrong_time_stamp_does_no_harm(seen):
    times = [k / FPS for k in range(FRAMES)]
    times[20] = 1e6
    found = played(stream(lag=4), seen, times)
    times[20] = 20 / FPS
    assert [one.time for one in found] == pytest.approx(times)
    assert "jump" in codes(found)


@pytest.mark.parametrize("wrong", [0.4, -0.4, 1e6])
def test_a_wrong_first_time_stamp_loses_two_estimates_at_most(seen, wrong):
    """All moments before the wrong stamp came late, and up to 15 were left out."""
    times = [k / FPS for k in range(FRAMES)]
    found = played(stream(lag=4), seen, [times[0] + wrong, *times[1:]])
    given = [one.time for one in found if one.observed.any()]
    assert len(given) >= FRAMES - 2
    assert given[-FRAMES + 2 :] == pytest.approx(times[2:])


@pytest.mark.slow
def test_the_clock_may_begin_anew(seen):
    times = [k / FPS + (0.0 if k < 16 else -100.0) for k in range(FRAMES)]
    found = played(stream(lag=4), seen, times)
    assert found[15].time == pytest.approx(15 / FPS)
    assert found[16].time == pytest.approx(17 / FPS - 100.0)  # one moment to be sure
    assert "jump" in codes(found)


def test_a_person_leaves_and_returns_elsewhere(seen):
    away = np.full((20, 22, 3), np.nan, dtype=np.float32)
    there = seen[:16] + np.array([3.0, 1.0, 0.0], dtype=np.float32)
    found = played(stream(lag=4), np.concatenate((seen[:16], away, there)))
    times = np.array([one.time for one in found])
    assert (np.diff(times) > 0).all()
    back = [one for one in found if one.time > 35.5 / FPS]
    assert len(back) == 16
    assert torch.isfinite(joints_of(found)).all()
    assert (joints_of(back)[:, 0] - joints_of(found)[:16, 0])[:, 0].mean() == pytest.approx(
        3.0, abs=0.05
    )
    assert "gap" in codes(found)
    rest = [recon.BodyModel.load().rest_joints(one.shape) for one in (found[15], back[0])]
    moved = (rest[1] - rest[0]).norm(dim=-1).max()
    assert moved < 0.01, "who returns is the person who left"


def test_points_that_fly_off_are_left_out(seen, truth):
    moments = seen.copy()
    moments[20] += 4.0
    moments[24, 20] += 4.0
    found = played(stream(lag=4), moments)
    assert codes(found).count("outliers") == 2
    assert (joints_of(found) - truth).norm(dim=-1).max() < 0.15
    assert not found[20].observed.any()
    assert not found[24].observed[20]


@pytest.mark.parametrize("joint", [0, 15, 21])
def test_a_moment_with_all_points_in_one_place_counts_as_unseen(seen, joint):
    """The body shrank into the place of its pelvis, and was up to 1.5 m off for a second."""
    moments, unseen = seen.copy(), seen.copy()
    moments[20], unseen[20] = seen[20, joint], np.nan
    found = joints_of(played(stream(lag=4), moments))
    torch.testing.assert_close(found, joints_of(played(stream(lag=4), unseen)))


def test_points_that_stay_away_are_the_person(seen):
    moments = seen.copy()
    moments[16:] += np.array([5.0, 0.0, 0.0], dtype=np.float32)
    found = played(stream(lag=4), moments)
    assert [one.time for one in found] == pytest.approx([k / FPS for k in range(FRAMES)])
    assert "jump" in codes(found)
    away = (joints_of(found)[28:] - torch.from_numpy(moments[28:])).norm(dim=-1)
    assert away.mean() < 0.06


def test_bad_moments_are_refused_and_the_stream_goes_on(seen):
    """What is refused leaves nothing behind: it counts as a moment that was dropped."""
    live, found = stream(lag=4), []
    bad = (
        seen[0][:10],
        "nothing",
        np.zeros((22, 2)),
        recon.Joints3D(seen[:2], np.ones((2, 22), bool), range(22), FPS),
        recon.Joints3D(seen[:1, :21], np.ones((1, 21), bool), range(21), FPS),
        recon.Joints3D(seen[:1], np.ones((1, 22), bool), range(22), 60.0),
        1e9 * seen[0],
    )
    for k, moment in enumerate(seen[:20]):
        if 10 <= k < 10 + len(bad):
            with pytest.raises(recon.ReconError):
                live.push(bad[k - 10], k / FPS)
        estimate = live.push(moment, k / FPS)
        found += () if estimate is None else estimate.every
    found += live.finish()
    assert [one.time for one in found] == pytest.approx([k / FPS for k in range(20)])
    assert codes(found) == []


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"lag": -1}, "lag: expected"),
        ({"prior": "anchor"}, "prior: expected .*'humor'"),
        ({"noise": [0.1, 0.2], "template": None}, "noise: expected one"),
        ({"noise": [0.1, 0.2]}, "noise: expected one"),
        ({"noise": -1.0}, "noise: expected a number above 0"),
    ],
)
def test_settings_are_checked(settings, message, seen):
    template = recon.Joints3D(seen[:1], np.ones((1, 22), bool), range(22), FPS)
    with pytest.raises(recon.ReconError, match=message):
        recon.Stream(**{"template": template, **settings}).push(template)


@pytest.mark.parametrize("noise", [0.0, [0.1, float("nan")]])
def test_noise_is_refused_before_the_first_moment(noise):
    """It was refused after the first moment had set the clock."""
    with pytest.raises(recon.ReconError, match="noise"):
        recon.Stream(noise=noise)


def test_points_with_standard_deviations_are_refused(seen):
    sure = recon.Joints3D(seen[:1], np.ones((1, 22), bool), range(22), FPS, std=0.02)
    with pytest.raises(recon.ObservationError, match="leave out std"):
        recon.Stream().push(sure)


def test_arrays_need_a_template(seen):
    with pytest.raises(recon.ObservationError, match="template"):
        recon.Stream().push(seen[0])


@pytest.mark.slow
def test_memory_is_bounded(seen):
    """After the beginning, a stream holds as many tensors after 30 more moments as before."""
    live = stream(lag=4)

    def held() -> int:
        tracking = live._tracking
        assert tracking is not None
        now = tracking.smoothed
        assert now is not None
        return now.window.frames + now.active_frames + len(tracking.times) + len(tracking.gathered)

    sizes = []
    for k in range(60):
        live.push(seen[k % 30 if k % 60 < 30 else 29 - k % 30])
        sizes.append(held() if k > 20 else 0)
    assert len(set(sizes[21:])) == 1


@pytest.mark.slow
def test_markers(truth):
    body, motion = recon.BodyModel.load(), walk(20)
    vertices = [landmark(name) for name in KEYPOINTS_43]
    points = body.pose(motion).points(torch.tensor(vertices))
    template = recon.Markers3D(points[:1], torch.ones(1, 43, dtype=torch.bool), vertices, FPS)
    found = played(recon.Stream(lag=4, template=template), points)
    assert len(found) == 20
    assert (joints_of(found) - truth[:20]).norm(dim=-1).mean() < 0.02


def test_cameras(truth):
    views = [view(walk(20), camera, seed=k) for k, camera in enumerate(cameras(walk(20), 3))]
    live, found = recon.Stream(lag=4), []
    for k in range(20):
        moments = [one[0].window(k / FPS, k / FPS) for one in views]
        estimate = live.push(moments)
        found += () if estimate is None else estimate.every
    found += live.finish()
    assert [one.time for one in found] == pytest.approx([k / FPS for k in range(20)])
    assert (joints_of(found) - truth[:20]).norm(dim=-1).mean() < 0.03


def test_cameras_without_a_pose_are_refused():
    (camera,) = cameras(walk(4))
    loose = recon.Camera.create(camera.camera_matrix, camera.image_size)
    seen = view(walk(4), camera).derived(camera=loose.map(lambda t: t[None, None]))
    with pytest.raises(recon.ObservationError, match="pose is known"):
        recon.Stream().push(seen[0].window(0.0, 0.0))


def test_lines_of_json(seen, truth):
    """What `recon stream` does; lines that are hold no moment are reported and skipped."""
    lines = [
        json.dumps({"time": k / FPS, "points": [row.tolist() for row in moment]}) + "\n"
        for k, moment in enumerate(seen[:24])
    ]
    lines[20] = json.dumps({"time": 20 / FPS, "points": [None, [None, 1, 2], *[[None] * 3] * 20]})
    lines.insert(10, "{nothing")
    lines.insert(12, '{"time": 1.0}')
    lines.insert(14, "")
    told: list[str] = []
    found = [json.loads(line) for line in stream_lines(lines, stream(lag=4), told.append)]
    assert [line["time"] for line in found] == pytest.approx(
        [k / FPS for k in range(24)], abs=1e-5
    )
    assert len(told) == 2
    assert told[0].startswith("line 11: expected")
    assert np.abs(np.array([line["joints"] for line in found]) - truth[:24].numpy()).mean() < 0.03
    assert set(found[0]) >= {"trans", "poses", "betas", "observed"}
    assert sum(found[20]["observed"]) == 0


def test_lines_of_several_sensors():
    """A row with null for a coordinate was taken for a sensor; lists of rows are sensors."""
    views = [view(walk(12), camera, seed=k) for k, camera in enumerate(cameras(walk(12), 2))]
    both = [torch.cat((v.pixels, v.confidence[..., None]), -1)[0] for v in views]
    lines = [json.dumps({"points": [one[k].tolist() for one in both]}) for k in range(12)]
    live, told = recon.Stream(lag=2, template=views), []
    found = [json.loads(line) for line in stream_lines(lines, live, told.append)]
    assert told == []
    assert len(found) == 12

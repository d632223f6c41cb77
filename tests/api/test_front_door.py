"""`recon.fit` from Python: plain arrays in, a result out; what it takes and what it refuses."""

import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
import torch

import recon
from priors.pose.prior import PosePrior
from recon.api.given import checked_prior
from recon.api.observations import clip_of, in_fit_frame
from recon.core.skeleton import JOINTS
from recon.fitting import clip as clip_module
from recon.formats.observations import PositionsFile, save_observation
from recon.method.terms import Term
from recon.solver.lbfgs import LBFGS
from tests.filmed import bundled, cameras, joint_error, view, walk


class Quick:
    """Four iterations of every stage of the pose prior."""

    def stages(self, data: tuple[Term, ...]):
        return tuple(replace(s, minimiser=LBFGS(4)) for s in PosePrior.load().stages(data))


def noisy(frames: int = 16, deviation: float = 0.02) -> np.ndarray:
    """Joints of the walk in double precision, no leading axis."""
    joints = bundled().pose(walk(frames)).joints.double().numpy()
    return joints + np.random.default_rng(0).normal(0, deviation, joints.shape)


def seen(positions: np.ndarray, **fields) -> recon.Joints3D:
    visible = np.asarray(np.isfinite(positions).all(-1))
    return recon.Joints3D(positions, visible, range(22), fps=30.0, **fields)


@pytest.mark.parametrize(
    ("frames", "fps", "start_time"),
    [(17, 29.97, 0.0), (12, 25.0, 0.0), (40, 120.0, 0.0), (33, 100.0, 1.7e9 + 0.37)],
)
def test_under_humor_a_result_has_every_frame_of_the_data(frames, fps, start_time):
    moments = torch.arange(frames, dtype=torch.float64) / fps
    joints = bundled().pose(walk(20).replace(fps=30.0).at(moments, fps)).joints.numpy()
    shown = np.ones(joints.shape[:-1], dtype=bool)
    sensor = recon.Joints3D(joints, shown, range(22), fps=fps, start_time=start_time)
    result = recon.fit(sensor, noise=0.01, checks=())
    assert result.motion.frames == frames
    assert result.joints.shape == (frames, 22, 3)


def test_eight_lines_from_an_array_to_a_file(tmp_path):
    """README's example: the raw core had to be told prior, noise, weights and clip axis."""
    positions = noisy(12)
    positions[:, [18, 20]] = np.nan  # the left arm
    result = recon.fit(seen(positions))
    result.save(tmp_path / "motion.npz")
    assert joint_error(result.motion, walk(12)) < 0.05
    assert result.joints.shape == (12, 22, 3)
    assert result.contacts.shape == (12, 22)
    assert result.observed.shape == (12, 22)
    assert not result.observed[:, 20].any()
    assert result.observed[:, 0].all()
    assert result.ground.tolist() == [0.0, 0.0, 1.0, 0.0]
    again = recon.load_motion(tmp_path / "motion.npz")
    assert torch.equal(again.motion.translation, result.motion.translation)
    assert (tmp_path / "motion.npz.json").is_file()
    text = repr(result)
    assert "12 frames" in text
    assert "tensor" not in text
    assert len(text.splitlines()) <= 10
    assert max(map(len, text.splitlines())) <= 110


@pytest.mark.parametrize("axis", [False, True])
def test_a_leading_axis_makes_no_difference(axis):
    plain = recon.fit(seen(noisy(8)), Quick())
    other = recon.fit([seen(noisy(8))[None] if axis else seen(noisy(8))], Quick())
    assert torch.equal(plain.motion.translation, other.motion.translation)


@pytest.mark.parametrize(
    "prior",
    ["tests.api.test_front_door:Quick", Quick(), PosePrior.load()],
    ids=["place", "method", "prior"],
)
def test_priors_are_named_imported_or_given(prior):
    result = recon.fit(seen(noisy(8)), prior)
    assert joint_error(result.motion, walk(8)) < 0.06


@pytest.mark.parametrize("prior", ["humour", "tests.nowhere:Prior", "recon:nothing", 3, Quick])
def test_what_is_no_prior_is_refused(prior):
    with pytest.raises(recon.WeightsError, match="prior"):
        checked_prior(prior, "open")


def test_pixels_and_metres_need_a_noise_each():
    one = view(walk(8), cameras(walk(8))[0])
    both = [seen(noisy(8)), one]
    with pytest.raises(recon.ObservationError, match="one number for each of joints3d, keypo"):
        recon.fit(both, Quick(), noise=0.02)
    result = recon.fit(both, Quick(), noise=(0.03, 5.0))
    assert [noise.own for noise in result.noises] == [0.03, 5.0]


def test_noise_in_millimetres_is_refused():
    with pytest.raises(
        recon.ObservationError, match=r"at most 1 m for joints3d, got 20; .* 0\.02"
    ):
        recon.fit(seen(noisy(8)), Quick(), noise=20.0)
    pixels = view(walk(8), cameras(walk(8))[0])
    assert recon.fit(pixels, Quick(), noise=20.0).noises[0].own == 20


def test_a_shape_is_held():
    shape = [1.5, -1.0]
    result = recon.fit(seen(noisy(8)), Quick(), shape=shape)
    assert result.motion.shape[:2].tolist() == shape
    assert not result.motion.shape[2:].any()
    again = recon.fit(seen(noisy(8)), Quick(), shape=result)
    assert torch.equal(again.motion.shape, result.motion.shape)


def test_terms_of_the_caller_count():
    def high(estimate):
        return (estimate.body.joints[..., 15, 2] - 3.0).square().sum(-1)

    plain = recon.fit(seen(noisy(8)), Quick())
    pulled = recon.fit(seen(noisy(8)), Quick(), terms=[Term("high", high, 1.0)])
    assert (pulled.joints[:, 15, 2] > plain.joints[:, 15, 2] + 0.05).all()


def test_a_start_is_gone_on_from(tmp_path):
    first = recon.fit(seen(noisy(8)), Quick())
    stages = recon.fit(seen(noisy(8)), Quick(), start=first).reconstruction.reports
    fresh = recon.fit(seen(noisy(8)), Quick()).reconstruction.reports
    assert float(stages[0].solution.trace[0, 0].sum()) < float(fresh[0].solution.trace[0, 0].sum())
    first.save(tmp_path / "first.npz")
    read = recon.fit(seen(noisy(8)), Quick(), start=tmp_path / "first.npz").reconstruction.reports
    ours, theirs = (float(one[0].solution.trace[0, 0].sum()) for one in (stages, read))
    assert theirs == pytest.approx(ours, rel=1e-3)
    with pytest.raises(FileNotFoundError, match=r"nothing\.npz"):
        recon.fit(seen(noisy(8)), Quick(), start=tmp_path / "nothing.npz")


def test_a_callback_may_end_the_fit():
    calls = []

    def enough(stage, progress):
        calls.append(stage)
        return len(calls) >= 3

    result = recon.fit(seen(noisy(8)), callback=enough)
    assert len(calls) == 3
    assert result.warnings[0].code == "stopped"
    assert bool(result.joints.isfinite().all())
    assert "the caller stopped it" in result.report()["stages"][-1]["termination"]
    assert not result.failed


def test_time_that_is_used_up_ends_the_fit():
    result = recon.fit(seen(noisy(16)), max_seconds=0.05)
    assert "max_seconds = 0.05" in result.warnings[0].message
    assert bool(result.joints.isfinite().all())


def test_a_part_at_another_rate():
    result = recon.fit(seen(noisy(16)), Quick(), between=(0.1, 0.3), fps=60.0)
    assert result.motion.fps == 60.0
    assert result.motion.start_time == pytest.approx(0.1)
    assert result.motion.frames == 13


@pytest.mark.parametrize("given", ["unknown", (0.0, 0.0, 1.0, 0.7)], ids=str)
def test_the_ground_may_be_elsewhere(given):
    """0.7 m higher: found, or given as a plane, after which it is z = 0."""
    raised = noisy(16) + np.array([0.0, 0.0, 0.7])
    result = recon.fit(seen(raised), "pose", ground=given)
    assert result.examined.fit.ground_known == (given != "unknown")
    height = float(result.ground[3])
    assert height == pytest.approx(0.7 if given == "unknown" else 0.0, abs=0.05)
    lowest = float(result.joints[..., 2].amin())
    assert lowest - height == pytest.approx(float(bundled().pose(walk(16)).joints[..., 2].amin()),
                                            abs=0.06)  # fmt: skip


def test_a_camera_without_a_pose_finds_its_ground():
    """Its frame was taken for a world whose ground is its optical centre."""
    true = view(walk(16), cameras(walk(16))[0])
    lens = true.camera.camera_matrix[0, 0]
    camera = recon.Camera.create(lens, true.camera.image_size)
    lost = recon.Keypoints2D(true.pixels[0], true.confidence[0], true.points, camera, fps=30.0)
    result = recon.fit(lost, "pose")
    assert not result.examined.fit.ground_known
    assert result.T_world_camera is not None
    assert float(result.T_world_camera[2, 3]) == pytest.approx(1.6, abs=0.3)  # the dome's height
    with pytest.raises(recon.ReconError, match="no pose"):
        recon.fit(lost, "pose", ground="known")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"shape": [[1.0]]}, "shape: expected"),
        ({"robust": -1.0}, "robust"),
        ({"max_seconds": 0.0}, "max_seconds"),
        ({"noise": [0.1, 0.2]}, "noise: expected one number, or 1"),
        ({"weights": "nc", "prior": Quick()}, "weights"),
    ],
    ids=lambda given: given if isinstance(given, str) else "+".join(given),
)
def test_other_arguments_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        recon.fit(seen(noisy(8)), **({"prior": "pose"} | arguments))


@pytest.mark.parametrize("ground", ["flat", (0.0, 1.0), 3, (0.0, 0.0, float("nan"), 0.0)])
def test_what_is_no_ground_is_refused(ground):
    with pytest.raises(recon.ReconError, match="ground: expected"):
        in_fit_frame(clip_of(seen(noisy(8)), bundled()), ground)


def test_a_clip_in_which_nothing_is_seen_is_refused():
    """The motion was then a guess from nothing, with a warning."""
    with pytest.raises(recon.ObservationError, match="at least one point that is seen, got none"):
        recon.fit(seen(np.full((16, 22, 3), np.nan)))


def test_what_is_no_clip_is_refused():
    with pytest.raises(recon.ObservationError, match="nothing to fit"):
        recon.fit([])
    with pytest.raises(recon.ObservationError, match="got ndarray"):
        clip_of([noisy(8)], bundled())
    two = np.stack((noisy(8), noisy(8)))
    with pytest.raises(recon.ObservationError, match=r"leading axes \(2,\)"):
        recon.fit(seen(two))


def test_files_are_read(tmp_path):
    file = PositionsFile("joints3d", noisy(8), np.ones((8, 22), bool), tuple(JOINTS), 30.0)
    save_observation(tmp_path / "joints.npz", file)
    read = recon.load_observation(tmp_path / "joints.npz")
    assert isinstance(read, recon.Joints3D)
    assert read.positions.shape == (1, 8, 22, 3)
    both = recon.load_observation([tmp_path / "joints.npz"] * 2)
    assert isinstance(both, list)
    assert len(both) == 2
    (tmp_path / "bad.txt").write_text("nothing")
    with pytest.raises(recon.FormatError, match=r"expected a film, an observation"):
        recon.load_observation(tmp_path / "bad.txt")
    with pytest.raises(FileNotFoundError):
        recon.load_observation(tmp_path / "none.npz")


def test_long_recordings_hold_a_shape_and_may_be_ended(monkeypatch):
    """Windows share the shape that is held; a fit that was ended still has all of them."""
    monkeypatch.setattr(clip_module, "LONG", 1.0)
    monkeypatch.setattr("recon.fitting.long.WINDOW", 1.0)
    shape = [1.5, -1.0]
    result = recon.fit(seen(noisy(36)), Quick(), shape=shape, callback=lambda *_: True)
    assert result.motion.frames == 36
    assert result.motion.shape[:2].tolist() == shape
    assert result.warnings[0].code == "stopped"
    assert joint_error(result.motion, walk(36)) < 0.5


def test_two_threads_do_not_disturb_each_other():
    clips = [seen(noisy(8)), seen(noisy(8, 0.05))]
    alone = [recon.fit(clip, Quick()) for clip in clips]
    with ThreadPoolExecutor(2) as threads:
        together = list(threads.map(lambda clip: recon.fit(clip, Quick()), clips))
    for one, other in zip(alone, together, strict=True):
        assert torch.equal(one.motion.translation, other.motion.translation)


def test_importing_is_cheap_and_seeds_and_threads_are_left_alone():
    line = "import sys, recon; assert 'torch' not in sys.modules; assert 'fit' in dir(recon)"
    subprocess.run([sys.executable, "-c", line], check=True)
    before, threads = torch.random.get_rng_state(), torch.get_num_threads()
    recon.fit(seen(noisy(8)), Quick())
    assert torch.equal(before, torch.random.get_rng_state())
    assert torch.get_num_threads() == threads


def test_a_height_is_heeded_where_data_cannot_tell():
    """Pixels of one camera tell a person from a smaller one who is nearer by nothing but feet."""
    true = view(walk(12), cameras(walk(12))[0])
    camera = recon.Camera.create(true.camera.camera_matrix[0, 0], true.camera.image_size)
    lost = recon.Keypoints2D(true.pixels[0], true.confidence[0], true.points, camera, fps=30.0)
    for metres in (1.6, 1.9):
        result = recon.fit(lost, Quick(), shape=metres)
        assert float(result.body.height(result.motion.shape)) == pytest.approx(metres, abs=0.03)
        assert result.arguments["shape_prior"]["height"] == metres


def test_a_known_shape_is_corrected_by_data_as_its_deviation_allows():
    away = [2.0, -2.0]
    distances = []
    for std in (0.01, 10.0):
        result = recon.fit(seen(noisy(8)), Quick(), shape=recon.Shape(like=away, like_std=std))
        distances.append(float((result.motion.shape[:2] - torch.tensor(away)).norm()))
    assert distances[0] < 0.1
    assert distances[1] > 1.0


@pytest.mark.parametrize(
    ("shape", "words"),
    [
        (17.5, "height of 1 to 2.5 metres, got 17.5"),
        (recon.Shape(), "expected height, or a similar shape as `like`"),
        (recon.Shape(height=1.7, height_std=0.0), "height_std: expected a number above 0"),
    ],
    ids=str,
)
def test_what_is_no_height_is_refused(shape, words):
    with pytest.raises(recon.ReconError, match=words):
        recon.fit(seen(noisy(8)), "pose", shape=shape)

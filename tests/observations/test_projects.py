"""Folders of Pose2Sim and OpenCap: one command finds calibration, rate and frames in them."""

import json

import cv2
import numpy as np
import pytest

from observations.correspondences import BodyPoints
from recon.core.layouts import keypoint_names
from recon.core.units import to_z_up
from recon.fitting.settings import DEFAULTS
from recon.formats.projects import project_at
from recon.mocap.marker_tables import write_trc
from recon.mocap.recording import MarkerRecording
from recon.reading.clip import load_clip
from recon.reading.inputs import observation_input
from tests.filmed import bundled, cameras, view, walk

FRAMES = 10


def pose2sim(folder, config="[project]\nframe_rate = 30\nframe_range = []\n"):
    """A session with its calibration, and a trial in it."""
    trial = folder / "session" / "trial"
    (folder / "session" / "calibration").mkdir(parents=True)
    (folder / "session" / "Config.toml").write_text(config)
    lines = []
    for k, camera in enumerate(cameras(walk(FRAMES), 2), 1):
        seen = view(walk(FRAMES), camera, seed=k, layout="halpe26")
        T = camera.T_camera_world.reshape(4, 4).double().numpy()
        turn = cv2.Rodrigues(T[:3, :3])[0].ravel().tolist()
        lines += [
            f"[cam_0{k}]", f'name = "cam_0{k}"', "size = [1920.0, 1080.0]",
            f"matrix = {camera.camera_matrix.reshape(3, 3).tolist()}",
            "distortions = [0.0, 0.0, 0.0, 0.0]", f"rotation = {turn}",
            f"translation = {T[:3, 3].tolist()}", "fisheye = false",
        ]  # fmt: skip
        where = trial / "pose" / f"cam0{k}_json"
        where.mkdir(parents=True)
        shown = np.concatenate((seen.pixels[0].numpy(), seen.confidence[0, ..., None].numpy()), -1)
        for t, frame in enumerate(shown.tolist()):
            flat = [x for point in frame for x in point]
            text = json.dumps({"people": [{"pose_keypoints_2d": flat}]})
            (where / f"cam0{k}_{t:06d}.json").write_text(text)
    (folder / "session" / "calibration" / "Calib_scene.toml").write_text("\n".join(lines))
    return trial


def trc(path, names, x, fps=30.0):
    path.parent.mkdir(parents=True, exist_ok=True)
    seen = np.ones(x.shape[:2], bool)
    write_trc(path, MarkerRecording("x", tuple(names), x, seen, fps, ()))


def keypoints() -> np.ndarray:
    body = bundled()
    places = BodyPoints.of_layout("coco133", body)
    return places.of(body.pose(walk(FRAMES))).double().numpy()


def test_a_pose2sim_trial_needs_no_options(tmp_path):
    trial = pose2sim(tmp_path)
    clip = load_clip([trial], DEFAULTS, bundled())
    assert [one.kind for one in clip.observations] == ["keypoints2d", "keypoints2d"]
    assert {one.fps for one in clip.observations} == {30.0}
    assert {one.moments for one in clip.observations} == {FRAMES}
    assert clip.names == ("cam_01", "cam_02")
    said = "\n".join(clip.notes)
    assert "frame_rate of Config.toml" in said
    assert "Calib_scene.toml" in said


def test_the_trial_s_own_settings_count_and_frames_are_cut(tmp_path):
    trial = pose2sim(tmp_path)
    (trial / "Config.toml").write_text("[project]\nframe_rate = 60\nframe_range = [2, 7]\n")
    clip = load_clip([trial], DEFAULTS, bundled())
    assert {one.fps for one in clip.observations} == {60.0}
    assert {one.moments for one in clip.observations} == {5}
    assert clip.observations[0].start_time == pytest.approx(2 / 60)


def test_what_a_project_reads_counts_for_its_checksum(tmp_path):
    """A batch must fit a project again whose calibration or settings changed."""
    trial = pose2sim(tmp_path)
    before = observation_input(trial).checksum()
    calibration = tmp_path / "session" / "calibration" / "Calib_scene.toml"
    calibration.write_text(calibration.read_text() + "\n")
    after = observation_input(trial).checksum()
    assert after != before
    (tmp_path / "session" / "Config.toml").write_text("[project]\nframe_rate = 60\n")
    assert observation_input(trial).checksum() != after


def test_a_session_of_several_trials_names_them(tmp_path):
    pose2sim(tmp_path)
    with pytest.raises(ValueError, match="give one of them: trial"):
        load_clip([tmp_path / "session"], DEFAULTS, bundled())


def test_a_rate_that_nothing_states_is_asked_for(tmp_path):
    trial = pose2sim(tmp_path, "[project]\nframe_rate = 'auto'\n")
    with pytest.raises(ValueError, match="--frame-rate"):
        load_clip([trial], DEFAULTS, bundled())
    trc(trial / "pose-3d" / "trial_0-9.trc", keypoint_names("coco133"), keypoints())
    assert load_clip([trial], DEFAULTS, bundled()).observations[0].fps == 30


@pytest.mark.parametrize(
    ("config", "named"),
    [
        ("[project\n", "expected TOML"),
        ("[project]\nframe_rate = -1\n", "frame_rate"),
        ("[project]\nframe_rate = 30\nframe_range = [5, 2]\n", "two rising numbers"),
    ],
)
def test_damaged_settings_are_refused(tmp_path, config, named):
    with pytest.raises(ValueError, match=named):
        load_clip([pose2sim(tmp_path, config)], DEFAULTS, bundled())


def test_an_opencap_session_is_its_one_trial(tmp_path):
    names = [*keypoint_names("coco133"), "r.ASIS_study", "L.ASIS_study"]
    x = np.concatenate((keypoints(), keypoints()[:, :2]), 1)
    (tmp_path / "sessionMetadata.yaml").write_text("mass_kg: 70\n")
    (tmp_path / "Videos" / "Cam0").mkdir(parents=True)
    (tmp_path / "Videos" / "Cam0" / "cameraIntrinsicsExtrinsics.pickle").write_bytes(
        b"cos\nsystem"
    )
    trc(tmp_path / "MarkerData" / "neutral.trc", names, x)
    trc(tmp_path / "MarkerData" / "walk.trc", names, x)
    clip = load_clip([tmp_path], DEFAULTS, bundled())
    (seen,) = clip.observations
    assert seen.kind == "keypoints3d"
    np.testing.assert_allclose(seen.positions[0], keypoints(), atol=1e-4)  # metres
    said = "\n".join(clip.notes)
    assert "2 markers that OpenCap computed" in said
    assert "pickles may run code" in said
    trc(tmp_path / "MarkerData" / "run.trc", names, x)
    with pytest.raises(ValueError, match=r"walk\.trc"):
        load_clip([tmp_path], DEFAULTS, bundled())


STUDY = [
    "C7", "r_shoulder", "L_shoulder", "r.ASIS", "L.ASIS", "r.PSIS", "L.PSIS", "RHJC", "LHJC",
    *(
        f"{side}_{name}"
        for side in "rL"
        for name in (
            "knee", "mknee", "ankle", "mankle", "calc", "toe", "5meta", "lelbow", "melbow",
            "lwrist", "mwrist", "thigh1", "thigh2", "thigh3", "sh1", "sh2", "sh3",
        )
    ),
]  # fmt: skip
"""The 43 markers of OpenCap's augmenter (opencap-core, utils.py)."""


def test_all_markers_of_the_augmenter_are_known(tmp_path):
    """Elbows and wrists, eight of them, were not."""
    x = np.random.default_rng(0).normal(scale=0.3, size=(FRAMES, len(STUDY), 3))
    names = [f"{name}_study" for name in STUDY]
    x[:, [names.index(f"{side}_toe_study") for side in "rL"], 2] -= 1
    x[:, names.index("C7_study"), 2] += 1
    trc(tmp_path / "x.trc", names, x @ to_z_up("z").T)
    (seen,) = load_clip([tmp_path / "x.trc"], DEFAULTS, bundled()).observations
    assert seen.kind == "markers3d"
    assert seen.moments == FRAMES
    assert len(seen.point_names(bundled())) == 41  # all but the two centres of hip joints


def test_a_folder_of_detections_alone_is_no_project(tmp_path):
    """Calibrations of whatever lies beside it were taken for its own."""
    (tmp_path / "some" / "pose" / "cam1").mkdir(parents=True)
    for other in ("calibration_of_others", "more_calibrations"):
        (tmp_path / other).mkdir()
        (tmp_path / other / "Calib.toml").write_text("")
    assert project_at(tmp_path / "some") is None

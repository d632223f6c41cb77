"""3D keypoints as other programs write them: read by one call, what is guessed is said."""

import csv
import json

import cv2
import numpy as np
import pytest

import recon
from observations.correspondences import BodyPoints
from observations.keypoints3d import Keypoints3D
from observations.start.standing import planted_translations
from recon.core.layouts import LAYOUTS, keypoint_names
from recon.core.units import to_z_up
from recon.fitting.settings import FitSettings
from recon.keypoints3d.labels import are_keypoints, keypoints_of_labels
from recon.mocap.marker_tables import write_trc
from recon.mocap.recording import MarkerRecording
from recon.reading.clip import load_clip
from tests.filmed import bundled, joint_error, walk
from tests.formats.pose2sim_files import write_trc as write_pose2sim_trc
from tests.keypoint_scene import camera, figure, image, write_openpose, write_toml

FRAMES = 12


def points(layout: str) -> np.ndarray:
    """The keypoints of a walk, metres, z up."""
    body = bundled()
    return BodyPoints.of_layout(layout, body).of(body.pose(walk(FRAMES))).double().numpy()


def wide(path, names, x):
    with path.open("w", newline="") as file:
        rows = csv.writer(file)
        rows.writerow([f"{name}_{axis}" for name in names for axis in "xyz"])
        rows.writerows(x.reshape(len(x), -1).round(4).tolist())


def long(path, names, x):
    with path.open("w", newline="") as file:
        rows = csv.writer(file)
        rows.writerow(["frame", "timestamp", "keypoint", "x", "y", "z"])
        for t, frame in enumerate(x):
            rows.writerows([t, t / 30, n, *p.tolist()] for n, p in zip(names, frame, strict=True))


def read(path, **settings) -> tuple[Keypoints3D, str]:
    """The one sensor of a file, and all that was said."""
    clip = load_clip([path], FitSettings(**settings), bundled())
    (seen,) = clip.observations
    assert isinstance(seen, Keypoints3D)
    return seen, "\n".join(clip.notes)


def agrees(seen: Keypoints3D, expected: np.ndarray):
    np.testing.assert_allclose(seen.positions[0].numpy(), expected, atol=2e-4)  # metres
    assert seen.fps == 30
    assert seen.placed
    assert seen.ground_known


def test_wide_and_long_tables_arrays_and_trc_are_one_thing(tmp_path):
    names, x = keypoint_names("mediapipe33"), points("mediapipe33")
    wide(tmp_path / "body_3d.csv", [f"body_{name}" for name in names], 1000 * x)
    long(tmp_path / "long.csv", names, 1000 * x)
    np.save(tmp_path / "body.npy", 1000 * x)
    np.savez(tmp_path / "body.npz", keypoints=x, fps=30.0)
    seen, said = read(tmp_path / "body_3d.csv", frame_rate=30.0)
    agrees(seen, x)
    assert "unit mm" in said
    assert "up axis z" in said
    agrees(read(tmp_path / "long.csv")[0], x)
    seen, said = read(tmp_path / "body.npy", frame_rate=30.0)
    agrees(seen, x)
    assert "layout mediapipe33" in said
    agrees(read(tmp_path / "body.npz")[0], x)


@pytest.mark.parametrize(("mark", "encoding"), [(";", "utf-8"), ("\t", "utf-8"), ("\t", "utf-16")])
def test_tables_of_other_spreadsheets_are_read(tmp_path, mark, encoding):
    """Semicolons, tabs and UTF-16, as Excel saves where numbers have commas, were no table."""
    names, x = keypoint_names("coco17"), points("coco17")
    wide(tmp_path / "a.csv", names, x)
    text = (tmp_path / "a.csv").read_text().replace(",", mark).replace(".", ",")
    (tmp_path / "b.csv").write_bytes(text.encode(encoding))
    agrees(read(tmp_path / "b.csv", frame_rate=30.0)[0], x)


@pytest.mark.parametrize(
    ("head", "ticks"),
    [("time", 1.0), ("Time (s)", 1.0), ("time_ms", 1e3), ("Timestamp [us]", 1e6), ("t ns", 1e9)],
)
def test_times_may_count_parts_of_seconds(tmp_path, head, ticks):
    """Milliseconds were taken for seconds: a frame every 33 s, which ended in a traceback."""
    names, x = keypoint_names("coco17"), points("coco17")
    header = [head, *(f"{name}_{axis}" for name in names for axis in "xyz")]
    with (tmp_path / "a.csv").open("w", newline="") as file:
        rows = csv.writer(file)
        rows.writerow(header)
        rows.writerows([t / 30 * ticks, *one] for t, one in enumerate(x.reshape(FRAMES, -1)))
    agrees(read(tmp_path / "a.csv")[0], x)


@pytest.mark.parametrize("missing", ["NA", "null", "-", "NaN", ""])
def test_frames_and_cells_may_be_missing_where_times_are_known(tmp_path, missing):
    """A table with a gap in its frames was said to state no rate; NA, as R writes, was refused."""
    names, x = keypoint_names("coco17"), points("coco17")
    header = ["frame", "time", *(f"{name}_{axis}" for name in names for axis in "xyz")]
    table = [[t, t / 30, *one] for t, one in enumerate(x.reshape(FRAMES, -1).tolist())]
    table[1][2:5] = [missing] * 3
    with (tmp_path / "a.csv").open("w", newline="") as file:
        csv.writer(file).writerows([header, *table[:3], *table[5:]])
    seen, _ = read(tmp_path / "a.csv")
    assert (seen.fps, seen.moments) == (30.0, FRAMES)
    assert int((~seen.visible).sum()) == 2 * len(names) + 1


def test_times_that_tell_no_rate_are_named(tmp_path):
    """Numbers of frames were seconds; of a pause it was said that there are no times."""
    names, x = keypoint_names("coco17"), points("coco17")
    header = ["time", *(f"{name}_{axis}" for name in names for axis in "xyz")]
    for times in (range(FRAMES), [0.1 * t + 0.55 * (t > 5) for t in range(FRAMES)]):
        with (tmp_path / "a.csv").open("w", newline="") as file:
            rows = csv.writer(file)
            rows.writerow(header)
            rows.writerows([t, *one] for t, one in zip(times, x.reshape(FRAMES, -1), strict=True))
        with pytest.raises(recon.ReconError, match=r"times in a.csv .* not used; give frames"):
            read(tmp_path / "a.csv")


def test_keypoints_of_a_trc_are_never_skin(tmp_path):
    """A Pose2Sim TRC was fitted as markers on the skin: joints were 7 cm off."""
    names = [
        name.replace("left_", "L").replace("right_", "R").title().replace("_", "")
        for name in keypoint_names("halpe26")
    ]
    names = [name.replace("MidHip", "Hip").replace("HeadTop", "Head") for name in names]
    x = points("halpe26")
    seen = np.ones(x.shape[:2], bool)
    write_trc(tmp_path / "pose.trc", MarkerRecording("pose", tuple(names), x, seen, 30.0, ()))
    found, _ = read(tmp_path / "pose.trc")
    agrees(found, x)
    assert found.points.names == keypoint_names("halpe26")


def test_points_of_pose2sim_stand_where_its_cameras_have_them(tmp_path):
    """They were turned by a quarter about the vertical: Pose2Sim's y up is not OpenSim's."""
    x = points("halpe26")
    write_pose2sim_trc(tmp_path / "pose.trc", "halpe26", x, 0)
    found, said = read(tmp_path / "pose.trc")
    assert "Pose2Sim's world" in said
    told, _ = read(tmp_path / "pose.trc", up="y")
    for seen in (found, told):
        np.testing.assert_allclose(seen.positions[0].numpy(), x, atol=2e-4)


def test_an_azure_kinect_s_body_is_in_a_camera_that_may_be_tilted(tmp_path):
    x = points("azure32") @ to_z_up("y-down") * 1000 + (0, 0, 3000)
    frames = [
        {"timestamp_usec": round(t * 1e6 / 30), "bodies": [
            {"body_id": 4, "joint_positions": frame.tolist()}
        ]}
        for t, frame in enumerate(x)
    ]  # fmt: skip
    path = tmp_path / "azure.json"
    path.write_text(json.dumps({"frames": frames}))
    seen, said = read(path)
    assert seen.point_names(bundled()) == keypoint_names("azure32")
    assert not seen.level
    assert not seen.ground_known
    assert "y points down" in said
    expected = x / 1000 @ to_z_up("y-down").T
    np.testing.assert_allclose(seen.positions[0].numpy(), expected, atol=2e-4)


@pytest.mark.parametrize("layout", ["h36m17", "mediapipe33"])
def test_what_is_relative_to_the_pelvis_is_said_to_have_no_place(tmp_path, layout):
    x, names = points(layout), keypoint_names(layout)
    hips = [names.index("left_hip"), names.index("right_hip")]
    np.save(tmp_path / "X3D.npy", x - x[:, hips].mean(1, keepdims=True))
    seen, said = read(tmp_path / "X3D.npy", frame_rate=30.0)
    assert not seen.placed
    assert f"layout {layout}" in said
    assert "no place in the world" in said


def test_a_body_about_its_pelvis_is_fitted_wherever_it_is():
    """Its root, which is always exactly at the origin, was called a held point and left out."""
    x, names = points("h36m17"), keypoint_names("h36m17")
    x = x - x[:, names.index("mid_hip"), None]
    seen = recon.Keypoints3D(x, np.ones(x.shape[:2], bool), "h36m17", fps=30.0, placed=False)
    result = recon.fit(seen, "pose")
    joints, truth = result.joints.numpy(), bundled().pose(walk(FRAMES)).joints.numpy()
    relative = (joints - joints[:, :1]) - (truth - truth[:, :1])
    assert np.linalg.norm(relative, axis=-1).mean() < 0.016  # metres
    assert [one.code for one in (*result.repairs, *result.warnings)] == []


def test_mediapipe_s_world_landmarks_are_told_from_those_of_the_image(tmp_path):
    x = points("mediapipe33")
    x = (x - x[:, 23:25].mean(1, keepdims=True)) @ to_z_up("y-down")
    entries = [
        {
            "frame": t,
            "pose_landmarks": [{"x": 0.5, "y": 0.5, "z": 0.0, "visibility": 0.9}] * 33,
            "pose_world_landmarks": [
                dict(zip("xyz", point.tolist(), strict=True), visibility=0.9 if k else 0.1)
                for k, point in enumerate(frame)
            ],
        }
        for t, frame in enumerate(x)
    ]
    (tmp_path / "mp.json").write_text(json.dumps(entries))
    seen, _ = read(tmp_path / "mp.json", frame_rate=30.0)
    assert not seen.placed
    assert seen.visible[0, :, 1:].all()
    assert not seen.visible[0, :, 0].any()  # the nose's visibility is low
    lens = {"camera_matrix": np.diag([900.0, 900.0, 1.0]), "image_size": (640, 480)}
    lens["camera_matrix"][:2, 2] = (320, 240)
    np.savez(tmp_path / "lens.npz", **lens)
    with_camera = load_clip(
        [tmp_path / "mp.json"],
        FitSettings(frame_rate=30.0, camera=tmp_path / "lens.npz"),
        bundled(),
    )
    assert with_camera.observations[0].kind == "keypoints2d"


def test_a_session_folder_of_freemocap(tmp_path):
    names, x = keypoint_names("mediapipe33"), 1000 * points("mediapipe33")
    (tmp_path / "output_data").mkdir()
    np.save(tmp_path / "output_data" / "mediapipe_body_3d_xyz.npy", x)
    long(tmp_path / "trial_by_frame.csv", names, x)
    seen, said = read(tmp_path)
    agrees(seen, x / 1000)
    assert "FreeMoCap session" in said
    assert "by the times in trial_by_frame.csv" in said


@pytest.mark.parametrize(
    ("settings", "named"),
    [
        ({"layout": "coco17"}, r"do not form a body.*h36m17 fits.*--layout"),
        ({"layout": "halpe26"}, r"has 26 keypoints, the file 17"),
        ({"unit": "mm"}, r"unit is mm \(given\).*give --unit m"),
        ({"frame_rate": None}, r"--frame-rate"),
    ],
)
def test_a_wrong_layout_unit_and_rate_are_named(tmp_path, settings, named):
    np.save(tmp_path / "x.npy", points("h36m17"))
    with pytest.raises(ValueError, match=named):
        read(tmp_path / "x.npy", **{"frame_rate": 30.0, **settings})


def test_a_wrong_axis_is_named(tmp_path):
    np.save(tmp_path / "x.npy", points("h36m17"))
    _, said = read(tmp_path / "x.npy", frame_rate=30.0, up="y")
    assert "up axis y: given, with which the person lies" in said
    assert "--up z" in said


def test_points_that_are_no_body_are_refused(tmp_path):
    rng = np.random.default_rng(0)
    np.save(tmp_path / "x.npy", rng.normal(size=(FRAMES, 33, 3)))
    with pytest.raises(ValueError, match="a body in none of these orders"):
        read(tmp_path / "x.npy", frame_rate=30.0)
    np.save(tmp_path / "x.npy", rng.normal(size=(FRAMES, 19, 3)))
    with pytest.raises(ValueError, match=r"19 points, .*coco133 with hands 133.* left_index1"):
        read(tmp_path / "x.npy", frame_rate=30.0)


@pytest.mark.parametrize(
    ("name", "content", "named"),
    [
        ("x.npy", b"\x93NUMPY\x01\x00v\x00{'descr'", "cannot be read"),
        ("x.npy", b"\x93NUMPY\x01\x00\x06\x00{'a':\n", "cannot be read"),
        ("x.npy", b"", "empty"),
        ("x.csv", b"hip_x,hip_y,hip_z,nose_x,nose_y,nose_z\n1,2,1e308,1,2,3\n", "in any unit"),
        ("x.csv", b"left_hip_x,left_hip_y,left_hip_z,nose_x,nose_y,nose_z\n1,2,three\n", "number"),
        ("x.csv", b"frame,keypoint,x,y,z\n0,nose,1,2,3\n0,nose,1,2,3\n", "twice"),
        ("x.csv", b"frame,keypoint,x,y,z\n0,nose,1,2,3\n0,tail,1,2,3\n", "too few"),
        ("x.json", b'{"frames": [{"bodies": []}]}', "all 1 frames are empty"),
        ("x.json", b'{"frames": [{"bodies": [{"joint_positions": [[1,2]]}]}]}', "x, y, z"),
        ("x.json", b'[{"frame": 0, "pose_world_landmarks": [{"x": 1}]}]', "33 MediaPipe"),
        ("x.json", b'{"joint_names": ["a"], "frames": [[[1, 2, 3]], [[1, 2]]]}', "numbers"),
    ],
)  # fmt: skip
def test_damaged_files_are_refused_with_a_reason(tmp_path, name, content, named):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(ValueError, match=named):
        read(tmp_path / name, frame_rate=30.0)


@pytest.mark.parametrize(
    ("labels", "meant"),
    [
        (("LHip", "RBigToe", "Head", "Neck", "CHip"),
         ("left_hip", "right_big_toe", "head_top", "neck", "mid_hip")),
        (("body_left_eye_inner", "body_mouth_right", "body_left_foot_index"),
         ("left_eye_inner", "right_mouth", "left_big_toe")),
        (("SPINE_CHEST", "HEAD", "FOOT_LEFT", "CLAVICLE_RIGHT", "HANDTIP_LEFT"),
         ("spine_chest", "head_joint", "left_foot_joint", "right_clavicle", "left_fingertip")),
        (("LEFT_HIP", "RIGHT_KNEE", "LEFT_FOOT_INDEX", "RHIP"),
         ("left_hip", "right_knee", "left_big_toe", "right_hip")),
        (("lhip", "rknee", "tail"), ("left_hip", "right_knee", None)),
        (("RFoot", "Thorax"), ("right_ankle", "thorax")),
    ],
)  # fmt: skip
def test_labels_mean_keypoints_as_their_producers_do(labels, meant):
    assert tuple(keypoints_of_labels(labels)) == meant


def test_markers_of_a_laboratory_are_no_keypoints():
    assert not are_keypoints(("LASI", "RASI", "LKNE", "RKNE", "LANK", "RANK", "LTOE", "C7"))
    assert are_keypoints(("LHip", "RHip", "LKnee", "RKnee", "LAnkle", "RAnkle", "Nose"))


def test_every_layout_is_told_by_the_shape_of_its_body(tmp_path):
    for layout in LAYOUTS:
        np.save(tmp_path / "x.npy", points(layout))
        seen, said = read(tmp_path / "x.npy", frame_rate=30.0)
        assert f"layout {layout}" in said
        assert seen.positions.shape[2] == len(keypoint_names(layout))


def test_arrays_are_fitted_as_joints_are():
    rng = np.random.default_rng(1)
    x = points("halpe26") + rng.normal(scale=0.015, size=(FRAMES, 26, 3))
    seen = recon.Keypoints3D(x, np.ones(x.shape[:2], bool), "halpe26", fps=30.0)
    result = recon.fit(seen, "pose")
    assert joint_error(result.motion, walk(FRAMES)) < 0.02  # metres
    assert [one.code for one in result.warnings] == []
    with pytest.raises(ValueError, match="no keypoint is called tail"):
        recon.Keypoints3D(x[:, :1], np.ones((FRAMES, 1), bool), ["tail"], fps=30.0)


def test_the_path_of_a_body_about_its_pelvis_is_that_of_its_planted_feet():
    """Toes that swing low above the ground were taken for standing: the path went to and fro."""
    body, motion = bundled(), walk(60)
    points = BodyPoints.of_layout("mediapipe33", body)
    x = points.of(body.pose(motion)).double().numpy()
    root = x[:, 23:25].mean(1)
    rng = np.random.default_rng(3)
    about = x - root[:, None] + rng.normal(scale=0.015, size=x.shape)
    path = planted_translations(points.names, about, np.ones(x.shape[:2], bool), motion.fps)
    walked = root[-1, :2] - root[0, :2]
    assert np.linalg.norm(walked) > 0.5  # metres
    assert np.linalg.norm((path[-1, :2] - path[0, :2]) - walked) < 0.25 * np.linalg.norm(walked)
    assert np.abs(path[:, 2] - root[:, 2]).max() < 0.05  # metres above the ground


def test_a_tilted_camera_is_not_taken_for_a_level_one(tmp_path):
    x = points("mediapipe33")
    tilt = cv2.Rodrigues(np.array([0.25, 0.0, 0.0]))[0]  # radians
    for level, turn in ((True, np.eye(3)), (False, tilt)):
        y = (x - x[:, 23:25].mean(1, keepdims=True)) @ to_z_up("y-down") @ turn.T
        np.save(tmp_path / "x.npy", y)
        assert read(tmp_path / "x.npy", frame_rate=30.0)[0].level == level


def test_views_beside_other_data_begin_at_their_first_frame(tmp_path):
    """Keypoints from frame 30 on were put at time 0 beside joints, and both were 5 cm off."""
    names, x = keypoint_names("mediapipe33"), points("mediapipe33")
    np.savez(tmp_path / "body.npz", keypoints=np.repeat(x, 4, 0), names=names, fps=30.0)
    people = [[image(figure("openpose25"), camera(10))]] * 10
    folder = write_openpose(tmp_path / "cam", people, first=15)
    settings = FitSettings(camera=write_toml(tmp_path / "c.toml", {"cam": camera(10)}),
                           frame_rate=30.0)  # fmt: skip
    clip = load_clip([tmp_path / "body.npz", folder], settings, bundled())
    assert [one.start_time for one in clip.observations] == [0.0, 0.5]
    assert any("number 15: they begin at 0.500 s" in note for note in clip.notes)
    alone = load_clip([folder], settings, bundled())
    assert alone.observations[0].start_time == 0.0

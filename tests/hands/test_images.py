"""Points of hands in files of 2D keypoints, and hands in images that cannot be right."""

import json
from dataclasses import replace

import numpy as np
import pytest
import torch

import recon
from observations.fingers import checked_fingers
from recon.api.hands import with_fingers
from recon.core.camera import pose_looking_at
from recon.core.fingers import FINGER_POINTS
from recon.detections.reader import read_keypoints
from recon.detections.tables import detection_arrays
from recon.formats.observations import KeypointsFile, load_observation, save_observation
from recon.reading.images import keypoints_of
from recon.simulation.images import keypoints2d
from recon.simulation.points import Corruption
from tests.hands.made import Person, hand_points, person
from tests.hands.test_fit import TIPS, views_of

SIDES = ("left", "right")


@pytest.fixture(scope="module")
def somebody() -> Person:
    return person(5, 3)


def cameras(count: int) -> list[recon.Camera]:
    out = []
    for k in range(count):
        angle = torch.tensor(2.1 * k - 1.2)
        place = torch.stack((3 * angle.sin(), -3 * angle.cos(), torch.tensor(1.4)))
        T = pose_looking_at(place, torch.tensor([0.0, 0.0, 1.0]))
        matrix = torch.tensor([[1100.0, 0, 960], [0, 1100.0, 540], [0, 0, 1]])
        out.append(recon.Camera(matrix, (1920, 1080), None, T))
    return out


def filmed(somebody: Person, camera: recon.Camera, layout: str, seed: int = 0) -> KeypointsFile:
    """A view of the body and of its hands, 2 px of noise."""
    motion = somebody.motion.replace(hands=None)
    file = keypoints2d(motion, somebody.body, camera, Corruption(noise=2.0), seed, layout)
    hands = camera.project(somebody.points).pixels.numpy()
    hands = hands + np.random.default_rng(seed).normal(0, 2, hands.shape)
    return replace(file, fingers=np.pad(hands, ((0, 0), (0, 0), (0, 1)), constant_values=0.9))


def as_openpose(file: KeypointsFile, folder) -> None:
    folder.mkdir()
    body = np.concatenate((file.pixels, file.confidence[..., None]), -1)
    for t, (own, hands) in enumerate(zip(body, file.fingers, strict=True)):
        one = {"person_id": [-1], "pose_keypoints_2d": own.ravel().tolist()}
        for k, side in enumerate(SIDES):
            one[f"hand_{side}_keypoints_2d"] = hands[21 * k : 21 * k + 21].ravel().tolist()
        if t == 1:
            one["hand_left_keypoints_2d"] = []
        text = json.dumps(
            {
                "people": [one]
                if t
                else [one | {"hand_left_keypoints_2d": [], "hand_right_keypoints_2d": []}]
            }
        )
        (folder / f"{folder.name}_{t:012d}_keypoints.json").write_text(text)


def as_wholebody(file: KeypointsFile, path) -> None:
    points = np.zeros((len(file.pixels), 133, 3))
    points[:, :23] = np.concatenate((file.pixels, file.confidence[..., None]), -1)
    points[:, 91:] = file.fingers
    frames = [
        {"instances": [{"keypoints": one[:, :2].tolist(), "keypoint_scores": one[:, 2].tolist()}]}
        for one in points
    ]
    path.write_text(json.dumps(frames))


def as_holistic(file: KeypointsFile, path) -> None:
    def landmarks(pixels):
        return [{"x": x / 1920, "y": y / 1080, "z": 0.0} for x, y in pixels.tolist()]

    frames = [
        {"pose_landmarks": landmarks(body), "left_hand_landmarks": landmarks(hands[:21, :2]),
         "right_hand_landmarks": landmarks(hands[21:, :2]) if t != 1 else None}
        for t, (body, hands) in enumerate(zip(file.pixels, file.fingers, strict=True))
    ]  # fmt: skip
    path.write_text(json.dumps(frames))


def test_openpose_with_hands(somebody, tmp_path):
    file = filmed(somebody, cameras(1)[0], "openpose25")
    as_openpose(file, tmp_path / "cam0")
    found = read_keypoints(tmp_path / "cam0")
    assert found.layout == "openpose25"
    assert found.pixels.shape[1] == 25
    assert found.hands[2:] == pytest.approx(file.fingers[2:])
    assert not found.hands[0].any()
    assert not found.hands[1, :21].any()
    assert found.hands[1, 21:] == pytest.approx(file.fingers[1, 21:])


def test_wholebody(somebody, tmp_path):
    file = filmed(somebody, cameras(1)[0], "coco133")
    as_wholebody(file, tmp_path / "cam0.json")
    found = read_keypoints(tmp_path / "cam0.json")
    assert (found.layout, found.pixels.shape[1]) == ("coco133", 23)
    assert found.hands == pytest.approx(file.fingers)


def test_mediapipe_holistic(somebody, tmp_path):
    file = filmed(somebody, cameras(1)[0], "mediapipe33")
    as_holistic(file, tmp_path / "cam0.json")
    found = read_keypoints(tmp_path / "cam0.json", image_size=(1920, 1080))
    assert (found.layout, found.pixels.shape[1]) == ("mediapipe33", 33)
    assert found.hands[..., :2][2:] == pytest.approx(file.fingers[2:, :, :2], abs=1e-6)
    assert not found.hands[1, 21:].any()
    assert (found.hands[2:, :, 2] == 1).all()


def test_arrays_of_body_and_hands_and_what_detect_writes(somebody, tmp_path):
    file = filmed(somebody, cameras(1)[0], "mediapipe33")
    body = np.concatenate((file.pixels, file.confidence[..., None]), -1)
    points = np.concatenate((body, file.fingers), 1)
    np.savez(tmp_path / "a.npz", keypoints=points[..., :2], scores=points[..., 2])
    found = read_keypoints(tmp_path / "a.npz")
    assert found.hands == pytest.approx(file.fingers)
    np.savez(tmp_path / "b.npz", **detection_arrays(found))
    again = read_keypoints(tmp_path / "b.npz")
    assert again.hands == pytest.approx(found.hands)
    assert again.pixels == pytest.approx(found.pixels)
    bad = detection_arrays(found) | {"hands": found.hands[:, None, :5]}
    np.savez(tmp_path / "c.npz", **bad)
    with pytest.raises(recon.FormatError, match="expected hands"):
        read_keypoints(tmp_path / "c.npz")


def test_a_hand_of_another_number_is_refused(tmp_path):
    one = {"pose_keypoints_2d": [5.0, 6.0, 1.0] * 25, "hand_left_keypoints_2d": [1.0] * 60}
    (tmp_path / "a_000000000000_keypoints.json").write_text(json.dumps({"people": [one]}))
    with pytest.raises(recon.FormatError, match="expected 21 keypoints of a hand, got 20 and 0"):
        read_keypoints(tmp_path)


def test_observation_files_keep_them(somebody, tmp_path):
    file = filmed(somebody, cameras(1)[0], "coco133")
    save_observation(tmp_path / "seen.npz", file)
    assert load_observation(tmp_path / "seen.npz").fingers == pytest.approx(file.fingers)
    bent = replace(file.camera, distortion=np.array([0.1, -0.02, 0.001, 0, 0]))
    sensor = keypoints_of(replace(file, camera=bent), somebody.body)
    away = sensor.fingers[0, ..., :2].numpy() - file.fingers[..., :2]
    assert 0.1 < np.linalg.norm(away, axis=-1).max() < 200


@pytest.mark.numerics
@pytest.mark.parametrize("layout", ["openpose25", "coco133"])
def test_fit_of_files_of_three_views(somebody, tmp_path, layout):
    """`recon.fit` of folders of JSON and a calibration gives fingers, without an option."""
    views = cameras(3)
    rows = []
    for k, camera in enumerate(views):
        file = filmed(somebody, camera, layout, k)
        if layout == "openpose25":
            as_openpose(file, tmp_path / f"cam{k}")
        else:
            as_wholebody(file, tmp_path / f"cam{k}.json")
        rows.append(camera)
    ending = "" if layout == "openpose25" else ".json"
    arrays = {
        f"cam{k}": {"K": one.camera_matrix.tolist(), "T": one.T_camera_world.tolist()}
        for k, one in enumerate(rows)
    }
    write_calibration(tmp_path / "Calib.toml", arrays)
    result = recon.fit(
        [tmp_path / f"cam{k}{ending}" for k in range(3)], "pose",
        camera=tmp_path / "Calib.toml", frame_rate=30.0,
    )  # fmt: skip
    assert result.motion.hands is not None
    away = (hand_points(result.motion, somebody.body) - somebody.points).norm(dim=-1)
    tips = away[2:, TIPS] - away[2:, [0, 21]].mean()
    assert float(tips.mean()) < 0.015


def write_calibration(path, arrays) -> None:
    import cv2

    lines = []
    for name, one in arrays.items():
        T = np.array(one["T"])
        rotation = cv2.Rodrigues(T[:3, :3])[0].ravel()
        lines += [
            f"[{name}]", f'name = "{name}"', "size = [1920.0, 1080.0]",
            f"matrix = {one['K']}", "distortions = [0.0, 0.0, 0.0, 0.0]",
            f"rotation = {rotation.tolist()}", f"translation = {T[:3, 3].tolist()}",
            "fisheye = false", "",
        ]  # fmt: skip
    path.write_text("\n".join(lines))


def fingers_of_views(somebody, fault, count=3):
    sensors = views_of(somebody, count)
    sensors = [fault(k, one) for k, one in enumerate(sensors)]
    where = torch.eye(4, dtype=torch.float64)
    alone = somebody.motion.replace(hands=None)
    return with_fingers(alone, somebody.body, sensors, sensors, where)


EXCHANGED = [*range(21, 42), *range(21)]


@pytest.mark.parametrize("views", [(1,), (0, 1, 2)])
def test_hands_exchanged_in_views_are_exchanged_back(somebody, views):
    def fault(k, one):
        return one.derived(fingers=one.fingers[..., EXCHANGED, :]) if k in views else one

    right, _ = fingers_of_views(somebody, lambda _, one: one)
    found, said = fingers_of_views(somebody, fault)
    assert [one.code for one in said.repairs] == ["sides exchanged"]
    assert torch.allclose(right.hands.rotations, found.hands.rotations, atol=1e-5)


def test_hands_exchanged_in_a_single_view(somebody):
    def fault(_, one):
        return one.derived(fingers=one.fingers[..., EXCHANGED, :])

    _, said = fingers_of_views(somebody, fault, 1)
    assert [one.code for one in said.repairs] == ["sides exchanged"]
    assert sum("one view" in one.message for one in said.diagnosis) == 2


@pytest.mark.parametrize(("fault", "says", "count"), [
    ("mirrored", "mirrored", 3), ("elsewhere", "from the wrist", 3),
    ("elsewhere", "from the wrist", 1), ("few", "points are seen", 1),
])  # fmt: skip
def test_bad_hands_in_images_are_said(somebody, fault, says, count):
    """A left hand that is mirrored in space, at the right wrist, or one point alone."""
    points = somebody.points[:, :21].clone()
    if fault == "mirrored":
        palm = points[:, [5, 17]] - points[:, :1]
        normal = torch.linalg.cross(palm[:, 0], palm[:, 1], dim=-1)
        normal = (normal / normal.norm(dim=-1, keepdim=True))[:, None]
        arm = points - points[:, :1]
        points = points - 2 * (arm * normal).sum(-1, keepdim=True) * normal
    elif fault == "elsewhere":
        points = points + somebody.points[:, 21:22] - points[:, :1]

    def spoiled(_, one):
        fingers = one.fingers.clone()
        camera = one.camera.map(lambda x: x[0])
        seen = fingers[0, :, :21, 2:]
        fingers[0, :, :21, :2] = camera.project(points).pixels * seen
        if fault == "few":
            fingers[:, :, 1:21] = 0
        return one.derived(fingers=fingers)

    found, said = fingers_of_views(somebody, spoiled, count)
    bad = [one.message for one in said.warnings if one.code == "hand"]
    assert [one.startswith("left hand") for one in bad] == [True]
    assert says in bad[0]
    if count > 1:
        away = (hand_points(found, somebody.body) - somebody.points).norm(dim=-1)
        assert float(away[:, 21:].mean()) < 0.01


def test_joints_of_openxr(somebody):
    """26 a hand: palm, wrist, four of the thumb, and five of each other finger."""
    hands = torch.full((somebody.motion.frames, 52, 4), torch.nan)
    names = ["palm", "hand_wrist", "thumb1", "thumb2", "thumb3", "thumb_tip"]
    for finger in ("index", "middle", "ring", "pinky"):
        names += ["metacarpal", *(f"{finger}{k}" for k in (1, 2, 3)), f"{finger}_tip"]
    for s, side in enumerate(SIDES):
        for k, name in enumerate(names):
            if f"{side}_{name}" in FINGER_POINTS:
                row = FINGER_POINTS.index(f"{side}_{name}")
                hands[:, 26 * s + k, :3] = somebody.points[:, row]
                hands[:, 26 * s + k, 3] = 1
    found = checked_fingers(hands, somebody.motion.rotations[..., 0], 4)
    assert torch.equal(found[..., :3], somebody.points)
    with pytest.raises(recon.ObservationError, match="OpenXR's 52"):
        checked_fingers(hands[:, :51], somebody.motion.rotations[..., 0], 4)

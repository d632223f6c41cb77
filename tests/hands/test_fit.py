"""Fingers are fitted to points of hands after the body, and bad hands are said."""

import numpy as np
import pytest
import torch

import recon
from observations.correspondences import BodyPoints
from observations.keypoints3d import Keypoints3D
from recon.api.hands import _hands_at_frames, with_fingers
from recon.body.hands import LIMITS, RELAXED, HandModel
from recon.body.identities import identity
from recon.body.motion_files import with_shape
from recon.core import rotations as so3
from recon.core.bone_names import names_of_joints
from recon.core.camera import pose_looking_at as look_at
from recon.core.fingers import FINGER_POINTS, HAND_JOINTS, HAND_PARENTS, ROWS
from recon.core.layouts import LAYOUTS
from recon.core.skeleton import JOINTS
from recon.fitting.hands import HandView, _angle_precision, _FingerProblem
from recon.keypoints3d.labels import _point_of_hand, are_keypoints, split_off_hands
from recon.keypoints3d.reader import read_session
from recon.keypoints3d.records import Points3D
from tests.hands.made import FPS, hand_points, noisy, person, pose_table

TIPS = [k for k, name in enumerate(FINGER_POINTS) if name.endswith("_tip")]


def fitted(somebody, fingers):
    """The fit of fingers after a body whose joints are known, but not how its wrists turn."""
    turned = somebody.motion.rotations.clone()
    turned[:, 20:22] = so3.exp(torch.tensor([0.3, -0.2, 0.4])) @ turned[:, 20:22]
    body_alone = somebody.motion.replace(hands=None, rotations=turned)
    joints = somebody.body.pose(body_alone).joints
    names = [f"{name}_joint" for name in JOINTS]
    shown = torch.ones(joints.shape[:2], dtype=torch.bool)
    sensor = Keypoints3D(joints, shown, names, FPS, fingers=fingers)[None]
    where = torch.eye(4, dtype=torch.float64)
    found, said = with_fingers(body_alone, somebody.body, [sensor], [sensor], where)
    return body_alone, found, said


@pytest.mark.numerics
def test_fingertips_of_noisy_points():
    """1 cm of noise and 30 % missing: tips to 8 mm, joints within limits, the body unchanged."""
    somebody = person(0, 6)
    before, after, said = fitted(somebody, noisy(somebody.points, 0.01, 0.3))
    away = (hand_points(after, somebody.body) - somebody.points).norm(dim=-1)
    assert float(away[:, TIPS].mean()) < 0.008
    moved = somebody.body.pose(after).joints - somebody.body.pose(before).joints
    assert float(moved.abs().max()) < 2e-6
    assert said.warnings == ()
    assert said.repairs == ()


@pytest.mark.slow
@pytest.mark.numerics
def test_forty_poses():
    """With a body fitted to joints that are as noisy and as often missing."""
    somebody = person(0)
    joints = somebody.body.pose(somebody.motion).joints
    seen = noisy(joints, 0.01, 0.3, 1)
    names = [f"{name}_joint" for name in JOINTS]

    def fit(**hands):
        given = recon.Keypoints3D(seen[..., :3], seen[..., 3] > 0, names, FPS, **hands)
        return recon.fit(given, "pose")

    without, found = fit(), fit(fingers=noisy(somebody.points, 0.01, 0.3, 2))
    away = (hand_points(found.motion, somebody.body) - somebody.points).norm(dim=-1)
    assert float(away[:, TIPS].mean()) < 0.008
    assert float((found.joints - without.joints).abs().max()) < 2e-4


def views_of(somebody, count):
    """Cameras about a person, and the points of hands in them with 2 px of noise."""
    cameras = []
    for k in range(count):
        angle = torch.tensor(2.1 * k - 1.2)
        place = torch.stack((3 * angle.sin(), -3 * angle.cos(), torch.tensor(1.4)))
        T = look_at(place, torch.tensor([0.0, 0.0, 1.1]))
        matrix = torch.tensor([[1400.0, 0, 960], [0, 1400.0, 540], [0, 0, 1]])
        cameras.append(recon.Camera(matrix, (1920, 1080), None, T))
    generator, sensors = torch.Generator().manual_seed(9), []
    joints = somebody.body.pose(somebody.motion).joints
    points = BodyPoints.of_layout("smpl22", somebody.body)
    for camera in cameras:
        seen = [camera.project(one).pixels for one in (joints, somebody.points)]
        pixels, hands = (one + 2 * torch.randn(one.shape, generator=generator) for one in seen)
        shown = torch.rand(hands.shape[:-1], generator=generator) > 0.3
        fingers = torch.cat((hands, torch.ones_like(hands[..., :1])), -1) * shown[..., None]
        sensors.append(recon.Keypoints2D(
            pixels, torch.ones(pixels.shape[:-1]), points, camera, FPS, fingers=fingers
        )[None])  # fmt: skip
    return sensors


@pytest.mark.numerics
@pytest.mark.parametrize(("count", "within"), [(3, 0.012), (1, 0.08)])
def test_fingertips_of_views(count, within):
    """2 px of noise, 30 % missing: three views give depth, and of one it is said to be unsure."""
    somebody = person(5, 4)
    sensors = views_of(somebody, count)
    where = torch.eye(4, dtype=torch.float64)
    alone = somebody.motion.replace(hands=None)
    found, said = with_fingers(alone, somebody.body, sensors, sensors, where)
    away = (hand_points(found, somebody.body) - somebody.points).norm(dim=-1)
    assert float(away[:, TIPS].mean()) < within
    assert [("one view" in one.message) for one in said.diagnosis] == [True] * 2 * (count == 1)
    made, fitted = (
        one.unflatten(1, (2, 21)) for one in (somebody.points, hand_points(found, somebody.body))
    )
    off = (fitted - fitted[:, :, :1] - made + made[:, :, :1])[:, :, 4::4].norm(dim=-1).mean((0, 2))
    for one, error in zip(said.diagnosis, off.tolist(), strict=False):
        assert one.value is not None
        assert 0.4 * one.value < error < 1.3 * one.value


@pytest.mark.parametrize("fps", [25.0, 120.0])
def test_points_are_between_frames_at_other_rates(fps):
    """Fingertips of a walker were 17 mm off at 25 Hz: points came from the nearest frame."""
    somebody = person(0, 2)
    frames = somebody.motion.frames
    moved = torch.zeros(frames, 3)
    moved[:, 0] = torch.arange(frames) * 3.0 / FPS  # 3 m/s
    walker = somebody.motion.replace(hands=None, translation=somebody.motion.translation + moved)
    joints = somebody.body.pose(walker).joints
    names = [f"{name}_joint" for name in JOINTS]
    points = somebody.points + moved[:, None]
    hands = torch.cat((points, torch.ones(*points.shape[:2], 1)), -1)
    shown = torch.ones(joints.shape[:2], dtype=torch.bool)
    sensor = Keypoints3D(joints, shown, names, FPS, fingers=hands)[None]
    other = walker.resample(fps)
    seen = _hands_at_frames(other, somebody.body, sensor, sensor, torch.eye(4).double())
    wrists = (seen.values[:, [0, 21]] - somebody.body.pose(other).joints[:, 20:22]).norm(dim=-1)
    there = seen.confidence[:, 0] > 0
    assert there.sum() >= other.frames - fps / FPS
    own = (points[:, [0, 21]] - joints[:, 20:22]).norm(dim=-1)
    assert float(wrists[there].max()) < float(own.max()) + 1e-3


def test_session_with_hands(tmp_path):
    """FreeMoCap writes hands beside the body, millimetres."""
    generator = np.random.default_rng(0)
    parts = {"body": 33, "left_hand": 21, "right_hand": 21}
    arrays = {name: generator.normal(size=(9, count, 3)) for name, count in parts.items()}
    for name, array in arrays.items():
        np.save(tmp_path / f"mediapipe_{name}_3d_xyz.npy", array)
    read = read_session(tmp_path)
    _, hands = split_off_hands(read)
    assert np.array_equal(hands.positions[:, 21:], arrays["right_hand"])


@pytest.mark.parametrize(("label", "point"), [
    ("left_hand_index_finger_mcp", "left_index1"), ("LIndexPIP", "left_index2"),
    ("RIGHT_HAND_THUMB_CMC", "right_thumb1"), ("right_thumb_metacarpal", "right_thumb1"),
    ("left_little_intermediate", "left_pinky2"), ("left_index3", "left_index3"),
    ("left_index_finger_phalanx_distal", "left_index3"), ("r_ring_tip", "right_ring_tip"),
    ("left_hand_wrist", "left_hand_wrist"), ("left_index", None), ("left_wrist", None),
    ("left_index_metacarpal", None), ("nose", None), ("left_hand_root", "left_hand_wrist"),
    ("left_forefinger1", "left_index1"), ("right_middle_finger4", "right_middle_tip"),
    ("LThumb2Knuckles", "left_thumb2"), ("LIndex4FingerTip", "left_index_tip"),
    ("leftHandIndexFingerIntermediateTip", "left_index3"), ("index_01_l", "left_index1"),
    ("leftHandThumbKnuckle", "left_thumb1"), ("left_foot_index", None), ("left_small_toe", None),
    ("left_pinky_finger_third_joint", "left_pinky1"), ("left_index_5", None),
])  # fmt: skip
def test_labels_of_points(label, point):
    assert _point_of_hand(label) == point


@pytest.mark.parametrize("program", names_of_joints())
def test_names_of_exported_finger_bones_are_points(program):
    for joint in HAND_JOINTS:
        assert _point_of_hand(names_of_joints()[program][joint]) == joint


def test_thumbs_of_unity_begin_with_the_proximal_joint():
    """Its metacarpal joint was the second one, and the second was left out."""
    places = ("Proximal", "Intermediate", "Distal")
    names = tuple(f"Left{finger}{place}" for finger in ("Thumb", "Index") for place in places)
    seen = np.arange(6.0)[None, :, None] * np.ones((1, 6, 3))
    points = Points3D("unity", seen, names)
    body, hands = split_off_hands(points)
    assert body.decisions == (
        "6 points of hands, which fingers are fitted to; none of left_middle, left_ring, "
        "left_pinky",
    )
    at = [FINGER_POINTS.index(f"left_{name}") for name in ("thumb1", "thumb2", "thumb3", "index1")]
    assert hands.positions[0, at, 0].tolist() == [0, 1, 2, 3]


def test_labels_with_fingers_are_keypoints():
    """42 points of hands beside those of the body made them a recording of markers."""
    assert are_keypoints((*LAYOUTS["coco17"], *FINGER_POINTS))


def test_tree_is_that_of_smplh():
    assert HAND_JOINTS[:4] == ("left_index1", "left_index2", "left_index3", "left_middle1")
    assert HAND_PARENTS[:4] == (20, 22, 23, 20)
    assert HAND_PARENTS[15] == 21
    assert len(HAND_PARENTS) == 40


def test_poses_are_possible():
    table = np.deg2rad(list(pose_table().values()))
    low, high = LIMITS.unbind(-1)
    assert bool(((low < RELAXED) & (high > RELAXED)).all())
    assert ((table >= low.numpy()) & (table <= high.numpy())).all()


def test_derivative():
    """The gradient of the objective is that of its terms."""
    somebody = person(1, 1)
    model = HandModel.of(somebody.body, somebody.motion.shape)
    generator = torch.Generator().manual_seed(0)

    def drawn(*shape):
        return torch.randn(*shape, generator=generator, dtype=torch.float64)

    turns, place = so3.exp(drawn(5, 3)), drawn(5, 3)
    view = HandView(0.1 * drawn(5, 21, 3) + place[:, None], torch.full((5, 21), 20.0).double())
    problem = _FingerProblem((view,), model, 1, turns, place, 30.0, _angle_precision(), 1.0, 0.01)
    x = 0.3 * drawn(1, 5 * 28 + 20)
    rows = torch.zeros(1, dtype=torch.long)
    own = problem.model(x, rows).gradient
    x.requires_grad_()
    (gradient,) = torch.autograd.grad(problem.value(x, rows).sum(), x)
    assert torch.allclose(own, gradient, atol=1e-6 * float(gradient.abs().max()))


def test_exchanged_hands_are_exchanged_back():
    somebody = person(2, 3)
    fingers = noisy(somebody.points, 0.005, 0.0)
    _, right, _ = fitted(somebody, fingers)
    _, after, said = fitted(somebody, fingers[:, [*range(21, 42), *range(21)]])
    assert [one.code for one in said.repairs] == ["sides exchanged"]
    assert torch.allclose(right.hands.rotations, after.hands.rotations, atol=1e-5)


@pytest.mark.parametrize(("fault", "says"), [
    ("mirrored", "mirrored"), ("elsewhere", "from the wrist"), ("few", "points are seen"),
])  # fmt: skip
def test_bad_hand_is_said_and_left_at_rest(fault, says):
    """A left hand that cannot be right is not fitted; the right one is."""
    somebody = person(3, 3)
    fingers = noisy(somebody.points, 0.005, 0.0)
    left = fingers[:, :21]
    if fault == "mirrored":
        palm = left[:, [5, 17], :3] - left[:, :1, :3]
        normal = torch.linalg.cross(palm[:, 0], palm[:, 1], dim=-1)
        normal = (normal / normal.norm(dim=-1, keepdim=True))[:, None]
        arm = left[..., :3] - left[:, :1, :3]
        left[..., :3] -= 2 * (arm * normal).sum(-1, keepdim=True) * normal
    elif fault == "elsewhere":
        left[..., :3] += fingers[:, 21:22, :3] - left[:, :1, :3]
    else:
        left[:, 1:] = 0
    _, after, said = fitted(somebody, fingers)
    assert [one.code for one in said.warnings] == ["hand"]
    assert said.warnings[0].message.startswith("left hand")
    assert says in said.warnings[0].message
    assert after.hands is not None
    away = (hand_points(after, somebody.body) - somebody.points).norm(dim=-1)
    assert float(away[:, 21:].mean()) < 0.01


def test_files_keep_fingers(tmp_path):
    """Ours and both layouts of AMASS give fingers back; 22 joints alone have none."""
    somebody = person(4, 2)
    path = tmp_path / "motion.npz"
    recon.save_motion(path, somebody.motion)
    read = recon.load_motion(path).motion
    assert torch.allclose(read.hands.rotations, somebody.motion.hands.rotations, atol=1e-5)
    assert torch.equal(read.hands.lengths, somebody.motion.hands.lengths)
    with np.load(path) as file:
        arrays = {key: file[key] for key in file.files}
    assert arrays["poses"].shape[1] == 156
    del arrays["finger_lengths"], arrays["pose_hand"]
    np.savez(path, **arrays)
    smplh = recon.load_motion(path).motion.hands
    face = np.zeros((len(arrays["poses"]), 9))
    poses = np.concatenate((arrays["poses"][:, :66], face, arrays["poses"][:, 66:]), 1)
    np.savez(path, **(arrays | {"poses": poses}))
    smplx = recon.load_motion(path).motion.hands
    assert torch.equal(smplh.rotations, smplx.rotations)
    assert smplh.lengths is None
    np.savez(path, **(arrays | {"poses": arrays["poses"][:, :66]}))
    assert recon.load_motion(path).motion.hands is None


def test_hands_grow_with_the_body():
    """A retargeted person was 14 % taller and had the fingers of before."""
    somebody = person(0, 2)
    tall = identity("height=1.95", somebody.body)
    grown = with_shape(somebody.motion, somebody.body, tall)
    before, after = (HandModel.of(somebody.body, one.shape).lengths
                     for one in (somebody.motion, grown))  # fmt: skip
    assert float(after.mean()) > 1.05 * float(before.mean())
    own = [one.hands and one.hands.lengths for one in (somebody.motion, grown)]
    assert own[0] is not None
    assert own[1] is not None
    ratio = own[1] / own[0]
    torch.testing.assert_close(ratio[ROWS], (after / before).float())


def test_windows_and_rates_keep_fingers():
    motion = person(4, 2).motion
    half = motion.window(3, 13)
    assert torch.equal(half.hands.rotations, motion.hands.rotations[3:13])
    assert torch.allclose(
        half.resample(60.0).hands.rotations[::2], half.hands.rotations, atol=1e-6
    )

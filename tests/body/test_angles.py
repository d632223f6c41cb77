"""Joint angles: known poses, signs on both sides, and an independent computation on recordings."""

from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from recon.body.angles import ISB_ANGLES, isb_angle_derivatives, isb_angles
from recon.body.landmarks import landmark
from recon.body.model import BodyModel
from recon.body.opensim import angles_about_axes, opensim_coordinates
from recon.body.segments import cardan, elevation_angles
from recon.core import rotations as so3
from recon.core.motion import Motion
from recon.core.skeleton import MIRROR, joint_index
from recon.formats.motions import load_motion
from tests.body.angles_beside import angles_by_points, coordinates_by_points


def standing(body: BodyModel, frames: int = 1) -> Motion:
    """The rest pose on its feet: arms to the sides, palms down, facing -y of the world."""
    rotations = torch.eye(3, dtype=torch.float64).repeat(frames, 22, 1, 1)
    rotations[:, 0] = so3.exp(torch.tensor([torch.pi / 2, 0.0, 0.0], dtype=torch.float64))
    shape = torch.zeros(body.shape_size, dtype=torch.float64)
    return Motion.create(torch.zeros(frames, 3, dtype=torch.float64), rotations, shape, 100.0)


def bent(body: BodyModel, joint: str, vector: tuple[float, float, float]) -> Motion:
    """The rest pose in the first frame; in the second a joint is turned about the body's axes.

    Axes of the rest pose: x to the body's left, y up, z forwards; degrees.
    """
    motion = standing(body, 2)
    turn = so3.exp(torch.deg2rad(torch.tensor(vector, dtype=torch.float64)))
    rotations = motion.rotations.clone()
    rotations[1, joint_index(joint)] = turn
    return motion.replace(rotations=rotations)


def change(angles: dict[str, np.ndarray], name: str) -> float:
    return float(angles[name][1] - angles[name][0])


# turns of 20 degrees of a person's left joint, and the angles that grow by about as much
MOVES = (
    ("left_hip", (-20.0, 0.0, 0.0), "hip_flexion_l", "hip_flexion_l", 1.0),
    ("left_hip", (0.0, 0.0, -20.0), "hip_adduction_l", "hip_adduction_l", 1.0),
    ("left_hip", (0.0, -20.0, 0.0), "hip_internal_rotation_l", "hip_rotation_l", 1.0),
    ("left_knee", (20.0, 0.0, 0.0), "knee_flexion_l", "knee_angle_l", 1.0),
    ("left_ankle", (-20.0, 0.0, 0.0), "ankle_dorsiflexion_l", "ankle_angle_l", 0.9),
    ("spine3", (20.0, 0.0, 0.0), "trunk_flexion", "lumbar_extension", -1.0),
    ("spine3", (0.0, 0.0, 20.0), "trunk_right_bending", "lumbar_bending", 1.0),
    ("spine3", (0.0, 20.0, 0.0), "trunk_left_rotation", "lumbar_rotation", 1.0),
    ("left_shoulder", (0.0, 0.0, 20.0), "shoulder_elevation_l", "arm_add_l", -1.0),
    ("left_elbow", (0.0, -20.0, 0.0), "elbow_flexion_l", "elbow_flex_l", 0.95),
    ("left_wrist", (0.0, 0.0, -20.0), "wrist_flexion_l", "wrist_flex_l", 0.9),
)  # fmt: skip


def mirrored(motion: Motion) -> Motion:
    """The same movement of the other side."""
    flip = torch.diag(torch.tensor([-1.0, 1.0, 1.0], dtype=torch.float64))
    rotations = flip @ motion.rotations[:, list(MIRROR)] @ flip
    return motion.replace(rotations=rotations)


def _of_side(name: str, end: str) -> str:
    return name.removesuffix("_l") + end if name.endswith("_l") else name


@pytest.mark.parametrize(("joint", "vector", "isb", "opensim", "share"), MOVES)
def test_a_known_movement_has_the_sign_of_its_name_on_both_sides(
    body, joint, vector, isb, opensim, share
):
    moved = bent(body, joint, vector)
    for motion, end in ((moved, "_l"), (mirrored(moved), "_r")):
        ours = {**isb_angles(motion, body), **opensim_coordinates(motion, body, "rajagopal2016")}
        sign = -1.0 if end == "_r" and isb in ("trunk_right_bending", "trunk_left_rotation") else 1
        assert change(ours, _of_side(isb, end)) == pytest.approx(20.0 * sign, abs=3.0)
        name = _of_side(opensim, end)
        assert change(ours, name) == pytest.approx(20.0 * share * sign, abs=5.0)


def test_the_older_model_bends_the_knee_to_the_other_side(body):
    motion = bent(body, "right_knee", (30.0, 0.0, 0.0))
    new = opensim_coordinates(motion, body, "rajagopal2016")
    old = opensim_coordinates(motion, body, "gait2392")
    assert change(new, "knee_angle_r") == pytest.approx(30.0, abs=0.5)
    assert change(old, "knee_angle_r") == pytest.approx(-30.0, abs=0.5)
    assert np.array_equal(new["knee_angle_r"], new["knee_angle_r_beta"])
    assert "arm_flex_r" not in old


def test_a_person_who_stands_has_small_angles_and_a_pelvis_at_its_spines(body):
    motion = standing(body)
    found = opensim_coordinates(motion, body, "rajagopal2016")
    assert abs(found["pelvis_tilt"][0]) < 1e-6
    assert abs(found["pelvis_list"][0]) < 1e-6
    # our rest pose stands with the legs a little apart
    for name in ("hip_flexion_r", "hip_adduction_l", "knee_angle_r", "ankle_angle_l"):
        assert abs(found[name][0]) < 10.0, name
    assert found["arm_add_r"][0] == pytest.approx(-90.0, abs=10.0)
    # the rest pose has the palms down: halfway between supination and pronation
    assert found["pro_sup_l"][0] == pytest.approx(found["pro_sup_r"][0], abs=1e-3)
    assert 45.0 < found["pro_sup_l"][0] < 135.0
    # the root turns about the pelvis, which is not at the origin
    pelvis = body.rest_joints(motion.shape)[0]
    spines = body.template[[landmark("left_asis"), landmark("right_asis")]].mean(0) - pelvis
    assert found["pelvis_ty"][0] == pytest.approx(float(spines[1] + pelvis[2]), abs=1e-6)


def test_turning_round_changes_the_heading_and_nothing_else(body):
    motion = bent(body, "left_hip", (-30.0, 10.0, 5.0))
    T = torch.eye(4, dtype=torch.float64)
    T[:3, :3] = so3.about_z(torch.tensor(1.1, dtype=torch.float64))
    turned = motion.carried(T, body.rest_joints(motion.shape)[0])
    before, after = isb_angles(motion, body), isb_angles(turned, body)
    for name in before:
        expected = np.rad2deg(1.1) if name == "pelvis_left_rotation" else 0.0
        difference = (after[name] - before[name] - expected + 180) % 360 - 180
        assert np.abs(difference).max() < 1e-6, name


@pytest.mark.parametrize("order", ["ZXY", "YXZ", "XYZ", "ZYX"])
def test_angles_in_sequence_are_the_rotation_and_do_not_jump(order):
    time = np.linspace(0, 6, 240)
    # the middle angle passes through gimbal lock, the first one through a whole turn
    angles = np.stack((2.0 * time, 1.9 * np.sin(time), 0.4 * np.cos(time)), -1)
    r = Rotation.from_euler(order, angles).as_matrix()
    found = cardan(r, order)
    assert np.abs(Rotation.from_euler(order, found).as_matrix() - r).max() < 1e-9
    assert np.abs(np.diff(found, axis=0)).max() < 0.5  # radians per frame
    assert np.abs(found - angles).max() < 1e-6


def test_gimbal_lock_is_the_same_rotation():
    for order in ("ZXY", "XYZ", "YXZ"):
        for middle in (90.0, -90.0):
            r = Rotation.from_euler(order, [[30.0, middle, 40.0]] * 2, degrees=True).as_matrix()
            found = cardan(r, order)
            again = Rotation.from_euler(order, found).as_matrix()
            assert np.abs(again - r).max() < 1e-9, (order, middle)


def test_elevation_is_the_sequence_of_the_shoulder():
    time = np.linspace(0, 4, 100)
    angles = np.stack((0.5 + time, -1.5 - 1.4 * np.sin(time), 0.3 * time), -1)
    r = Rotation.from_euler("YXY", angles).as_matrix()
    found = elevation_angles(r)
    assert np.abs(found - angles * [1, -1, 1]).max() < 1e-9
    for lifted in (0.0, np.pi):
        one = Rotation.from_euler("YXY", [[0.3, -lifted, 0.5]]).as_matrix()
        q1, e, q3 = elevation_angles(one)[0]
        assert np.abs(Rotation.from_euler("YXY", [q1, -e, q3]).as_matrix() - one).max() < 1e-9


def test_two_axes_follow_a_rotation_as_well_as_they_can():
    generator = np.random.default_rng(0)
    axes = ((0.226047, 0.022269, 0.973863), (0.056398, 0.998406, 0.001952))
    wanted = generator.uniform((0, -0.5), (2.4, 1.5), (40, 2))

    def turn(q):
        return Rotation.from_rotvec(np.outer(q[0], axes[0])[0]) * Rotation.from_rotvec(
            np.outer(q[1], axes[1])[0]
        )

    exact = np.stack([turn(q).as_matrix() for q in wanted])
    errors = np.mod(angles_about_axes(exact, axes) - wanted + np.pi, 2 * np.pi) - np.pi
    assert np.abs(errors).max() < 1e-5  # the axes are given to six digits
    off = Rotation.from_rotvec(generator.normal(0, 0.15, (40, 3))).as_matrix() @ exact
    found = angles_about_axes(off, axes)
    for r, q, start in zip(off, found, wanted, strict=True):
        best = minimize(lambda x, r=r: np.square(turn(x).as_matrix() - r).sum(), start)
        reached = np.square(turn(q).as_matrix() - r).sum()
        assert reached <= best.fun + 1e-9


@pytest.fixture(scope="session")
def recordings(data: Path, tmp_path_factory) -> list[Path]:
    """Five recordings of other people and movements, converted."""
    from recon.api.convert import convert

    folder = tmp_path_factory.mktemp("recordings")
    found = []
    for path in five_recordings(data):
        convert(path).save(folder / f"{path.stem}.npz")
        found.append(folder / f"{path.stem}.npz")
    return found


def five_recordings(data: Path) -> list[Path]:
    """Markers of laboratories: a walk, a run, squats, a drop jump, a stand."""
    names = (
        "opensim/rajagopal_walk.trc", "nimblephysics/hamner04_run300.trc",
        "nimblephysics/opencap_s4_squats1.trc", "nimblephysics/opencap_s4_DJ1.trc",
        "nimblephysics/opencap_s4_walking1.trc",
    )  # fmt: skip
    return [data / "observations" / name for name in names]


@pytest.mark.slow
def test_angles_of_recordings_are_those_of_an_independent_computation(recordings, body):
    for path in recordings:
        motion = load_motion(path, torch.float64).motion
        for ours, other in (
            (isb_angles(motion, body), angles_by_points(motion, body)),
            (
                opensim_coordinates(motion, body, "rajagopal2016"),
                coordinates_by_points(motion, body),
            ),
        ):
            assert len(other) >= 23
            for name, values in other.items():
                away = (ours[name] - values + 180) % 360 - 180
                assert np.abs(away).max() < 1.0, (path.name, name)


def test_slopes_are_the_differences_of_angles_that_every_joint_s_turn_makes(body):
    motion = standing(body, 6)
    random = torch.Generator().manual_seed(0)
    bends = 0.3 * torch.randn(22, 3, generator=random).double() + torch.zeros(6, 22, 3)
    motion = motion.replace(rotations=motion.rotations @ so3.exp(bends))
    slopes = isb_angle_derivatives(motion, body).reshape(6, len(ISB_ANGLES), 22, 3)
    here = np.stack(list(isb_angles(motion, body).values()), -1)
    step = 1e-4
    for joint in range(22):
        for axis in range(3):
            turn = torch.zeros(3).double()
            turn[axis] = step
            rotations = motion.rotations.clone()
            rotations[:, joint] = rotations[:, joint] @ so3.exp(turn)
            there = isb_angles(motion.replace(rotations=rotations), body)
            away = np.stack(list(there.values()), -1) - here
            away = (away - 360 * np.round(away / 360)) / step
            assert np.abs(away - slopes[:, :, joint, axis]).max() < 0.5  # of 57 degrees per radian

"""Coordinates of every sensor: what is sure is put right and said, what is not is asked for."""

from dataclasses import replace
from pathlib import Path
from typing import Literal, get_args

import numpy as np
import pytest
import torch

from observations.correspondences import BodyPoints
from recon.body.landmarks import landmark
from recon.body.marker_labels import match_markers
from recon.body.model import BodyModel
from recon.core import rotations as so3
from recon.core.clouds import unit_of_clouds, up_of_clouds
from recon.core.coordinates import inferred_up, unit_of_path
from recon.core.errors import ObservationError, UnitsError
from recon.core.hands import facing_agreement, right_handed_signs
from recon.core.layouts import keypoint_names
from recon.core.skeleton import FEET, JOINTS
from recon.core.units import METRES, Up, to_z_up
from recon.formats.observations import PositionsFile
from recon.ingest.marker_sets import full_body_markers, right_handed_markers
from recon.keypoints3d.records import Points3D
from recon.mocap.reader import read_recording
from recon.mocap.recording import MarkerRecording
from recon.reading.keypoints3d import points_in_metres
from recon.reading.points import positions_in_metres
from recon.simulation.points import Corruption, scan_points
from recon.view.info import info
from tests.walking import a_walk

BODY = BodyModel.load()
SIDED = ("asis", "psis", "acromion", "knee_lateral", "ankle_lateral", "heel", "toe2_base")
SKIN = ("c7", "sternum", *(f"{side}_{one}" for side in ("left", "right") for one in SIDED))
Kind = Literal["joints3d", "markers3d", "keypoints3d"]
MIRROR = np.array([-1.0, 1.0, 1.0])


def walk(kind: Kind) -> PositionsFile:
    """Points of a walk, z up, metres."""
    posed = BODY.pose(a_walk(BODY))
    points = {
        "joints3d": (JOINTS, posed.joints),
        "markers3d": (SKIN, posed.points(torch.tensor([landmark(name) for name in SKIN]))),
        "keypoints3d": (keypoint_names("coco17"), BodyPoints.of_layout("coco17", BODY).of(posed)),
    }
    names, positions = points[kind]
    seen = np.ones(positions.shape[:2], dtype=bool)
    return PositionsFile(kind, positions.double().numpy(), seen, tuple(names), 50.0)


@pytest.mark.parametrize("kind", ["joints3d", "markers3d", "keypoints3d"])
def test_mirrored_points_are_mirrored_back_and_others_are_left(kind: Kind) -> None:
    """People in left-handed coordinates walked backwards, and nothing was said."""
    file = walk(kind)
    kept = positions_in_metres(file, "walk.npz", BODY)
    assert np.array_equal(kept.positions, file.positions)
    assert not kept.decisions
    mirrored = replace(file, positions=file.positions * MIRROR)
    found = positions_in_metres(mirrored, "walk.npz", BODY)
    assert np.array_equal(found.positions, file.positions)
    assert "--hand right" in found.decisions[-1]
    kept = positions_in_metres(mirrored, "walk.npz", BODY, hand="right")
    assert np.array_equal(kept.positions, mirrored.positions)


def test_the_real_recording_of_a_mirrored_walk_is_told(data) -> None:
    """Its labels were taken for exchanged, or its markers lay 15 mm off instead of 6."""
    recording = read_recording(data / "observations" / "bmc" / "walk1.trc").window(0, 40)
    assert isinstance(recording, MarkerRecording)
    markers = full_body_markers(recording, BODY)
    turned = right_handed_markers(recording, markers, None)
    assert np.array_equal(turned.positions, recording.positions * MIRROR)
    assert right_handed_markers(turned, markers, None).decisions == turned.decisions


@pytest.mark.parametrize("up", get_args(Up))
@pytest.mark.parametrize("unit", ["m", "cm", "mm"])
def test_keypoints_of_any_axes_and_unit_are_settled(up: Up, unit: str) -> None:
    file = walk("keypoints3d")
    raw = file.positions @ to_z_up(up) / METRES[unit]
    for flip in (1.0, -1.0):
        points = Points3D("walk.npy", raw * (flip, 1.0, 1.0), file.names, fps=50.0)
        found = points_in_metres(points, BODY)
        apart = np.linalg.norm(found.positions[:, :, None] - found.positions[:, None], axis=-1)
        true = np.linalg.norm(file.positions[:, :, None] - file.positions[:, None], axis=-1)
        assert np.allclose(apart, true, atol=1e-6)
        assert np.allclose(found.positions[..., 2], file.positions[..., 2], atol=1e-6) or flip < 0
        assert facing_agreement(found.names, found.positions, found.visible).mean() > 0.3


@pytest.mark.parametrize("height", [0.4, 0.9])
@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_fractions_of_images_are_no_points_in_space(
    height: float, order: tuple[int, int], tmp_path: Path
) -> None:
    """Small people were to be scaled to metres; those who fill an image were read as metres."""
    x, _, z = np.moveaxis(walk("keypoints3d").positions, -1, 0)
    places = 0.5 + height / np.ptp(z) * np.stack((x - x.mean(), z.mean() - z), -1)
    scores = np.full((*x.shape, 1), 0.9)
    raw = np.concatenate((places[..., list(order)], scores), -1)
    points = Points3D("walk.npy", raw, keypoint_names("coco17"), fps=50.0)
    with pytest.raises(UnitsError, match=r"fractions of an image .*x · width, y · height"):
        points_in_metres(points, BODY)
    advised = np.concatenate((places * (1280, 720), scores), -1)
    np.savez(tmp_path / "walk.npz", keypoints=advised)
    assert info(tmp_path / "walk.npz")["format"] == "2D keypoints of one view"


def test_an_axis_that_a_lying_person_may_have_is_asked_for_and_a_wrong_one_put_right() -> None:
    file = walk("joints3d")
    lying = replace(file, positions=file.positions @ to_z_up("y") + (0.0, 0.0, 1.0))
    with pytest.raises(ObservationError, match="--up y, or --up z if"):
        positions_in_metres(lying, "walk.npz", BODY)
    below = replace(file, positions=file.positions @ to_z_up("z-down"))
    found = positions_in_metres(below, "walk.npz", BODY)
    assert np.allclose(found.positions, file.positions)
    assert "z-down" in found.decisions[0]


@pytest.mark.parametrize("unit", ["m", "cm", "mm"])
def test_the_unit_of_an_estimates_path_is_told_by_feet_that_stand(unit: str) -> None:
    """A path 94 times too long was refined with the feet 86 m above the ground."""
    motion = a_walk(BODY)
    feet = (BODY.pose(motion).joints[:, list(FEET)] - motion.translation[:, None]).double().numpy()
    path = motion.translation.double().numpy() / METRES[unit]
    up = np.array([0.0, 0.0, 1.0])
    assert unit_of_path(path, feet, motion.fps, up, "walk.npz")[0] == unit
    away = path + np.array([50.0, 0.0, 0.0])
    assert unit_of_path(away, feet, motion.fps, up, "walk.npz")[0] == unit
    still = path[:1] + 0 * path + np.array([100.0, 0.0, 0.0])  # was asked for
    stood = feet[:1] + 0 * feet
    assert unit_of_path(still, stood, motion.fps, up, "stand.npz")[0] == unit
    with pytest.raises(UnitsError, match="--unit cm or mm"):
        unit_of_path(still + 500.0, stood, motion.fps, up, "stand.npz")


@pytest.mark.parametrize("up", get_args(Up))
def test_scans_of_a_walker_are_turned_and_scaled(up: Up) -> None:
    """Scans with y up were refused for a ground that nobody saw, those of unit height fitted."""
    motion = a_walk(BODY, speed=0.4)
    for side, sign in (("left_shoulder", -1.2), ("right_shoulder", 1.2)):
        motion.rotations[:, JOINTS.index(side)] = so3.about_z(torch.tensor(sign))
    file = scan_points(motion, BODY, Corruption(), 0, points=400)
    scans = [file.points[file.frame == frame] for frame in range(0, motion.frames, 5)]
    scans = [cloud - cloud.min(0) * (0.0, 0.0, 1.0) for cloud in scans]
    for unit in ("m", "cm", "mm"):
        clouds = [cloud @ to_z_up(up) / METRES[unit] for cloud in scans]
        assert unit_of_clouds(clouds, "scans") == unit
        metres = [cloud * METRES[unit] for cloud in clouds]
        found, said = up_of_clouds(metres, "scans", unit_given=False)
        assert found == up
        assert bool(said) == (up != "z")
    small = [0.55 * (cloud - np.concatenate(metres).mean(0)) for cloud in metres]
    with pytest.raises(UnitsError, match="unit height"):
        up_of_clouds(small, "scans", unit_given=False)
    assert up_of_clouds(small, "scans", unit_given=True)[0] == up


def test_scans_of_who_crouches_have_z_up_where_the_floor_is() -> None:
    """Acrobats whose scans had another axis were laid on the side, as z was 0 now and then."""
    random = np.random.default_rng(0)
    clouds = [
        random.uniform((shift - 0.5, -0.5, 0.0), (shift + 0.5, 0.5, 0.9), (200, 3))
        for shift in np.linspace(0.0, 1.0, 20)
    ]
    assert up_of_clouds(clouds, "scans", unit_given=False) == ("z", ())
    aside = [cloud[:, [1, 2, 0]] for cloud in clouds]
    with pytest.raises(UnitsError, match="--up"):
        up_of_clouds(aside, "scans", unit_given=False)


def test_scans_that_another_axis_explains_as_well_are_asked_for() -> None:
    """Another axis was z, being at 0 by chance; a climber was head down below the floor."""
    random = np.random.default_rng(0)
    lying = [random.uniform((0.0, -0.5, 0.0), (1.5, 0.9, 0.5), (200, 3)) for _ in range(20)]
    with pytest.raises(UnitsError, match="--up"):
        up_of_clouds(lying, "scans", unit_given=False)
    climber = [random.uniform((-0.3, -0.3, 0.9), (0.3, 0.3, 2.3), (200, 3)) for _ in range(20)]
    assert up_of_clouds(climber, "scans", unit_given=False) == ("z", ())
    with pytest.raises(UnitsError, match=r"0.9 m below the origin.*--up"):
        up_of_clouds([-cloud for cloud in climber], "scans", unit_given=False)


def test_no_laboratory_is_mirrored_but_one(data) -> None:
    """Nor is any asked for its axes; `bmc/walk1.trc` has right and left exchanged in space."""
    folder, told = data / "observations", []
    paths = sorted(folder.glob("[b-or]*/*.c3d")) + sorted(folder.glob("[b-or]*/*.trc"))
    for path in paths:
        recording = read_recording(path)
        assert isinstance(recording, MarkerRecording)
        places, _ = match_markers(recording.marker_names)
        names = [places.get(name, "") for name in recording.marker_names]
        if right_handed_signs(names, recording.positions, recording.visible)[1]:
            told.append(path.name)
    assert len(paths) > 50
    assert told == ["walk1.trc"]


def test_who_turns_over_tells_no_axis() -> None:
    """A cartwheel of which the legs were hidden laid the room on its side."""
    angle = np.linspace(0.0, 2 * np.pi, 30)
    trunk = np.stack([np.zeros(30), np.sin(angle), np.cos(angle)], -1)[:, None]
    points = np.concatenate([0 * trunk, trunk], axis=1)
    points[:, 1, 0] += 0.2
    seen = np.ones((30, 2), dtype=bool)
    with pytest.raises(UnitsError, match="--up"):
        inferred_up(("pelvis", "neck"), points, seen, None, "cartwheel")
    assert inferred_up(("pelvis", "neck"), points, seen, "z", "cartwheel")[0] == "z"

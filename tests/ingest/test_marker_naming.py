"""Markers without names get those of a named trial."""

import dataclasses
from collections.abc import Mapping

import numpy as np
import pytest
import torch

import recon
from observations.markers3d import Markers3D
from recon.api.made import MadeMotion
from recon.body.landmarks import landmark
from recon.body.marker_labels import is_nameless, marker_sets
from recon.ingest.marker_unnamed import placed_markers
from recon.mocap.marker_tables import write_trc
from recon.mocap.reader import read_recording
from recon.mocap.recording import MarkerRecording
from tests.verbs import report_of

NAMES = {
    "LFHD": "left_front_head", "RFHD": "right_front_head", "C7": "c7", "STRN": "xiphoid",
    "LSHO": "left_acromion", "RSHO": "right_acromion", "LELB": "left_elbow_lateral",
    "RELB": "right_elbow_lateral", "LWRA": "left_wrist_radial", "RWRA": "right_wrist_radial",
    "LASI": "left_asis", "RASI": "right_asis", "LPSI": "left_psis", "RPSI": "right_psis",
    "LTHI": "left_lower_thigh_lateral", "RTHI": "right_lower_thigh_lateral",
    "LKNE": "left_knee_lateral", "RKNE": "right_knee_lateral", "LTIB": "left_shank_lateral",
    "RTIB": "right_shank_lateral", "LANK": "left_ankle_lateral", "RANK": "right_ankle_lateral",
    "LTOE": "left_toe2_base", "RTOE": "right_toe2_base",
}  # fmt: skip
NAMES_IN_ORDER = list(NAMES)


def trial(frames: slice, names: Mapping[str, str] = NAMES) -> MarkerRecording:
    """Frames of the demo's motion as markers."""
    body = recon.BodyModel.load()
    motion = recon.load_motion(recon.__path__[0] + "/assets/demo.npz").motion
    vertices = torch.tensor([landmark(place) for place in names.values()])
    x = body.pose(motion).points(vertices).double().numpy()[frames]
    fps = float(motion.fps)
    return MarkerRecording("trial.trc", tuple(names), x, np.ones(x.shape[:2], bool), fps, ())


@pytest.mark.parametrize("known", ["cmu", "pig"])
def test_the_usual_set_is_the_one_with_as_many_markers_as_are_seen(known):
    """Toes of 39 markers were named fifth metatarsals, as the set of 41 has four on each foot."""
    true = trial(slice(60, 90), marker_sets()[known])
    numbers = tuple(f"*{k}" for k in range(len(true.marker_names)))
    unnamed = dataclasses.replace(true, marker_names=numbers)
    named, _ = placed_markers(unnamed, recon.BodyModel.load())
    assert set(named.marker_names) == set(true.marker_names)
    assert np.allclose(named.positions, true.select(named.marker_names).positions)


@pytest.mark.numerics
def test_shuffled_markers_with_a_gap_and_a_ghost_get_the_names_of_a_named_trial(tmp_path):
    write_trc(tmp_path / "named.trc", trial(slice(0, 60)))
    true = trial(slice(60, 120))
    order = np.random.default_rng(0).permutation(len(NAMES))
    x, seen = true.positions[:, order], true.visible[:, order].copy()
    seen[20:30, 3] = False
    ghost = np.repeat(x[:1, :1] + [0.4, 0.5, 0.3], len(x), 0)
    unnamed = dataclasses.replace(
        true,
        marker_names=tuple(f"*{k}" for k in range(len(order) + 1)),
        positions=np.concatenate((x, ghost), 1),
        visible=np.concatenate((seen, seen[:, :1] | True), 1),
    )
    found = recon.label(unnamed, like=tmp_path / "named.trc")
    named = found.recording.select(list(NAMES))
    right = (np.abs(named.positions - true.positions) < 1e-9).all(-1) & named.visible
    assert right.sum() >= 0.95 * seen.sum()
    assert right.sum() >= 0.98 * named.visible.sum()
    assert found.recording.visible.sum() == seen.sum() + len(x)
    for out in (tmp_path / "out.trc", tmp_path / "out.csv"):
        found.save(out)
        again = read_recording(out)
        assert set(NAMES) <= set(again.marker_names)
        shown = again.select(list(NAMES))
        assert np.allclose(shown.positions, named.positions, atol=1e-5)
    with pytest.raises(recon.ReconError, match="changed copy of the one"):
        found.save(tmp_path / "out.c3d")


@pytest.mark.numerics
def test_a_set_s_table_names_markers_of_somebody_unknown_who_carries_a_box():
    true = trial(slice(60, 120))
    order = np.random.default_rng(0).permutation(len(NAMES))
    x = true.positions
    wrists = [NAMES_IN_ORDER.index(name) for name in ("LWRA", "RWRA")]
    corners = np.array([[0.3, 0.1, 0.0], [0.3, -0.1, 0.0], [0.5, 0.1, 0.1], [0.5, -0.1, 0.2]])
    box = x[:, wrists].mean(1, keepdims=True) + corners
    unnamed = dataclasses.replace(
        true,
        marker_names=tuple(f"*{k}" for k in range(len(order) + 4)),
        positions=np.concatenate((x[:, order], box), 1),
        visible=np.ones((len(x), len(order) + 4), bool),
    )
    found = recon.label(unnamed, set="pig").recording
    right = 0
    for k, name in enumerate(NAMES):
        if name in found.marker_names:
            column = found.marker_names.index(name)
            same = np.abs(found.positions[:, column] - true.positions[:, k]).max(-1) < 1e-9
            right += int((same & found.visible[:, column]).sum())
    assert right >= 0.85 * true.visible.sum()
    named = found.positions[:, [name in NAMES for name in found.marker_names]]
    assert not any(np.isclose(named, box[:, [k]]).all(-1).any() for k in range(4))
    with pytest.raises(recon.ReconError, match="expected one of the marker sets"):
        recon.label(unnamed, set="vicon")


def joints_within_3_cm(found: MadeMotion, named: MadeMotion) -> float:
    """Share of the frames in which the joints of two conversions are 3 cm apart or less."""
    away = np.linalg.norm(np.asarray(found.joints) - np.asarray(named.joints), axis=-1)
    return float((away.mean(-1) < 0.03).mean())


@pytest.mark.numerics
def test_markers_without_names_are_fitted_with_or_without_a_named_trial(tmp_path):
    """They were refused, with a mapping to write by hand."""
    true = trial(slice(60, 120))
    random, x, seen = np.random.default_rng(0), true.positions.copy(), true.visible.copy()
    for first in range(0, 60, 20):
        order = random.permutation(len(NAMES))
        x[first : first + 20] = x[first : first + 20, order]
    seen[20:30, 3] = False
    unnamed = dataclasses.replace(
        true, marker_names=tuple(f"U_{k}" for k in range(len(NAMES))), positions=x, visible=seen
    )
    named = recon.convert(true)
    free = recon.convert(unnamed)
    assert joints_within_3_cm(free, named) >= 0.9
    assert any("points without names" in said for said in free.about["decisions"])
    write_trc(tmp_path / "named.trc", trial(slice(0, 60)))
    like = recon.convert(unnamed, mapping=tmp_path / "named.trc")
    assert joints_within_3_cm(like, named) >= 0.9
    write_trc(tmp_path / "unnamed.trc", unnamed)
    sensor = recon.load_observation(tmp_path / "unnamed.trc")
    assert isinstance(sensor, Markers3D)
    assert sensor.labels is not None
    assert set(sensor.labels) <= set(marker_sets()["pig"])


def without_names(x: np.ndarray) -> MarkerRecording:
    """A recording of unnamed points that are always seen."""
    names = tuple(f"*{k}" for k in range(x.shape[1]))
    return MarkerRecording("cloud.trc", names, x, np.ones(x.shape[:2], bool), 30.0, ())


@pytest.mark.numerics
@pytest.mark.parametrize("what", ["millimetres", "upside down", "five markers"])
def test_points_that_are_no_upright_person_get_no_names(what):
    x = trial(slice(60, 90)).positions
    cloud = {
        "millimetres": 1000 * x,
        "upside down": x * [1, -1, -1],
        "five markers": x[:, :5],
    }[what]
    with pytest.raises(recon.ReconError, match="in no frame"):
        recon.label(without_names(cloud), like=trial(slice(0, 60)))
    with pytest.raises(recon.ReconError, match=r"in no frame|not to be believed"):
        recon.convert(without_names(cloud))


@pytest.mark.numerics
def test_of_two_people_one_is_named_and_the_other_stays_open():
    x = trial(slice(60, 90)).positions
    other = x[::-1] + np.array([1.5, 0.4, 0.0])
    found = recon.label(without_names(np.concatenate((x, other), 1)), like=trial(slice(0, 60)))
    named = found.recording.select(list(found.confidence))
    one = [NAMES_IN_ORDER.index(name) for name in named.marker_names]
    right = [np.abs(named.positions - own[:, one]).max(-1) < 1e-9 for own in (x, other)]
    assert max(same.sum() for same in right) >= 0.95 * x[..., 0].size
    assert any("without a name" in said for said in found.warnings)
    assert any("other names may be wrong" in said for said in found.warnings)


@pytest.mark.numerics
def test_outputs_of_a_model_keep_their_names_in_a_trial_named_like_itself():
    """Joint centres and the like were called *1, *2, ... in the copy."""
    true = trial(slice(0, 60))
    outputs = {"LHJC": true.positions[:, [10]] - [0.0, 0.0, 0.08], "LFEO": true.positions[:, [14]]}
    x = np.concatenate((true.positions, *outputs.values(), true.positions[:, :1] + 0.5), 1)
    a, b = NAMES_IN_ORDER.index("LKNE"), NAMES_IN_ORDER.index("RKNE")
    x[20:35, [a, b]] = x[20:35, [b, a]]
    names = (*NAMES, *outputs, "*7")
    given = dataclasses.replace(
        true, marker_names=names, positions=x, visible=np.ones(x.shape[:2], bool)
    )
    found = recon.label(given, like=given)
    assert found.recording.marker_names == (*NAMES, *outputs, "*1")
    kept = found.recording.select(list(outputs))
    assert kept.visible.all()
    assert np.array_equal(kept.positions, np.concatenate([*outputs.values()], 1))
    mended = found.recording.select(["LKNE"])
    assert np.array_equal(mended.positions[:, 0], true.positions[:, a])
    assert any("30 points" in said for said in found.warnings)


@pytest.mark.parametrize(
    ("label", "nameless"),
    [("*12", True), ("U_1", True), ("C_12", True), ("unlabeled-12", True), ("Unlabeled 7", True),
     ("", True), ("Ann:*3", True), ("Trajectory 3", True), ("12", True), ("New 0001", True),
     ("C7", False), ("T10", False), ("LASI", False), ("Ann:LTOE", False), ("ULNA", False)],
)  # fmt: skip
def test_labels_that_say_nothing(label, nameless):
    assert is_nameless(label) == nameless


def test_trials_without_names_are_refused(tmp_path):
    nameless = dataclasses.replace(
        trial(slice(0, 20)), marker_names=tuple(f"*{k}" for k in range(len(NAMES)))
    )
    write_trc(tmp_path / "trial.trc", nameless)
    with pytest.raises(recon.ReconError, match="--like"):
        recon.label(nameless)
    with pytest.raises(recon.ReconError, match="got 0"):
        recon.label(nameless, like=tmp_path / "trial.trc")


def test_the_command_line_names_a_file_as_another(tmp_path):
    """The command failed with a KeyError: it looked for an option that only `convert` has."""
    for name, part in (("named", slice(0, 60)), ("trial", slice(60, 120))):
        write_trc(tmp_path / f"{name}.trc", trial(part))
    said = report_of(
        "label", tmp_path / "out.trc", recording=tmp_path / "trial.trc",
        like=tmp_path / "named.trc", unit=None, up=None, json=False, overwrite=False,
    )  # fmt: skip
    assert said["named"] > 0.95
    assert set(said["confidence"]) == set(NAMES)

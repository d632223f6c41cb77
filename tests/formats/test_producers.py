"""Every producer's files are known, and four verbs give one answer to each of them."""

import json
import re
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch

import recon
from observations.keypoints3d import Keypoints3D
from recon.core.layouts import keypoint_names
from recon.core.units import to_z_up
from recon.detections.reader import read_keypoints
from recon.fitting.settings import FitSettings
from recon.formats.estimates import read_estimate
from recon.formats.producers import (
    BODIES,
    MARKERS,
    PRODUCERS,
    Producer,
    holds_estimated_bodies,
    producer_of,
)
from recon.formats.scans import read_scans
from recon.keypoints3d.labels import keypoints_of_labels
from recon.keypoints3d.layouts import MHR70, ZED38
from recon.keypoints3d.reader import holds_points_3d, read_points_3d
from recon.mocap.reader import read_recording
from recon.mocap.recording import MarkerRecording
from recon.reading.clip import load_clip
from recon.view.info import info
from tests.filmed import bundled, walk
from tests.formats.producer_files import FRAMES, SAMPLES, of_labels, points

VERBS: dict[str, Callable[[Path], object]] = {
    "info": info, "fit": recon.fit, "refine": recon.refine, "convert": recon.convert,
}  # fmt: skip


def _key(one: Producer) -> tuple[str, str, str]:
    return one.name, one.holds, one.endings[0]


every = pytest.mark.parametrize("producer", PRODUCERS, ids=lambda one: "-".join(_key(one)))


def test_the_table_is_complete():
    assert [_key(one) for one in PRODUCERS] == list(SAMPLES)


@every
def test_the_four_verbs_give_one_answer(tmp_path, producer):
    """One file had three answers, some of them untrue ("all frames are empty")."""
    path = SAMPLES[_key(producer)](tmp_path)
    assert producer_of(path) == producer
    answers = {}
    for name, verb in VERBS.items():
        if name in producer.verbs or (name == "info" and producer.verbs):
            continue
        begun = time.perf_counter()
        with pytest.raises(recon.ReconError) as refused:
            verb(path)
        assert time.perf_counter() - begun < 0.5
        answers[name] = str(refused.value)
    assert set(answers.values()) <= {f"{path}: {producer.how_to_read()}"}
    assert producer.verbs or producer.note in producer.how_to_read()


@every
def test_the_verbs_that_are_named_take_it(tmp_path, producer):
    path = SAMPLES[_key(producer)](tmp_path)
    if producer.verbs and producer.holds != "a body model":
        assert info(path)["producer"] == producer.name
    for verb in producer.verbs:
        match verb:
            case "convert":
                assert read_recording(path).frames > 0
            case "refine" if holds_estimated_bodies([path]) and producer.name != "SAM 3D Body":
                assert len(read_estimate(path).translation) > 0
            case "fit" if producer.holds == "2D keypoints":
                assert not holds_points_3d(path)
                assert len(read_keypoints(path, image_size=(640, 480)).frame) > 0
            case "fit" if producer.name == "SAM 3D Body":
                assert holds_points_3d(path)
                assert len(read_points_3d(path).positions) > 0
            case "fit" if producer.holds == "a film":
                with pytest.raises(recon.FormatError, match="nobody was found"):
                    load_clip([path], FitSettings(), bundled())
            case "fit" if not holds_estimated_bodies([path]):
                assert load_clip([path], FitSettings(frame_rate=30.0), bundled()).observations
            case _:
                assert verb in ("info", "refine", "fit", "detect")


@pytest.mark.parametrize(
    "producer",
    [one for one in PRODUCERS if one.form or one.verbs],
    ids=lambda one: "-".join(_key(one)),
)
def test_the_manual_has_its_row(producer):
    manual = Path(__file__).parents[2] / "docs" / "files.md"
    assert row(producer) in manual.read_text(encoding="utf-8").splitlines()


def row(one: Producer) -> str:
    """The producer in the manual's table."""
    what = f"{one.name}: {one.holds}" if one.name else one.holds
    verbs = ", ".join(f"`{verb}`" for verb in one.verbs) or "none"
    return f"| {what} | {one.form} | {verbs} | {one.note} |"


def _of(name: str, holds: str) -> Callable[[Path], Path]:
    return next(write for key, write in SAMPLES.items() if key[:2] == (name, holds))


@pytest.mark.parametrize(
    ("name", "layout", "unit", "metres"),
    [
        ("EasyMocap", "openpose25", "m", 2e-3),
        ("OpenPose", "openpose25", "m", 2e-3),
        ("MMPose", "h36m17", "m", 2e-3),
        ("ZED", ZED38, "m", 2e-3),
        ("AIST++", "coco17", "cm", 2e-3),
        ("NTU RGB+D", "kinect25", "m", 2e-3),
    ],
)
def test_keypoints_in_space_are_where_they_were(tmp_path, name, layout, unit, metres):
    """Their files were called empty of 2D keypoints."""
    path = _of(name, "3D keypoints")(tmp_path)
    (seen,) = load_clip([path], FitSettings(frame_rate=30.0, unit=unit), bundled()).observations
    assert isinstance(seen, Keypoints3D)
    truth = points(layout) if isinstance(layout, str) else of_labels(layout)
    names = keypoint_names(layout) if isinstance(layout, str) else keypoints_of_labels(layout)
    rows = [names.index(one) for one in seen.point_names(bundled())]
    found, visible = seen.positions[0].numpy(), seen.visible[0].numpy()
    if name == "OpenPose":  # in its camera
        truth = truth @ to_z_up("y-down") + (0, 0, 4)
        truth = truth @ to_z_up("y-down").T
    elif name == "NTU RGB+D":  # in its sensor's axes, y up
        truth = (truth @ to_z_up("y") + (0, -0.9, 3)) @ to_z_up("y").T
    away = np.linalg.norm(found - truth[:, rows], axis=-1)
    assert away[visible].max() < metres
    assert len(found) == FRAMES
    assert visible.mean() > 0.85
    if name == "NTU RGB+D":
        assert not visible[:, rows.index(7)].any()


def test_a_second_person_can_be_asked_for(tmp_path):
    path = _of("EasyMocap", "3D keypoints")(tmp_path)
    one, two = (read_points_3d(path, person=k).positions for k in range(2))
    shift = two - one
    assert np.nanmax(np.abs(shift - (2, 0, 0))) < 1e-9
    assert np.isfinite(shift).mean() > 0.85


def test_points_of_longer_layouts_are_named_by_their_number(tmp_path):
    """133 points, those of a face left out, and the 70 of SAM 3D Body, were no layout."""
    whole = np.concatenate((points("coco133"), np.ones((FRAMES, 110, 3))), 1)
    for x, kept in ((whole, 65), (of_labels(MHR70), 70), (of_labels(ZED38), 38)):
        np.save(tmp_path / "x.npy", x)
        assert read_points_3d(tmp_path / "x.npy").positions.shape[1] == kept
        seen = load_clip([tmp_path / "x.npy"], FitSettings(frame_rate=30.0), bundled())
        assert seen.observations[0].kind == "keypoints3d"


@pytest.mark.parametrize("name", ["TRAM", "AIST++", "WHAM", "PHALP (4D-Humans)", "GVHMR"])
def test_body_parameters_are_what_they_were(tmp_path, name):
    """A dictionary in an .npy file was refused, and AIST++'s unit put feet 86 m high."""
    found = read_estimate(_of(name, BODIES)(tmp_path))
    truth = walk(FRAMES)
    np.testing.assert_allclose(found.rotations, truth.rotations.numpy(), atol=1e-5)
    if not name.startswith("PHALP"):
        np.testing.assert_allclose(found.translation, truth.translation.numpy(), atol=1e-5)


@pytest.mark.parametrize("verb", [info, recon.fit, recon.refine])
def test_of_a_folder_of_separate_files_one_is_asked_for(tmp_path, verb):
    _of("TRAM", BODIES)(tmp_path)
    with pytest.raises(recon.ReconError, match=r"one of its files; .* TRAM: `recon refine`"):
        verb(tmp_path)


@pytest.mark.parametrize("read", [info, recon.read])
def test_a_folder_around_keypoints_in_space_is_no_folder_of_views(tmp_path, read):
    """It was said to hold no 2D keypoints in a form that is known."""
    folder = SAMPLES["EasyMocap", "3D keypoints", ".json"](tmp_path)
    with pytest.raises(ValueError, match=r"keypoints3d holds .* in space \(EasyMocap\); give"):
        read(folder.parent)


def test_views_whose_files_have_points_in_space_too_are_views(tmp_path):
    """Two folders of MediaPipe's landmarks in the image and in space were refused."""
    row = {"x": 0.4, "y": 0.3, "z": 0.0, "visibility": 0.9}
    rows = [{**row, "y": 0.3 + 0.01 * k} for k in range(33)]
    frame = json.dumps({"pose_landmarks": rows, "pose_world_landmarks": rows})
    for name in ("cam1", "cam2"):
        (tmp_path / name).mkdir()
        for k in range(3):
            (tmp_path / name / f"{k:04d}.json").write_text(frame)
    assert info(tmp_path)["format"] == "2D keypoints of 2 views"


def test_a_tensor_that_repeats_its_numbers_is_refused(tmp_path):
    wide = torch.zeros(1).expand(10**9)
    np.save(tmp_path / "a.npy", np.array({"pred_rotmat": wide}, dtype=object), allow_pickle=True)
    with pytest.raises(recon.ReconError, match="a tensor of"):
        read_estimate(tmp_path / "a.npy")


def test_vertices_of_obj_files_are_scans(tmp_path):
    folder = SAMPLES["", "scans", ".obj"](tmp_path)
    found = read_scans(folder, fps=30.0, outliers=None)
    np.testing.assert_allclose(found.points, of_labels(MHR70).reshape(-1, 3), atol=1e-4)
    (folder / "0003.obj").write_text("v 1 2\nv 1 2 3\n")
    with pytest.raises(ValueError, match=r"0003\.obj: damaged OBJ file"):
        read_scans(folder, fps=30.0)


@pytest.mark.parametrize("name", ["OptiTrack Motive", "Qualisys"])
def test_tables_of_markers_are_recordings(tmp_path, name):
    """Motive's was taken for DeepLabCut's, or refused as no recording."""
    path = _of(name, MARKERS)(tmp_path)
    found = read_recording(path)
    assert isinstance(found, MarkerRecording)
    truth = of_labels([label.removeprefix("A:") for label in found.marker_names])
    assert found.fps == 30.0
    assert found.visible.sum() == found.visible.size - 1
    away = np.linalg.norm(found.positions - truth, axis=-1)
    assert away[found.visible].max() < 1e-4
    text = path.read_text()
    path.write_text(text[: text.index("Name" if name[0] == "O" else "MARKER_NAMES") - 10])
    with pytest.raises(recon.ReconError, match="expected"):
        read_recording(path)


def test_qualisys_tables_may_have_decimal_commas(tmp_path):
    path = _of("Qualisys", MARKERS)(tmp_path)
    plain = read_recording(path)
    head, label, rows = path.read_text().partition("MARKER_NAMES")
    path.write_text(head.replace("\t30", "\t30,0") + label + rows.replace(".", ","))
    found = read_recording(path)
    assert np.array_equal(found.positions, plain.positions)
    assert found.fps == 30.0


def test_a_skeleton_file_that_is_cut_short_is_refused(tmp_path):
    path = _of("NTU RGB+D", "3D keypoints")(tmp_path)
    path.write_text(path.read_text()[:4000])
    with pytest.raises(recon.ReconError, match=r"frame 2 is cut short"):
        read_points_3d(path)


HOSTILE = (
    b'"keypoints":' + b" " * (1 << 16), b'"keypoints":[1,' * 5000, b"frame_idx," * 7000,
    b"smpl" * (1 << 15), b"poses" * (1 << 15), b"pose_body\n" * (1 << 14),
    b"scorer\ncoords,,," * 5000,
    b"[{" * (1 << 15), b"\ncoords" + b"," * (1 << 16), b" " * (1 << 16),
)  # fmt: skip


@pytest.mark.parametrize("head", HOSTILE, ids=lambda head: str(head[:12]))
def test_files_are_looked_at_in_a_time_that_grows_with_their_size(head):
    begun = time.perf_counter()
    for producer in PRODUCERS:
        re.search(producer.pattern, head)
    assert time.perf_counter() - begun < 2.0

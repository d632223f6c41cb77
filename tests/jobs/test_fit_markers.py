"""`recon fit` of a laboratory's file: markers on the skin, gaps, an arm that nobody saw."""

import json
import runpy
from pathlib import Path

import numpy as np
import pytest

from recon.cli.looks import refuse_unknown_markers
from recon.core.skeleton import joint_index
from recon.fitting.settings import FitSettings
from recon.formats.motions import load_motion
from recon.mocap.marker_tables import write_trc
from recon.mocap.reader import read_recording
from recon.mocap.recording import MarkerRecording
from recon.reading.inputs import input_checksums, settings_checksum
from tests.documents.blocks import ROOT
from tests.verbs import fit_files

ARM = ("LUPA", "LELB", "LWRA", "LWRB", "LFIN")


@pytest.fixture(scope="module")
def trial(tmp_path_factory: pytest.TempPathFactory) -> MarkerRecording:
    pytest.importorskip("ezc3d")
    path = tmp_path_factory.mktemp("laboratory") / "trial.c3d"
    runpy.run_path(str(ROOT / "examples" / "05_c3d.py"))["written"](path)
    found = read_recording(path)
    assert isinstance(found, MarkerRecording)
    return found


def spoiled(trial: MarkerRecording) -> MarkerRecording:
    """From 2 s on, nothing in the first three frames, a gap, and no marker on the left arm."""
    from dataclasses import replace

    visible = trial.visible.copy()
    visible[:3] = False
    visible[12:20, trial.marker_names.index("RANK")] = False
    visible[:, [trial.marker_names.index(name) for name in ARM]] = False
    return replace(trial, visible=visible, start_time=2.0)


def test_markers_of_a_laboratory_are_fitted(trial: MarkerRecording, tmp_path: Path) -> None:
    """They were refused with the advice to convert them, which fills nothing."""
    write_trc(tmp_path / "trial.trc", spoiled(trial))
    report = fit_files([tmp_path / "trial.trc"], tmp_path / "m.npz", FitSettings(prior="pose"))
    said = " ".join(report["read"])
    assert "markers used" in said
    assert "the first 3 of 30 frames" in said
    assert "RANK" in report["residuals"][0]["by_point"]
    file = load_motion(tmp_path / "m.npz")
    assert file.motion.start_time == pytest.approx(2.1)
    assert file.motion.frames == 27
    assert file.observed is not None
    assert not file.observed[:, joint_index("left_wrist")].any()
    assert file.observed[:, joint_index("right_wrist")].all()
    assert file.joints is not None
    ankle = file.joints[:, joint_index("right_ankle")].numpy()
    marker = trial.positions[3:, trial.marker_names.index("RANK")]
    assert np.linalg.norm(ankle - marker, axis=-1)[9:17].max() < 0.10  # m, within the gap
    shoulder, elbow = (file.joints[:, joint_index(f"left_{j}")] for j in ("shoulder", "elbow"))
    down = (shoulder - elbow)[:, 2] / (shoulder - elbow).norm(dim=-1)
    assert down.min() > 0.5  # no T-pose


def test_a_mapping_counts_in_checksums(trial: MarkerRecording, tmp_path: Path) -> None:
    """A batch would have kept results of markers that were mapped otherwise."""
    path = tmp_path / "names.json"
    path.write_text(json.dumps({"C7": "c7"}))
    write_trc(tmp_path / "trial.trc", trial)
    settings = FitSettings(mapping=path)
    before = settings_checksum(settings, 1)
    assert str(path) in input_checksums(vars(settings))
    path.write_text(json.dumps({"C7": "t2"}))
    assert settings_checksum(settings, 1) != before
    assert settings_checksum(FitSettings(), 1) != before


def test_unnamed_markers_are_refused_at_a_look(trial: MarkerRecording, tmp_path: Path) -> None:
    from dataclasses import replace

    path = tmp_path / "unnamed.trc"
    names = tuple(f"Channel{k}" for k in range(len(trial.marker_names)))
    write_trc(path, replace(trial, marker_names=names))
    with pytest.raises(ValueError, match=r'got 0 \(none\).*\{"Channel0": "LANDMARK"'):
        refuse_unknown_markers([path], None, None)
    refuse_unknown_markers([path], tmp_path / "names.json", None)
    write_trc(path, trial)
    refuse_unknown_markers([path, tmp_path / "none.c3d", tmp_path], None, None)

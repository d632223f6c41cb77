"""The laboratory report: a page that needs nothing, a table beside it, and what it refuses."""

import csv
import io
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

import recon
from recon import cli
from recon.api.result import motion_file_of
from recon.body.angles import ISB_ANGLES
from recon.body.motion_files import load_motion_of
from recon.formats.reports import report_text
from recon.gait.analysis import CURVES
from recon.gait.laboratory import LaboratoryReport
from recon.gait.report import report_file

DEMO = Path(recon.__file__).parent / "assets" / "demo.npz"


@pytest.fixture(scope="module")
def found() -> LaboratoryReport:
    return recon.report(DEMO)


@pytest.fixture(scope="module")
def page(found) -> str:
    pytest.importorskip("matplotlib")
    return found.page()


def test_the_page_shows_everything_and_loads_nothing(page):
    assert all(curve.title in page for curve in CURVES)
    assert "cadence (steps/min)" in page
    assert page.count("<svg") == 2  # steps and cycles; no residuals are known of the demo
    assert "Not known: no report" in page
    for loading in ("src=", "<link", "@import", "url(http"):
        assert loading not in page


def test_the_same_report_is_the_same_page(found, page):
    assert found.page() == page


def test_the_table_has_every_number(found):
    rows = list(csv.DictReader(io.StringIO(found.table())))
    kinds = {kind: [row for row in rows if row["kind"] == kind] for kind in
             ("figure", "event", "cycle", "angle")}  # fmt: skip
    assert len(kinds["angle"]) == len(CURVES) * 101 * len(found.gait.cycles)
    assert len(kinds["figure"]) == len(found.gait.figures)
    first = [row for row in kinds["angle"] if row["side"] == "left" and row["cycle"] == "1"]
    knee = [row for row in first if row["name"] == "Knee flexion"]
    curve = next(curve for curve in CURVES if curve.name == "knee_flexion")
    np.testing.assert_allclose(
        [float(row["value"]) for row in knee], found.gait.curves(curve, "left")[0], rtol=1e-4,
        atol=1e-4,
    )  # fmt: skip
    marked = sum((one.strike is not None) + (one.off is not None) for one in found.gait.stances)
    assert len(kinds["event"]) == marked


def test_it_prints_in_ten_lines(found):
    assert len(repr(found).splitlines()) <= 10
    assert "cadence" in repr(found)


def test_standard_deviations_of_a_fit_are_bands():
    pytest.importorskip("matplotlib")
    body = recon.BodyModel.load()
    motion = load_motion_of(DEMO, body).motion
    std = torch.full((motion.frames, len(ISB_ANGLES)), 2.0)
    file = motion_file_of(motion, body, angle_std=std)
    sure = recon.report(file)
    assert sure.gait.angle_std["knee_flexion_l"].mean() == pytest.approx(2.0)
    assert "SD of the fit" in sure.page()
    rows = csv.DictReader(io.StringIO(sure.table()))
    assert {row["std"] for row in rows if row["kind"] == "angle"} == {"2"}


def test_a_motion_without_steps_has_angles_along_time():
    """Arrays of no cycles once could not be shaped."""
    pytest.importorskip("matplotlib")
    body = recon.BodyModel.load()
    still = load_motion_of(DEMO, body).motion.window(0, 20)
    shown = recon.report(still)
    assert shown.gait.cycles == ()
    assert "There is no complete cycle of gait" in shown.page()
    assert "time (s)" in shown.page()


def test_strides_backwards_are_a_warning(found):
    """A stance of 90 % of the cycle was reported of a walk that was played backwards."""
    walk = load_motion_of(DEMO, recon.BodyModel.load()).motion
    played = {"translation": walk.translation.flip(0), "rotations": walk.rotations.flip(0)}
    backward = recon.report(walk.replace(**played))
    count = len(backward.gait.cycles)
    assert count > 0
    assert backward.warnings[0].startswith(f"{count} of {count} strides go backwards")
    assert found.warnings == ()


def test_what_a_conversion_said_stands_on_the_page(tmp_path):
    pytest.importorskip("matplotlib")
    body = recon.BodyModel.load()
    motion = load_motion_of(DEMO, body)
    recon.save_motion(tmp_path / "walk.npz", motion.motion)
    beside = tmp_path / "walk.npz.json"
    said = {
        "residuals_mm": {"LASI": 12.5, "$^{$": 9.0},
        "decisions": ["unit mm"],
        "warnings": [{"code": "swap", "message": "labels <exchanged>"}],
        "diagnosis": [{"code": "residual", "message": "LASI: 12.5 mm on average"}],
    }
    beside.write_text(report_text(said, {}, {}))
    shown = recon.report(tmp_path / "walk.npz")
    assert shown.residuals[0].values == {"LASI": 12.5, "$^{$": 9.0}
    assert shown.notes == ()
    page = shown.page()
    assert "labels &lt;exchanged&gt;" in page
    assert "unit mm" in page
    assert page.count("<svg") == 3
    beside.write_text(beside.read_text().replace("12.5", "13.5"))
    foreign = recon.report(tmp_path / "walk.npz")
    assert foreign.residuals == ()
    assert "not as recon wrote it" in foreign.warnings[0]


def test_the_command_writes_page_table_and_reports(tmp_path):
    pytest.importorskip("matplotlib")
    out = tmp_path / "gait.html"
    assert cli.run(["report", str(DEMO), "--out", str(out)]) in (None, 0)
    names = sorted(path.name for path in tmp_path.iterdir())
    assert names == ["gait.csv", "gait.csv.json", "gait.html", "gait.html.json"]
    (tmp_path / "gait.csv").write_text("somebody's")
    with pytest.raises(FileExistsError, match="overwrite"):
        recon.report(DEMO).save(out)


def test_trials_whose_names_have_dots_get_pages_of_their_own(tmp_path, monkeypatch, found):
    pytest.importorskip("matplotlib")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("recon.gait.report.report", lambda *_, **__: found)
    for name in ("walk.1.npz", "walk.2.npz", "run.bvh.xz", "all.mat"):
        (tmp_path / name).touch()
        report_file(Path(name if name != "all.mat" else "all.mat::jump"))
    pages = sorted(path.name for path in tmp_path.glob("*.html"))
    assert pages == ["jump.html", "run.html", "walk.1.html", "walk.2.html"]


def test_without_matplotlib_it_says_what_to_install(found, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(recon.ReconError, match=r"motion-recon\[report\]"):
        found.page()


def test_what_is_no_motion_is_refused(tmp_path, found):
    np.savez(tmp_path / "seen.npz", kind="joints3d", positions=np.zeros((4, 22, 3)))
    with pytest.raises(recon.FormatError, match="recon fit"):
        recon.report(tmp_path / "seen.npz")
    with pytest.raises(recon.FormatError, match="are options for recordings"):
        recon.report(DEMO, unit="mm")
    with pytest.raises(ValueError, match="would both be written"):
        found.save(tmp_path / "gait.csv")

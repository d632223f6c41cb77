"""Files for OpenSim: markers and coordinates as a strict reader of its formats takes them."""

import json
import os
from pathlib import Path

import numpy as np
import pytest
import torch

from recon import cli
from recon.body.landmarks import landmark, landmarks
from recon.body.model import BodyModel
from recon.core import rotations as so3
from recon.core.motion import Motion, MotionFile
from recon.export.tables import body_places_of_markers, recorded_markers
from recon.formats.motions import save_motion
from recon.mocap.marker_tables import read_trc
from tests.standing_body import path, standing, times


def words(text: str) -> list[str]:
    return text.split()


# as published: Pose2Sim's Markers_Halpe26.xml, Markers_LSTM.xml and Markers_SKEL.xml
HALPE_OF_POSE2SIM = words(
    "Hip RHip RKnee RAnkle RBigToe RSmallToe RHeel LHip LKnee LAnkle LBigToe LSmallToe LHeel "
    "Neck Head Nose RShoulder RElbow RWrist LShoulder LElbow LWrist"
)
OF_EACH_SIDE = words(
    "knee mknee ankle mankle toe 5meta calc shoulder lelbow melbow lwrist mwrist thigh1 thigh2 "
    "thigh3 sh1 sh2 sh3"
)
OPENCAP = {
    *(f"{side}.{name}_study" for side in "rL" for name in ("ASIS", "PSIS")),
    *(f"{side}_{name}_study" for side in "rL" for name in OF_EACH_SIDE),
    *("C7_study", "RHJC_study", "LHJC_study"),
}
BSM = {
    *words("BLTI BRTI C7 CHIN CLAV FBBT FLTI FRBT FRTI LUMB LUMC NOSE RIBL RIBR RITL RITR THD"),
    *(
        side + name
        for side in "LR"
        for name in words(
            "AKI ANK BAC BHD BWT ELB ELS ELSO FBB FBT FFB FFT FHD FIN FLB FLT FMB FMT FPI FRM "
            "FWT HAP HBA HEB HEE HFR HME HPI HTH HTO KNE KNI MT5 SCA SHN SHO TIA TIB TIC TOE TOP "
            "TOS WRA WRB"
        )
    ),
}
# as published: Rajagopal2016.osim and gait2392_thelen2003muscle.osim of opensim-models
RAJAGOPAL = words(
    "pelvis_tilt pelvis_list pelvis_rotation pelvis_tx pelvis_ty pelvis_tz hip_flexion_r "
    "hip_adduction_r hip_rotation_r knee_angle_r knee_angle_r_beta ankle_angle_r "
    "subtalar_angle_r mtp_angle_r hip_flexion_l hip_adduction_l hip_rotation_l knee_angle_l "
    "knee_angle_l_beta ankle_angle_l subtalar_angle_l mtp_angle_l lumbar_extension "
    "lumbar_bending lumbar_rotation arm_flex_r arm_add_r arm_rot_r elbow_flex_r pro_sup_r "
    "wrist_flex_r wrist_dev_r arm_flex_l arm_add_l arm_rot_l elbow_flex_l pro_sup_l "
    "wrist_flex_l wrist_dev_l"
)
GAIT2392 = [n for n in RAJAGOPAL[:25] if not n.endswith("_beta")]


def make_motion(body: BodyModel, frames: int = 7, start_time: float = 2.5) -> Motion:
    generator = torch.Generator().manual_seed(5)
    vectors = 0.2 * torch.randn(1, 22, 3, generator=generator, dtype=torch.float64)
    rotations = so3.exp(
        torch.linspace(0.5, 1, frames, dtype=torch.float64)[:, None, None] * vectors
    )
    upright = so3.exp(torch.tensor([torch.pi / 2, 0, 0], dtype=torch.float64))
    rotations[:, 0] = upright @ rotations[:, 0]
    walk = torch.linspace(0, 1, frames, dtype=torch.float64)[:, None] * torch.ones(3)
    shape = torch.zeros(body.shape_size, dtype=torch.float64)
    return Motion.create(walk, rotations, shape, 120.0, start_time)


@pytest.fixture
def clip(body: BodyModel, tmp_path: Path) -> Path:
    motion = make_motion(body)
    save_motion(tmp_path / "clip.npz", MotionFile(motion, body.name, body.checksum))
    return tmp_path / "clip.npz"


def strict_trc(path: Path) -> tuple[dict[str, str], list[str], np.ndarray, np.ndarray]:
    """Header, labels, times and coordinates, every rule of OpenSim's documentation asserted."""
    lines = path.read_text().splitlines()
    assert lines[0].split("\t") == ["PathFileType", "4", "(X/Y/Z)", path.name]
    header = dict(zip(lines[1].split("\t"), lines[2].split("\t"), strict=True))
    labels = lines[3].rstrip("\t").split("\t")
    assert labels[:2] == ["Frame#", "Time"]
    assert all(cell == "" for k, cell in enumerate(labels[2:]) if k % 3)
    labels = labels[2::3]
    axes = [f"{axis}{k}" for k in range(1, len(labels) + 1) for axis in "XYZ"]
    assert lines[4].split("\t") == ["", "", *axes]
    assert lines[5] == ""
    rows = np.array([line.split("\t") for line in lines[6:]], dtype=float)
    assert rows.shape == (int(header["NumFrames"]), 2 + 3 * len(labels))
    assert int(header["NumMarkers"]) == len(labels) == len(set(labels))
    assert np.array_equal(rows[:, 0], np.arange(1, len(rows) + 1))
    step = 1 / float(header["DataRate"])
    assert np.abs(np.diff(rows[:, 1]) - step).max() < 2e-6  # s
    return header, labels, rows[:, 1], rows[:, 2:].reshape(len(rows), -1, 3)


def strict_mot(path: Path) -> tuple[list[str], np.ndarray]:
    """Columns and rows of a storage file."""
    lines = path.read_text().splitlines()
    end = lines.index("endheader")
    header = dict(line.split("=") for line in lines[1:end] if "=" in line)
    assert header["version"] == "1"
    assert header["inDegrees"] == "yes"
    names = lines[end + 1].split("\t")
    rows = np.array([line.split("\t") for line in lines[end + 2 :]], dtype=float)
    assert rows.shape == (int(header["nRows"]), int(header["nColumns"])) == (len(rows), len(names))
    assert names[0] == "time"
    return names[1:], rows


def test_marker_sets_have_the_published_names():
    assert list(body_places_of_markers("halpe26"))[:22] == HALPE_OF_POSE2SIM
    assert len(body_places_of_markers("halpe26")) == 26
    assert set(body_places_of_markers("opencap")) == OPENCAP
    assert len(OPENCAP) == len(body_places_of_markers("opencap")) == 43
    assert set(body_places_of_markers("bsm")) == BSM
    assert len(BSM) == len(body_places_of_markers("bsm")) == 105
    assert len(body_places_of_markers("pig")) == 39


def test_labels_of_one_side_lie_on_that_side():
    """A letter says the side: the first of most labels, the second of BSM's shanks, their last
    of its ribs.
    """
    for name in ("halpe26", "opencap", "pig", "bsm"):
        for label, place in body_places_of_markers(name).items():
            points = " ".join((*place.joints, *place.landmarks))
            if ("left" in points) == ("right" in points):
                continue
            if label in ("FBBT", "FRBT"):
                letter = {"FBBT": "l", "FRBT": "r"}[label]
            elif label.startswith(("BL", "BR", "FL", "FR")):
                letter = label[1]
            else:
                letter = label[-1] if label.startswith("RI") else label[0]
            assert ("left" in points) == (letter in "lL"), (name, label, points)


@pytest.mark.parametrize("markers", ["joints", "halpe26", "opencap", "pig", "bsm"])
@pytest.mark.parametrize(("unit", "up"), [("mm", "y"), ("m", "z"), ("cm", "x")])
def test_a_strict_reader_takes_the_markers(clip, tmp_path, body, markers, unit, up):
    out = tmp_path / "m.trc"
    line = ["export", str(clip), "--trc", str(out), "--markers", markers, "--unit", unit]
    assert cli.run([*line, "--up", up]) == cli.OK
    header, labels, times, places = strict_trc(out)
    assert header["Units"] == unit
    assert header["DataRate"] == header["OrigDataRate"] == "120"
    assert times[0] == 2.5
    motion = make_motion(body)
    truth = recorded_markers(motion, body, markers, "x")
    assert labels == list(truth.marker_names)
    # heights stand in the column of the axis that points up
    heights = places[..., "xyz".index(up)] * {"m": 1.0, "cm": 0.01, "mm": 0.001}[unit]
    assert np.abs(heights - truth.positions[..., 2]).max() < 1e-5  # m, float32 in the motion file


def test_axes_of_the_file_are_right_handed(body, tmp_path, clip):
    found = {}
    for up in "xyz":
        out = tmp_path / f"{up}.trc"
        assert cli.run(["export", str(clip), "--trc", str(out), "--up", up]) == cli.OK
        found[up] = strict_trc(out)[3][0] / 1000
    base = found["z"] - found["z"].mean(0)
    for up in "xy":
        other = found[up] - found[up].mean(0)
        turn, *_ = np.linalg.lstsq(base, other, rcond=None)
        assert np.linalg.det(turn) == pytest.approx(1.0, abs=1e-4)


def test_markers_survive_the_way_there_and_back(body, tmp_path):
    """Time began at zero in every file, whatever the recording's clock said."""
    from recon.mocap.marker_tables import write_trc

    truth = recorded_markers(make_motion(body, 100, 12.25), body, "pig", "clip")
    for unit in ("m", "mm"):
        write_trc(tmp_path / "clip.trc", truth, unit=unit)
        back = read_trc(tmp_path / "clip.trc")
        assert back.frames == 100
        assert back.fps == 120
        assert back.start_time == 12.25
        assert back.marker_names == truth.marker_names
        assert np.abs(back.positions - truth.positions).max() < 2e-6  # m
        assert back.visible.all()
    assert back.window(10, 20).start_time == pytest.approx(12.25 + 10 / 120)


def test_markers_lie_on_the_skin_where_their_names_say(body):
    motion = make_motion(body)
    found = recorded_markers(motion, body, "pig", "x")
    skin = body.pose(motion).vertices.numpy()
    place = found.positions[:, found.marker_names.index("LASI")]
    assert np.abs(place - skin[:, landmark("left_asis")]).max() < 1e-9
    hip = recorded_markers(motion, body, "opencap", "x")
    centre = hip.positions[:, hip.marker_names.index("LHJC_study")]
    assert np.abs(centre - body.pose(motion).joints[:, 1].numpy()).max() < 1e-9


@pytest.mark.parametrize(
    ("model", "names", "title"),
    [("rajagopal2016", RAJAGOPAL, "Rajagopal2016"), ("gait2392", GAIT2392, "3DGaitModel2392")],
)
def test_a_strict_reader_takes_the_coordinates(clip, tmp_path, model, names, title):
    out = tmp_path / "m.mot"
    assert cli.run(["export", str(clip), "--mot", str(out), "--model", model]) == cli.OK
    columns, rows = strict_mot(out)
    assert sorted(columns) == sorted(names)
    assert rows[0, 0] == 2.5
    assert len(rows) == 7
    assert title in out.read_text().splitlines()[0]


def test_angles_are_a_table_with_units_in_its_names(clip, tmp_path):
    out = tmp_path / "angles.csv"
    assert cli.run(["export", str(clip), "--angles", str(out)]) == cli.OK
    head, *rows = out.read_text().splitlines()
    assert head.split(",")[:2] == ["time", "pelvis_left_rotation_deg"]
    assert all(name.endswith("_deg") for name in head.split(",")[1:])
    assert np.array([row.split(",") for row in rows], dtype=float).shape == (7, 43)


def test_sets_on_the_skin_and_angles_need_the_bundled_body(body, tmp_path, toy_body):
    motion = make_motion(body).replace(shape=torch.zeros(16, dtype=torch.float64))
    for markers in ("halpe26", "pig"):
        with pytest.raises(ValueError, match="--markers joints"):
            recorded_markers(motion, toy_body, markers, "x")
    assert recorded_markers(motion, toy_body, "joints", "x").positions.shape == (7, 22, 3)
    from recon.body.angles import isb_angles

    with pytest.raises(ValueError, match="bundled body only"):
        isb_angles(motion, toy_body)


@pytest.mark.parametrize(
    ("option", "word", "output"), [("--markers", "pig", "--trc"), ("--model", "gait2392", "--mot")]
)
def test_options_of_a_file_that_is_not_asked_for_are_refused(
    option, word, output, clip, tmp_path, capsys
):
    line = ["export", str(clip), "--bvh", str(tmp_path / "m.bvh"), option, word]
    assert cli.run(line) == cli.BAD_INPUT
    assert f"{option} is an option of {output}" in capsys.readouterr().err
    assert not (tmp_path / "m.bvh").exists()
    assert set(landmarks()) >= {"left_rib", "right_thumb", "left_heel_below"}


def test_forces_are_a_storage_with_y_up_and_csv_has_the_same_columns(
    body: BodyModel, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Identifiers of external loads must find three columns each: OpenSim refuses more."""
    still = standing(body, path(like=times(1.0)))
    save_motion(tmp_path / "clip.npz", MotionFile(still, body.name, body.checksum))
    mot, csv = tmp_path / "grf.mot", tmp_path / "grf.csv"
    asked = ["export", str(tmp_path / "clip.npz"), "--mass", "70", "--forces"]
    assert cli.run([*asked, str(mot)]) == cli.run([*asked, str(csv)]) == cli.OK
    lines = mot.read_text().splitlines()
    end = lines.index("endheader")
    assert "inDegrees=no" in lines
    names = lines[end + 1].split("\t")
    rows = np.array([line.split("\t") for line in lines[end + 2 :]], dtype=float)
    assert csv.read_text().splitlines()[0].split(",") == names
    for side in "rl":
        for part in (f"ground_force_{side}_v", f"ground_force_{side}_p", f"ground_torque_{side}_"):
            assert [name[-1] for name in names if name.startswith(part)] == ["x", "y", "z"]
    up = [names.index(f"ground_force_{side}_vy") for side in "rl"]
    assert rows[:, up].sum(1) == pytest.approx(70 * 9.81, rel=1e-5)
    assert (rows[:, names.index("ground_force_r_py")] == 0).all()
    capsys.readouterr()
    assert cli.run(["export", str(tmp_path / "clip.npz"), "--mass", "70", "--mot", str(mot)]) != 0
    assert "--forces FILE, which was not given" in capsys.readouterr().err
    assert cli.run([*asked, str(tmp_path / "grf.txt")]) != 0
    assert ".mot, .sto, .csv" in capsys.readouterr().err


@pytest.mark.skipif(not os.environ.get("RECON_DATA"), reason="needs real recordings: RECON_DATA")
def test_force_plates_stand_beside_the_estimate(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    trial = Path(os.environ["RECON_DATA"]) / "observations" / "rehazenter" / "2014001_C1_01.c3d"
    motion, mot = tmp_path / "walk.npz", tmp_path / "grf.mot"
    assert cli.run(["convert", str(trial), str(motion), "--quiet"]) == cli.OK
    asked = ["export", str(motion), "--forces", str(mot), "--mass", "67", "--plates", str(trial)]
    assert cli.run([*asked, "--moments", str(tmp_path / "id.sto")]) == cli.OK
    table = (tmp_path / "id.sto").read_text().split("endheader\n")[1].splitlines()
    moments = np.array([line.split("\t") for line in table[1:]], dtype=float).T
    named = dict(zip(table[0].split("\t"), moments, strict=True))
    on = named["plate_known_r"] > 0
    assert -1.6 < named["ankle_angle_r_moment"][on].min() / 67 < -0.8  # push-off, N m/kg
    assert (named["ankle_angle_r_std"][on] > 0).all()
    report = json.loads((tmp_path / "grf.mot.json").read_text())
    for row in report["beside plates"].values():
        assert row["vertical_rms_percent"] < 12
        assert abs(row["impulse_percent"]) < 8
        assert row["centre_cm"] < 3
    lines = mot.read_text().splitlines()
    names = lines[lines.index("endheader") + 1].split("\t")
    rows = np.array([x.split("\t") for x in lines[lines.index("endheader") + 2 :]], dtype=float)
    measured = rows[rows[:, names.index("plate_known_r")] > 0, names.index("plate_force_r_y")]
    assert measured.mean() == pytest.approx(540, abs=30)  # N


def test_a_page_can_be_exported(clip: Path) -> None:
    """It failed since pages can have a film over which the body is drawn."""
    page = clip.with_suffix(".html")
    assert cli.run(["export", str(clip), "--html", str(page)]) == cli.OK
    assert page.stat().st_size > 10_000

"""Readers on real recordings, against each other and against the size of people."""

from pathlib import Path

import numpy as np
import pytest

from recon.export.bvh import write_bvh
from recon.mocap.bvh import parse_bvh, read_bvh
from recon.mocap.reader import bvh_texts_in_archive, read_recording
from recon.mocap.recording import (
    MarkerRecording,
    SkeletonRecording,
    drop_lead_in,
    head_to_foot_length,
)


def skeleton(path: Path) -> SkeletonRecording:
    recording = read_recording(path)
    assert isinstance(recording, SkeletonRecording)
    return recording


def markers(path: Path) -> MarkerRecording:
    recording = read_recording(path)
    assert isinstance(recording, MarkerRecording)
    return recording


@pytest.mark.parametrize(
    ("clip", "lead_in"), [("bvh31/02_01", 1), ("bvh31/07_12", 2), ("bvh43/14_19", 4)]
)
def test_skeletons_have_the_size_of_people_and_lose_their_t_pose(
    data: Path, clip: str, lead_in: int
) -> None:
    recording = skeleton(data / "mocap/cmu" / f"{clip}.bvh.xz")
    assert (
        1.4
        < head_to_foot_length(recording.joint_names, recording.parents, recording.rest_offsets)
        < 2.1
    )  # m
    cut = drop_lead_in(recording)
    assert cut.frames == recording.frames - lead_in
    assert cut.positions[..., 2].min() > -0.1  # m
    speed = np.linalg.norm(np.diff(cut.positions[:3], axis=0), axis=-1).mean() * cut.fps
    assert speed < 10  # m/s


@pytest.mark.parametrize("clip", ["02_01", "02_05"])
def test_bvh_and_amc_of_one_clip_agree(data: Path, clip: str) -> None:
    """The conversion dropped two bones per side; restored, they are those of the original."""
    amc = skeleton(data / f"observations/cmu_c3d/{clip}.amc")
    bvh = drop_lead_in(skeleton(data / f"mocap/cmu/bvh31/{clip}.bvh.xz"))
    pairs = {
        "root": "Hips", "ltoes": "LeftToeBase", "rtibia": "RightLeg", "lhumerus": "LeftArm",
        "rradius": "RightForeArm", "lhand": "LeftFingerBase", "head_end": "Head_end",
    }  # fmt: skip
    for mine, theirs in pairs.items():
        a = amc.positions[:, amc.joint(mine)]
        b = bvh.positions[:, bvh.joint(theirs)]
        assert np.linalg.norm(a - b, axis=-1).max() < 0.005, mine  # m


@pytest.mark.parametrize("clip", ["02_01", "02_05", "06_01"])
def test_bvh_and_c3d_of_one_clip_agree(data: Path, clip: str) -> None:
    """Frame k + 1 of the skeleton is frame k of the markers; headings differ by a quarter turn."""
    points = markers(data / f"observations/cmu_c3d/{clip}.c3d")
    joints = drop_lead_in(skeleton(data / f"mocap/cmu/bvh31/{clip}.bvh.xz"))
    frames = min(points.frames, joints.frames)
    turned = joints.positions[:frames] @ np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 1.0]])
    waist = points.select(["LFWT", "RFWT", "LBWT", "RBWT"])
    seen = waist.visible[:frames].all(1)
    apart = waist.positions[:frames].mean(1) - turned[:, joints.joint("Hips")]
    assert np.sqrt((apart[seen] ** 2).sum(-1).mean()) < 0.015  # m
    for marker, joint in (("LSHO", "LeftArm"), ("RSHO", "RightArm"), ("LANK", "LeftFoot")):
        one = points.select([marker])
        distance = np.linalg.norm(one.positions[:frames, 0] - turned[:, joints.joint(joint)],
                                  axis=-1)[one.visible[:frames, 0]]  # fmt: skip
        assert distance.mean() < 0.07, marker  # m


def test_bvh_is_written_and_read_back(data: Path, tmp_path: Path) -> None:
    clip = drop_lead_in(skeleton(data / "mocap/cmu/bvh31/02_03.bvh.xz"))
    write_bvh(tmp_path / "clip.bvh", clip)
    back = read_bvh(tmp_path / "clip.bvh")
    assert back.joint_names == clip.joint_names
    assert np.abs(back.positions - clip.positions).max() < 1e-6  # m
    assert back.fps == clip.fps


def test_packed_skeletons(data: Path) -> None:
    path = data / "mocap/bandai-namco/dataset-1.tar.xz"
    for name, text in bvh_texts_in_archive(path):
        clip = parse_bvh(text, name)
        assert clip.joint_names[clip.body_root] == "Hips"
        assert (
            1.4 < head_to_foot_length(clip.joint_names, clip.parents, clip.rest_offsets) < 2.1
        )  # m
        assert clip.fps == 30
        break


@pytest.mark.parametrize(
    ("file", "up", "low", "high"),
    [
        ("bmc/Gait.c3d", "z", 1.2, 1.6),
        ("nimblephysics/nick_freeform_001.c3d", "y", 1.4, 2.0),
        ("pycgm/59993_Frame_Static.c3d", "z", 1.4, 2.0),
        ("rehazenter/2014001_ST.c3d", "z", 1.2, 1.6),
        ("bmc/walk.trc", "y", 0.8, 1.2),
        ("nimblephysics/opencap_s4_walking1.trc", "y", 1.2, 1.7),
        ("nimblephysics/sprinter_run0350cms.trc", "y", 1.2, 1.7),
        ("opensim/gait2354_subject01_walk1.trc", "y", 1.5, 2.0),
    ],
)
def test_marker_files(data: Path, file: str, up: str, low: float, high: float) -> None:
    recording = markers(data / "observations" / file)
    assert any(d.startswith(f"up axis {up}") for d in recording.decisions)
    heights = np.where(recording.visible, recording.positions[..., 2], np.nan)
    shown = heights[recording.visible.sum(1) > 5]
    span = np.median(np.nanmax(shown, 1) - np.nanmin(shown, 1))
    assert low < span < high  # m
    assert not recording.positions[~recording.visible].any()

"""BVH and Acclaim: hand-computed poses, round trips, the T-pose at the start, archives."""

import dataclasses
import io
import lzma
import tarfile
from pathlib import Path

import numpy as np
import pytest
import torch

from recon.body.model import BodyModel
from recon.core import rotations as so3
from recon.core.motion import Motion
from recon.core.units import METRES
from recon.export.bvh import Order, skeleton_of, write_bvh
from recon.mocap.asf_amc import read_amc
from recon.mocap.bvh import parse_bvh, read_bvh
from recon.mocap.reader import bvh_texts_in_archive, read_recording
from recon.mocap.recording import SkeletonRecording, drop_lead_in

BVH = """HIERARCHY
ROOT Hips
{
  OFFSET 0 0 0
  CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
  JOINT Head { OFFSET 0 60 0
    CHANNELS 3 Zrotation Xrotation Yrotation
    End Site { OFFSET 0 20 0 } }
  JOINT LeftFoot
  {
    OFFSET 10 -90 0
    CHANNELS 3 Zrotation Xrotation Yrotation
    End Site
    {
      OFFSET 0 0 15
    }
  }
}
MOTION
Frames: 2
Frame Time: 0.0333333
1 95 3 0 0 0 0 0 0 0 0 0
1 95 3 90 0 0 0 90 0 0 0 0
"""


def make_motion(body: BodyModel, frames: int = 6) -> Motion:
    generator = torch.Generator().manual_seed(3)
    vectors = torch.randn(frames, 22, 3, generator=generator, dtype=torch.float64)
    walk = torch.randn(frames, 3, generator=generator, dtype=torch.float64)
    rotations = so3.exp(0.3 * vectors)
    upright = so3.exp(torch.tensor([torch.pi / 2, 0, 0], dtype=torch.float64))
    rotations[:, 0] = upright @ rotations[:, 0]
    shape = 0.3 * torch.randn(body.shape_size, generator=generator, dtype=torch.float64)
    return Motion.create(walk, rotations, shape, 30.0)


@pytest.fixture
def recording(body: BodyModel) -> SkeletonRecording:
    return skeleton_of(make_motion(body), body, "clip")


def test_a_hand_computed_pose() -> None:
    clip = parse_bvh(BVH, "clip", up="y")
    assert clip.fps == 30
    assert clip.joint_names == ("Hips", "Head", "Head_end", "LeftFoot", "LeftFoot_end")
    # y up (x, y, z) becomes z up (x, -z, y), centimetres become metres
    assert np.allclose(clip.positions[0, 0], [0.01, -0.03, 0.95], atol=1e-12)  # m
    assert np.allclose(clip.positions[0, 2], [0.01, -0.03, 1.75], atol=1e-12)  # m
    # a quarter turn about z takes the spine from +y to -x; then one about x, +y to +z
    assert np.allclose(clip.positions[1, 1], [0.01 - 0.6, -0.03, 0.95], atol=1e-12)  # m
    assert np.allclose(clip.positions[1, 2], [0.01 - 0.6, -0.03 - 0.2, 0.95], atol=1e-12)  # m


def test_forward_kinematics_law_holds(recording: SkeletonRecording) -> None:
    for joint, parent in enumerate(recording.parents):
        if parent >= 0:
            placed = (
                recording.positions[:, parent]
                + recording.orientations[:, parent] @ recording.rest_offsets[joint]
            )
            assert np.allclose(placed, recording.positions[:, joint], atol=1e-9)  # m


@pytest.mark.parametrize("order", ["XYZ", "XZY", "YXZ", "YZX", "ZXY", "ZYX"])
def test_what_is_written_is_read_back(
    recording: SkeletonRecording, tmp_path: Path, order: Order
) -> None:
    write_bvh(tmp_path / "clip.bvh", recording, order=order)
    back = read_bvh(tmp_path / "clip.bvh", up="y")
    names = [back.joint(name) for name in recording.joint_names]
    assert np.abs(back.positions[:, names] - recording.positions).max() < 1e-6  # m
    assert np.abs(back.orientations[:, names] - recording.orientations).max() < 1e-6
    assert np.abs(back.rest_offsets[names] - recording.rest_offsets)[1:].max() < 1e-6  # m
    assert back.fps == recording.fps
    assert any("unit cm" in decision for decision in back.decisions)
    assert list(tmp_path.iterdir()) == [tmp_path / "clip.bvh"]


def test_gimbal_lock_is_written_without_loss(recording: SkeletonRecording, tmp_path: Path) -> None:
    recording.orientations[:, :] = np.array([[0, 0, 1.0], [0, 1, 0], [-1, 0, 0]])
    write_bvh(tmp_path / "clip.bvh", recording, order="ZYX")
    back = read_bvh(tmp_path / "clip.bvh", unit="cm", up="y")
    names = [back.joint(name) for name in recording.joint_names]
    assert np.abs(back.orientations[:, names] - recording.orientations).max() < 1e-6


def test_joints_that_move_within_their_parent_keep_their_path(
    recording: SkeletonRecording, tmp_path: Path
) -> None:
    recording.positions[:, 1, 2] += np.linspace(0, 0.1, recording.frames)
    write_bvh(tmp_path / "clip.bvh", recording)
    back = read_bvh(tmp_path / "clip.bvh", up="y")
    names = [back.joint(name) for name in recording.joint_names]
    assert np.abs(back.positions[:, names] - recording.positions).max() < 1e-6  # m


def test_units_and_axes_may_be_given(tmp_path: Path) -> None:
    (tmp_path / "clip.bvh").write_text(BVH)
    clip = read_recording(tmp_path / "clip.bvh", unit="inch", up="z")
    assert np.allclose(clip.positions[0, 0], 0.0254 * np.array([1, 95, 3]))
    assert clip.decisions[1:] == ("unit inch: given", "up axis z: given")


@pytest.mark.parametrize("unit", ["mm", "m"])
def test_a_given_unit_that_makes_a_dwarf_or_giant_is_refused(tmp_path: Path, unit: str) -> None:
    """`recon convert --unit mm` of centimetres gave a person of 17 cm, and said nothing."""
    (tmp_path / "clip.bvh").write_text(BVH)
    with pytest.raises(ValueError, match=f"with --unit {unit} it measures .* leave --unit out"):
        read_recording(tmp_path / "clip.bvh", unit=unit)


def test_lines_may_end_as_on_old_macs(tmp_path: Path) -> None:
    plain = parse_bvh(BVH, "clip", up="y")
    back = parse_bvh(BVH.replace("\n", "\r"), "clip", up="y")
    assert np.array_equal(back.positions, plain.positions)


def test_compressed_and_archived_files_read_like_plain_ones(tmp_path: Path) -> None:
    with lzma.open(tmp_path / "clip.bvh.xz", "wt") as file:
        file.write(BVH)
    with tarfile.open(tmp_path / "pack.tar.xz", "w:xz") as archive:
        for name in ("pack/a.bvh", "pack/b.bvh"):
            info = tarfile.TarInfo(name)
            info.size = len(BVH)
            archive.addfile(info, io.BytesIO(BVH.encode()))
    plain = parse_bvh(BVH, "clip", up="y").positions
    assert np.array_equal(read_recording(tmp_path / "clip.bvh.xz", up="y").positions, plain)
    packed = list(bvh_texts_in_archive(tmp_path / "pack.tar.xz"))
    assert packed == [("pack/a.bvh", BVH), ("pack/b.bvh", BVH)]
    one = read_recording(f"{tmp_path / 'pack.tar.xz'}::b.bvh", up="y")
    assert np.array_equal(one.positions, plain)
    with pytest.raises(ValueError, match="::NAME"):
        read_recording(tmp_path / "pack.tar.xz")


def test_a_name_that_two_files_of_an_archive_have_is_refused(tmp_path: Path) -> None:
    """The first was taken, of whichever folder it was."""
    with tarfile.open(tmp_path / "pack.tar", "w") as archive:
        for name in ("ann/a.bvh", "bob/a.bvh", "a.bvh"):
            info = tarfile.TarInfo(name)
            info.size = len(BVH)
            archive.addfile(info, io.BytesIO(BVH.encode()))
    with pytest.raises(ValueError, match=r"it holds ann/a\.bvh, bob/a\.bvh, a\.bvh$"):
        read_recording(f"{tmp_path / 'pack.tar'}::a", up="y")
    for name in ("bob/a.bvh", "a.bvh"):
        assert read_recording(f"{tmp_path / 'pack.tar'}::{name}", up="y").name == name


def test_a_t_pose_at_the_start_is_cut_and_reported(recording: SkeletonRecording) -> None:
    still = recording.window(1, 2).positions
    for count in (1, 2):
        recording.positions[:] = still
        recording.positions[:count] += 0.5
        cut = drop_lead_in(recording)
        assert cut.frames == recording.frames - count
        assert cut.start_time == count / recording.fps
        assert "T-pose" in cut.decisions[-1]
    recording.positions[:] = still
    assert drop_lead_in(recording) is recording
    assert drop_lead_in(recording.window(0, 1)).frames == 1


def test_bones_lost_by_the_cgspeed_conversion_are_restored() -> None:
    """Its thorax had no length, so that shoulders sat 12 cm too low."""
    chain = ("Hips", "LowerBack", "Spine", "Spine1", "Neck", "Neck1", "Head")
    text = "HIERARCHY\nROOT Hips { OFFSET 0 0 0 CHANNELS 3 Xposition Yposition Zposition\n"
    text = text.replace(" CHANNELS", "\nCHANNELS")
    for name in ("LHipJoint", "RHipJoint", "LeftFoot"):
        text += f"JOINT {name} {{ OFFSET 0 {-16 if name == 'LeftFoot' else 0} 0 }}\n"
    for name, length in zip(chain[1:], (0, 2, 2, 0, 1.5, 1.5), strict=True):
        text += f"JOINT {name} {{ OFFSET 0 {length} 0\n"
    text += "}}}\n"
    for side, sign in (("Left", 1), ("Right", -1)):
        text += f"JOINT {side}Arm {{ OFFSET 0 0 0\nJOINT {side}Hand {{ OFFSET {sign * 3} 0 0\n"
        text += f"JOINT {side}FingerBase {{ OFFSET 0 0 0 }} }} }}\n"
    text += "}}}}\nMOTION\nFrames: 1\nFrame Time: 0.01\n0 16 0\n"
    clip = parse_bvh(text, "clip", unit="cmu", up="y")
    clip = dataclasses.replace(clip, positions=clip.positions / METRES["cmu"])
    assert np.allclose(clip.positions[0, clip.joint("Neck")], [0, 0, 22])
    assert np.allclose(clip.positions[0, clip.joint("Head")], [0, 0, 25])
    assert np.allclose(clip.positions[0, clip.joint("LeftFingerBase")], [4.5, 0, 22])
    assert "restored" in clip.decisions[-1]


ASF = """:version 1.10
:units
  mass 1.0
  length 0.45
  angle deg
:root
  order TX TY TZ RX RY RZ
  axis XYZ
  position 0 0 0
  orientation 0 0 0
:bonedata
  begin
    id 1
    name lfoot
    direction 0 -1 0
    length 17
    axis 0 0 90 XYZ
    dof rx rz
  end
  begin
    id 2
    name head
    direction 0 2 0
    length 12
    axis 0 0 0 XYZ
  end
:hierarchy
  begin
    root lfoot head
  end
"""
AMC = (
    ":FULLY-SPECIFIED\n:DEGREES\n1\nroot 1 17 2 0 0 0\nlfoot 0 0\n"
    "2\nroot 1 17 2 0 0 90\nlfoot 90 0\n"
)


def test_acclaim_bones_turn_about_their_own_axes(tmp_path: Path) -> None:
    (tmp_path / "07.asf").write_text(ASF)
    (tmp_path / "07_01.amc").write_text(AMC)
    clip = read_recording(tmp_path / "07_01.amc", up="y")
    unit = 0.0254 / 0.45
    assert clip.joint_names == ("root", "lfoot", "head", "lfoot_end", "head_end")
    assert np.allclose(clip.positions[0, 0], unit * np.array([1, -2, 17]))  # m
    assert np.allclose(clip.positions[0, 3], unit * np.array([1, -2, 0]), atol=1e-12)  # m
    assert np.allclose(clip.positions[0, 4], unit * np.array([1, -2, 29]), atol=1e-12)  # m
    # the bone's x axis is the world's y (C turns by 90 degrees about z), along the bone itself;
    # the root's turn about z takes the bone from -y to +x
    assert np.allclose(clip.positions[1, 3], unit * np.array([18, -2, 17]), atol=1e-12)  # m
    radians = AMC.replace("DEGREES", "RADIANS").replace(" 90", f" {np.pi / 2}")
    (tmp_path / "07_02.amc").write_text(radians)
    again = read_amc(tmp_path / "07_02.amc", up="y")
    assert np.allclose(again.positions, clip.positions, atol=1e-9)  # m


@pytest.mark.parametrize(("number", "said"), [("4", "got 4 after 1"), ("1", "got 1 after 1")])
def test_a_motion_that_lacks_frames_is_refused(tmp_path: Path, number: str, said: str) -> None:
    """Frames were taken one after another, whatever their numbers, and the clock ran ahead."""
    (tmp_path / "07.asf").write_text(ASF)
    (tmp_path / "07_01.amc").write_text(AMC.replace("\n2\n", f"\n{number}\n"))
    with pytest.raises(ValueError, match=said):
        read_amc(tmp_path / "07_01.amc", up="y")


def test_a_skeleton_is_found_by_the_longest_beginning_of_the_motion_s_name(tmp_path: Path) -> None:
    """The skeletons of HDM05 (HDM_bk.asf for HDM_bk_kick_01.amc) were not found, because only the
    first word of the name counted."""
    for name in ("HDM_bk.asf", "HDM_dg.asf", "HDM.asf"):
        (tmp_path / name).write_text(ASF)
    (tmp_path / "HDM_bk_kick_01.amc").write_text(AMC)
    clip = read_recording(tmp_path / "HDM_bk_kick_01.amc", up="y")
    assert "skeleton HDM_bk.asf" in clip.decisions


def test_a_motion_of_another_skeleton_or_without_one_is_refused(tmp_path: Path) -> None:
    (tmp_path / "07_01.amc").write_text(AMC)
    with pytest.raises(FileNotFoundError, match=r"07\.asf"):
        read_recording(tmp_path / "07_01.amc")
    (tmp_path / "07.asf").write_text(ASF.replace("dof rx rz", "dof rx"))
    with pytest.raises(ValueError, match="another subject"):
        read_recording(tmp_path / "07_01.amc")
    with pytest.raises(ValueError, match=r"\.amc"):
        read_recording(tmp_path / "07.asf")

"""Files that are no observations are refused at a look, before torch is loaded."""

import subprocess
import sys

import numpy as np
import pytest

from recon.cli.looks import refuse_foreign_files


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("a.txt", b"hello", r"\.txt are not known.*3D keypoints"),
        ("a.bvh", b"HIERARCHY", "recon convert"),
        ("a.npz", b"PK", "cannot be read"),
        ("a.npy", b"hello", "other bytes"),
        ("a.trc", b"time,x,y", "PathFileType; got 'time,x,y'"),
        ("a.c3d", b"hello", "0x50"),
        ("a.csv", b"a,b\n1,2\n", "left_hip_x.*got 'a,b'"),
        ("a.json", b"hello", "begins with"),
        ("a.json", b'{"hello": 1}', "got '{\"hello\": 1}'"),
        ("a.csv", b"", "empty"),
    ],
)
def test_foreign_files_are_refused_with_what_was_seen(tmp_path, name, content, said):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(ValueError, match=said):
        refuse_foreign_files([tmp_path / name])


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("a.trc", b"\xef\xbb\xbfPathFileType\t4\t(X/Y/Z)\tx.trc\n"),
        ("a.mp4", b"...."),
        ("a.c3d", b"\x02\x50"),
        ("a.csv", b"nose_x,nose_y,nose_z\n"),
        ("a.csv", b"frame,keypoint,x,y,z\n"),
        ("a.csv", b"scorer,DLC,DLC\nbodyparts,nose,nose\ncoords,x,y\n"),
        ("a.json", b'{"people": []}'),
        ("a.json", b'  [{"pose_world_landmarks": []}]'),
    ],
)
def test_files_that_may_be_observations_are_let_in(tmp_path, name, content):
    (tmp_path / name).write_bytes(content)
    refuse_foreign_files([tmp_path / name])


def test_motions_are_told_from_observations(tmp_path):
    motion = {"trans": np.zeros((2, 3)), "poses": np.zeros((2, 66)), "body_checksum": "1"}
    np.savez(tmp_path / "m.npz", **motion)
    with pytest.raises(ValueError, match="a motion of recon: `recon refine` takes it"):
        refuse_foreign_files([tmp_path / "m.npz"])


def test_the_command_refuses_them_without_torch(tmp_path):
    """A wrong file took as long as loading torch: three seconds."""
    (tmp_path / "a.csv").write_text("a,b\n1,2\n")
    line = f"['fit', {str(tmp_path / 'a.csv')!r}, '--out', {str(tmp_path / 'o.npz')!r}]"
    code = f"import sys; from recon import cli; assert cli.run({line}) == 2"
    code += "; print('torch' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"

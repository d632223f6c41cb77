"""A rigged character from a glTF file: its bones, its rest pose, and points of its skin."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from recon.core import rotations as so3
from recon.core.errors import FormatError, ReconError
from recon.core.fingers import SIDES
from recon.export.bone_map import BoneMap, map_bones
from recon.export.bone_tree import Tree
from recon.export.glb_file import GltfFile, normalised
from recon.export.nodes import joints_of, parents_first, transforms_to_scene, tree_and_transforms

_UNEVEN = 0.01
"""Greatest relative difference of the scales along a bone's axes that is accepted."""
_DIRECTIONS = 32
"""Number of directions in which the farthest points of each bone's skin are kept."""


@dataclass(frozen=True)
class Character:
    """A rigged character at rest: its bones, and transforms of its nodes; y up, scene units."""

    file: GltfFile
    bones: BoneMap
    tree: Tree
    local: Float[np.ndarray, "nodes 4 4"]
    """Transform of every node to its parent, as the file has it."""
    world: Float[np.ndarray, "nodes 4 4"]
    """Transform of every node to the scene, as the file has it."""
    reference: Float[np.ndarray, "nodes 4 4"]
    """Transform of every node in the pose that the skin was modelled in, in axes of the skin;
    zeros of nodes that are no bones."""
    warnings: tuple[str, ...]

    @classmethod
    def read(cls, path: Path, bones: Path | None = None) -> "Character":
        """Read a character and find its bones.

        The rest pose is that in which the skin was bound; for a VRM it is that of the nodes.

        Raises:
            FileNotFoundError: when there is no such file.
            ValueError: when it is damaged, has no skin, or no bones of a person are found.
        """
        file = GltfFile.read(path)
        tree, local = tree_and_transforms(file)
        order = parents_first(tree.parents, path)
        world = transforms_to_scene(tree.parents, order, local)
        places = world[:, :3, 3]
        found = map_bones(tree, places, file.document, path, bones)
        reference, warnings = world, tuple[str, ...]()
        extensions = file.document.get("extensions")
        if not isinstance(extensions, dict) or not {"VRM", "VRMC_vrm"} & set(extensions):
            bound = _node_transforms_at_binding(file, tree, order, local, found)
            if bound is None:
                warnings = (
                    f"{path}: the pose in which the skin was bound cannot be read; the pose of "
                    "the nodes is taken instead",
                )
            else:
                reference = bound
        made = cls(file, found, tree, local, world, reference, warnings)
        made.check()
        return made

    @cached_property
    def order(self) -> list[int]:
        """All nodes, parents before children."""
        return parents_first(self.tree.parents, self.file.path)

    @property
    def animated_nodes(self) -> list[int]:
        """Nodes that are animated, parents before children."""
        used = {*self.bones.nodes.values(), *self.bones.spine, *self.bones.neck}
        return [k for k in self.order if k in used]

    def check(self) -> None:
        """Refuse bones with zero, negative or uneven scales, which rotations would distort.

        Raises:
            ReconError: naming the bone.
        """
        inner = {above for k in self.animated_nodes for above in self.tree.path_to_root(k)}
        for k in sorted(inner):
            part = self.world[k, :3, :3]
            sizes = np.linalg.norm(part, axis=0)
            name, path = self.tree.names[k], self.file.path
            if not np.isfinite(self.world[k]).all() or sizes.min() < 1e-9:
                raise FormatError(
                    f"{path}: the bone {name!r:.40} is scaled to zero or placed at NaN or infinity"
                )
            if np.linalg.det(part) < 0:
                raise ReconError(
                    f"{path}: {name!r:.40} mirrors the character by a negative scale; apply the "
                    "scale in your 3D program and export again"
                )
            even = part.T @ part / sizes.mean() ** 2
            if np.abs(even - np.eye(3)).max() > 3 * _UNEVEN:
                told = ", ".join(f"{size:.3g}" for size in sizes)
                raise ReconError(
                    f"{path}: {name!r:.40} is scaled unevenly ({told}); apply "
                    "the scale in your 3D program and export again"
                )

    @cached_property
    def rotation_to_body_axes(self) -> Float[np.ndarray, "3 3"]:
        """Rotation from `reference` to the body model's axes: x to its left, y up, z ahead."""
        nodes, place = self.bones.nodes, self.reference[:, :3, 3]
        legs = place[[nodes["left_hip"], nodes["right_hip"]]]
        arms = place[[nodes["left_shoulder"], nodes["right_shoulder"]]]
        up = _nearest_axis(arms.mean(0) - legs.mean(0) + place[nodes["head"]] - legs.mean(0))
        aside = (legs[0] - legs[1]) + (arms[0] - arms[1])
        aside = aside - (aside @ up) * up
        if np.linalg.norm(aside) < 1e-6 * np.linalg.norm(place[nodes["head"]] - legs.mean(0)):
            raise ReconError(
                f"{self.file.path}: expected left and right bones at different places, got equal "
                "ones; name the right bones with --bones"
            )
        aside = aside / np.linalg.norm(aside)
        return np.stack((aside, up, np.cross(aside, up)))

    @cached_property
    def rotations_in_file(self) -> Float[Tensor, "nodes 3 3"]:
        """Rotation of every node to the scene, as the file has it."""
        return _rotations_without_scales(self.world)

    @cached_property
    def rest_rotations(self) -> Float[Tensor, "nodes 3 3"]:
        """Rotation of every node in the rest pose, from its axes to the body model's."""
        return torch.from_numpy(self.rotation_to_body_axes) @ _rotations_without_scales(
            self.reference
        )

    @cached_property
    def rest_positions(self) -> Float[np.ndarray, "nodes 3"]:
        """Positions of all nodes in the rest pose, in body-model axes and lengths of the scene."""
        return self.reference[:, :3, 3] @ self.rotation_to_body_axes.T * self.scale

    @cached_property
    def scale(self) -> float:
        """Ratio of lengths in the scene to those in `reference`, taken at legs and upper arms."""
        nodes = self.bones.nodes
        pairs = [
            (nodes[f"{s}_{a}"], nodes[f"{s}_{b}"])
            for s in SIDES
            for a, b in (("hip", "knee"), ("knee", "ankle"), ("shoulder", "elbow"))
        ]
        lengths = [
            sum(np.linalg.norm(np.diff(one[list(pair), :3, 3], axis=0)) for pair in pairs)
            for one in (self.world, self.reference)
        ]
        if min(lengths) < 1e-9:
            raise FormatError(f"{self.file.path}: expected legs and arms longer than zero")
        return float(lengths[0] / lengths[1])

    @cached_property
    def skin(self) -> dict[int, Float[np.ndarray, "points 3"]]:
        """Outermost points on the skin of every animated bone, in the axes of its node.

        Multiplied by the scale of the node they are in lengths of the scene. There are none where
        the mesh is compressed. What lies below the soles at rest, such as a train, is left out:
        the ground would lift the body by it.
        """
        low = -np.inf if self.lowest_height is None else self.lowest_height - 1e-3
        kept = {k: one[self._heights_at_rest(k, one) > low] for k, one in self._vertices.items()}
        return {node: _outermost_points(points) for node, points in kept.items() if len(points)}

    @cached_property
    def _vertices(self) -> dict[int, Float[np.ndarray, "points 3"]]:
        """Vertices that every animated bone moves most, or a bone below it, like `skin`."""
        bone_of_node: dict[int, int] = {}
        driven = set(self.animated_nodes)
        for k in self.order:
            above = self.tree.parents[k]
            bone_of_node[k] = k if k in driven else bone_of_node.get(above, -1)
        found: dict[int, list[np.ndarray]] = {}
        for joints, binds, places, own in self._skinned_parts():
            for slot in np.unique(own):
                node = joints[slot]
                if bone_of_node[node] < 0:
                    continue
                points = places[own == slot] @ binds[slot, :3, :3].T + binds[slot, :3, 3]
                back = np.linalg.inv(self.world[bone_of_node[node]]) @ self.world[node]
                points = points @ back[:3, :3].T + back[:3, 3]
                found.setdefault(bone_of_node[node], []).append(points)
        return {node: np.concatenate(points) for node, points in found.items()}

    def _skinned_parts(self) -> list[tuple[list[int], np.ndarray, np.ndarray, np.ndarray]]:
        """Read joints, inverse bind matrices, vertices and their main joints of all mesh parts."""
        file, parts = self.file, []
        meshes, skins = file.listed("meshes"), file.listed("skins")
        for node in file.listed("nodes"):
            if "mesh" not in node or "skin" not in node:
                continue
            skin = skins[file.index(node["skin"], len(skins), "skin")]
            mesh = meshes[file.index(node["mesh"], len(meshes), "mesh")]
            joints, binds = joints_of(file, skin), _inverse_bind_matrices(file, skin)
            primitives = mesh.get("primitives")
            for one in primitives if isinstance(primitives, list) and binds is not None else ():
                read = _vertices_and_joints(file, one, len(joints))
                if read is not None:
                    parts.append((joints, binds, *read))
        return parts

    @cached_property
    def lowest_height(self) -> float | None:
        """Height of the soles in the rest pose, like `rest_positions`; None if unknown.

        They are the lowest vertex of the feet, as a train, cape or weapon may reach below; where
        the feet have no vertices that can be read, the lowest one of all.
        """
        nodes = self.bones.nodes
        feet = {nodes.get(f"{side}_{joint}") for side in SIDES for joint in ("ankle", "foot")}
        skin = {node: points for node, points in self._vertices.items() if node in feet}
        box = None if skin or self.reference is self.world else self._bounds_of_skin()
        if box is not None:
            corners = np.stack(np.meshgrid(*box.T), -1).reshape(-1, 3)
            return float((corners @ self.rotation_to_body_axes[1]).min() * self.scale)
        skin = skin or self._vertices
        low = [self._heights_at_rest(node, points).min() for node, points in skin.items()]
        return float(min(low)) if low else None

    def _heights_at_rest(self, node: int, points: np.ndarray) -> np.ndarray:
        """Return heights in the rest pose of points in the axes of a node, as `rest_positions`."""
        posed = points @ self.reference[node, :3, :3].T + self.reference[node, :3, 3]
        return posed @ self.rotation_to_body_axes[1] * self.scale

    def _bounds_of_skin(self) -> Float[np.ndarray, "2 3"] | None:
        """Return smallest and largest coordinates of vertices of the skin with most bones."""
        file = self.file
        main, boxes = _main_skin(file, self.bones), []
        accessors, meshes = file.listed("accessors"), file.listed("meshes")
        for node in file.listed("nodes"):
            if node.get("skin") != main or "mesh" not in node:
                continue
            mesh = meshes[file.index(node["mesh"], len(meshes), "mesh")]
            for one in mesh.get("primitives") or ():
                number = one.get("attributes", {}).get("POSITION")
                told = accessors[file.index(number, len(accessors), "accessor")]
                box = np.array([told.get("min"), told.get("max")], dtype=object)
                if box.shape == (2, 3) and all(type(x) in (int, float) for x in box.flat):
                    boxes.append(normalised(box.astype(float), told))
        if not boxes:
            return None
        stacked = np.stack(boxes)
        return np.stack((stacked[:, 0].min(0), stacked[:, 1].max(0)))


def _main_skin(file: GltfFile, bones: BoneMap) -> int:
    """Return the number of the skin that has most of the bones."""
    used = set(bones.nodes.values())
    skins = [used & set(joints_of(file, skin)) for skin in file.listed("skins")]
    return max(range(len(skins)), key=lambda k: len(skins[k]))


def _inverse_bind_matrices(
    file: GltfFile, skin: dict[str, Any]
) -> Float[np.ndarray, "joints 4 4"] | None:
    """Read the inverse bind matrices of a skin; None where they cannot be read."""
    count = len(joints_of(file, skin))
    if "inverseBindMatrices" not in skin:
        return np.tile(np.eye(4), (count, 1, 1))
    numbers = file.numbers(skin["inverseBindMatrices"])
    if numbers is None:
        return None
    if numbers.shape[0] < count or numbers.shape[1] != 16 or not np.isfinite(numbers).all():
        raise FormatError(
            f"{file.path}: expected {count} inverse bind matrices of 16 finite numbers, got "
            f"{numbers.shape[0]} of {numbers.shape[1]} numbers, or some not finite"
        )
    return numbers[:count].astype(float).reshape(-1, 4, 4).transpose(0, 2, 1)


def _node_transforms_at_binding(
    file: GltfFile, tree: Tree, order: list[int], local: np.ndarray, bones: BoneMap
) -> Float[np.ndarray, "nodes 4 4"] | None:
    """Return nodes' transforms to the skin's axes when it was bound; None if they are unknown."""
    skin = file.listed("skins")[_main_skin(file, bones)]
    binds = _inverse_bind_matrices(file, skin)
    if binds is None or "inverseBindMatrices" not in skin:
        return None
    if np.abs(np.linalg.det(binds[:, :3, :3])).min() < 1e-15:
        return None
    own = dict(zip(joints_of(file, skin), np.linalg.inv(binds), strict=True))
    made = np.zeros((len(tree.names), 4, 4))
    for k in order:
        above = tree.parents[k]
        if k in own:
            made[k] = own[k]
        elif above >= 0 and made[above].any():
            made[k] = made[above] @ local[k]
    used = [*bones.nodes.values(), *bones.spine, *bones.neck]
    turned = np.linalg.det(made[used][:, :3, :3])
    return made if (turned > 1e-15).all() else None


def _vertices_and_joints(
    file: GltfFile, primitive: Any, joints: int
) -> tuple[np.ndarray, Int[np.ndarray, " vertices"]] | None:
    """Read vertices, and the joint that moves each most; None where they cannot be read."""
    attributes = primitive.get("attributes") if isinstance(primitive, dict) else None
    extensions = primitive.get("extensions") if isinstance(primitive, dict) else None
    if not isinstance(attributes, dict) or "KHR_draco_mesh_compression" in (extensions or {}):
        return None
    if not {"POSITION", "JOINTS_0", "WEIGHTS_0"} <= set(attributes):
        return None
    read = [file.numbers(attributes[name]) for name in ("POSITION", "JOINTS_0", "WEIGHTS_0")]
    places, slots, weights = read
    if places is None or slots is None or weights is None:
        return None
    if not len(places) == len(slots) == len(weights) or slots.shape != weights.shape:
        raise FormatError(f"{file.path}: expected skinning weights for all vertices of a mesh")
    own = np.take_along_axis(slots, weights.argmax(1)[:, None], 1)[:, 0].astype(int)
    if len(own) and (own.min() < 0 or own.max() >= joints or not np.isfinite(places).all()):
        raise FormatError(
            f"{file.path}: expected finite vertices of a mesh, each bound to a joint of its skin"
        )
    return places.astype(float), own


def _outermost_points(points: Float[np.ndarray, "points 3"]) -> Float[np.ndarray, "some 3"]:
    """Keep the points that are farthest in one of `_DIRECTIONS` directions over the sphere."""
    k = np.arange(_DIRECTIONS) + 0.5
    height, angle = 1 - 2 * k / _DIRECTIONS, np.pi * (1 + 5**0.5) * k
    level = np.sqrt(1 - height**2)
    ways = np.stack((level * np.cos(angle), level * np.sin(angle), height), 1)
    best = [(points @ way).argmax() for way in ways]
    return points[np.unique(best)]


def _nearest_axis(direction: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    """Return the coordinate axis, or its opposite, that is nearest to a direction."""
    at = int(np.abs(direction).argmax())
    return np.eye(3)[at] * np.sign(direction[at])


def _rotations_without_scales(
    matrices: Float[np.ndarray, "nodes 4 4"],
) -> Float[Tensor, "nodes 3 3"]:
    """Extract the rotations of transforms, without scales; the identity for zeros."""
    parts = torch.from_numpy(matrices[:, :3, :3].copy())
    sizes = parts.norm(dim=-2, keepdim=True)
    some = (sizes > 0).all(-1, keepdim=True)
    return so3.nearest_rotation(
        torch.where(some, parts / sizes.clamp(min=1e-300), torch.eye(3).to(parts))
    )

"""Reads the nodes of a glTF file: their tree, transforms, and which are joints of skins."""

from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from recon.core.errors import FormatError, ReconError
from recon.export.bone_tree import Tree
from recon.export.glb_file import GltfFile


def joints_of(file: GltfFile, skin: dict[str, Any]) -> list[int]:
    """List the numbers of the nodes that are joints of a skin.

    Raises:
        ValueError: when these are no nodes of the file.
    """
    joints, count = skin.get("joints"), len(file.listed("nodes"))
    if not isinstance(joints, list) or not joints:
        raise FormatError(f"{file.path}: expected a list of joints in every skin, got none")
    return [file.index(one, count, "node") for one in joints]


def tree_and_transforms(file: GltfFile) -> tuple[Tree, Float[np.ndarray, "nodes 4 4"]]:
    """Read the tree of all nodes, and the transform of each to its parent.

    Raises:
        ValueError: when there is no skin, or a node has two parents.
    """
    nodes, skins = file.listed("nodes"), file.listed("skins")
    if not skins:
        raise ReconError(
            f"{file.path}: expected a rigged character, but it has no skin; bind the mesh to a "
            "skeleton, in Blender or by a service for rigging, and export it again"
        )
    parents = [-1] * len(nodes)
    for k, node in enumerate(nodes):
        children = node.get("children", [])
        if not isinstance(children, list):
            raise FormatError(f"{file.path}: expected a list as children of node {k}")
        for child in children:
            at = file.index(child, len(nodes), "node")
            if parents[at] >= 0:
                raise FormatError(f"{file.path}: node {at} has two parents")
            parents[at] = k
    names = tuple(str(one.get("name", f"node {k}")) for k, one in enumerate(nodes))
    joints = frozenset(k for skin in skins for k in joints_of(file, skin))
    local = np.stack([local_matrix(one, file.path) for one in nodes])
    return Tree(names, tuple(parents), joints), local


def local_matrix(node: dict[str, Any], path: Path) -> Float[np.ndarray, "4 4"]:
    """Return the transform of a node to its parent, from its matrix or its separate parts.

    Raises:
        ValueError: when it has too few or too many numbers, or they are not plausible.
    """
    if "matrix" in node:
        return _numbers(node["matrix"], 16, path).reshape(4, 4).T
    made = np.eye(4)
    quaternion = _numbers(node.get("rotation", (0, 0, 0, 1)), 4, path)
    if quaternion @ quaternion < 1e-12:
        raise FormatError(f"{path}: expected unit quaternions as rotations of nodes, got zeros")
    turn = Rotation.from_quat(quaternion).as_matrix()
    made[:3, :3] = turn * _numbers(node.get("scale", (1, 1, 1)), 3, path)
    made[:3, 3] = _numbers(node.get("translation", (0, 0, 0)), 3, path)
    return made


def _numbers(value: Any, count: int, path: Path) -> np.ndarray:
    fits = isinstance(value, list | tuple) and len(value) == count
    if not fits or not all(type(x) in (int, float) and abs(x) < 1e9 for x in value):
        raise FormatError(f"{path}: expected {count} numbers of a node, got {value!r:.60}")
    return np.array(value, float)


def parents_first(parents: tuple[int, ...], path: Path) -> list[int]:
    """List the numbers of all nodes, parents before children.

    Raises:
        ValueError: when nodes are their own ancestors.
    """
    children: dict[int, list[int]] = {}
    for k, parent in enumerate(parents):
        children.setdefault(parent, []).append(k)
    order = list(children.get(-1, ()))
    for k in order:
        order += children.get(k, ())
    if len(order) < len(parents):
        raise FormatError(f"{path}: expected a tree of nodes, but some are their own ancestors")
    return order


def transforms_to_scene(
    parents: tuple[int, ...], order: list[int], local: Float[np.ndarray, "nodes 4 4"]
) -> Float[np.ndarray, "nodes 4 4"]:
    """Compute the transforms of nodes to the scene from those to their parents."""
    world = local.copy()
    for k in order:
        if parents[k] >= 0:
            world[k] = world[parents[k]] @ local[k]
    return world

"""Writes a motion as an animation of a user's own rigged character."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from recon.body.model import BodyModel
from recon.core import rotations as so3
from recon.core.fingers import HAND_JOINTS, SIDES
from recon.core.motion import Motion
from recon.core.units import to_z_up
from recon.export.character import Character
from recon.export.limbs import ARM, LEG, Limb, PersonMotion, upper_envelope
from recon.export.rig import CharacterPose, CharacterRig, Posed, node_rotations
from recon.export.skeleton import one_clip, quaternions

_UP = torch.tensor([0.0, 1.0, 0.0], dtype=torch.float64)


@dataclass(frozen=True)
class AnimatedCharacter:
    """How a character was animated: by which bones, at what scale, with what warnings."""

    bones: dict[str, str]
    """Names of the character's nodes, keyed by body joint."""
    scale: float
    """Ratio of the character's legs to the person's, by which the path was scaled."""
    warnings: tuple[str, ...]


def write_character(
    path: Path,
    motion: Motion,
    body: BodyModel,
    character: Path,
    *,
    bones: Path | None = None,
    ground: float = 0.0,
) -> AnimatedCharacter:
    """Write a user's character as GLB with a motion as one more animation.

    Mesh, materials, other animations and extensions stay as they are in the file.

    Args:
        path: file to write.
        motion: one clip without a batch axis.
        body: the body model of the motion.
        character: a rigged .glb, .vrm or .gltf of any proportions, unit, rest pose and names.
        bones: TOML file of lines `left_knee = "name of a node"`, where names tell nothing.
        ground: height of the level ground in the motion, metres.

    Raises:
        FileNotFoundError: when a file does not exist.
        ValueError: when the character is damaged, has no skin, or bones are missing.
    """
    # in double precision, since steps of feet are small differences of large positions
    motion = one_clip(motion).to(dtype=torch.float64)
    read = Character.read(character, bones)
    rig, carried, ratio = retargeted_to_character(
        motion, body.to(dtype=torch.float64), read, ground
    )
    posed, turned = rig.node_transforms(carried), _animated_nodes(read, motion)
    tracks: list[tuple[int, str, np.ndarray]] = []
    records: dict[int, dict[str, Any]] = {}
    for node in turned:
        record = dict(read.file.listed("nodes")[node])
        if "matrix" in record:
            record |= _translation_rotation_scale(read.local[node])
            del record["matrix"]
            records[node] = record
        above = read.tree.parents[node]
        over = _poses_of_parent(rig, posed, node)
        local = over[:, :3, :3].mT @ posed[node][:, :3, :3]
        if node == rig.hips:
            back = np.eye(4) if above < 0 else np.linalg.inv(read.world[above])
            places = so3.transform(torch.from_numpy(back), posed[node][:, :3, 3])
            tracks.append((node, "translation", places.numpy()))
        tracks.append((node, "rotation", quaternions(local[:, None])[:, 0].numpy()))
    times = np.arange(motion.frames) / motion.fps
    read.file.write_with_animation(path, "motion", times, tracks, records)
    return AnimatedCharacter(
        read.bones.names_by_joint(read.tree.names), ratio, _warnings(read, motion)
    )


def retargeted_to_character(
    motion: Motion, body: BodyModel, character: Character, ground: float
) -> tuple[CharacterRig, CharacterPose, float]:
    """Retarget a motion to a character; return rig, poses and the ratio of leg lengths.

    Every bone turns as the person's does, from the same rest pose. The middle of the hips follows
    the person's path, scaled by the ratio of the legs about its start. Then standing feet and
    touching hands keep their contacts (`Limb.end_targets`) by inverse kinematics of the two bones
    above: hips sink where a leg is too short, and rise where other parts would be in the ground.
    """
    rig, person = CharacterRig.of(character, motion, body), PersonMotion.of(motion, body, ground)
    up = torch.from_numpy(to_z_up("y").T).to(motion.translation)
    turns = {node: up @ turn for node, turn in node_rotations(character, motion, body).items()}
    legs = [Limb.of(rig, side, LEG, person) for side in SIDES]
    arms = [Limb.of(rig, side, ARM, person) for side in SIDES]
    nodes = character.bones.nodes
    low = 0.0 if character.lowest_height is None else character.lowest_height
    depth = float(np.mean([character.rest_positions[one.chain[2], 1] for one in legs])) - low
    ratio = (float(np.mean([leg.length for leg in legs])) + max(depth, 0.0)) / person.leg
    free = CharacterPose(turns, motion.translation * 0)
    posed = rig.node_transforms(free)
    hips = torch.stack([posed[nodes[f"{side}_hip"]][:, :3, 3] for side in SIDES]).mean(0)
    begin = person.middle[0] * person.middle.new_tensor([1.0, 1.0, 0.0]) + ground * _UP[[0, 2, 1]]
    way = (begin + ratio * (person.middle - begin)) @ up.T
    # where the person's soles are below the ground, the character is raised by that depth
    soles = torch.stack([one.contacts.height for one in legs]).amin(0)
    raised = ratio * upper_envelope((-soles).clamp(min=0.0), motion.fps)
    free = replace(free, hips=way - hips + raised[:, None] * _UP)
    carried, feet, hands = free, *({k for one in two for k in one.tip} for two in (legs, arms))
    # parts below the ground raise the hips: first all but feet and hands, then also the hands
    for lifted in (feet | hands, feet, feet):
        skin = rig.points(
            rig.node_transforms(carried), [k for k in character.animated_nodes if k not in lifted]
        )
        if skin.shape[1]:
            sunk = (ground - skin[..., 1].amin(1)).clamp(min=0.0)
            free = replace(free, hips=free.hips + upper_envelope(sunk, motion.fps)[:, None] * _UP)
        posed = rig.node_transforms(free)
        goals = [one.end_targets(posed, motion.fps, ratio, ground) for one in legs]
        short = [one.sink_needed(posed, goal) for one, goal in zip(legs, goals, strict=True)]
        sinks = upper_envelope(torch.stack(short).amax(0), motion.fps)
        free = replace(free, hips=free.hips - sinks[:, None] * _UP)
        carried = _with_limbs_at_goals(rig, free, legs, motion.fps, ratio, ground)
        carried = _with_limbs_at_goals(rig, carried, arms, motion.fps, ratio, ground)
    return rig, carried, ratio


def _with_limbs_at_goals(
    rig: CharacterRig,
    pose: CharacterPose,
    limbs: list[Limb],
    fps: float,
    ratio: float,
    ground: float,
) -> CharacterPose:
    """Turn the limbs of a pose so that their ends reach their goals."""
    posed, turns = rig.node_transforms(pose), dict(pose.turns)
    for one in limbs:
        goal = one.end_targets(posed, fps, ratio, ground)
        for node, turn in one.rotations_reaching(posed, goal).items():
            turns[node] = turn @ turns[node]
    return replace(pose, turns=turns)


def _animated_nodes(character: Character, motion: Motion) -> list[int]:
    """List the nodes that the animation turns; fingers only where the motion has some."""
    idle = {
        node for joint, node in character.bones.nodes.items()
        if motion.hands is None and joint in HAND_JOINTS
    }  # fmt: skip
    return [node for node in character.animated_nodes if node not in idle]


def _poses_of_parent(rig: CharacterRig, posed: Posed, node: int) -> Float[Tensor, "time 4 4"]:
    """Return a node's parent's pose in every frame; nodes between animated ones stay at rest."""
    character = rig.character
    path = character.tree.path_to_root(node)[1:]
    rest = character.rotations_in_file
    if not path:
        return torch.eye(4, dtype=torch.float64).expand(len(posed[node]), 4, 4)
    driven = next((k for k in path if k in posed), None)
    if driven is None:
        return so3.rigid(rest[path[0]], torch.zeros(3).double()).expand(len(posed[node]), 4, 4)
    between = rest[driven].mT @ rest[path[0]]
    return so3.rigid(posed[driven][:, :3, :3] @ between, posed[driven][:, :3, 3])


def _translation_rotation_scale(matrix: Float[np.ndarray, "4 4"]) -> dict[str, list[float]]:
    """Split a matrix into translation, rotation and scale, as glTF animates no matrices."""
    sizes = np.linalg.norm(matrix[:3, :3], axis=0)
    turn = torch.from_numpy(matrix[:3, :3] / sizes)
    return {
        "translation": matrix[:3, 3].tolist(),
        "rotation": quaternions(turn[None, None])[0, 0].tolist(),
        "scale": sizes.tolist(),
    }


def _warnings(character: Character, motion: Motion) -> tuple[str, ...]:
    """Return warnings about bones, soles and fingers that were guessed or left out."""
    path, found = character.file.path, list(character.warnings)
    if character.bones.by_tree:
        found.append(
            f"{path}: names tell nothing of {', '.join(character.bones.by_tree)}; these bones "
            "were found by the tree and their places: look at the table of bones"
        )
    if character.lowest_height is None:
        found.append(
            f"{path}: the mesh is compressed; soles are taken to be at the joints of the feet"
        )
    if motion.hands is not None and not any(j in HAND_JOINTS for j in character.bones.nodes):
        found.append(f"{path}: no fingers were found; those of the motion are left out")
    return tuple(found)

"""Imports a BVH and a glTF file in Blender; runs in a Python with `bpy`, without recon.

python in_blender.py FILE.bvh FILE.glb OUT.npz OUT.fbx FRAMES FPS
"""

import json
import sys
from pathlib import Path

import bpy
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from to_fbx import to_fbx


def emptied() -> None:
    bpy.ops.wm.read_factory_settings(use_empty=True)


def armature() -> bpy.types.Object:
    (found,) = [one for one in bpy.data.objects if one.type == "ARMATURE"]
    return found


def heads(frames: range) -> dict[str, np.ndarray]:
    """Return the positions of all bones' heads in the world at some frames, metres."""
    rig = armature()
    found: dict[str, list] = {bone.name: [] for bone in rig.pose.bones}
    for frame in frames:
        bpy.context.scene.frame_set(frame)
        for bone in rig.pose.bones:
            found[bone.name].append(list(rig.matrix_world @ bone.head))
    return {name: np.array(places) for name, places in found.items()}


def skin(frames: range) -> np.ndarray:
    """Return the vertices of the skinned mesh in the world at some frames, metres."""
    (mesh,) = [one for one in bpy.data.objects if one.type == "MESH" and one.vertex_groups]
    found = []
    for frame in frames:
        bpy.context.scene.frame_set(frame)
        posed = mesh.evaluated_get(bpy.context.evaluated_depsgraph_get())
        found.append([list(posed.matrix_world @ v.co) for v in posed.data.vertices])
    return np.array(found)


def main(bvh: str, glb: str, out: str, fbx: str, frames: int, fps: float) -> None:
    arrays: dict[str, np.ndarray] = {}
    emptied()
    bpy.ops.import_anim.bvh(filepath=bvh, global_scale=0.01)
    ends = {b.name: list(b.tail_local) for b in armature().data.bones if not b.children}
    # the first frame of a BVH is Blender's frame 1
    for name, places in heads(range(1, frames + 1)).items():
        arrays[f"bvh {name}"] = places
    parents = {b.name: b.parent.name if b.parent else None for b in armature().data.bones}
    emptied()
    bpy.context.scene.render.fps = round(fps)
    bpy.ops.import_scene.gltf(filepath=glb)
    arrays["gltf skin"] = skin(range(0, frames, 10))
    for name, places in heads(range(frames)).items():
        arrays[f"gltf {name}"] = places
    to_fbx(glb, fbx, fps)
    emptied()
    bpy.context.scene.render.fps = round(fps)
    bpy.ops.import_scene.fbx(filepath=fbx)
    first = int(bpy.data.actions[0].frame_range[0])
    for name, places in heads(range(first, first + frames)).items():
        arrays[f"fbx {name}"] = places
    np.savez(out, **arrays)
    sys.stdout.write(
        json.dumps({"version": bpy.app.version_string, "parents": parents, "ends": ends}) + "\n"
    )


if __name__ == "__main__":
    *files, count, rate = sys.argv[1:]
    main(*files, int(count), float(rate))

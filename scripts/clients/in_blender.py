"""Imports a BVH and a glTF file in Blender; runs in a Python with `bpy`, without recon.

python in_blender.py FILE.bvh FILE.glb OUT.npz OUT.fbx FRAMES FPS

Beside OUT.npz it writes metarig.glb, Rigify's human metarig.
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


def heads(kind: str, frames: range) -> dict[str, np.ndarray]:
    """Return the places (m) of all bones' heads in the world, keyed "<kind> <name of bone>"."""
    rig = armature()
    places = []
    for frame in frames:
        bpy.context.scene.frame_set(frame)
        places.append([list(rig.matrix_world @ bone.head) for bone in rig.pose.bones])
    found = zip(rig.pose.bones, np.moveaxis(places, 1, 0), strict=True)
    return {f"{kind} {bone.name}": of_bone for bone, of_bone in found}


def skin(frames: range) -> np.ndarray:
    """Return the vertices of the skinned mesh in the world at some frames, metres."""
    (mesh,) = [one for one in bpy.data.objects if one.type == "MESH" and one.vertex_groups]
    found = []
    for frame in frames:
        bpy.context.scene.frame_set(frame)
        posed = mesh.evaluated_get(bpy.context.evaluated_depsgraph_get())
        found.append([list(posed.matrix_world @ v.co) for v in posed.data.vertices])
    return np.array(found)


def write_metarig(glb: str) -> None:
    """Write Rigify's human metarig, with a cube as its skin."""
    emptied()
    bpy.ops.preferences.addon_enable(module="rigify")
    bpy.ops.object.armature_human_metarig_add()
    rig = bpy.context.object
    bpy.ops.mesh.primitive_cube_add()
    bpy.context.object.vertex_groups.new(name="spine").add(range(8), 1.0, "REPLACE")
    bpy.context.object.modifiers.new("rig", "ARMATURE").object = rig
    bpy.ops.export_scene.gltf(filepath=glb)


def main(bvh: str, glb: str, out: str, fbx: str, frames: int, fps: float) -> None:
    emptied()
    bpy.ops.import_anim.bvh(filepath=bvh, global_scale=0.01)
    # the first frame of a BVH is Blender's frame 1
    arrays = heads("bvh", range(1, frames + 1))
    parents = {b.name: b.parent.name if b.parent else None for b in armature().data.bones}
    emptied()
    bpy.context.scene.render.fps = round(fps)
    bpy.ops.import_scene.gltf(filepath=glb)
    arrays["gltf skin"] = skin(range(0, frames, 10))
    arrays |= heads("gltf", range(frames))
    to_fbx(glb, fbx, fps)
    emptied()
    bpy.context.scene.render.fps = round(fps)
    bpy.ops.import_scene.fbx(filepath=fbx)
    first = int(bpy.data.actions[0].frame_range[0])
    arrays |= heads("fbx", range(first, first + frames))
    write_metarig(str(Path(out).with_name("metarig.glb")))
    np.savez(out, **arrays)
    sys.stdout.write(json.dumps({"version": bpy.app.version_string, "parents": parents}) + "\n")


if __name__ == "__main__":
    *files, count, rate = sys.argv[1:]
    main(*files, int(count), float(rate))

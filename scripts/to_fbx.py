"""Converts a glTF file to FBX by Blender (4.2 or newer), without its window.

    blender --background --python scripts/to_fbx.py -- motion.glb motion.fbx 30

or, with Blender as a Python package (pip install bpy), `python scripts/to_fbx.py motion.glb
motion.fbx 30`. The last number is the rate of the motion, frames per second: Blender counts
frames, and would otherwise play 24 a second.
"""

import sys

import bpy


def to_fbx(glb: str, fbx: str, fps: float) -> None:
    bpy.ops.wm.read_factory_settings(use_empty=True)
    render = bpy.context.scene.render
    render.fps, render.fps_base = round(fps), round(fps) / fps
    bpy.ops.import_scene.gltf(filepath=glb)
    # all keys are kept, and no bones are added at the ends
    bpy.ops.export_scene.fbx(filepath=fbx, add_leaf_bones=False, bake_anim_simplify_factor=0.0)


if __name__ == "__main__":
    words = sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else sys.argv[1:]
    to_fbx(words[0], words[1], float(words[2]))

"""Writes a motion as USD: a skinned mesh with an animated skeleton (UsdSkel).

It needs the package usd-core (`pip install motion-recon[usd]`), which is loaded when a file is
written.
"""

import re
import shutil
from importlib import import_module
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from jaxtyping import Float

from recon.body.model import BodyModel
from recon.core.bone_names import BoneNames, joint_names_in
from recon.core.errors import ReconError, optional_module
from recon.core.motion import Motion
from recon.core.skeleton import JOINTS, PARENTS
from recon.export.skeleton import Skeleton, largest_skin_weights, one_clip, quaternions
from recon.formats.replacing import replacing

SUFFIXES = (".usd", ".usda", ".usdc")
_COLOUR = (0.55, 0.65, 0.8)


def write_usd(path: Path, motion: Motion, body: BodyModel, names: BoneNames = "smpl") -> None:
    """Write one clip as USD: metres, z up, one time code per frame from 0 on.

    All skinning weights are kept. Corrective offsets of SMPL bodies are left out. The motion's
    start time stands in the layer's custom data as `start_time`, seconds.

    Args:
        path: file to write; .usda is text, .usd and .usdc are binary.
        motion: one clip without a batch axis.
        body: the body model of the motion.
        names: of joints; USD allows letters, digits and underscores, others become underscores.

    Raises:
        ValueError: when the motion has a batch axis, the file another ending, or usd-core is not
            installed.
    """
    motion = one_clip(motion)
    if path.suffix.lower() not in SUFFIXES:
        raise ReconError(f"{path}: expected an ending {', '.join(SUFFIXES)}, got {path.suffix!r}")
    optional_module("pxr.UsdSkel", "usd-core", "writing USD", "usd")
    with replacing(path) as beside, TemporaryDirectory() as folder:
        # first write a file with a plain name: the library parses arguments in file names
        staged = Path(folder) / f"motion{path.suffix.lower()}"
        _write_stage(staged, motion, body, names)
        shutil.copyfile(staged, beside)


def joint_paths(
    names: BoneNames = "smpl",
    joints: tuple[str, ...] = JOINTS,
    parents: tuple[int, ...] = PARENTS,
) -> list[str]:
    """Return UsdSkel's name of every joint: its path in the tree, as pelvis/left_hip/left_knee."""
    paths: list[str] = []
    told = (re.sub(r"\W", "_", name) for name in joint_names_in(joints, names))
    for name, parent in zip(told, parents, strict=True):
        paths.append(name if parent < 0 else f"{paths[parent]}/{name}")
    return paths


def _write_stage(path: Path, motion: Motion, body: BodyModel, names: BoneNames) -> None:
    """Write a USD stage with one person: skeleton, animation and skinned mesh."""
    pxr: Any = import_module("pxr")
    bones = Skeleton.of(motion, body)
    joints = joint_paths(names, bones.names, bones.parents)
    rest = body.rest_joints(motion.shape).detach().double().cpu().numpy()
    stage = pxr.Usd.Stage.CreateNew(str(path))
    pxr.UsdGeom.SetStageUpAxis(stage, pxr.UsdGeom.Tokens.z)
    pxr.UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    stage.SetTimeCodesPerSecond(motion.fps)
    stage.SetFramesPerSecond(motion.fps)
    stage.SetStartTimeCode(0)
    stage.SetEndTimeCode(motion.frames - 1)
    layer = stage.GetRootLayer()
    layer.customLayerData = {"start_time": motion.start_time, "generator": "recon"}
    root = pxr.UsdSkel.Root.Define(stage, "/person")
    stage.SetDefaultPrim(root.GetPrim())
    skeleton = pxr.UsdSkel.Skeleton.Define(stage, "/person/skeleton")
    skeleton.CreateJointsAttr(pxr.Vt.TokenArray(joints))
    # bind transforms are joints at rest in the world, rest transforms are relative to parents
    skeleton.CreateBindTransformsAttr(_usd_matrices(pxr, np.linalg.inv(bones.binds.astype(float))))
    apart = np.tile(np.eye(4), (len(joints), 1, 1))
    apart[:, :3, 3] = bones.offsets
    skeleton.CreateRestTransformsAttr(_usd_matrices(pxr, apart))
    animation = pxr.UsdSkel.Animation.Define(stage, "/person/motion")
    _write_animation(pxr, animation, motion, bones, joints)
    binding = pxr.UsdSkel.BindingAPI.Apply(skeleton.GetPrim())
    binding.CreateAnimationSourceRel().SetTargets([animation.GetPath()])
    mesh = pxr.UsdGeom.Mesh.Define(stage, "/person/body")
    _write_skin(
        pxr, mesh, skeleton, body, bones, body.rest_vertices(motion.shape).detach().cpu().numpy()
    )
    # viewers show the body only inside a bounding box, here a cube of half size `reach`
    reach = float(np.linalg.norm(rest - rest[0], axis=-1).max()) + 0.5
    middle = motion.translation.double().numpy() + rest[0]
    extent = root.CreateExtentAttr()
    for frame in range(0, motion.frames, max(int(motion.fps), 1)):
        corners = np.stack((middle[frame] - reach, middle[frame] + reach))
        extent.Set(_bounding_box(pxr, corners), frame)
    layer.Save()


def _usd_matrices(pxr: Any, transforms: Float[np.ndarray, "joints 4 4"]) -> Any:
    """Convert transforms to matrices of USD, transposed since USD multiplies row vectors."""
    rows = transforms.transpose(0, 2, 1).tolist()
    return pxr.Vt.Matrix4dArray(
        [pxr.Gf.Matrix4d(*(x for row in one for x in row)) for one in rows]
    )


def _write_animation(
    pxr: Any,
    animation: Any,
    motion: Motion,
    bones: Skeleton,
    joints: list[str],
) -> None:
    """Write the rotations of all joints and the path of the pelvis into an animation."""
    animation.CreateJointsAttr(pxr.Vt.TokenArray(joints))
    turns = quaternions(bones.rotations.double()).numpy().astype(np.float32)
    places = np.tile(bones.offsets.astype(float), (motion.frames, 1, 1))
    places[:, 0] += motion.translation.double().numpy()
    rotations, translations = animation.CreateRotationsAttr(), animation.CreateTranslationsAttr()
    ones = np.ones((len(joints), 3), np.float16)
    animation.CreateScalesAttr(pxr.Vt.Vec3hArray.FromNumpy(ones))
    for frame, (turn, place) in enumerate(zip(turns, places.astype(np.float32), strict=True)):
        rotations.Set(pxr.Vt.QuatfArray.FromNumpy(turn), frame)
        translations.Set(pxr.Vt.Vec3fArray.FromNumpy(place), frame)


def _write_skin(
    pxr: Any,
    mesh: Any,
    skeleton: Any,
    body: BodyModel,
    bones: Skeleton,
    vertices: Float[np.ndarray, "vertices 3"],
) -> None:
    """Write the unposed surface and its skinning weights into a mesh."""
    integers, numbers = pxr.Vt.IntArray.FromNumpy, pxr.Vt.FloatArray.FromNumpy
    faces = body.faces.cpu().numpy().astype(np.int32)
    mesh.CreatePointsAttr(pxr.Vt.Vec3fArray.FromNumpy(vertices.astype(np.float32)))
    mesh.CreateFaceVertexCountsAttr(integers(np.full(len(faces), 3, np.int32)))
    mesh.CreateFaceVertexIndicesAttr(integers(faces.reshape(-1)))
    mesh.CreateSubdivisionSchemeAttr(pxr.UsdGeom.Tokens.none)
    mesh.CreateDisplayColorAttr([pxr.Gf.Vec3f(*_COLOUR)])
    mesh.CreateExtentAttr(_bounding_box(pxr, vertices))
    weights, joints = largest_skin_weights(bones.weights)
    count = weights.shape[1]
    binding = pxr.UsdSkel.BindingAPI.Apply(mesh.GetPrim())
    binding.CreateSkeletonRel().SetTargets([skeleton.GetPath()])
    indices = integers(joints.astype(np.int32).reshape(-1))
    binding.CreateJointIndicesPrimvar(False, count).Set(indices)
    binding.CreateJointWeightsPrimvar(False, count).Set(numbers(weights.reshape(-1)))
    binding.CreateGeomBindTransformAttr(pxr.Gf.Matrix4d(1.0))


def _bounding_box(pxr: Any, points: Float[np.ndarray, "points 3"]) -> Any:
    corners = np.stack((points.min(0), points.max(0))).astype(np.float32)
    return pxr.Vt.Vec3fArray.FromNumpy(corners)

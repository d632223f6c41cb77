"""USD (.usd, .usda, .usdc): the body as a skinned mesh with an animated skeleton (UsdSkel).

It needs the package usd-core (`pip install motion-recon[usd]`), which is loaded when a file is
written.
"""

from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float

from recon.body.model import BodyModel
from recon.core.errors import ReconError
from recon.core.motion import Motion
from recon.core.skeleton import JOINTS, PARENTS
from recon.export.gltf import quaternions
from recon.formats.opening import replacing

SUFFIXES = (".usd", ".usda", ".usdc")
_COLOUR = (0.55, 0.65, 0.8)


def write_usd(path: Path, motion: Motion, body: BodyModel) -> None:
    """Write one clip: metres, z up, a time code per frame from 0 on.

    All skinning weights are kept. Corrective offsets of SMPL bodies are left out. The motion's
    start time stands in the layer's custom data as `start_time`, seconds.

    Args:
        path: file to write; .usda is text, .usd and .usdc are binary.
        motion: one clip without a batch axis.
        body: whose motion it is.

    Raises:
        ValueError: when the motion has a batch axis, the file another ending, or usd-core is not
            installed.
    """
    if motion.translation.ndim != 2:
        raise ReconError("expected one clip without a batch axis; export motion[k]")
    if path.suffix.lower() not in SUFFIXES:
        raise ReconError(f"{path}: expected an ending {', '.join(SUFFIXES)}, got {path.suffix!r}")
    _check_installed()
    with replacing(path) as beside:
        # the library tells the kind of file by its name
        staged = beside.with_name(f"{beside.name}{path.suffix}")
        try:
            _Scene(motion, body).save(staged)
            staged.replace(beside)
        finally:
            staged.unlink(missing_ok=True)


def _check_installed() -> None:
    try:
        import_module("pxr.UsdSkel")
    except ImportError as error:
        raise ReconError(
            "writing USD needs the package usd-core, which is not installed: "
            "pip install 'motion-recon[usd]'"
        ) from error


def joint_paths() -> list[str]:
    """Every joint with those above it, as UsdSkel names them: pelvis/left_hip/left_knee."""
    paths: list[str] = []
    for name, parent in zip(JOINTS, PARENTS, strict=True):
        paths.append(name if parent < 0 else f"{paths[parent]}/{name}")
    return paths


class _Scene:
    """A stage with one person."""

    def __init__(self, motion: Motion, body: BodyModel) -> None:
        self.gf: Any = import_module("pxr.Gf")
        self.sdf: Any = import_module("pxr.Sdf")
        self.usd: Any = import_module("pxr.Usd")
        self.geometry: Any = import_module("pxr.UsdGeom")
        self.skel: Any = import_module("pxr.UsdSkel")
        self.vt: Any = import_module("pxr.Vt")
        self.motion = motion.window(0, int(motion.valid.sum())).detach().to(device="cpu")
        self.body = body
        self.rest = body.rest_joints(self.motion.shape).detach().double().cpu().numpy()

    def save(self, path: Path) -> None:
        """Make the stage and write it."""
        stage = self.usd.Stage.CreateNew(str(path))
        self.geometry.SetStageUpAxis(stage, self.geometry.Tokens.z)
        self.geometry.SetStageMetersPerUnit(stage, 1.0)
        stage.SetTimeCodesPerSecond(self.motion.fps)
        stage.SetFramesPerSecond(self.motion.fps)
        stage.SetStartTimeCode(0)
        stage.SetEndTimeCode(self.motion.frames - 1)
        layer = stage.GetRootLayer()
        layer.customLayerData = {"start_time": self.motion.start_time, "generator": "recon"}
        root = self.skel.Root.Define(stage, "/person")
        stage.SetDefaultPrim(root.GetPrim())
        skeleton = self.skel.Skeleton.Define(stage, "/person/skeleton")
        self._bind(skeleton)
        animation = self.skel.Animation.Define(stage, "/person/motion")
        self._animate(animation)
        binding = self.skel.BindingAPI.Apply(skeleton.GetPrim())
        binding.CreateAnimationSourceRel().SetTargets([animation.GetPath()])
        self._skin(self.geometry.Mesh.Define(stage, "/person/body"), skeleton)
        self._bound(root)
        layer.Save()

    def _bind(self, skeleton: Any) -> None:
        """The skeleton of the unposed body: in the world, and every joint in its parent."""
        skeleton.CreateJointsAttr(self.vt.TokenArray(joint_paths()))
        above = np.where(np.array(PARENTS)[:, None] < 0, 0.0, self.rest[list(PARENTS)])
        skeleton.CreateBindTransformsAttr(self._placed(self.rest))
        skeleton.CreateRestTransformsAttr(self._placed(self.rest - above))

    def _placed(self, places: Float[np.ndarray, "joints 3"]) -> Any:
        matrices = [
            self.gf.Matrix4d(1.0).SetTranslate(self.gf.Vec3d(*place)) for place in places.tolist()
        ]
        return self.vt.Matrix4dArray(matrices)

    def _animate(self, animation: Any) -> None:
        """Rotations of all joints and the path of the pelvis."""
        animation.CreateJointsAttr(self.vt.TokenArray(joint_paths()))
        turns = quaternions(self.motion.rotations.double()).numpy().astype(np.float32)
        above = np.where(np.array(PARENTS)[:, None] < 0, 0.0, self.rest[list(PARENTS)])
        places = np.tile(self.rest - above, (self.motion.frames, 1, 1))
        places[:, 0] = self.motion.translation.double().numpy() + self.rest[0]
        rotations, translations = (
            animation.CreateRotationsAttr(),
            animation.CreateTranslationsAttr(),
        )
        ones = np.ones((len(JOINTS), 3), np.float16)
        animation.CreateScalesAttr(self.vt.Vec3hArray.FromNumpy(ones))
        for frame, (turn, place) in enumerate(zip(turns, places.astype(np.float32), strict=True)):
            rotations.Set(self.vt.QuatfArray.FromNumpy(turn), frame)
            translations.Set(self.vt.Vec3fArray.FromNumpy(place), frame)

    def _skin(self, mesh: Any, skeleton: Any) -> None:
        """The unposed surface with its weights."""
        vertices = self.body.rest_vertices(self.motion.shape).detach().cpu().numpy()
        faces = self.body.faces.cpu().numpy().astype(np.int32)
        mesh.CreatePointsAttr(self.vt.Vec3fArray.FromNumpy(vertices.astype(np.float32)))
        mesh.CreateFaceVertexCountsAttr(
            self.vt.IntArray.FromNumpy(np.full(len(faces), 3, np.int32))
        )
        mesh.CreateFaceVertexIndicesAttr(self.vt.IntArray.FromNumpy(faces.reshape(-1)))
        mesh.CreateSubdivisionSchemeAttr(self.geometry.Tokens.none)
        mesh.CreateDisplayColorAttr([self.gf.Vec3f(*_COLOUR)])
        mesh.CreateExtentAttr(self._extent(vertices))
        weights, joints = self.body.weights.double().sort(dim=-1, descending=True, stable=True)
        count = int((weights > 0).sum(-1).max())
        weights, joints = weights[:, :count], joints[:, :count]
        weights = (weights / weights.sum(-1, keepdim=True)).float()
        joints = torch.where(weights > 0, joints, 0).int()
        binding = self.skel.BindingAPI.Apply(mesh.GetPrim())
        binding.CreateSkeletonRel().SetTargets([skeleton.GetPath()])
        binding.CreateJointIndicesPrimvar(False, count).Set(
            self.vt.IntArray.FromNumpy(joints.cpu().numpy().reshape(-1))
        )
        binding.CreateJointWeightsPrimvar(False, count).Set(
            self.vt.FloatArray.FromNumpy(weights.cpu().numpy().reshape(-1))
        )
        binding.CreateGeomBindTransformAttr(self.gf.Matrix4d(1.0))

    def _bound(self, root: Any) -> None:
        """Say where the body is at some moments: viewers need not skin it to find it."""
        reach = float(np.linalg.norm(self.rest - self.rest[0], axis=-1).max()) + 0.5
        middle = self.motion.translation.double().numpy() + self.rest[0]
        extent = root.CreateExtentAttr()
        for frame in range(0, self.motion.frames, max(int(self.motion.fps), 1)):
            extent.Set(
                self._extent(np.stack((middle[frame] - reach, middle[frame] + reach))), frame
            )

    def _extent(self, points: Float[np.ndarray, "points 3"]) -> Any:
        corners = np.stack((points.min(0), points.max(0))).astype(np.float32)
        return self.vt.Vec3fArray.FromNumpy(corners)

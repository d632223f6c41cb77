"""Writes a motion as glTF 2.0 (.glb): a skinned mesh with an animated skeleton."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pygltflib as gltf
import torch
from jaxtyping import Float
from torch import Tensor

from recon.body.model import BodyModel
from recon.core import rotations as so3
from recon.core.bone_names import BoneNames, joint_names_in
from recon.core.motion import Motion
from recon.core.raster import differentiable_normals
from recon.core.units import to_z_up
from recon.export.skeleton import Skeleton, largest_skin_weights, one_clip, quaternions
from recon.formats.replacing import replacing

INFLUENCES = 4
"""Number of joints that move a vertex: more are legal, but many readers take the first four."""
_HALF = 0.5**0.5


def write_glb(path: Path, motion: Motion, body: BodyModel, names: BoneNames = "smpl") -> None:
    """Write one clip as GLB, frame k at k / fps seconds; `asset.extras` has the start time.

    The node `z_up` above the skeleton turns our z up to glTF's y up. Vertices keep their four
    largest weights, scaled to sum to one. Corrective offsets of SMPL bodies are left out.

    With the names `vrm` the file is a VRM 1.0 avatar and a VRM animation: the body at rest stands
    upright on y = 0, and the root's motion has y up without a node `z_up`.

    Raises:
        ReconError: when the motion has a batch axis.
    """
    motion = one_clip(motion)
    vertices = body.rest_vertices(motion.shape).detach()
    avatar = names == "vrm"
    if avatar:
        turn = torch.from_numpy(to_z_up("y").T).to(motion.translation)
        upright = so3.rigid(turn, turn.new_zeros(3))
        motion = motion.carried(upright, body.rest_joints(motion.shape)[0].detach())
    skeleton, file = Skeleton.of(motion, body), _Buffer()
    mesh = file.add_mesh(vertices, body, skeleton)
    inverse = skeleton.binds.transpose(0, 2, 1).reshape(-1, 16)
    matrices = file.add(inverse, gltf.FLOAT, gltf.MAT4)
    animation = file.add_animation(motion, skeleton)
    count = len(skeleton.names)
    nodes = [
        gltf.Node(
            name=name,
            translation=skeleton.offsets[j].tolist(),
            children=[c for c, p in enumerate(skeleton.parents) if p == j] or None,
        )
        for j, name in enumerate(joint_names_in(skeleton.names, names))
    ]
    nodes.append(gltf.Node(name="body", mesh=0, skin=0))
    if avatar:
        x, y, z = skeleton.offsets[0].tolist()
        nodes[0].translation = [x, y - float(vertices[:, 1].min()), z]
    else:
        nodes.append(gltf.Node(name="z_up", rotation=[-_HALF, 0.0, 0.0, _HALF], children=[0]))
    skin = gltf.Skin(joints=list(range(count)), inverseBindMatrices=matrices, skeleton=0)
    paint = gltf.PbrMetallicRoughness(
        baseColorFactor=[0.55, 0.65, 0.8, 1.0], metallicFactor=0.0, roughnessFactor=0.8
    )
    document = gltf.GLTF2(
        asset=gltf.Asset(
            version="2.0", generator="recon", extras={"start_time": motion.start_time}
        ),
        scene=0,
        # a skinned mesh must be a root node, since only its joints move it
        scenes=[gltf.Scene(nodes=[count, 0 if avatar else count + 1])],
        nodes=nodes,
        meshes=[mesh],
        skins=[skin],
        materials=[gltf.Material(name="body", pbrMetallicRoughness=paint)],
        animations=[animation],
        accessors=file.accessors,
        bufferViews=file.views,
        buffers=[gltf.Buffer(byteLength=len(file.data))],
    )
    if avatar:
        document.extensions = _vrm_extensions(joint_names_in(skeleton.names, names))
        document.extensionsUsed = list(document.extensions)
    document.set_binary_blob(bytes(file.data))
    with replacing(path) as beside:
        document.save_binary(str(beside))


def _vrm_extensions(bones: Sequence[str]) -> dict[str, Any]:
    """Make the VRM 1.0 extensions of glTF that say which nodes are a person's bones."""
    humanoid = {"humanBones": {bone: {"node": k} for k, bone in enumerate(bones)}}
    told = {"specVersion": "1.0", "humanoid": humanoid}
    licence = "https://vrm.dev/licenses/1.0/"
    meta = {"name": "body", "authors": ["recon"], "licenseUrl": licence}
    return {"VRMC_vrm": told | {"meta": meta}, "VRMC_vrm_animation": told}


class _Buffer:
    """The growing binary part of a .glb, with its buffer views and accessors."""

    def __init__(self) -> None:
        self.data = bytearray()
        self.views: list[Any] = []
        self.accessors: list[Any] = []

    def add(self, array: np.ndarray, component: int, kind: str, target: int | None = None) -> int:
        """Append an array with a row per element; returns its accessor's number."""
        array = np.ascontiguousarray(array)
        self.views.append(
            gltf.BufferView(
                buffer=0, byteOffset=len(self.data), byteLength=array.nbytes, target=target
            )
        )
        self.data += array.tobytes() + bytes(-array.nbytes % 4)
        bounded = kind in (gltf.VEC3, gltf.SCALAR) and array.dtype == np.float32
        rows = array.reshape(len(array), -1)
        self.accessors.append(
            gltf.Accessor(
                bufferView=len(self.views) - 1,
                componentType=component,
                count=len(array),
                type=kind,
                min=rows.min(0).tolist() if bounded else None,
                max=rows.max(0).tolist() if bounded else None,
            )
        )
        return len(self.accessors) - 1

    def add_mesh(
        self, vertices: Float[Tensor, "vertices 3"], body: BodyModel, skeleton: Skeleton
    ) -> Any:
        """Append the body at rest with its skinning weights as a mesh."""
        weights, joints = largest_skin_weights(skeleton.weights, INFLUENCES)
        normals = _float32_array(differentiable_normals(vertices.double(), body.faces))
        attributes = gltf.Attributes(
            POSITION=self.add(_float32_array(vertices), gltf.FLOAT, gltf.VEC3, gltf.ARRAY_BUFFER),
            NORMAL=self.add(normals, gltf.FLOAT, gltf.VEC3, gltf.ARRAY_BUFFER),
            JOINTS_0=self.add(
                joints.astype(np.uint16), gltf.UNSIGNED_SHORT, gltf.VEC4, gltf.ARRAY_BUFFER
            ),
            WEIGHTS_0=self.add(weights, gltf.FLOAT, gltf.VEC4, gltf.ARRAY_BUFFER),
        )
        faces = body.faces.cpu().numpy().astype(np.uint32).reshape(-1)
        indices = self.add(faces, gltf.UNSIGNED_INT, gltf.SCALAR, gltf.ELEMENT_ARRAY_BUFFER)
        return gltf.Mesh(
            name="body",
            primitives=[gltf.Primitive(attributes=attributes, indices=indices, material=0)],
        )

    def add_animation(self, motion: Motion, skeleton: Skeleton) -> Any:
        """Append an animation of all joints' rotations and the pelvis' path."""
        times = (np.arange(motion.frames) / motion.fps).astype(np.float32)
        clock = self.add(times, gltf.FLOAT, gltf.SCALAR)
        turns = _float32_array(quaternions(skeleton.rotations.double()))
        places = _float32_array(motion.translation) + skeleton.offsets[0]
        tracks = [(0, "translation", places, gltf.VEC3)]
        tracks += [(j, "rotation", turns[:, j], gltf.VEC4) for j in range(turns.shape[1])]
        samplers, channels = [], []
        for node, property_, values, kind in tracks:
            output = self.add(values, gltf.FLOAT, kind)
            samplers.append(
                gltf.AnimationSampler(input=clock, output=output, interpolation="LINEAR")
            )
            target = gltf.AnimationChannelTarget(node=node, path=property_)
            channels.append(gltf.AnimationChannel(sampler=len(samplers) - 1, target=target))
        return gltf.Animation(name="motion", samplers=samplers, channels=channels)


def _float32_array(tensor: Tensor) -> np.ndarray:
    return tensor.detach().cpu().numpy().astype(np.float32)

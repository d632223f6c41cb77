"""A motion file in the formats of other programs."""

from pathlib import Path

import numpy as np

from recon.body import BodyModel
from recon.formats.bvh_write import skeleton_of, write_bvh
from recon.formats.gltf import write_glb
from recon.formats.ply import write_ply_sequence
from recon.formats.trc import write_trc
from recon.motion_files import load_motion_of
from recon.recording import MarkerRecording


def export_file(
    source: Path,
    *,
    glb: Path | None = None,
    bvh: Path | None = None,
    trc: Path | None = None,
    ply: Path | None = None,
    body: Path | None = None,
) -> None:
    """Write a motion in any of these formats; `ply` is a folder, `body` the motion's own.

    Raises:
        FileNotFoundError: when there is no such motion, or no folder to write into.
        ValueError: when the motion is damaged or of another body.
    """
    model = BodyModel.load(body)
    motion = load_motion_of(source, model).motion
    if glb is not None:
        write_glb(glb, motion, model)
    skeleton = skeleton_of(motion, model, source.stem)
    if bvh is not None:
        write_bvh(bvh, skeleton)
    if trc is not None:
        joints = MarkerRecording(
            name=source.stem,
            marker_names=skeleton.joint_names,
            positions=skeleton.positions,
            visible=np.ones(skeleton.positions.shape[:2], dtype=bool),
            fps=skeleton.fps,
            decisions=(),
        )
        write_trc(trc, joints)
    if ply is not None:
        vertices = model.pose(motion).vertices.numpy()
        write_ply_sequence(ply, vertices, model.faces.numpy())

"""A motion file in the formats of other programs."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from recon.body.model import BodyModel
from recon.body.motion_files import load_motion_of
from recon.formats.clouds.ply import write_ply_sequence
from recon.formats.mocap.recording import MarkerRecording, SkeletonRecording
from recon.formats.mocap.trc import write_trc
from recon.formats.results.outputs import Kind, Output
from recon.formats.results.reports import checksums, versions
from recon.formats.results.writing import writing
from recon.jobs.export.bvh import skeleton_of, write_bvh
from recon.jobs.export.gltf import write_glb
from recon.jobs.view import draw_html, shown


def export_file(
    source: Path,
    *,
    glb: Path | None = None,
    bvh: Path | None = None,
    trc: Path | None = None,
    ply: Path | None = None,
    html: Path | None = None,
    body: Path | None = None,
    overwrite: bool = False,
) -> None:
    """Write a motion in any of these formats, all or none; `ply` is a folder.

    Beside every file is a report, in the folder `report.json`. `body` is the motion's own.

    Raises:
        FileNotFoundError: when there is no such motion.
        ValueError: when the motion is damaged or of another body.
        FileExistsError: when a file to write is there and recon did not write it, unless
            `overwrite`.
    """
    model = BodyModel.load(body)
    motion = load_motion_of(source, model).motion
    skeleton = skeleton_of(motion, model, source.stem)

    def meshes(folder: Path) -> None:
        write_ply_sequence(folder, model.pose(motion).vertices.numpy(), model.faces.numpy())

    every: list[tuple[Path | None, Kind, Callable[[Path], object]]] = [
        (glb, Kind.FILE, lambda path: write_glb(path, motion, model)),
        (bvh, Kind.FILE, lambda path: write_bvh(path, skeleton)),
        (trc, Kind.FILE, lambda path: write_trc(path, markers_of(skeleton))),
        (ply, Kind.FOLDER, meshes),
        (html, Kind.FILE, lambda path: draw_html(path, shown(source, body=body))),
    ]
    asked = [(Output(path, kind), write) for path, kind, write in every if path is not None]
    report = {
        "inputs": checksums([source] if body is None else [source, body]),
        "versions": versions(),
    }
    outputs = [output for output, _ in asked]
    with writing(*outputs, report=report, overwrite=overwrite) as staged:
        for path, (_, write) in zip(staged, asked, strict=True):
            write(path)


def markers_of(skeleton: SkeletonRecording) -> MarkerRecording:
    """The joints of a skeleton as markers that are always seen."""
    return MarkerRecording(
        name=skeleton.name,
        marker_names=skeleton.joint_names,
        positions=skeleton.positions,
        visible=np.ones(skeleton.positions.shape[:2], dtype=bool),
        fps=skeleton.fps,
        decisions=(),
    )

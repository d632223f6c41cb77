"""A motion file in the formats of other programs."""

from collections.abc import Callable
from pathlib import Path
from typing import Literal, cast

from recon.body.angles import OpenSimModel
from recon.body.model import BodyModel
from recon.body.motion_files import load_motion_of
from recon.core.errors import ReconError
from recon.core.units import Axis
from recon.export.bvh import skeleton_of, write_bvh
from recon.export.gltf import write_glb
from recon.export.robots import write_robot, write_smpl
from recon.export.tables import MarkerSetName, markers_of, write_angles, write_mot
from recon.export.usd import write_usd
from recon.formats.mocap.trc import write_trc
from recon.formats.outputs import Kind, Output
from recon.formats.reports import checksums, versions, write_joint_table
from recon.formats.scans import write_ply_sequence
from recon.formats.writing import writing
from recon.jobs.view import draw_html, shown


def export_file(
    source: Path,
    *,
    glb: Path | None = None,
    usd: Path | None = None,
    bvh: Path | None = None,
    trc: Path | None = None,
    mot: Path | None = None,
    angles: Path | None = None,
    joints: Path | None = None,
    robot: Path | None = None,
    smpl: Path | None = None,
    ply: Path | None = None,
    html: Path | None = None,
    markers: MarkerSetName = "joints",
    model: OpenSimModel = "rajagopal2016",
    unit: Literal["m", "cm", "mm"] = "mm",
    up: Axis = "y",
    smplx: Path | None = None,
    onto: Path | None = None,
    body: Path | None = None,
    overwrite: bool = False,
) -> None:
    """Write a motion in any of these formats, all or none; `ply` is a folder.

    Beside every file is a report, in the folder `report.json`. `markers`, `unit` and `up` are of
    the TRC file, `model` is the OpenSim model of the MOT file, `smplx` the body of `robot`, `onto`
    that of `smpl`; `body` is the motion's own.

    Raises:
        FileNotFoundError: when there is no such motion.
        ValueError: when the motion is damaged or of another body.
        FileExistsError: when a file to write is there and recon did not write it, unless
            `overwrite`.
    """
    if robot is not None and smplx is None:
        raise ReconError("a file for robots needs `smplx`, the SMPL-X body that is posed there")
    if smpl is not None and onto is None:
        raise ReconError("a file for SMPL needs `onto`, the body file that is posed there")
    own = BodyModel.load(body)
    file = load_motion_of(source, own)
    motion, name = file.motion, source.stem

    def tracks(path: Path) -> None:
        write_trc(path, markers_of(motion, own, markers, name), unit=unit, up=up)

    def meshes(folder: Path) -> None:
        write_ply_sequence(folder, own.pose(motion).vertices.numpy(), own.faces.numpy())

    every: list[tuple[Path | None, Kind, Callable[[Path], object]]] = [
        (glb, Kind.FILE, lambda path: write_glb(path, motion, own)),
        (usd, Kind.FILE, lambda path: write_usd(path, motion, own)),
        (bvh, Kind.FILE, lambda path: write_bvh(path, skeleton_of(motion, own, name))),
        (trc, Kind.FILE, tracks),
        (mot, Kind.FILE, lambda path: write_mot(path, motion, own, model)),
        (angles, Kind.FILE, lambda path: write_angles(path, motion, own, file.angle_std)),
        (joints, Kind.FILE, lambda path: write_joint_table(path, file, own.pose(motion).joints)),
        (robot, Kind.FILE, lambda path: write_robot(path, motion, own, cast(Path, smplx))),
        (smpl, Kind.FILE, lambda path: write_smpl(path, motion, own, cast(Path, onto))),
        (ply, Kind.FOLDER, meshes),
        (html, Kind.FILE, lambda path: draw_html(path, shown(source, body=body))),
    ]
    asked = [(Output(path, kind), write) for path, kind, write in every if path is not None]
    report = {
        "inputs": checksums([one for one in (source, body, smplx, onto) if one is not None]),
        "versions": versions(),
    }
    outputs = [output for output, _ in asked]
    with writing(*outputs, report=report, overwrite=overwrite) as staged:
        for path, (_, write) in zip(staged, asked, strict=True):
            write(path)

"""`recon export`'s function: writes a motion file in formats of other programs."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, cast

from recon.body.model import BodyModel
from recon.body.motion_files import load_motion_of
from recon.core.errors import ReconError
from recon.core.units import Axis
from recon.export.bvh import skeleton_of, write_bvh
from recon.export.forces import (
    GroundLoads,
    ground_loads,
    write_forces,
    write_moments,
)
from recon.export.gltf import write_glb
from recon.export.robots import write_robot, write_smpl
from recon.export.tables import recorded_markers, write_angles, write_mot
from recon.export.usd import SUFFIXES, write_usd
from recon.formats.joint_table import write_joint_table
from recon.formats.outputs import Output, OutputKind
from recon.formats.reports import checksums, versions
from recon.formats.scans import write_ply_sequence
from recon.formats.writing import writing
from recon.mocap.marker_tables import write_trc
from recon.view.files import draw_html, show_of_files

_STORAGES = (".mot", ".sto", ".csv")
_ENDINGS = {
    "glb": (".glb",), "usd": SUFFIXES, "bvh": (".bvh",), "trc": (".trc",), "mot": _STORAGES,
    "angles": (".csv",), "forces": _STORAGES, "moments": _STORAGES, "joints": (".csv",),
    "html": (".html", ".htm"), "robot": (".npz",), "smpl": (".npz",),
}  # fmt: skip
"""Endings of the files that each option writes."""


@dataclass(frozen=True)
class Exported:
    """The files that were written, with warnings and tables about them."""

    place: str
    """Paths of the written files."""
    warnings: tuple[str, ...] = ()
    tables: Mapping[str, Any] = field(default_factory=dict)
    """Tables of numbers, by title."""


def export_file(
    motion: Path,
    *,
    glb: Path | None = None,
    usd: Path | None = None,
    bvh: Path | None = None,
    trc: Path | None = None,
    mot: Path | None = None,
    forces: Path | None = None,
    moments: Path | None = None,
    angles: Path | None = None,
    joints: Path | None = None,
    robot: Path | None = None,
    smpl: Path | None = None,
    ply: Path | None = None,
    html: Path | None = None,
    names: Literal["smpl", "mixamo", "unreal", "vrm", "rigify", "xsens"] = "smpl",
    markers: Literal["joints", "halpe26", "opencap", "pig", "cmu", "bsm"] = "joints",
    model: Literal["rajagopal2016", "gait2392"] = "rajagopal2016",
    mass: float | None = None,
    plates: Path | None = None,
    unit: Literal["m", "cm", "mm"] = "mm",
    up: Axis = "y",
    smplx: Path | None = None,
    onto: Path | None = None,
    character: Path | None = None,
    bones: Path | None = None,
    body: Path | None = None,
    overwrite: bool = False,
) -> Exported | None:
    """Write a motion for Blender, game engines, biomechanics tools or mesh viewers.

    Args:
        motion: motion file.
        glb: glTF 2.0 with skinned mesh and animation.
        usd: USD with skinned mesh and animation (.usd, .usda, .usdc); needs usd-core.
        bvh: skeleton animation.
        trc: markers for OpenSim and others, those that --markers names.
        mot: coordinates of an OpenSim model, degrees and metres.
        forces: estimated forces of the ground on the feet and their centres of pressure, with
            standard deviations, as OpenSim's external loads (.mot, .sto) or CSV; N, m, y up.
        moments: moments of hips, knees and ankles by inverse dynamics, in the coordinates of
            --model, with standard deviations (.mot, .sto, .csv); from plates where they measured,
            else from estimated forces: a column says which.
        angles: joint angles after the ISB as CSV, degrees.
        joints: positions of the 22 joints as CSV, metres, with their standard deviations.
        robot: SMPL-X .npz for GMR and like loaders, 30 Hz, soles on z = 0; needs --smplx.
        smpl: AMASS .npz on the SMPL-family body of --onto, with betas that are its own.
        ply: folder for one mesh per frame.
        html: self-contained page, as `recon view` writes.
        names: of bones in --glb, --usd and --bvh: ours, or those of Mixamo, of Unreal's UE5
            mannequin, of VRM 1.0 and Unity (a .glb is a VRM then), of Rigify or of Xsens.
        markers: labels of --trc: the 22 joints, keypoints as Pose2Sim names them, OpenCap's 43
            markers, Plug-in Gait or the 105 markers of BSM (SKEL).
        model: OpenSim model whose coordinates --mot and --moments have.
        mass: kg, for --forces and --moments; default: that of the body's shape.
        plates: C3D file of the motion's recording, whose force plates are written beside --forces,
            compared with it, and taken for --moments.
        unit: of --trc.
        up: axis that points up in --trc; y is OpenSim's.
        smplx: the SMPL-X body that the loader of --robot poses, SMPLX_NEUTRAL.npz or .pkl.
        onto: the body file of --smpl (SMPL, SMPL-H, SMPL-X; .npz or .pkl).
        character: your own rigged character (.glb, .vrm, .gltf), which --glb then is, with the
            motion as one animation more.
        bones: TOML file of its bones, lines left_knee = "name"; default: found by names.
        body: the SMPL-family file of the motion's body; default: the bundled body.
        overwrite: replace files that are there and recon did not write.

    Raises:
        FileNotFoundError: when there is no such motion.
        ValueError: when nothing is asked for, options do not go together, or the motion is damaged
            or of another body.
        FileExistsError: when a file to write is there and recon did not write it, unless
            `overwrite`.
    """
    targets = {
        "glb": glb, "usd": usd, "bvh": bvh, "trc": trc, "mot": mot, "angles": angles,
        "forces": forces, "moments": moments,
        "joints": joints, "robot": robot, "smpl": smpl, "html": html,
    }  # fmt: skip
    if ply is None and all(target is None for target in targets.values()):
        options = ", ".join(f"--{name}" for name in targets)
        raise ReconError(f"nothing to write: give {options} FILE or --ply FOLDER")
    of_trc = {"markers": markers != "joints", "unit": unit != "mm", "up": up != "y"}
    _refuse_without_output(of_trc, trc, "trc")
    _refuse_without_output({"model": model != "rajagopal2016"}, mot or moments, "mot")
    _refuse_without_output({"names": names != "smpl"}, glb or usd or bvh, "glb")
    _refuse_without_output({"character": character is not None}, glb, "glb")
    _refuse_without_output({"bones": bones is not None}, character, "character")
    if character is not None and (names != "smpl" or usd or bvh):
        raise ReconError(
            "--character keeps its own names, and goes into --glb alone: leave out --names, "
            "--usd and --bvh"
        )
    _refuse_without_output(
        {"mass": mass is not None, "plates": plates is not None}, forces or moments, "forces"
    )
    vrm = {"glb": (".glb", ".vrm")} if names == "vrm" or character is not None else {}
    for option, endings in (_ENDINGS | vrm).items():
        target = targets[option]
        if target is not None and target.suffix.lower() not in endings:
            expected = ", ".join(endings)
            raise ReconError(f"--{option} {target}: expected a file that ends in {expected}")
    if (robot is None) != (smplx is None):
        raise ReconError(
            "--robot and --smplx go together: the first is the file to write, the second the "
            "SMPL-X body (SMPLX_NEUTRAL.npz or .pkl) that the robot's loader poses; betas of the "
            "bundled body have no meaning on SMPL-X"
        )
    if (smpl is None) != (onto is None):
        raise ReconError(
            "--smpl and --onto go together: the first is the file to write, the second the body "
            "file (SMPL, SMPL-H or SMPL-X; .npz or .pkl) whose poses and betas it has"
        )
    own = BodyModel.load(body)
    file = load_motion_of(motion, own)
    moved, name = file.motion, motion.stem

    loads = ground_loads(file, own, mass, plates) if forces or moments else None
    told: list[Exported] = []

    def write_gltf(path: Path) -> None:
        if character is None:
            return write_glb(path, moved, own, names)
        from recon.api.given import GivenMotion
        from recon.api.retarget import ground_height
        from recon.export.onto_character import write_character  # imported only for characters

        level = ground_height(GivenMotion(file, str(motion)), None)
        made = write_character(path, moved, own, character, bones=bones, ground=level)
        rows = {joint: {"bone": name} for joint, name in made.bones.items()}
        told.append(Exported("", made.warnings, {"bones of the character": rows}))
        report.update(bones=made.bones, scale=made.scale, warnings=list(made.warnings))
        return None

    every: list[tuple[Path | None, OutputKind, Callable[[Path], object]]] = [
        (glb, OutputKind.FILE, write_gltf),
        (usd, OutputKind.FILE, lambda path: write_usd(path, moved, own, names)),
        (
            bvh,
            OutputKind.FILE,
            lambda path: write_bvh(path, skeleton_of(moved, own, name), bones=names),
        ),
        (
            trc,
            OutputKind.FILE,
            lambda path: write_trc(
                path, recorded_markers(moved, own, markers, name), unit=unit, up=up
            ),
        ),
        (mot, OutputKind.FILE, lambda path: write_mot(path, moved, own, model)),
        (
            forces,
            OutputKind.FILE,
            lambda path: write_forces(path, moved, cast(GroundLoads, loads)),
        ),
        (
            moments,
            OutputKind.FILE,
            lambda path: write_moments(path, moved, own, cast(GroundLoads, loads), model),
        ),
        (angles, OutputKind.FILE, lambda path: write_angles(path, moved, own, file.angle_std)),
        (
            joints,
            OutputKind.FILE,
            lambda path: write_joint_table(path, file, own.pose(moved).joints),
        ),
        (robot, OutputKind.FILE, lambda path: write_robot(path, moved, own, cast(Path, smplx))),
        (smpl, OutputKind.FILE, lambda path: write_smpl(path, moved, own, cast(Path, onto))),
        (
            ply,
            OutputKind.FOLDER,
            lambda path: write_ply_sequence(
                path, own.pose(moved).vertices.numpy(), own.faces.numpy()
            ),
        ),
        (html, OutputKind.FILE, lambda path: draw_html(path, show_of_files(motion, body=body))),
    ]
    asked = [(Output(path, kind), write) for path, kind, write in every if path is not None]
    report: dict[str, Any] = {
        "inputs": checksums(
            [one for one in (motion, body, smplx, onto, plates, character, bones) if one]
        ),
        "versions": versions(),
        **({} if loads is None else loads.report()),
    }
    outputs = [output for output, _ in asked]
    with writing(*outputs, report=report, overwrite=overwrite) as staged:
        for path, (_, write) in zip(staged, asked, strict=True):
            write(path)
    if loads is not None:
        told.append(Exported("", loads.warnings, loads.tables()))
    if not told:
        return None
    place = ", ".join(str(output.path) for output in outputs)
    warnings = tuple(warning for one in told for warning in one.warnings)
    return Exported(place, warnings, {k: v for one in told for k, v in one.tables.items()})


def _refuse_without_output(given: dict[str, bool], target: Path | None, name: str) -> None:
    """Refuse options that belong to an output file which is not written.

    Raises:
        ReconError: naming the option.
    """
    if target is None and (used := [one for one, by_user in given.items() if by_user]):
        raise ReconError(f"--{used[0]} is an option of --{name} FILE, which was not given")

"""`recon export`: a motion in other programs' formats."""

from pathlib import Path
from typing import Literal

from tyro.conf import Positional

from recon.cli.places import Overwrite, Place, folder, writes


@writes(
    Place("glb"), Place("usd"), Place("bvh"), Place("trc"), Place("mot"), Place("angles"),
    Place("joints"), Place("robot"), Place("smpl"), Place("ply", folder), Place("html"),
)  # fmt: skip
def export(
    motion: Positional[Path],
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
    markers: Literal["joints", "halpe26", "opencap", "pig", "bsm"] = "joints",
    model: Literal["rajagopal2016", "gait2392"] = "rajagopal2016",
    unit: Literal["m", "cm", "mm"] = "mm",
    up: Literal["x", "y", "z"] = "y",
    smplx: Path | None = None,
    onto: Path | None = None,
    body: Path | None = None,
    overwrite: Overwrite = False,
) -> None:
    """Write a motion for Blender, game engines, biomechanics tools or mesh viewers.

    Args:
        motion: motion file.
        glb: glTF 2.0 with skinned mesh and animation.
        usd: USD with skinned mesh and animation (.usd, .usda, .usdc); needs usd-core.
        bvh: skeleton animation.
        trc: markers for OpenSim and others; which of them says --markers.
        mot: coordinates of an OpenSim model, degrees and metres.
        angles: joint angles after the ISB as CSV, degrees.
        joints: positions of the 22 joints as CSV, metres, with their standard deviations.
        robot: SMPL-X .npz for GMR and like loaders, 30 Hz, soles on z = 0; needs --smplx.
        smpl: AMASS .npz on the SMPL-family body of --onto, with betas that are its own.
        ply: folder for one mesh per frame.
        html: self-contained page, as `recon view` writes.
        markers: labels of --trc: the 22 joints, keypoints as Pose2Sim names them, OpenCap's 43
            markers, Plug-in Gait or the 105 markers of BSM (SKEL).
        model: whose coordinates --mot has.
        unit: of --trc.
        up: axis that points up in --trc; y is OpenSim's.
        smplx: the SMPL-X body that the loader of --robot poses, SMPLX_NEUTRAL.npz or .pkl.
        onto: the body file of --smpl (SMPL, SMPL-H, SMPL-X; .npz or .pkl).
        body: the SMPL-family file of the motion's body; default: the bundled body.
        overwrite: replace files that are there and recon did not write.
    """
    from recon.export.motion import export_file

    asked = {
        "glb": glb, "usd": usd, "bvh": bvh, "trc": trc, "mot": mot, "angles": angles,
        "joints": joints, "robot": robot, "smpl": smpl, "html": html,
    }  # fmt: skip
    if ply is None and all(target is None for target in asked.values()):
        options = ", ".join(f"--{name}" for name in asked)
        raise ValueError(f"nothing to write: give {options} FILE or --ply FOLDER")
    _refuse_alone({"markers": markers != "joints", "unit": unit != "mm", "up": up != "y"}, trc)
    if (robot is None) != (smplx is None):
        raise ValueError(
            "--robot and --smplx go together: the first is the file to write, the second the "
            "SMPL-X body (SMPLX_NEUTRAL.npz or .pkl) that its loader poses, as betas of our body "
            "mean nothing there"
        )
    if (smpl is None) != (onto is None):
        raise ValueError(
            "--smpl and --onto go together: the first is the file to write, the second the body "
            "file (SMPL, SMPL-H or SMPL-X; .npz or .pkl) whose poses and betas it has"
        )
    export_file(
        motion, **asked, ply=ply, markers=markers, model=model, unit=unit, up=up, smplx=smplx,
        onto=onto, body=body, overwrite=overwrite,
    )  # fmt: skip


def _refuse_alone(given: dict[str, bool], trc: Path | None) -> None:
    """Refuse options of the TRC file where none is written: they would do nothing.

    Raises:
        ValueError: naming the option.
    """
    if trc is None and (said := [name for name, by_user in given.items() if by_user]):
        raise ValueError(f"--{said[0]} is an option of --trc FILE, which is not asked for")

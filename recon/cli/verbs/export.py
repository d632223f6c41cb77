"""`recon export`: a motion in other programs' formats."""

from pathlib import Path

from tyro.conf import Positional

from recon.cli.places import Overwrite, Place, folder, writes


@writes(Place("glb"), Place("bvh"), Place("trc"), Place("ply", folder), Place("html"))
def export(
    motion: Positional[Path],
    glb: Path | None = None,
    bvh: Path | None = None,
    trc: Path | None = None,
    ply: Path | None = None,
    html: Path | None = None,
    body: Path | None = None,
    overwrite: Overwrite = False,
) -> None:
    """Write a motion for Blender, game engines, biomechanics tools or mesh viewers.

    Args:
        motion: motion file.
        glb: glTF 2.0 with skinned mesh and animation.
        bvh: skeleton animation.
        trc: the 22 joints as markers, millimetres.
        ply: folder for one mesh per frame.
        html: self-contained page, as `recon view` writes.
        body: the SMPL-family file of the motion's body; default: the bundled body.
        overwrite: replace files that are there and recon did not write.
    """
    from recon.jobs.export.motion import export_file

    if all(target is None for target in (glb, bvh, trc, ply, html)):
        raise ValueError("nothing to write: give --glb, --bvh, --trc, --html FILE or --ply FOLDER")
    export_file(
        motion, glb=glb, bvh=bvh, trc=trc, ply=ply, html=html, body=body, overwrite=overwrite
    )

"""Recordings of motion capture in any known format: the reader is chosen by the suffix."""

from pathlib import Path

from recon.core.errors import FormatError
from recon.core.units import Axis
from recon.formats.mocap.recording import MarkerRecording, SkeletonRecording

RECORDINGS = (".bvh", ".bvh.xz", ".amc", ".amc.xz", ".c3d", ".trc", ".mat", ".tar", ".tar.xz")
"""Suffixes that `read_recording` knows, among others of the same families."""


def read_recording(
    path: str | Path, unit: str | None = None, up: Axis | None = None
) -> SkeletonRecording | MarkerRecording:
    """Read a recording of any known format, in metres and z up.

    Args:
        path: of the file; FILE::NAME is one recording of an archive or .mat file.
        unit: of the file (m, cm, mm, inch, cmu); None finds it out.
        up: axis of the file that points up; None finds it out.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: when the format is not known, the file is damaged, or unit or axis cannot be
            told; the message says what was expected.
    """
    # readers are imported when needed: some load large libraries
    location, _, member = str(path).partition("::")
    file, inside = Path(location), member or None
    name = file.name.lower()
    if inside is not None and not name.endswith((".mat", ".tar", ".tar.gz", ".tgz", ".tar.xz")):
        raise FormatError(f"{path}: only archives and .mat files hold several recordings (::)")
    if name.endswith((".tar", ".tar.gz", ".tgz", ".tar.xz")):
        from recon.formats.mocap.archives import read_member

        return read_member(file, inside, unit=unit, up=up)
    name = name.removesuffix(".xz")
    if name.endswith(".bvh"):
        from recon.formats.mocap.bvh import read_bvh

        return read_bvh(file, unit=unit, up=up)
    if name.endswith(".amc"):
        from recon.formats.mocap.asf_amc import read_amc

        return read_amc(file, unit=unit, up=up)
    if name.endswith(".c3d"):
        from recon.formats.mocap.c3d import read_c3d

        return read_c3d(file, unit=unit, up=up)
    if name.endswith(".trc"):
        from recon.formats.mocap.trc import read_trc

        return read_trc(file, unit=unit, up=up)
    if name.endswith(".mat"):
        from recon.formats.mocap.mat import read_mat

        return read_mat(file, inside, unit=unit, up=up)
    if name.endswith(".asf"):
        raise FormatError(f"{path}: a skeleton without motion; give one of its .amc files")
    if name.endswith(".npz"):
        raise FormatError(f"{path}: a motion or observation already, not a recording to convert")
    raise FormatError(f"{path}: not a known recording; expected one of {', '.join(RECORDINGS)}")

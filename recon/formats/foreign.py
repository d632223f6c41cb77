"""Quick refusals of files that no reader takes, before anything heavy is loaded."""

import zipfile
from collections.abc import Sequence
from pathlib import Path

from recon.core.errors import FormatError

EXPECTED = (
    "an observation (.npz), 3D keypoints (.npy, .npz, .csv, .json, .trc, .c3d or a session "
    "folder), markers (.c3d, .trc), 2D keypoints (.json, .csv or folders of them, with --camera), "
    "a folder of scans (.ply, .pcd) or depth images (.png)"
)
_HEAD = 1 << 16
"""Bytes at the start of a file that are looked at."""
_KEYS = (
    b"people", b"annots", b"keypoints", b"andmarks", b"image_id", b"bodies", b"instance",
    b"predictions", b"names", b"labels", b"frames",
)  # fmt: skip
"""Some of these stand in every JSON file of keypoints."""
_ELSEWHERE = {
    ".bvh": "a skeleton's motion: `recon convert` takes it",
    ".amc": "a skeleton's motion: `recon convert` takes it",
    ".asf": "a skeleton without motion",
    ".mat": "a recording of motion capture: `recon convert` takes it",
    ".skeleton": "NTU RGB+D's skeletons of Kinect v2: save the joints as a table with columns "
    "SpineBase_x, SpineBase_y, SpineBase_z, ... and give that",
    ".obj": "a mesh of OBJ: save its vertices as .ply (`trimesh.load(f).export('a.ply')`)",
    ".mp4": "a video: run a 2D detector on it, and give its keypoints",
    ".mov": "a video: run a 2D detector on it, and give its keypoints",
    ".avi": "a video: run a 2D detector on it, and give its keypoints",
    ".pickle": "a Python pickle, which may run code and is not opened",
    ".pkl": "a Python pickle, which may run code and is not opened",
    ".pt": "no observation; `recon refine` takes what a network told from video",
}
"""What files with other endings are, where that is known."""


def refuse_foreign(paths: Sequence[Path]) -> None:
    """Refuse files that cannot be observations, by suffix and first bytes.

    Raises:
        ValueError: says what was seen and what would fit.
    """
    for path in paths:
        if not path.is_file() or holds_sam3d_body(path):
            continue
        ending = path.suffix.lower()
        if ending in _ELSEWHERE:
            raise FormatError(f"{path}: {_ELSEWHERE[ending]}; expected {EXPECTED}")
        with path.open("rb") as file:
            head = file.read(_HEAD)
        if len(head) == 0:
            raise FormatError(f"{path}: the file is empty")
        if (wrong := _wrong(path, ending, head)) is not None:
            raise FormatError(f"{path}: {wrong}")


SAM3D_POINTS = "pred_keypoints_3d"
"""The key of a person's keypoints in results of SAM 3D Body."""
_PICKLE_HEAD = 1 << 20
"""Bytes within which a pickle of these names that key."""


def holds_sam3d_body(path: Path) -> bool:
    """Whether a file, or the .npz files of a folder, are results of SAM 3D Body."""
    if path.is_dir():
        first = next(iter(sorted(path.glob("*.npz"))), None)
        return first is not None and holds_sam3d_body(first)
    if not path.is_file():
        return False
    if path.suffix.lower() == ".npz":
        return SAM3D_POINTS in _arrays_of(path)
    if path.suffix.lower() not in (".pkl", ".npy"):
        return False
    with path.open("rb") as file:
        return SAM3D_POINTS.encode() in file.read(_PICKLE_HEAD)


def is_estimate(paths: Sequence[Path]) -> bool:
    """Whether the file seems to hold body parameters of a video network; reads little of it.

    Motion files of recon, which name their body by its checksum, are none.
    """
    if len(paths) != 1 or not paths[0].is_file() or holds_sam3d_body(paths[0]):
        return False
    if paths[0].suffix.lower() in (".pt", ".pth", ".pkl"):
        return True
    names = _arrays_of(paths[0]) if paths[0].suffix.lower() == ".npz" else set()
    return bool(names & _PLACES and names & _POSES) and not names & {"kind", "body_checksum"}


def _arrays_of(path: Path) -> set[str]:
    """Names of the arrays of an .npz file; none where it is damaged, which its reader tells."""
    try:
        with zipfile.ZipFile(path) as archive:
            return {name.removesuffix(".npy") for name in archive.namelist()}
    except (zipfile.BadZipFile, OSError, ValueError, NotImplementedError):
        return set()


_PLACES = {"trans", "transl", "trans_world"}
_POSES = {"poses", "pose", "pose_body", "body_pose", "pose_world", "fullpose"}
"""Arrays of such a file, of which it has one of each."""


def _wrong(path: Path, ending: str, head: bytes) -> str | None:
    """What is wrong with a file, by its ending and first bytes; None where nothing is."""
    text = head.decode("latin-1").lstrip("\ufeff\u00ef\u00bb\u00bf")
    lines = [line for line in text.splitlines() if line.strip()]
    first = repr(lines[0][:60]) if lines else "nothing"
    match ending:
        case ".npz":
            return _wrong_archive(path)
        case ".npy" if not head.startswith(b"\x93NUMPY"):
            return "expected an .npy file, got other bytes"
        case ".c3d" if head[1:2] != b"\x50":
            return "expected a C3D file, whose second byte is 0x50"
        case ".trc" if not text.lower().startswith("pathfiletype"):
            return f"expected a TRC file, whose first line is PathFileType; got {first}"
        case ".csv" if text.startswith("Format Version"):
            return (
                "Motive's CSV (OptiTrack), which is not read: export C3D, TRC or BVH from Motive"
            )
        case ".csv":
            axes = {cell.strip()[-1:].lower() for cell in "".join(lines[:1]).split(",")}
            heads = [line.lower().startswith(("scorer", "bodyparts")) for line in lines[:4]]
            if not {"x", "y"} <= axes and not any(heads):
                return (
                    "expected a table of keypoints: columns such as left_hip_x, left_hip_y, "
                    "left_hip_z, or frame, keypoint, x, y, z, or DeepLabCut's header rows scorer, "
                    f"bodyparts, coords; got {first}"
                )
        case ".json" if text.lstrip()[:1] not in ("{", "["):
            return "expected JSON, which begins with { or ["
        case ".json" if len(head) < _HEAD and not any(key in head for key in _KEYS):
            return (
                "expected keypoints in JSON (people, annots, keypoints, landmarks, bodies, "
                f"names); got {text[:60]!r}"
            )
        case ".npy" | ".c3d" | ".trc" | ".json":
            return None
        case _:
            known = ending or "nothing"
            return f"files ending in {known} are not known; expected {EXPECTED}"
    return None


def _wrong_archive(path: Path) -> str | None:
    try:
        with zipfile.ZipFile(path) as archive:
            names = {name.removesuffix(".npy") for name in archive.namelist()}
    except (zipfile.BadZipFile, OSError, ValueError, NotImplementedError) as error:
        return f"expected an .npz file of plain arrays, but it cannot be read ({error})"
    if "kind" not in names and {"trans", "poses"} <= names:
        return (
            "a motion, not an observation; `recon refine` takes what a network told from video, "
            "`recon simulate` makes observations of a motion"
        )
    if "kind" not in names and "v_template" in names:
        return "a body, not an observation; give it with --body"
    return None

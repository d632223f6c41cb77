"""Recognises the program that wrote a file, and names the verb that reads it.

`PRODUCERS` is the table of all kinds of files that are known, also printed in the manual. Every
verb refuses files of other kinds by `refuse_unsupported`, with the same sentence.
"""

import re
import zipfile
import zlib
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from recon.core.errors import FormatError


@dataclass(frozen=True)
class Producer:
    """A kind of file: the program that writes it, how to recognise it, and verbs that read it."""

    name: str
    """Names of the programs; empty where any program may write such files."""
    holds: str
    form: str
    """Endings and contents of its files, as text for the manual."""
    endings: tuple[str, ...]
    """Endings of its files; "/" is a folder, in whose file names `pattern` is searched."""
    pattern: bytes
    """Regular expression that is found at the start of its files, or in the names of arrays."""
    verbs: tuple[str, ...]
    """Verbs that take it, the usual one first; `recon info` takes all that any verb does."""
    note: str
    """What its files state (unit, rate), for the manual; or advice where no verb takes it."""
    folder: bool = False
    """Whether a folder of such files is one recording or view."""

    def how_to_read(self) -> str:
        """Return a sentence on what the file is, and which verb reads it or what to do instead."""
        what = f"{self.holds} of {self.name}" if self.name else self.holds
        if self.verbs == ("info",):
            return f"{what}: {self.note}"
        if self.verbs:
            return f"{what}: `recon {self.verbs[0]}` takes it"
        return f"{what}, which no verb takes: {self.note}"


SAM3D_POINTS = "pred_keypoints_3d"
"""The key of a person's keypoints in results of SAM 3D Body."""
_FIT, _REFINE, _INFO = ("fit",), ("refine", "fit"), ("info",)
POINTS_3D, POINTS_2D, BODIES = "3D keypoints", "2D keypoints", "body parameters"
MARKERS, SCANS, FILM = "markers or joint centres", "scans", "a film"
"""Kinds of data in files, the values of `Producer.holds` in most rows."""
_NUMBER = rb"[-+\dN][\w.+-]*\s*"
_XYZ = rb'x"?[,;\s]\s*"?y"?[,;\s]\s*"?z\b'
_ROWS = rb"(?:[ \t]*[-+.\de]+(?:[,; \t]+[-+.\de]+){2}(?:(?:[,; \t]+[-+.\de]+){3})?[ \t]*\r?\n){20}"
"""Matches twenty lines of three numbers, or six with colours or normals."""
_UNNAMED = rb"(?![^\n]*(?:point|mark|joint|part|name|bone))"
_MANY = rb"(?!543,)(?:[2-9]\d\d|\d{4,}), [3-9]\)"
"""Matches a cloud's shape: 200 points or more, but not MediaPipe's 543 of body, face and hands."""
FILMS = (
    ".mp4", ".m4v", ".mov", ".3gp", ".avi", ".mkv", ".webm", ".mts", ".m2ts", ".ts", ".mpg",
    ".mpeg", ".wmv", ".flv", ".mxf", ".gif",
)  # fmt: skip
"""Endings of film files."""
_BESIDE_FILMS = (".toml", ".yml", ".yaml", ".txt", ".md")
"""Endings of files that may lie in a folder of films: calibrations and texts."""
_OTHERS = (
    ("Vicon Nexus", "a table", (".csv", ".txt"), rb"\A\W*(?:Trajectories|Model Outputs|Devices|"
     rb"Joints|Segments|Events)[,;\t ]*\r?\n[\d.]+[,;\t ]*\r?\n", "export C3D"),
    ("CMU Panoptic", POINTS_3D, (".json",), rb'"joints(?:15|19|26)"', "save a CSV of one person "
     "with columns `NAME_x`, `NAME_y`, `NAME_z`"),
    ("Xsens", "a recording", (".mvnx", ".mvn"), b"", "export BVH or C3D"),
    ("Qualisys", "a recording", (".qtm",), b"", "export C3D or TSV"),
    ("SLEAP, DeepLabCut or another program", "HDF5", (".h5", ".slp"), b"", "export CSV"),
    ("OpenSim", "coordinates or forces", (".mot", ".sto"), b"", "give the `.trc` of the markers"),
    ("KITTI", "LiDAR points", (".bin",), rb"(?s)\A...[\x3b-\x43\xbb-\xc3]", "save a `.pcd` or "
     "`.ply` per frame in a folder"),
    ("Excel", "a table", (".xlsx", ".xls"), b"", "save `.csv`"),
    ("RealSense or ROS", "a recording", (".bag",), b"", "export depth images or `.ply`"),
    ("Record3D", "a recording", (".r3d",), b"", "export `.ply`, or its film"),
)  # fmt: skip
"""Kinds of files that no verb takes, with advice; they are too many for the manual."""
PRODUCERS = (
    *(Producer(who, what, "", ends, mark, (), note) for who, what, ends, mark, note in _OTHERS),
    Producer(
        "FreeMoCap", POINTS_3D, "session folder with `mediapipe_body_3d_xyz.npy` or `.csv`, or "
        "`body_3d_xyz.csv`", ("/",), rb"body_3d_xyz", _FIT,
        "millimetres; rate where `*_by_frame.csv` is beside",
    ),
    Producer(
        "SAM 3D Body", POINTS_3D, "lists by frame (`.pkl`, `.npy`), a folder of `.npz`, or "
        "stacked arrays (`.npz`): `pred_keypoints_3d`, `pred_cam_t`, also `pred_keypoints_2d`, "
        "`focal_length`", (".npz", ".pkl", ".npy"), SAM3D_POINTS.encode(), ("fit", "refine"),
        "names, metres in the camera", folder=True,
    ),
    Producer(
        "AIST++", POINTS_3D, "`.pkl`; `keypoints3d_optim` or `keypoints3d`", (".pkl",),
        rb"keypoints3d", _FIT, "",
    ),
    Producer(
        "TRAM", BODIES, "`hps_track_*.npy`; `pred_rotmat`, `pred_trans`, `frame`", (".npy",),
        rb"pred_rotmat", _REFINE, "in the camera",
    ),
    Producer(
        "MediaPipe", POINTS_3D, "JSON with `pose_world_landmarks`", (".json",),
        rb"orldLandmarks|world_landmarks", _FIT, "metres about the hips, y down",
    ),
    Producer(
        "Azure Kinect", POINTS_3D, "JSON of the offline processor: `frames`, `bodies`, "
        "`joint_positions`", (".json",), rb'"bodies"', _FIT,
        "millimetres in the camera, rate by `timestamp_usec`",
    ),
    Producer(
        "EasyMocap", POINTS_3D, "folder `keypoints3d`; `[{id, keypoints3d}]`", (".json",),
        rb'\A\s*\[\s*\{[^{}]*"keypoints3d"', _FIT, "confidence",
        folder=True,
    ),
    Producer(
        "OpenPose", POINTS_3D, "folder; `people[].pose_keypoints_3d`", (".json",),
        rb'"pose_keypoints_3d"\s*:\s*\[\s*[-\d]', _FIT, "confidence",
        folder=True,
    ),
    Producer(
        "ZED", POINTS_3D, "JSON of objects with `timestamp` and `body_list[].keypoint`: BODY_18, "
        "BODY_34, BODY_38", (".json",), rb'"body_list"', _FIT, "names, rate, NaN is missing",
    ),
    Producer(
        "OpenPose, Pose2Sim", POINTS_2D, "folder (`pose`, `pose-associated`); "
        "`people[].pose_keypoints_2d`", (".json",), rb'"people"', _FIT, "confidence", folder=True,
    ),
    Producer(
        "EasyMocap", POINTS_2D, "folder `annots/CAMERA`; `annots[].keypoints`", (".json",),
        rb'"annots"', _FIT, "confidence, negative is missing", folder=True,
    ),
    Producer(
        "AlphaPose", POINTS_2D, "JSON; `image_id`, `keypoints`", (".json",), rb'"image_id"', _FIT,
        "confidence, divided by 6 where any exceeds 1",
    ),
    Producer(
        "MMPose", POINTS_3D, "folder or JSON; `keypoints` of three numbers", (".json",),
        rb'"keypoints"\s*:[\s\[]*' + rb",\s*".join([_NUMBER] * 3) + rb"\]", _FIT, "",
        folder=True,
    ),
    Producer(
        "MMPose, rtmlib", POINTS_2D, "folder or JSON; `keypoints` with `keypoint_scores` or "
        "`scores`", (".json",), rb'"(?:keypoint_)?scores"|"instance_info"|"predictions"', _FIT,
        "confidence, clipped to [0, 1]", folder=True,
    ),
    Producer(
        "MediaPipe", POINTS_2D, "JSON; 33 landmarks in fractions of the image", (".json",),
        rb'andmarks"|"visibility"', _FIT, "visibility", folder=True,
    ),
    Producer(
        "DeepLabCut", POINTS_2D, "CSV; body parts matched by name", (".csv",),
        rb"(?i)\A(?:scorer|bodyparts)\b(?![^\0]*\ncoords[^\n]*,z\b)", _FIT, "likelihood",
        folder=True,
    ),
    Producer(
        "SLEAP", POINTS_2D, "its analysis CSV; nodes matched by name", (".csv",),
        rb"\A(?=[^\n]*\bframe_idx\b)[^\n]*\.x\b", _FIT, "`NODE.score`", folder=True,
    ),
    Producer(
        "rtmlib, ViTPose, your own", POINTS_2D, "`.npz`: `keypoints (T,P,K,2)` with `scores "
        "(T,P,K)`, or `(T,K,3)`", (".npz",), rb"(?m)^scores$|^keypoint_scores$", _FIT, "scores",
        folder=True,
    ),
    Producer(
        "OptiTrack Motive", MARKERS, "CSV from `Format Version` on; bones are left out",
        (".csv",), rb"\A\W*Format Version", ("convert", "fit"), "labels, rate, unit",
    ),
    Producer(
        "Qualisys", MARKERS, "`.tsv` with `MARKER_NAMES`", (".tsv",), rb"MARKER_NAMES",
        ("convert", "fit"), "labels, rate",
    ),
    Producer(
        "", SCANS, "folder of `.npy` (points, 3), or `.csv`, `.txt` of x, y, z",
        (".npy", ".csv", ".txt", ".asc"), rb"(?i)'shape': \(" + _MANY + rb"|\A" + _ROWS + rb"|\A"
        + _UNNAMED + rb'(?![^\n]*(?:frame|time))[#/\s"]*' + _XYZ, _FIT, "", folder=True,
    ),
    Producer(
        "", "clouds in one file", "`.npy` (frames, points, 3) from 200 points on; CSV of frame, "
        "x, y, z", (".npy", ".csv", ".txt"), rb"(?i)'shape': \(\d+, " + _MANY + rb"|\A"
        + _UNNAMED + rb"[^\n]*\b" + _XYZ, (),
        "save a `.npy` (points, 3) or `.ply` per frame in a folder",
    ),
    Producer(
        "", "Python objects", "other `.npy` of objects", (".npy",), rb"'descr': '\|O'", (),
        "save a plain array (frames, points, 3), or an array per frame",
    ),
    Producer(
        "Anipose, DeepLabCut, your own", POINTS_3D, "CSV with columns `NAME_x`, `NAME_y`, "
        "`NAME_z`, or rows of `frame`, `keypoint`, `x`, `y`, `z`; `timestamp` in seconds",
        (".csv",), rb"(?i)\A[^\n]*(?<![a-z])z\b|\ncoords[^\n]*,z\b", _FIT, "names, rate",
    ),
    Producer(
        "your own", POINTS_3D, "JSON with `names` and `frames` of x, y, z; `fps`, `unit`",
        (".json",), rb'names"|"labels"', _FIT, "names",
    ),
    Producer(
        "MotionBERT, your own", POINTS_3D, "`.npy` or `.npz` with one array (frames, points, 3); "
        "`.npz` also `names`, `fps`", (".npy",), b"", _FIT, "",
    ),
    Producer(
        "Vicon, Qualisys, Motive, Cortex, Pose2Sim, OpenCap", MARKERS,
        "`.c3d`, `.trc`; joint centres are `RHip`, `LKnee`, ...", (".c3d", ".trc"), b"",
        ("convert", "fit"), "labels, rate, unit",
    ),
    Producer(
        "", "a skeleton's motion", "`.bvh`, `.amc` with `.asf`, also `.xz`; archives of `.bvh` "
        "(`FILE::MEMBER`)", (".bvh", ".amc", ".tar", ".tgz"), b"", ("convert",), "rate",
    ),
    Producer(
        "Motion Capture Toolbox", "markers", "`.mat`", (".mat",), b"",
        ("convert",), "labels, rate",
    ),
    Producer(
        "", "a skeleton without motion", "`.asf`", (".asf",), b"", (),
        "give `recon convert` one of its .amc files",
    ),
    Producer(
        "NTU RGB+D", POINTS_3D, "`.skeleton`", (".skeleton",), b"", _FIT, "all",
    ),
    Producer(
        "", SCANS, "folder of `.obj`, `.ply`, `.pcd`, `.xyz` or `.pts`, one per frame",
        (".obj", ".ply", ".pcd", ".xyz", ".xyzn", ".xyzrgb", ".pts"),
        b"", _FIT, "times in `times.csv`", folder=True,
    ),
    Producer(
        "recon", "an observation", "`.npz` with `kind`", (".npz",), rb"(?m)^kind$", _FIT,
        "all ([above](#formats))",
    ),
    Producer(
        "recon", "a motion", "`.npz` with `trans`, `poses`, `body_checksum`", (".npz",),
        rb"(?m)^body_checksum$", ("refine",), "all ([above](#formats))",
    ),
    Producer(
        "", "a body model", "`.npz`, `.pkl` with `v_template`", (".npz", ".pkl"),
        rb"(?<!_)v_template(?!_)", _INFO, "give it with --body",
    ),
    Producer(
        "", "a calibration of cameras", "`.npz` with `camera_matrix`, JSON with `camera_mtx`",
        (".npz", ".json"), rb"camera_matrix|camera_mtx", _INFO, "give it with --camera",
    ),
    Producer(
        "", "a calibration of cameras", "`.toml`, `.yml`, `.yaml`", (".toml", ".yml", ".yaml"),
        b"", _INFO, "give it with --camera", folder=True,
    ),
    Producer(
        "", "silhouettes", "`.npz` with `mask`", (".npz",), rb"(?m)^mask$", _INFO,
        "give them with --masks",
    ),
    Producer(
        "AIST++", BODIES, "`.pkl`, `.npz`; `smpl_poses`, `smpl_trans`, `smpl_scaling`",
        (".pkl", ".npz"), rb"smpl_trans", _REFINE, "size",
    ),
    Producer(
        "GVHMR", BODIES, "`.pt`; `smpl_params_global`", (".pt", ".pth"), rb"smpl_params_global",
        _REFINE, "",
    ),
    Producer(
        "WHAM", BODIES, "`.pkl`; `pose_world`, `trans_world` by person", (".pkl",),
        rb"trans_world", _REFINE, "",
    ),
    Producer(
        "PHALP (4D-Humans)", BODIES, "`.pkl`; by image the lists `smpl`, `camera`, `tid`",
        (".pkl",), rb"(?s)\A(?=.*smpl).*tid", _REFINE, "in the camera",
    ),
    Producer(
        "AMASS", BODIES, "`.npz`, `.pkl`; `poses`, `trans`", (".npz", ".pkl"),
        rb"(?s)\A(?!.*poses_(?:root|60Hz))(?=.*poses).*trans", _REFINE, "rate",
    ),
    Producer(
        "SLAHMR", BODIES, "`.npz`; `root_orient`, `pose_body`, `trans` with an axis of people",
        (".npz",), rb"(?s)\A(?=.*pose_body).*trans", _REFINE, "",
    ),
    Producer(
        "SMPL, SMPL-X", BODIES, "`.npz`, `.pkl`, `.pt`; `global_orient`, `body_pose`, `transl`",
        (".npz",), rb"(?s)\A(?=.*pose).*trans", _REFINE, "",
    ),
    Producer("", BODIES, "any other `.pt`, `.pkl`", (".pt", ".pth", ".pkl"), b"", _REFINE, ""),
    Producer(
        "", FILM, "`.mp4`, `.mov`, `.avi`, `.mkv`, `.webm`, ...; people are detected in it",
        FILMS, b"", ("fit", "detect"), "rate, size of the images",
    ),
    Producer(
        "Autodesk", "a scene", "`.fbx`", (".fbx",), b"", (), "export BVH, as Blender does",
    ),
)  # fmt: skip
"""All known kinds of files; the first whose ending and pattern a file has is its kind."""


def producer_of(path: Path) -> Producer | None:
    """Recognise the kind of a file or folder by endings and first bytes; None if unknown."""
    if not path.is_dir():
        return _producer_of_file(path) if path.is_file() else None
    inside = [one for one in path.iterdir() if not one.name.startswith(".")]
    listed = "\n".join(one.name for one in (*inside, *path.glob("output_data/*"))).encode()
    for one in PRODUCERS:
        if "/" in one.endings and re.search(one.pattern, listed):
            return one
    endings = Counter(one.suffix.lower() for one in inside if one.is_file()).most_common(1)
    alike = [one for one in inside if endings and one.suffix.lower() == endings[0][0]]
    # the largest file is examined, since a frame without people does not show the format
    found = _producer_of_file(max(alike, key=lambda one: one.stat().st_size)) if alike else None
    return found if found is None or found.folder or len(alike) == len(inside) else None


def _producer_of_file(path: Path) -> Producer | None:
    ending, head = Path(path.name.lower().removesuffix(".xz")).suffix, None
    for one in PRODUCERS:
        if ending in one.endings:
            head = _first_bytes(path, ending) if head is None and one.pattern else head
            if not one.pattern or re.search(one.pattern, head or b""):
                return one
    return None


_HEAD = 1 << 16
"""Number of bytes at the start of a file in which patterns are searched."""
_PICKLED = 1 << 22
"""Number of bytes at the start of a pickle that are searched: some keys stand behind arrays."""


def _first_bytes(path: Path, ending: str) -> bytes:
    """Read the first bytes of a file, decompressed; for an .npz the names of its arrays."""
    if ending == ".npz":
        return "\n".join(sorted(_arrays_of(path))).encode()
    pickled = ending in (".pkl", ".npy", ".pt", ".pth")
    with path.open("rb") as file:
        head = file.read(_PICKLED if pickled else _HEAD)
    if not pickled or not head.startswith((b"x", b"\x1f\x8b")):
        return head
    try:
        return zlib.decompressobj(32 + zlib.MAX_WBITS).decompress(head, _PICKLED)
    except zlib.error:
        return head


def _arrays_of(path: Path) -> set[str]:
    """List the arrays of an .npz file; none if it is damaged (its reader raises the error)."""
    try:
        with zipfile.ZipFile(path) as archive:
            return {name.removesuffix(".npy") for name in archive.namelist()}
    except (zipfile.BadZipFile, OSError, ValueError, NotImplementedError):
        return set()


def refuse_unsupported(path: Path, verb: str) -> None:
    """Refuse a file that a verb does not take, and say what it is and what to do.

    Raises:
        FormatError: when the file is of a known kind that only other verbs take, or none.
    """
    found = producer_of(path)
    if found is None:
        return
    if path.is_file() and found.holds == SCANS:
        raise FormatError(
            f"{path}: one frame of scans: give the folder with a file for every frame"
        )
    if verb not in found.verbs and not (verb == "info" and found.verbs):
        raise FormatError(f"{path}: {found.how_to_read()}")
    one_file = not found.folder and "/" not in found.endings
    if path.is_dir() and one_file and not (verb == "fit" and films_at(path)):
        said = f"{path} is a folder: give one of its files; {found.how_to_read()}"
        for one in sorted(path.glob("*.npy"))[:1]:
            head = _first_bytes(one, ".npy")[10:250].partition(b"\n")[0].decode("latin-1")
            said += f"; in a folder of scans each has numbers (points, 3), but {one.name} {head}"
        raise FormatError(said)


def is_film(path: Path) -> bool:
    """Whether a path is a file with the ending of a film."""
    return path.suffix.lower() in FILMS and path.is_file()


def films_at(path: Path) -> list[Path]:
    """List the film at a path, or all films of a folder with nothing else but calibrations."""
    if not path.is_dir():
        return [path] if is_film(path) else []
    inside = [one for one in path.iterdir() if not one.name.startswith(".")]
    films = sorted(one for one in inside if is_film(one))
    others = [one for one in inside if one.suffix.lower() not in _BESIDE_FILMS]
    return films if len(others) == len(films) else []


def holds_sam3d_body(path: Path) -> bool:
    """Whether a file, or the files of a folder, are results of SAM 3D Body."""
    found = producer_of(path)
    return found is not None and found.name == "SAM 3D Body"


def holds_estimated_bodies(paths: Sequence[Path]) -> bool:
    """Whether there is just one path, to a file whose first bytes show body parameters.

    Motion files of recon, which name their body by its checksum, do not count.
    """
    found = producer_of(paths[0]) if len(paths) == 1 and paths[0].is_file() else None
    return found is not None and found.holds == BODIES

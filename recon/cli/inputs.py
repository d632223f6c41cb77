"""Checks, before slow imports, that the input files of a command exist."""

from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Any

_MOTION = "a motion file (.npz)"
_OBSERVATION = "an observation file (.npz)"
EXPECTED = {
    "a": _MOTION,
    "b": _MOTION,
    "beside": _MOTION,
    "body": "a SMPL-family file (.npz, .pkl)",
    "camera": "a calibration of cameras (.toml, .yml, .json)",
    "camera_track": "the track of a camera (a folder of COLMAP, .txt, .npy, .npz, .json)",
    "compare": _MOTION,
    "estimate": _MOTION,
    "corpus": "a folder that `recon convert --all` wrote",
    "film": "a film (.mp4, .mov, .mkv, ...)",
    "file": "a file or folder that recon reads",
    "bones": "a table of bones (.toml)",
    "character": "a rigged character (.glb, .gltf, .vrm)",
    "like": "a recording with named markers (.c3d, .trc)",
    "set": "a marker set by its name, or a file of markers and landmarks (.toml)",
    "manifest": "a folder of films, or a file with one JSON object per line",
    "mapping": "a TOML file that says which joints or markers are which, or a named trial",
    "masks": "a folder of silhouettes, or an .npz of them",
    "motion": _MOTION,
    "obs": _OBSERVATION,
    "observation": _OBSERVATION,
    "observations": f"{_OBSERVATION}, 2D detections, or a folder of scans or depth images",
    "onto": "a SMPL-family file (.npz, .pkl)",
    "plates": "a C3D file with force plates (.c3d)",
    "recording": "a recording (.bvh, .amc, .c3d, .trc, .mat)",
    "predictions": "a folder with one prediction for every window of `recon bench`",
    "recordings": "a folder of recordings (.bvh, .amc, .c3d, .trc, .mat)",
    "smplx": "a SMPL-X file (.npz, .pkl)",
    "splits": "a TOML file of parts and windows, as recon/benchmark/splits.toml",
    "trial": "a recording (.bvh, .amc, .c3d, .trc, .mat) or a motion file (.npz)",
    "truth": _MOTION,
}
"""What every argument that names something to read should be, by the argument's name."""


def check_inputs(given: Mapping[str, Any]) -> None:
    """Refuse input paths that do not exist.

    Args:
        given: the values of a verb's arguments, by name, without those that it writes.

    Raises:
        FileNotFoundError: names the path, what was expected there, and files like it.
    """
    for name, path in _named_paths(given):
        # FILE::MEMBER is a member of an archive, whose FILE must exist
        if not path.exists() and not Path(str(path).partition("::")[0]).exists():
            raise FileNotFoundError(
                f"there is nothing at {path}: expected {EXPECTED[name]}{_hint_at_missing(path)}"
            )


def _named_paths(given: Mapping[str, Any]) -> Iterator[tuple[str, Path]]:
    for name, value in given.items():
        for one in value if isinstance(value, tuple) else (value,):
            if isinstance(one, Path) and (name != "set" or one.suffix):  # `--set pig` is no path
                yield name, one
            elif is_dataclass(one):
                yield from _named_paths({f.name: getattr(one, f.name) for f in fields(one)})


def _hint_at_missing(path: Path) -> str:
    """Return a hint for a missing path: files of similar names, or that its folder is missing."""
    folder = path.parent
    if path.is_symlink():
        return f"; it is a link to {path.readlink()}, where nothing is"
    if not folder.is_dir():
        return f"; the folder {folder} is not there either"
    near = get_close_matches(path.name, (one.name for one in folder.iterdir()))
    return f"; did you mean {' or '.join(str(folder / name) for name in near)}?" if near else ""

"""The files that a fit of one clip reads, and checksums of what its result depends on."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from importlib import resources
from importlib.util import find_spec
from os.path import commonpath
from pathlib import Path
from typing import Any

from priors.checkpoints import FIRST, weights_path
from recon.fitting.settings import FitSettings
from recon.formats.opening import files_of
from recon.formats.producers import holds_sam3d_body
from recon.formats.projects import project_at
from recon.formats.replacing import MISSING, file_checksum, files_checksum, value_checksum
from recon.formats.scans import cloud_files
from recon.keypoints3d.reader import session_body_file, session_hand_files, session_time_stamps
from recon.reading.places import files_of_views

_IMAGES, _KEYPOINTS = (".png",), (".json",)
_CALIBRATIONS = (".toml", ".yml", ".yaml", ".npz")
_PATHS = ("body", "camera", "camera_track", "masks", "mapping", "weights")
"""Settings that name files: their contents count, not where they lie."""
_LATER = ("camera_track", "mapping")
"""Those of them that results without them do not mention, which keep their checksums so."""


@dataclass(frozen=True)
class InputFiles:
    """A file or folder given by the user, and the files that a fit reads in it."""

    path: Path
    files: tuple[Path, ...]
    root: Path | None = None
    """A folder that holds all of these files, where some of them lie outside `path`."""

    def checksum(self) -> str:
        """SHA-256 of the file, or of the contents and names of the files that are read.

        `MISSING` when there is nothing.

        Raises:
            OSError, ValueError: when a file is there and cannot be read.
        """
        if not self.path.exists():
            return MISSING
        if self.files == (self.path,):
            return file_checksum(self.path)
        folder = self.path if self.path.is_dir() else self.path.parent
        return files_checksum(self.files, self.root or folder)


def observation_input(path: Path) -> InputFiles:
    """Return the files that `recon.reading.clip.load_clip` reads of an observation.

    Of a folder these are its clouds or else its depth images with their table of times, or else
    its files of keypoints. A video in the folder is not read.
    """
    if not path.is_dir():
        return InputFiles(path, (path,))
    if holds_sam3d_body(path):
        return InputFiles(path, _files_inside(path, (".npz",)))
    if session := session_body_file(path):
        every = (session, *session_hand_files(session), session_time_stamps(path))
        return InputFiles(path, tuple(one for one in every if one is not None))
    try:
        if (project := project_at(path)) is None:
            if frames := tuple(cloud_files(path)) or _files_inside(path, _IMAGES):
                return InputFiles(path, (*frames, path / "times.csv"))
            return InputFiles(path, _keypoint_files(path))
        views = () if project.detections is None else _keypoint_files(project.detections)
    except (ValueError, OSError):
        return InputFiles(path, ())  # unreadable: the fit will raise the error
    points = [] if project.points is None else [project.points]
    every = tuple(one.resolve() for one in (*project.read, *points, *views))
    return InputFiles(path, every, Path(commonpath([path.resolve(), *every])))


def _keypoint_files(path: Path) -> tuple[Path, ...]:
    """The files of keypoints of all views in a folder."""
    views, _ = files_of_views([path])
    return tuple(file for one in views for file in (_files_inside(one, _KEYPOINTS) or (one,)))


def camera_input(path: Path) -> InputFiles:
    """The files that `recon.formats.calibration.load_cameras` reads of a calibration."""
    pair = {"intri.yml", "extri.yml"}
    if path.is_dir() and (path / "intri.yml").is_file():
        return InputFiles(path, tuple(path / name for name in sorted(pair)))
    if path.is_dir():
        return InputFiles(path, _files_inside(path, _CALIBRATIONS))
    if path.name.lower() in pair:
        return InputFiles(path, (path, path.with_name(*(pair - {path.name.lower()}))))
    return InputFiles(path, (path,))


def track_input(path: Path) -> InputFiles:
    """The files of a camera track: COLMAP's text files, or the one file itself."""
    folder = path if path.is_dir() else path.parent
    if path.is_dir() or path.name == "images.txt":
        return InputFiles(path, tuple(folder / name for name in ("cameras.txt", "images.txt")))
    return InputFiles(path, (path,))


def masks_input(path: Path) -> InputFiles:
    """The files of silhouettes: the images of a folder, or the one file itself."""
    return InputFiles(path, _files_inside(path, _IMAGES) if path.is_dir() else (path,))


def input_checksums(given: Mapping[str, Any]) -> dict[str, str]:
    """Return the SHA-256 of every file and folder among the arguments of a verb, by path.

    Args:
        given: values by the names that the verb's arguments have. A text counts where it is the
            name of a file, as weights, cameras and shapes are given by a word or by a file.

    Raises:
        OSError, ValueError: when a file is there and cannot be read.
    """
    found: list[InputFiles] = []
    for name, value in given.items():
        for one in value if isinstance(value, tuple | list) else (value,):
            path = Path(one) if isinstance(one, str) and Path(one).is_file() else one
            if isinstance(path, Path):
                parts: Sequence[Path] = (path,)
                if name == "recording":  # of `recon convert`
                    from recon.mocap.asf_amc import recording_files

                    parts = recording_files(path)
                found += [_input_of(name, part) for part in parts]
    return {str(one.path): one.checksum() for one in found}


def _input_of(argument: str, path: Path) -> InputFiles:
    """Return the files that a fit reads at the path given for an argument of that name."""
    return _READ[argument](path) if argument in _READ else InputFiles(path, (path,))


_READ: dict[str, Callable[[Path], InputFiles]] = {
    "observations": observation_input,
    "motion": observation_input,
    "camera": camera_input,
    "camera_track": track_input,
    "masks": masks_input,
}
"""What is read of an argument, where that is more than one file."""


def settings_checksum(settings: FitSettings, version: int) -> str:
    """Return a checksum of all settings on which the result of a fit depends.

    It depends on the settings, on the contents of the calibration, masks, body and weights, of
    the bundled tables, on the code of a prior or reader that is given by its place
    "package.module:Class", and on the version of the method.

    Raises:
        OSError, ValueError: when a file is there and cannot be read.
    """
    plain = {name: value for name, value in asdict(settings).items() if name not in _PATHS}
    del plain["detections"]  # where detections are kept does not change a result
    for name in ("shape", "detector", "fingers"):
        if plain[name] in (None, False):
            del plain[name]  # checksums stay those of versions without these options
    contents: dict[str, Any] = {
        "weights": _weights_checksums(settings),
        "tables": _bundled_checksums(
            "recon", "assets", ("body.npz", "landmarks.json", "markers.toml")
        ),
    }
    for name in ("camera", "masks", "body", "camera_track", "mapping"):
        path = getattr(settings, name)
        if path is not None:
            contents[name.replace("_", " ")] = _input_of(name, path).checksum()
        elif name not in _LATER:
            contents[name] = None
    for name in ("prior", "reader"):
        place = getattr(settings, name)
        if place and ":" in place:
            contents[f"code of {name}"] = _code_checksum(place)
    for name in ("shape", "detector"):
        value = getattr(settings, name)
        if value is not None and Path(value).is_file():
            contents[name] = file_checksum(value)
    return value_checksum({"version": version, "settings": plain, **contents})


def clip_checksum(paths: Sequence[Path], settings: str) -> str:
    """Return a checksum of one clip: its observations in order, their names, and settings.

    Raises:
        OSError, ValueError: when a file is there and cannot be read.
    """
    rows = [[path.name, observation_input(path).checksum()] for path in paths]
    return value_checksum({"settings": settings, "observations": rows})


def _weights_checksums(settings: FitSettings) -> list[str]:
    """Return checksums of the prior's weights, and of the weights of every first guess."""
    names = dict.fromkeys([("open", FIRST), (settings.weights, settings.prior)])
    paths = [weights_path(name, kind) for name, kind in names]
    return [InputFiles(path, (path,)).checksum() for path in paths]


def _code_checksum(class_place: str) -> str:
    """Return a checksum of the file that defines a class "module:Class", without imports."""
    try:
        spec = find_spec(class_place.partition(":")[0])
    except (ImportError, ValueError):
        spec = None  # no such module: the fit will raise the error
    if spec is None or spec.origin is None or not Path(spec.origin).is_file():
        return MISSING
    return file_checksum(spec.origin)


def _bundled_checksums(package: str, folder: str, names: Sequence[str]) -> list[str]:
    found = resources.files(package) / folder
    with resources.as_file(found) as path:
        return [file_checksum(path / name) for name in names]


def _files_inside(folder: Path, endings: Sequence[str]) -> tuple[Path, ...]:
    return tuple(files_of(folder, endings)) if folder.is_dir() else ()

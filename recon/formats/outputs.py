"""Checks, before a command starts, whether its outputs can and may be written.

recon's own files are those whose checksum stands in the report beside them
(`recon.formats.reports`).
"""

import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass
from enum import Enum
from pathlib import Path
from typing import Any

from recon.formats.replacing import clear_leftovers, temporary_path
from recon.formats.reports import read_report


class OutputKind(Enum):
    """Kind of an output: a file or a folder, and where its report lies."""

    FILE = "a file with its report beside it, OUT.json"
    REPORT = "a JSON file that is its own report"
    FOLDER = "a folder that is written whole, with report.json in it"
    CONTINUED = "a folder in which a later run of the same verb goes on"


@dataclass(frozen=True)
class Output:
    """One file or folder that a command writes."""

    path: Path
    kind: OutputKind = OutputKind.FILE
    is_former: Callable[[Path], bool] | None = None
    """Tests whether files in a folder come from a former run; only for continued folders."""
    inside_input: bool = False
    """Whether the output may lie in an input folder, since the reader leaves results alone."""

    @property
    def real_path(self) -> Path:
        """The path with symbolic links resolved, since a link's target is what is written over."""
        return Path(os.path.realpath(self.path))

    @property
    def is_folder(self) -> bool:
        """Whether the output is a folder."""
        return self.kind in (OutputKind.FOLDER, OutputKind.CONTINUED)

    @property
    def base_folder(self) -> Path:
        """The folder to which file names in the report are relative."""
        return self.real_path if self.is_folder else self.real_path.parent

    @property
    def report(self) -> Path | None:
        """Path of the report, which lists the files that recon wrote; None for CONTINUED."""
        places = {
            OutputKind.FILE: self.real_path.parent / f"{self.real_path.name}.json",
            OutputKind.REPORT: self.real_path,
            OutputKind.FOLDER: self.real_path / "report.json",
        }
        return places.get(self.kind)

    @property
    def places(self) -> tuple[Path, ...]:
        """Paths of the output and of its report."""
        others = () if self.report in (None, self.real_path) else (self.report,)
        return (self.real_path, *others)


def check_outputs(
    outputs: Sequence[Output], inputs: Iterable[Path] = (), *, overwrite: bool = False
) -> None:
    """Refuse outputs that cannot or must not be written; remove leftovers of killed runs.

    Args:
        outputs: everything that will be written.
        inputs: everything that will be read; none of it is ever written over.
        overwrite: whether files that recon did not write may be replaced.

    Raises:
        ValueError: when a place is an input, holds one or lies in one, is named twice, or is a
            folder where a file is written or the other way round.
        FileExistsError: when something is there that recon did not write.
        OSError: when nothing can be written there.
    """
    inputs = list(inputs)
    taken: dict[Path, Path] = {}
    for output in outputs:
        refuse_outputs_over_inputs(output, inputs)
        refuse_unwritable(output)
        checksums_of_own_files(output, overwrite=overwrite)
        for place in output.places:
            if place in taken:
                raise ValueError(
                    f"{output.path} and {taken[place]} would both be written as {place}; give "
                    "each a name of its own"
                )
            taken[place] = output.path


def refuse_outputs_over_inputs(output: Output, inputs: Iterable[Path]) -> None:
    """Refuse an output that is an input, holds one, or lies in an input folder.

    Symbolic and hard links, relative paths and other spellings are resolved.

    Raises:
        ValueError: naming output and input, and saying what to do.
    """
    for given in inputs:
        real = Path(os.path.realpath(given))
        for place in output.places:
            if _same_file(place, real):
                written = output.path if place == output.real_path else place
                raise ValueError(
                    f"{written} is the input {given}, which would be lost; write somewhere else"
                )
        # a symbolic link lies in two folders: its own and that of its target
        names = (real, Path(os.path.realpath(given.parent)) / given.name)
        if output.is_folder and any(name.is_relative_to(output.real_path) for name in names):
            raise ValueError(f"{output.path} holds the input {given}; write to another folder")
        if real.is_dir() and output.real_path.is_relative_to(real) and not output.inside_input:
            raise ValueError(
                f"{output.path} lies in the input {given}, and would be read as part of it the "
                "next time; write somewhere else"
            )


def refuse_unwritable(output: Output) -> None:
    """Refuse a path that cannot be written, by creating and removing a file there.

    Raises:
        ValueError: when a folder is where a file is written, or the other way round.
        OSError: when the place is below a file, or cannot be written to.
    """
    real = output.real_path
    for place in output.places:
        if place.is_symlink():  # realpath resolves all links but circular ones
            raise OSError(f"{output.path}: its symbolic links lead in a circle; give another name")
        folder_asked = output.is_folder and place == real
        if place.is_dir() and not folder_asked:
            raise ValueError(f"{place} is a folder; give the name of a file")
        if place.is_file() and folder_asked:
            raise ValueError(f"{place} is a file; give the name of a folder")
        if place.exists() and not (place.is_dir() or place.is_file()):
            raise ValueError(f"{place} is no plain file; give another name")
    folder = real if real.is_dir() else real.parent
    while not folder.exists():
        folder = folder.parent
    if not folder.is_dir():
        raise NotADirectoryError(
            f"{output.path} would lie below {folder}, which is a file; write somewhere else"
        )
    for beside in (real, folder / real.name):
        clear_leftovers(beside)
    # whether the file system is read-only shows only in an attempt to write
    trial = temporary_path(folder / (real.name + ".json"))
    try:
        os.close(os.open(trial, os.O_CREAT | os.O_EXCL | os.O_WRONLY))  # O_EXCL fails on links
        trial.unlink()
    except OSError as error:
        raise OSError(
            f"{output.path} cannot be written ({error.strerror} in {folder}); write somewhere else"
        ) from error


def checksums_of_own_files(output: Output, *, overwrite: bool) -> Mapping[str, str]:
    """Return SHA-256 of the existing files that a former run wrote, keyed by name.

    Raises:
        FileExistsError: when there are other files, unless they may be replaced.
    """
    if output.report is None:
        assert output.is_former is not None
        if not overwrite and _existing_files(output) and not output.is_former(output.real_path):
            raise FileExistsError(
                f"{output.path} holds files already, and is not the folder of an interrupted run; "
                "give a new folder, or write into it by --overwrite"
            )
        return {}
    report = read_report(output.report)
    if report is None and output.report.exists() and not overwrite:
        raise FileExistsError(
            f"{output.report} exists, and recon did not write it or it was changed since; move it "
            "away, write somewhere else, or replace it by --overwrite"
        )
    own: dict[str, str] = {}
    for name, path in _existing_files(output).items():
        checksum = None if report is None else report.checksum_if_own(name, path)
        if checksum is not None:
            own[name] = checksum
        elif not overwrite:
            raise FileExistsError(
                f"{path} exists, and recon did not write it or it was changed since (its checksum "
                f"does not stand in {output.report.name}); write somewhere else, or replace it "
                "by --overwrite"
            )
    return own


def _existing_files(output: Output) -> dict[str, Path]:
    """Find an output's existing files, without hidden ones, keyed by their names in the report."""
    real = output.real_path
    found = sorted(real.rglob("*")) if output.is_folder else [real]
    return {
        path.relative_to(output.base_folder).as_posix(): path
        for path in found
        if (path.is_file() or path.is_symlink())
        and path != output.report
        and not any(part.startswith(".") for part in path.relative_to(real).parts)
    }


def _same_file(a: Path, b: Path) -> bool:
    """Whether two real paths are one file, also by a hard link or another spelling."""
    try:
        return os.path.samefile(a, b)
    except OSError:
        return a == b


_READ_TOGETHER = {".amc": "*.asf*", ".xz": "*.asf*", ".yml": "*.yml", ".yaml": "*.y*ml"}
"""Patterns of files in the same folder that are read along with a file of each suffix."""


def paths_in(value: Any) -> Iterator[Path]:
    """Find all paths of files in a value, also inside tuples, lists and dataclasses.

    A text counts where it is the name of a file that exists, as weights, cameras and shapes are
    given by a word or by a file. Files that are read along with another, like the skeleton (.asf)
    of an .amc recording, count, too.
    """
    match value:
        case Path():
            # FILE::MEMBER means MEMBER of the archive FILE
            path = value if value.exists() else Path(str(value).partition("::")[0])
            yield path
            if path.is_file() and (pattern := _READ_TOGETHER.get(path.suffix.lower())) is not None:
                yield from path.parent.glob(pattern)
        case str():
            path = Path(value)
            if path.suffix and path.is_file():
                yield path
        case tuple() | list():
            for one in value:
                yield from paths_in(one)
        case _ if is_dataclass(value):
            for field in fields(value):
                yield from paths_in(getattr(value, field.name))
        case _:
            pass

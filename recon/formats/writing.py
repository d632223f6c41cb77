"""Atomic writing of results with their reports: the report first, the result last."""

import os
import shutil
import signal
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import Any

from recon.formats.outputs import Kind, Output, own_files, refuse_place
from recon.formats.replacing import file_checksum, part_of
from recon.formats.reports import report_text


@contextmanager
def writing(
    *outputs: Output, report: Mapping[str, Any], overwrite: bool = False
) -> Iterator[tuple[Path, ...]]:
    """Paths to write the outputs at; all of them are put in place when the block ends well.

    Until then they are hidden beside their places, and nothing of them stays when the block fails
    or is interrupted. Reports are moved first and results last, so that there is never a result
    without its report. A folder has afterwards what was written to it now: what a former run wrote
    and this one did not is removed.

    Args:
        outputs: what is written; folders above are made where they do not exist.
        report: what the reports say; read when the block ends.
        overwrite: whether files that recon did not write may be replaced.

    Raises:
        FileExistsError: when something is there that recon did not write, at the beginning or by
            the end, unless it may be replaced.
        ValueError, OSError: when a place cannot be written to.
    """
    for output in outputs:
        refuse_place(output)
        own_files(output, overwrite=overwrite)
    with ExitStack() as stack:
        stages = [stack.enter_context(_staged(output)) for output in outputs]
        with _named_as_asked(stages):
            yield tuple(stage.path for stage in stages)
        # checked again, since the computation may have taken hours
        former = [own_files(output, overwrite=overwrite) for output in outputs]
        for stage, own in zip(stages, former, strict=True):
            stage.add_report(report, own)
        with uninterrupted():
            for stage in stages:
                stage.move_report()
            for stage, own in zip(reversed(stages), reversed(former), strict=True):
                stage.move(own)


@contextmanager
def writing_file(
    path: Path, report: Mapping[str, Any], *, overwrite: bool = False
) -> Iterator[Path]:
    """A context that writes one file, with its report beside it."""
    with writing(Output(path), report=report, overwrite=overwrite) as (staged,):
        yield staged


def write_report(path: Path, report: Mapping[str, Any], *, overwrite: bool = False) -> None:
    """A JSON file that is a result and its own report."""
    with writing(Output(path, Kind.REPORT), report=report, overwrite=overwrite):
        pass


@dataclass(frozen=True)
class _Stage:
    """An output while it is being written to a temporary place."""

    output: Output
    folder: Path
    """Hidden, on the file system of the output."""

    @property
    def path(self) -> Path:
        """Path at which the result is prepared; it has its own name already."""
        return self.folder / self.output.real.name

    @property
    def report(self) -> Path:
        """Path at which the report is prepared, where it will lie beside or in the result."""
        assert self.output.report is not None
        return self.folder / self.output.report.relative_to(self.output.real.parent)

    def files(self) -> dict[str, Path]:
        """Checksums of the written files, by their names in the report."""
        found = [self.path]
        if self.output.is_folder:
            found = [path for path in sorted(self.path.rglob("*")) if path.is_file()]
        base = self.path if self.output.is_folder else self.folder
        return {p.relative_to(base).as_posix(): p for p in found if p != self.report}

    def add_report(self, report: Mapping[str, Any], own: Mapping[str, str]) -> None:
        """Write the report, and flush everything to the disk."""
        files = self.files()
        found = {name: file_checksum(path) for name, path in files.items()}
        self.report.write_text(report_text(report, found, own), encoding="utf-8")
        for path in (*files.values(), self.report):
            with path.open("rb+") as file:
                os.fsync(file.fileno())

    def move_report(self) -> None:
        """Put the report in place; that of a new folder comes with the folder."""
        if not self.output.is_folder or self.output.real.exists():
            os.replace(self.report, self.output.real.parent / self.report.relative_to(self.folder))

    def move(self, own: Mapping[str, str]) -> None:
        """Put the result in place, and remove what a former run left of its own."""
        real = self.output.real
        if self.output.is_folder and not real.exists():
            os.rename(self.path, real)
            return
        files = self.files()
        for name, path in files.items():
            place = self.output.base / name
            place.parent.mkdir(parents=True, exist_ok=True)
            os.replace(path, place)
        for name in own.keys() - files.keys():
            (self.output.base / name).unlink(missing_ok=True)


@contextmanager
def _staged(output: Output) -> Iterator[_Stage]:
    real = output.real
    # an existing folder may be a mount point, which cannot be replaced at once
    beside = real / real.name if output.is_folder and real.is_dir() else real
    beside.parent.mkdir(parents=True, exist_ok=True)
    stage = _Stage(output, part_of(beside))
    shutil.rmtree(stage.folder, ignore_errors=True)
    try:
        stage.folder.mkdir()
        if output.is_folder:
            stage.path.mkdir()
        yield stage
    finally:
        shutil.rmtree(stage.folder, ignore_errors=True)


@contextmanager
def _named_as_asked(stages: Sequence[_Stage]) -> Iterator[None]:
    """Errors name the output instead of its temporary path."""
    try:
        yield
    except ValueError as error:
        text = str(error)
        for stage in stages:
            text = text.replace(str(stage.path), str(stage.output.path))
        raise ValueError(text) from error


@contextmanager
def uninterrupted() -> Iterator[None]:
    """Ctrl-C and the signal to end wait until the block is done."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    came: list[int] = []

    def later(number: int, _: FrameType | None) -> None:
        came.append(number)

    before = {number: signal.signal(number, later) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        for number in came:
            signal.raise_signal(number)

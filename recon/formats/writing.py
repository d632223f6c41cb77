"""Writes results with their reports atomically: the report first, the result last."""

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

from recon.formats.outputs import Output, OutputKind, checksums_of_own_files, refuse_unwritable
from recon.formats.replacing import file_checksum, temporary_path
from recon.formats.reports import report_text


@contextmanager
def writing(
    *outputs: Output, report: Mapping[str, Any], overwrite: bool = False
) -> Iterator[tuple[Path, ...]]:
    """Context of temporary paths, all moved to the outputs' places if the block succeeds.

    Until then they are hidden beside their places, and nothing of them stays when the block fails
    or is interrupted. Reports are moved first and results last, so that there is never a result
    without its report. Files in an output folder that a former run wrote and this one did not are
    removed.

    Args:
        outputs: files and folders to write; missing folders above them are made.
        report: entries of the reports; read when the block ends.
        overwrite: whether files that recon did not write may be replaced.

    Raises:
        FileExistsError: when something is there that recon did not write, at the beginning or by
            the end, unless it may be replaced.
        ValueError, OSError: when a place cannot be written to.
    """
    for output in outputs:
        refuse_unwritable(output)
        checksums_of_own_files(output, overwrite=overwrite)
    with ExitStack() as stack:
        stages = [stack.enter_context(_staged_output(output)) for output in outputs]
        with _errors_name_output(stages):
            yield tuple(stage.temporary_result for stage in stages)
        # checked again, since hours may have passed since the first check
        former = [checksums_of_own_files(output, overwrite=overwrite) for output in outputs]
        for stage, own in zip(stages, former, strict=True):
            stage.add_report(report, own)
        with delayed_signals():
            for stage in stages:
                stage.move_report()
            for stage, own in zip(reversed(stages), reversed(former), strict=True):
                stage.move(own)


@contextmanager
def writing_file(
    path: Path, report: Mapping[str, Any], *, overwrite: bool = False
) -> Iterator[Path]:
    """Context with a temporary path for one output file, which gets a report next to it."""
    with writing(Output(path), report=report, overwrite=overwrite) as (staged,):
        yield staged


def write_report(path: Path, report: Mapping[str, Any], *, overwrite: bool = False) -> None:
    """Write a JSON file that is a result and its own report."""
    with writing(Output(path, OutputKind.REPORT), report=report, overwrite=overwrite):
        pass


@dataclass(frozen=True)
class _StagedOutput:
    """An output that is being prepared in a temporary folder."""

    output: Output
    folder: Path
    """Hidden temporary folder, on the file system of the output."""

    @property
    def temporary_result(self) -> Path:
        """Temporary path of the result, under its final name."""
        return self.folder / self.output.real_path.name

    @property
    def temporary_report(self) -> Path:
        """Temporary path of the report, next to the result or in its folder."""
        assert self.output.report is not None
        return self.folder / self.output.report.relative_to(self.output.real_path.parent)

    def temporary_files(self) -> dict[str, Path]:
        """Temporary paths of the written files, keyed by their names in the report."""
        found = [self.temporary_result]
        if self.output.is_folder:
            found = [path for path in sorted(self.temporary_result.rglob("*")) if path.is_file()]
        base = self.temporary_result if self.output.is_folder else self.folder
        return {p.relative_to(base).as_posix(): p for p in found if p != self.temporary_report}

    def add_report(self, report: Mapping[str, Any], former: Mapping[str, str]) -> None:
        """Write the report into the temporary folder, and flush all files to the disk."""
        files = self.temporary_files()
        found = {name: file_checksum(path) for name, path in files.items()}
        self.temporary_report.write_text(report_text(report, found, former), encoding="utf-8")
        for path in (*files.values(), self.temporary_report):
            with path.open("rb+") as file:
                os.fsync(file.fileno())

    def move_report(self) -> None:
        """Move the report to its place; that of a new folder is moved with the folder."""
        if not self.output.is_folder or self.output.real_path.exists():
            os.replace(
                self.temporary_report,
                self.output.real_path.parent / self.temporary_report.relative_to(self.folder),
            )

    def move(self, former: Mapping[str, str]) -> None:
        """Move the result to its place, and remove files of a former run."""
        real = self.output.real_path
        if self.output.is_folder and not real.exists():
            os.rename(self.temporary_result, real)
            return
        files = self.temporary_files()
        for name, path in files.items():
            place = self.output.base_folder / name
            place.parent.mkdir(parents=True, exist_ok=True)
            os.replace(path, place)
        for name in former.keys() - files.keys():
            (self.output.base_folder / name).unlink(missing_ok=True)


@contextmanager
def _staged_output(output: Output) -> Iterator[_StagedOutput]:
    real = output.real_path
    # stage inside an existing output folder: it may be a mount point, which cannot be replaced
    beside = real / real.name if output.is_folder and real.is_dir() else real
    beside.parent.mkdir(parents=True, exist_ok=True)
    stage = _StagedOutput(output, temporary_path(beside))
    shutil.rmtree(stage.folder, ignore_errors=True)
    try:
        stage.folder.mkdir()
        if output.is_folder:
            stage.temporary_result.mkdir()
        yield stage
    finally:
        shutil.rmtree(stage.folder, ignore_errors=True)


@contextmanager
def _errors_name_output(stages: Sequence[_StagedOutput]) -> Iterator[None]:
    """Context whose errors name the output instead of its temporary path."""
    try:
        yield
    except ValueError as error:
        text = str(error)
        for stage in stages:
            text = text.replace(str(stage.temporary_result), str(stage.output.path))
        raise ValueError(text) from error


@contextmanager
def delayed_signals() -> Iterator[None]:
    """Context that delays Ctrl-C and termination signals until its block is done."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    received: list[int] = []

    def remember_signal(number: int, _: FrameType | None) -> None:
        received.append(number)

    before = {
        number: signal.signal(number, remember_signal)
        for number in (signal.SIGINT, signal.SIGTERM)
    }
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        for number in received:
            signal.raise_signal(number)

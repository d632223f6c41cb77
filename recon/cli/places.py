"""Declares the outputs of verbs, which are checked before anything is computed.

Every path among a verb's arguments that is not declared as written is something that it reads,
and must be there.
"""

import functools
import inspect
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ParamSpec, TypeVar

from tyro.conf import arg

from recon.cli import console
from recon.cli.inputs import check_inputs
from recon.formats.outputs import Output, OutputKind, check_outputs, paths_in

Overwrite = Annotated[bool, arg(help="Replace files that are there and recon did not write.")]
"""The option of every verb that writes."""
Quiet = Annotated[
    bool,
    arg(help="Say nothing but errors and, last, where the result is. Warnings are in its report."),
]
"""The option of every verb that tells what it does."""
Arguments = Mapping[str, Any]
"""A verb's arguments by name."""
P = ParamSpec("P")
R = TypeVar("R")


def file_output(path: Path, _: Arguments) -> tuple[Output, ...]:
    """Declare the path as an output file with a report beside it."""
    return (Output(path),)


def motion_output(path: Path, _: Arguments) -> tuple[Output, ...]:
    """Declare the path as a motion file, whose name must not end like a file of another kind.

    Raises:
        ValueError: when it ends in .bvh, .glb and the like, which other programs could not open.
    """
    # an existing path is refused by a later check, whose message says more
    if not path.exists() and path.suffix.lower() in (
        ".bvh", ".c3d", ".csv", ".fbx", ".glb", ".html", ".mot", ".mp4", ".npy", ".trc", ".usd"
    ):  # fmt: skip
        raise ValueError(
            f"{path}: a motion is written as .npz; give such a name, and make other files of it "
            "by `recon export` or `recon view`"
        )
    return (Output(path),)


def report_output(path: Path, _: Arguments) -> tuple[Output, ...]:
    """Declare the path as an output file in JSON without another report."""
    return (Output(path, OutputKind.REPORT),)


def folder_output(path: Path, _: Arguments) -> tuple[Output, ...]:
    """Declare the path as an output folder, which is written as a whole."""
    return (Output(path, OutputKind.FOLDER),)


def folder_or_npz_output(path: Path, given: Arguments) -> tuple[Output, ...]:
    """Declare the path as one motion file if it ends in .npz, else as a folder of several.

    Raises:
        ValueError: when several motions are asked for in one file.
    """
    if path.suffix == ".npz" and (count := given.get("count", given.get("samples"))) > 1:
        raise ValueError(f"{path} is one file, but {count} motions were asked for; give a folder")
    return (Output(path, OutputKind.FILE if path.suffix == ".npz" else OutputKind.FOLDER),)


@dataclass(frozen=True)
class Place:
    """A verb's argument that names an output, and a function that lists what is written."""

    parameter: str
    outputs: Callable[[Path, Arguments], tuple[Output, ...]] = file_output
    """Lists what is written, from the path and all arguments; default: a file and its report."""


def writes(
    *places: Place, reads: Callable[[Arguments], Iterable[Path]] = lambda _: ()
) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Declare the outputs of a verb; inputs and outputs are then checked before it runs.

    Args:
        places: every argument that names an output. The verb has an argument `overwrite` besides.
        reads: paths that the verb reads beside those among its arguments.
    """

    def declare(verb: Callable[P, R]) -> Callable[P, R]:
        signature = inspect.signature(verb)
        written = {place.parameter for place in places}

        @functools.wraps(verb)
        def checked(*args: P.args, **kwargs: P.kwargs) -> R:
            bound = signature.bind(*args, **kwargs)
            bound.apply_defaults()
            given = bound.arguments
            read = {name: value for name, value in given.items() if name not in written}
            check_inputs(read)
            check_outputs(
                [
                    one
                    for place in places
                    if given[place.parameter] is not None
                    for one in place.outputs(given[place.parameter], given)
                ],
                (*paths_in(tuple(read.values())), *reads(given)),
                overwrite=given.get("overwrite", False),
            )
            with console.quiet_if(given.get("quiet", False)):
                return verb(*bound.args, **bound.kwargs)

        vars(checked)["writes"] = places
        return checked

    return declare

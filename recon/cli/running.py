"""Runs a verb: calls its function, writes the result with a report, prints a summary."""

from collections.abc import Mapping, Sequence
from importlib import import_module
from inspect import Parameter, signature
from pathlib import Path
from typing import Any

from recon.cli import console
from recon.cli.errors import Failed
from recon.cli.films import draw_film_sheets, films_given, with_films_detected
from recon.cli.looks import refuse_unsuitable


def run(function_name: str, outputs: Sequence[str], given: Mapping[str, Any]) -> None:
    """Call a verb's function with a command line's values; write and print its result.

    Args:
        function_name: "module:name".
        outputs: names of arguments that name outputs. The first is the place of the result where
            the function does not write it itself.
        given: arguments by name; `settings` are options of fits, `json` asks for an answer.

    Raises:
        Failed: when a fit met nan or inf.
        FileNotFoundError, ValueError: for bad input.
    """
    refuse_unsuitable(given)
    if outputs and isinstance(out := given.get(outputs[0]), Path):
        given = with_films_detected(given, out)
    module, _, name = function_name.partition(":")
    function = getattr(import_module(module), name)
    known = signature(function).parameters
    how = {key: value for key, value in given.items() if key in known}
    how |= {key: read(how[key]) for key, read in _VALUES.items() if key in how}
    if not outputs or outputs[0] in known:
        _print_result(function(**how), given)
        return
    from recon.reading.inputs import input_checksums

    options = {key: one for key, one in how.items() if not _is_input_file(known[key], one)}
    more = dict[str, Any]()
    settings = given.get("settings")
    if settings is not None:
        options |= vars(settings)
        more = settings.arguments()
    # checksums are taken before reading, so that changes of files during the run are noticed
    inputs = input_checksums(how | options)
    with console.stage_progress_bars({}) as watch:
        result = function(**how, **more, **({"callback": watch} if more else {}))
    out = given[outputs[0]]
    write_and_tell(result, out, inputs, options, given)
    if settings is not None:
        draw_film_sheets(films_given(given), out, settings)


def write_and_tell(
    result: Any,
    out: Path | None,
    inputs: Mapping[str, str],
    options: Mapping[str, Any],
    given: Mapping[str, Any],
) -> None:
    """Write a result with its report and print a summary; without a path, print the result.

    Raises:
        Failed: when a fit met nan or inf.
        FileExistsError, ValueError, OSError: when it cannot be written.
    """
    written: Any = None
    report = result.report(*([out] if hasattr(result, "noun") else []), inputs, options)
    if out is not None:
        written = result.save(out, overwrite=given["overwrite"], report=report)
    print_summary(report, result.tables, ", ".join(map(str, written or [out])) if out else "")
    if given["json"] is True:
        console.print_json({**report.get("conversion", {}), **report})
    elif out is None:
        console.print_json(result)
    if report.get("failed"):
        reasons = "; ".join(stage["termination"] for stage in report.get("stages", ()))
        raise Failed(f"{out}: the fit failed: {reasons or 'it met nan or inf'}")


def print_summary(report: Mapping[str, Any], tables: Mapping[str, Any], place: str) -> None:
    """Print tables and findings of a result, and where it was written.

    Args:
        report: of the result.
        tables: of numbers, by title.
        place: of the result; empty where it was not written.
    """
    for line in report.get("read", ()):
        console.print_note(line)
    for line in report.get("decisions", ()):
        console.print_progress(f"  {line}")
    for stage in report.get("stages", ()):
        console.print_progress(
            f"{stage['name']:<9} {stage['iterations']:>4} iterations {stage['seconds']:>7.2f} s, "
            f"total {sum(stage['energies'].values()):.4g}: {stage['termination']}"
        )
    if cycle := report.get("cycle"):
        residuals = ", ".join(f"{mm:.0f}" for mm in cycle["residual_mm"] if mm is not None)
        console.print_progress(
            f"one cycle of {cycle['seconds']:.2f} s, seen at {cycle['moments_seen']} moments, "
            f"code distance {cycle['code_distance']:.2f}, "
            f"residual {residuals} mm"
        )
    console.print_findings(report)
    for title, rows in tables.items():
        console.print_table(title, rows)
    if place:
        console.print_last_line(place)


def _print_result(found: Any, given: Mapping[str, Any]) -> None:
    """Print what a verb's function returned, as JSON, rows or tables.

    Functions with the option `json` return the facts of one file; others write files, and return
    tables, warnings and the place of these.
    """
    if given.get("json"):
        console.print_json(found)
    elif "json" in given:
        console.print_facts(str(given["file"]), found)
    elif found is not None:
        for title, rows in found.tables.items():
            console.print_table(title, rows)
        for warning in getattr(found, "warnings", ()):
            console.print_warning(warning)
        console.print_last_line(str(found.place))


def _is_input_file(parameter: Parameter, value: Any) -> bool:
    """Whether an argument is an input file of the verb, and not a setting."""
    return parameter.default is Parameter.empty and isinstance(value, Path | tuple)


def _frame_range(text: str | None) -> tuple[int, int] | None:
    if text is None:
        return None
    first, colon, last = text.partition(":")
    if not (colon and first.isdigit() and last.isdigit() and int(first) < int(last)):
        raise ValueError(f"--frames must be A:B with A < B, for example 0:90; got {text!r}")
    return int(first), int(last)


def _two_corners(corners: tuple[float, ...] | None) -> tuple[tuple[float, ...], ...] | None:
    return None if corners is None else (corners[:3], corners[3:])


_VALUES = {"frames": _frame_range, "hide_box": _two_corners}
"""Arguments that a command line writes in another way than a caller does."""

"""`recon bench`: evaluates methods on published windows with the same noise."""

from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import Positional, arg

from recon.cli.places import Overwrite, Place, Quiet, folder_output, report_output, writes


@writes(Place("json", report_output), Place("write", folder_output))
def bench(
    protocol: Positional[Literal["noisy-joints", "hidden-points", "gap", "upper-body"]],
    method: tuple[str, ...] = (),
    predictions: tuple[Path, ...] = (),
    corpus: Path | None = None,
    part: Literal["test", "validation"] = "test",
    splits: Path | None = None,
    only: int | None = None,
    write: Path | None = None,
    json: Annotated[Path | None, arg(help="File for all numbers.")] = None,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
) -> None:
    """Evaluate methods on published windows with the same noise.

    The windows are those of the free CMU recordings that the package lists, 2 s each. Without
    --corpus they are two of the bundled walk, which shows that a method runs, not how good it is.

    Args:
        protocol: 22 joints with 4 cm of noise; 43 points of the skin, those below 0.9 m hidden;
            22 joints of which nothing is seen for one second; joints from the pelvis up.
        method: built-in ones (linear, butterworth, least-squares, pose, collocation,
            rollout), and package.module:Class of your own; default: pose collocation.
        predictions: folders with one prediction per window, a motion file or an .npz of joints
            (time, 22, 3) in metres, named as the files of --write.
        corpus: folder of the converted CMU recordings (recon convert --all).
        part: windows of the test people, or of the validation people to choose on.
        splits: own parts and windows (.toml); default: the committed list.
        only: use so many windows, evenly from the list.
        write: folder for what methods see of every window; nothing is judged.
        json: file to write all numbers to.
        overwrite: replace files that are there and recon did not write.
        quiet: say nothing but errors and, last, where the result is.
    """
    del quiet  # the decorator `writes` has applied it
    from recon.cli import console
    from recon.cli.looks import allow_current_folder

    if write is not None and (method or predictions or json is not None):
        raise ValueError("--write writes observations only; evaluate methods in another run")
    allow_current_folder(method)
    from recon.benchmark import judged as work

    if write is not None:
        files = work.write_windows(
            protocol, write, corpus, part=part, splits=splits, only=only, overwrite=overwrite
        )
        console.print_last_line(f"{len(files)} windows in {write}")
        return
    with console.progress_bars() as bar:
        tasks = {}

        def advance_bar(name: str, window: str) -> None:
            if name not in tasks:
                tasks[name] = bar.add_task(name, total=None)
            bar.update(tasks[name], description=f"{name}: {window}", advance=1)

        table = work.bench(
            protocol, method, corpus, predictions=predictions, part=part, splits=splits, only=only,
            callback=advance_bar,
        )  # fmt: skip
    console.print_table(f"{protocol}, {table.source}", table.rows())
    if json is None:
        console.print_json(table.as_json())
    else:
        table.save(json, overwrite=overwrite)
        console.print_last_line(str(json))

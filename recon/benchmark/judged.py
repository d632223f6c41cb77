"""`recon.bench`: evaluates methods on the same windows of freely available motions."""

import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import torch

from recon.benchmark.answers import (
    Answer,
    Row,
    answer_from_folder,
    answer_of,
    feet_balanced_accuracy,
    metrics_of_answer,
)
from recon.benchmark.methods import BenchMethod, method_named
from recon.benchmark.protocols import BenchProtocol, SeenWindow, protocol_named, seen_windows
from recon.benchmark.table import BenchTable
from recon.benchmark.windows import BenchPart, TrueWindows, bench_windows
from recon.body.model import BodyModel
from recon.core.errors import ReconError
from recon.formats.observations import save_observation
from recon.formats.outputs import Output, OutputKind
from recon.formats.reports import versions
from recon.formats.writing import writing

DEFAULT = ("pose", "collocation")
"""Methods that are judged where none is named: stages 1-2, and collocation under HuMoR."""
TRUTH = "truth"
"""The last row: what the metrics say of the true motion itself."""


def bench(
    protocol: str,
    methods: Sequence[str] | Mapping[str, BenchMethod] = (),
    corpus: Path | str | None = None,
    *,
    predictions: Sequence[Path | str] = (),
    part: BenchPart = "test",
    splits: Path | str | None = None,
    only: int | None = None,
    callback: Callable[[str, str], None] | None = None,
) -> BenchTable:
    """Evaluate methods on the windows and with the noise of a published protocol.

    Args:
        protocol: what is seen: `noisy-joints`, `hidden-points`, `gap` or `upper-body`.
        methods: names of built-in methods (`linear`, `butterworth`, `least-squares`, `pose`,
            `collocation`, `rollout`), classes "package.module:Class", or objects by
            the names they shall have; see `BenchMethod`. Without any, and without predictions,
            `pose` and `collocation`.
        corpus: folder of the free CMU recordings on our body (`recon convert --all`); None is
            the bundled clip of four seconds, which shows that a method runs.
        predictions: folders of predictions, one file per window as `write_windows` names them;
            each is a row of the table.
        part: windows of the test people, or of the validation people to choose on.
        splits: a file of own parts and windows instead of the committed list.
        only: use so many windows, evenly from the list.
        callback: called with the method and the window before each is given back.

    Returns:
        Means over subjects with 95 % intervals, and the values of every window.

    Raises:
        ReconError: when a name is unknown, windows are missing, or a method gives something else
            than a motion or joints of the window's frames.
        FileNotFoundError: when there is no such folder, file of splits, or prediction.
    """
    asked, body = protocol_named(protocol), BodyModel.load()
    if len(methods) == 0 and len(predictions) == 0:
        methods = DEFAULT
    made = (
        dict(methods)
        if isinstance(methods, Mapping)
        else {name: method_named(name, body) for name in methods}
    )
    folders = {Path(folder).name: Path(folder) for folder in predictions}
    if TRUTH in {*made, *folders} or set(made) & set(folders) or len(folders) < len(predictions):
        raise ReconError(
            "expected different names of methods and folders of predictions, none of them "
            f"{TRUTH!r}; rename them"
        )
    windows, about, checksum = bench_windows(_as_path(corpus), part, _as_path(splits), only, body)
    seen = seen_windows(asked, windows, body)
    rows: dict[str, list[Row]] = {}
    feet: dict[str, float | None] = {}
    for name, method in made.items():
        given: list[Answer] = []
        seconds: list[float] = []
        for window in seen:
            if callback is not None:
                callback(name, window.name)
            began = time.process_time()
            answer = method(window.seen)
            seconds.append(time.process_time() - began)
            given.append(answer_of(answer, window, body, name))
        rows[name], feet[name] = _evaluated_windows(asked, windows, seen, given, body)
        for row, own in zip(rows[name], seconds, strict=True):
            row["seconds"] = own
    for name, folder in folders.items():
        given = [answer_from_folder(folder, window, body) for window in seen]
        rows[name], feet[name] = _evaluated_windows(asked, windows, seen, given, body)
    truth = [answer_of(window.truth, window, body, TRUTH) for window in seen]
    rows[TRUTH], feet[TRUTH] = _evaluated_windows(asked, windows, seen, truth, body)
    values = {
        name: {
            metric: [row.get(metric) for row in own]
            for metric in dict.fromkeys([*asked.columns, *(key for row in own for key in row)])
        }
        for name, own in rows.items()
    }
    names, counted = windows.names, tuple(windows.averaged_subjects)
    return BenchTable(asked, about, names, windows.subjects, counted, values, feet, checksum)


def write_windows(
    protocol: str,
    folder: Path | str,
    corpus: Path | str | None = None,
    *,
    part: BenchPart = "test",
    splits: Path | str | None = None,
    only: int | None = None,
    overwrite: bool = False,
) -> list[Path]:
    """Write an observation file per window, as methods see it, without the truth.

    Predictions go into another folder under the same names, for `bench(predictions=...)`.

    Args:
        protocol: as for `bench`, and so are `corpus`, `part`, `splits` and `only`.
        folder: to write.
        corpus: folder of motions.
        part: of the windows.
        splits: own parts and windows.
        only: so many windows.
        overwrite: replace files that are there and recon did not write.

    Raises:
        ReconError, FileNotFoundError: as `bench`.
        FileExistsError: when the folder holds files that recon did not write, unless `overwrite`.
    """
    asked, body = protocol_named(protocol), BodyModel.load()
    windows, about, checksum = bench_windows(_as_path(corpus), part, _as_path(splits), only, body)
    report = {"protocol": asked.name, "about": asked.about, "source": about}
    report |= {"data": checksum, "versions": versions()}
    written: list[Path] = []
    output = Output(Path(folder), OutputKind.FOLDER)
    with writing(output, report=report, overwrite=overwrite) as (staged,):
        for window in seen_windows(asked, windows, body):
            save_observation(staged / window.file_name, window.seen)
            written.append(Path(folder) / window.file_name)
    return written


def _evaluated_windows(
    protocol: BenchProtocol,
    windows: TrueWindows,
    seen: Sequence[SeenWindow],
    answers: Sequence[Answer],
    body: BodyModel,
) -> tuple[list[Row], float | None]:
    """Return a method's metrics for each window, and its accuracy of foot contacts over all."""
    rows = [metrics_of_answer(protocol, *pair, body) for pair in zip(seen, answers, strict=True)]
    contacts = [answer.contacts for answer in answers if answer.contacts is not None]
    if len(contacts) < len(answers):
        return rows, None
    predicted = torch.stack([one[slice(*protocol.judged)].double() for one in contacts]) > 0.5
    return rows, feet_balanced_accuracy(windows.frames(*protocol.judged), predicted)


def _as_path(given: Path | str | None) -> Path | None:
    return None if given is None else Path(given)

"""`recon batch` and `recon convert --all`: many clips at once."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Annotated

from tyro.conf import OmitArgPrefixes, Positional, arg

from recon.cli.errors import Failed
from recon.cli.places import Arguments, Overwrite, Place, Quiet, writes
from recon.fitting.settings import DEFAULTS, FitSettings
from recon.formats.outputs import Output, OutputKind

if TYPE_CHECKING:
    from recon.batch.workers import Run


def _is_former_batch(folder: Path) -> bool:
    """Whether a folder holds the log of a former `recon batch`, possibly still empty."""
    from recon.batch.worklog import read_log

    logs = list(folder.glob("log*.jsonl"))
    return any(b"\n" not in log.read_bytes() or read_log(log) for log in logs)


def _batch_output(out: Path, _: Arguments) -> tuple[Output, ...]:
    return (Output(out, OutputKind.CONTINUED, is_former=_is_former_batch),)


def _observations_in_manifest(given: Arguments) -> Iterator[Path]:
    from recon.batch.worklog import read_manifest

    if given["manifest"].exists():
        for clip in read_manifest(given["manifest"]):
            yield from clip.observations


@writes(Place("out", _batch_output), reads=_observations_in_manifest)
def batch(
    manifest: Positional[Path],
    out: Path,
    settings: OmitArgPrefixes[FitSettings] = DEFAULTS,
    processes: int | None = None,
    shard: str = "0/1",
    ray: str | None = None,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
) -> None:
    """Fit every clip of a manifest; run it again to go on where it stopped.

    The manifest has one JSON object per line: {"id": "clip", "observations": ["clip.npz"]}.
    With "subject": "anna" beside, the clips of one subject share one shape, which is estimated
    from all of them first. Results are OUT/ID.npz; OUT/log.jsonl says what became of each clip.
    A clip is fitted again when the contents of its files, of the calibration, body, masks or
    weights, the settings or its subject's shape are others than before. Exit code 1 says that
    some clip has no result; see the log for why.

    Args:
        manifest: JSON lines, paths relative to them; or a folder, of which every film is fitted.
        out: folder for the results.
        settings: how to fit.
        processes: that work at a time, one thread each; default: 2, and with --ray as many as
            the cluster has processors.
        shard: I/N fits the I-th of N equal parts: one part per machine or job of a cluster.
        ray: `local`, or the address of a Ray cluster that does the work (motion-recon[ray]); its
            machines have recon and see the same files under the same paths.
        overwrite: replace files that are there and recon did not write.
        quiet: say nothing but errors and, last, where the result is.
    """
    del quiet  # the decorator `writes` has applied it
    from recon.cli import console
    from recon.cli.looks import check_plugins

    check_plugins(settings.prior, settings.reader)
    from recon.batch.batch import fit_all
    from recon.batch.worklog import clips_of_shard as part
    from recon.batch.worklog import read_manifest

    if ray is not None:
        from recon.batch.ray_cluster import with_absolute_paths

        # a cluster's processes start in other folders, where relative paths mean other files
        manifest, out, settings = (
            manifest.absolute(),
            out.absolute(),
            with_absolute_paths(settings),
        )
    index, slash, count = shard.partition("/")
    if not (slash and index.isdigit() and count.isdigit()):
        raise ValueError(f"--shard must be I/N, for example 0/4; got {shard!r}")
    clips = part(read_manifest(manifest), int(index), int(count))
    out.mkdir(parents=True, exist_ok=True)
    log = out / ("log.jsonl" if shard == "0/1" else f"log-{index}-{count}.jsonl")
    counts: dict[str, int] = {}
    with console.progress_bars() as bar, _executor(processes, ray) as (workers, run):
        task = bar.add_task("clips", total=len(clips))
        for record in fit_all(clips, out, settings, workers, log, overwrite=overwrite, run=run):
            counts[record["status"]] = counts.get(record["status"], 0) + 1
            if "error" in record:
                console.print_error(f"{record['id']}: {record['status']}: {record['error']}")
            bar.advance(task)
    console.print_json({"clips": len(clips), **counts, "log": str(log)})
    console.print_last_line(str(out))
    if any(status not in ("ok", "skipped") for status in counts):
        bad = sum(n for status, n in counts.items() if status not in ("ok", "skipped"))
        raise Failed(f"{bad} of {len(clips)} clips were not fitted; {log} says why")


@contextmanager
def _executor(processes: int | None, ray: str | None) -> Iterator[tuple[int, "Run"]]:
    """Context: number of processes, and the function that runs jobs locally or by Ray."""
    if ray is None:
        from recon.batch.workers import run_jobs

        yield 2 if processes is None else processes, run_jobs
        return
    from recon.batch.ray_cluster import ray_cluster

    # Ray's output must not mix with the answer on stdout
    with redirect_stdout(sys.stderr), ray_cluster(ray, processes) as (cpus, run):
        yield cpus if processes is None else processes, run


def _is_former_corpus(folder: Path) -> bool:
    """Whether a folder holds the report.json of a former `recon convert --all`."""
    import json

    try:
        rows = json.loads((folder / "report.json").read_bytes())
    except (OSError, ValueError, RecursionError):
        return False
    return isinstance(rows, list) and all(isinstance(row, dict) and "clip" in row for row in rows)


def _corpus_output(out: Path, _: Arguments) -> tuple[Output, ...]:
    # OUT may lie in the folder of recordings, since motion files are no recordings
    return (Output(out, OutputKind.CONTINUED, inside_input=True, is_former=_is_former_corpus),)


@writes(Place("out", _corpus_output))
def convert_all(
    recordings: Positional[Path],
    out: Positional[Path],
    body: Path | None = None,
    processes: int = 2,
    json: Annotated[bool, arg(help="Print the report as JSON on stdout.")] = False,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
) -> None:
    """Convert every skeleton recording below a folder to our body, one shape per skeleton.

    Run it again to continue. Exit code 1 says that something went wrong with some; those that are
    too short or of an unknown skeleton are rejected, which is in the report alone. Unit, axis and
    rate are taken from each file. Files of markers (.c3d, .trc, .mat) are left out, which the
    report tells: convert each by `recon convert`, in a loop, or fit many by `recon batch`.

    Args:
        recordings: folder of skeleton recordings (.bvh, .amc, also .xz).
        out: folder for the motions and the report.
        body: a SMPL-family file of your own; default: the bundled body.
        processes: clips at a time.
        json: print the report as JSON on stdout.
        overwrite: replace files that are there and recon did not write.
        quiet: say nothing but errors and, last, where the result is.
    """
    del quiet  # the decorator `writes` has applied it
    from recon.batch.corpus import convert_corpus
    from recon.cli import console

    rows = convert_corpus(recordings, out, processes=processes, body=body, overwrite=overwrite)
    kept = [row for row in rows if row.get("kept")]
    failed = [row for row in rows if row["status"] not in ("ok", "rejected")]
    table = out / "report.csv"
    summary = {
        "clips": len(rows),
        "converted": len(kept),
        "rejected": len(rows) - len(kept) - len(failed),
        "failed": len(failed),
        "minutes": round(sum(float(row["seconds"] or 0) for row in kept) / 60, 2),
        "median_residual_mm": median(float(row["residual_mm"] or 0) for row in kept)
        if kept
        else 0,
        "report": str(table),
    }
    console.print_table(str(out), {key: {"value": value} for key, value in summary.items()})
    console.print_last_line(str(out))
    if json:
        console.print_json(summary)
    if not kept:
        raise Failed(f"{recordings}: no recording could be converted; see {table}")
    if failed:
        raise Failed(f"{len(failed)} recordings could not be converted; {table} says why")

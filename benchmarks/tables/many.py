"""Throughput of batches, and what it makes a million clips cost."""

from collections.abc import Iterator, Mapping
from typing import Any

from benchmarks.tables.values import markdown, number, result, source

_VARIANTS = ("0.1.0", "one by one")
_CLIP_SECONDS = (2, 10, 60)
_CLIPS = 1_000_000
_CORES = 64


def batch() -> str:
    """Commands that fit the same clips: 0.1.0, and this version."""
    found = result("batch")
    count = found["clips"]
    rows = [line for prior, row in found["rows"].items() for line in _beside(prior, row, count)]
    headings = [f"{count} clips, {found['processes']} processes", "CPU s a clip",
                "MB a process", "error cm",
                "throughput, of 0.1.0"]  # fmt: skip
    return markdown(headings, rows) + source("batch")


def _beside(prior: str, row: Mapping[str, Any], clips: int) -> Iterator[list[str]]:
    for name in _VARIANTS:
        cost = row[name]
        yield [
            f"`{prior}`, {name}", number(cost["cpu_seconds"] / clips, 1, 2),
            number(cost["largest_mb"], 1, 0), number(cost["error"], 100, 2),
            number(row["0.1.0"]["cpu_seconds"] / cost["cpu_seconds"], 1, 2),
        ]  # fmt: skip


def million() -> str:
    """Core hours of a million clips, in proportion to the frames of those that were measured."""
    found = result("batch")
    rows = []
    for prior, row in found["rows"].items():
        cost = row["one by one"]
        frame = cost["cpu_seconds"] / found["clips"] / found["frames"]
        hours = [_CLIPS * 30 * seconds * frame / 3600 for seconds in _CLIP_SECONDS]
        gigabytes = _CORES * cost["largest_mb"] / 1024
        rows.append([
            f"`{prior}`", number(1000 * frame, 1, 1),
            *(f"{round(one, -2):,.0f}" for one in hours),
            number(hours[0] / _CORES / 24, 1, 1), number(gigabytes, 1, 0),
        ])  # fmt: skip
    headings = ["a million clips at 30 Hz", "CPU ms a frame",
                *(f"core hours, clips of {seconds} s" for seconds in _CLIP_SECONDS),
                f"days of {_CORES} cores, {_CLIP_SECONDS[0]} s",
                f"GB of {_CORES} processes"]  # fmt: skip
    return markdown(headings, rows) + source("batch")

"""The command `recon`, whose verbs are Python functions from a table and entry points.

Exit codes: 0 done, 1 the fit failed (the last finite estimate was written), 2 bad input or no
place to write to, 130 interrupted.
Results go to files, tables of results and progress to stderr, what was asked for (`--json`,
`info`, `--version`) to stdout.
"""

import logging
import os
import platform
import signal
import sys
from collections.abc import Callable, Sequence
from types import FrameType

from recon import __distribution__, __version__
from recon.core.visible import visible

if __distribution__ != "motion-recon":
    raise ImportError(
        "another package `recon` shadows that of motion-recon; reinstall motion-recon"
    )

OK, FAILED, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130


def main() -> None:
    """Run the command line and exit the process: the entry point of the script `recon`."""
    # more threads would slow down the small operations of one clip
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    signal.signal(signal.SIGTERM, _interrupt)
    sys.exit(run(sys.argv[1:]))


def _interrupt(_: int, __: FrameType | None) -> None:
    """Handle SIGTERM like Ctrl-C, so that no half-written file remains."""
    raise KeyboardInterrupt


def run(words: Sequence[str]) -> int:
    """Run one verb and return its exit code; usage errors and `--help` raise SystemExit."""
    try:
        return _run(words)
    except KeyboardInterrupt:
        sys.stderr.write("recon: interrupted; what was not finished was not written\n")
        return INTERRUPTED


def _run(words: Sequence[str]) -> int:
    if list(words) == ["--version"]:
        sys.stdout.write(f"{_version()}\n")
        return OK
    from recon.cli.parsing import parsed_command

    return run_command(lambda: parsed_command(words)())


def run_command(command: Callable[[], object]) -> int:
    """Run a command, and turn errors into a line on stderr and an exit code."""
    from recon.cli.errors import Failed

    logging.basicConfig(stream=sys.stderr, level=logging.WARNING, format="%(message)s")
    try:
        command()
        sys.stdout.flush()
    except Failed as failure:
        sys.stderr.write(f"recon: {visible(failure)}\n")
        return FAILED
    except BrokenPipeError:
        # the reader closed the pipe, as `head` does, so Python must not flush into it
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return OK
    except (ValueError, OSError) as error:
        sys.stderr.write(f"recon: {visible(error)}\n")
        return BAD_INPUT
    return OK


def _version() -> str:
    """Versions of recon, torch and Python, read without importing torch."""
    from importlib.metadata import version

    return f"recon {__version__}, torch {version('torch')}, Python {platform.python_version()}"

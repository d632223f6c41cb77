"""The command `recon`: one file per verb, the only place that knows all three packages.

Exit codes: 0 done, 1 the fit failed (the last finite estimate was written), 2 bad input or no
place to write to, 130 interrupted.
Results go to files, tables and progress to stderr, `--json` to stdout.
"""

import logging
import os
import signal
import sys
from collections.abc import Sequence
from types import FrameType

from recon import __distribution__

if __distribution__ != "motion-recon":
    raise ImportError("this `recon` is not motion-recon's; reinstall motion-recon")

OK, FAILED, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130


def main() -> None:
    """The console script."""
    # a clip's operations are too small to share: more threads only wait for each other
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    signal.signal(signal.SIGTERM, _interrupt)
    sys.exit(run(sys.argv[1:]))


def _interrupt(_: int, __: FrameType | None) -> None:
    """Who is asked to end does what Ctrl-C does: nothing half written stays."""
    raise KeyboardInterrupt


def run(arguments: Sequence[str]) -> int:
    """Run one verb and say how it went; usage errors and `--help` end through SystemExit."""
    try:
        return _run(arguments)
    except KeyboardInterrupt:
        sys.stderr.write("recon: interrupted; what was not finished was not written\n")
        return INTERRUPTED


def _run(arguments: Sequence[str]) -> int:
    import tyro

    from recon.cli import listing as verbs
    from recon.cli.errors import Failed

    logging.basicConfig(stream=sys.stderr, level=logging.WARNING, format="%(message)s")
    app = tyro.extras.SubcommandApp()
    for verb in verbs.ALL:
        app.command(verb)
    try:
        app.cli(prog="recon", description=verbs.__doc__ or "", args=arguments)
    except Failed as failure:
        sys.stderr.write(f"recon: {failure}\n")
        return FAILED
    except (ValueError, OSError) as error:
        sys.stderr.write(f"recon: {error}\n")
        return BAD_INPUT
    return OK

"""Public doors: the command line in this process and beside it, and what may come out of them."""

import contextlib
import io
import os
import runpy
import signal
import subprocess
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pytest

import recon

DEMO = Path(recon.__file__).parent / "assets" / "demo.npz"
DONE, FAILED, REFUSED = 0, 1, 2
"""Exit codes of `recon`."""


def command(*words: str | Path) -> tuple[int, str, str]:
    """Exit code, answer and complaints of `python -m recon WORDS` in this process."""
    answers, complaints = io.StringIO(), io.StringIO()
    handler, before = signal.getsignal(signal.SIGTERM), sys.argv
    sys.argv = ["recon", *map(str, words)]
    code: int | str | None = None
    try:
        with contextlib.redirect_stdout(answers), contextlib.redirect_stderr(complaints):
            runpy.run_module("recon", run_name="__main__")
    except SystemExit as end:
        code = end.code
    finally:
        sys.argv = before
        signal.signal(signal.SIGTERM, handler)
    assert code is None or isinstance(code, int), code
    return code or DONE, answers.getvalue(), complaints.getvalue()


def started(*words: str | Path) -> subprocess.Popen[str]:
    """`recon WORDS` in a process, and a group, of its own."""
    pipe = subprocess.PIPE
    path = str(Path(recon.__file__).parents[1])
    return subprocess.Popen(
        [sys.executable, "-m", "recon", *map(str, words)],
        stdout=pipe, stderr=pipe, text=True, start_new_session=True,
        env=os.environ | {"PYTHONPATH": path, "OMP_NUM_THREADS": "1"},
    )  # fmt: skip


def refused(call: Callable[[], object], *names: str) -> str:
    """The words with which a call refuses its input; they have one of the names."""
    with pytest.raises((recon.ReconError, OSError)) as caught:
        call()
    said = str(caught.value)
    assert not names or any(name in said for name in names), said
    assert len(said) < 2000
    return said


def refused_by_command(*words: str | Path, names: tuple[str, ...] = ()) -> str:
    """The words with which a command refuses its input, without a traceback."""
    code, _, said = command(*words)
    assert code == REFUSED, said
    assert "Traceback" not in said
    assert not names or any(name in said for name in names), said
    return said


def reading(path: Path) -> dict[str, object]:
    """What readers make of a file: a record, or the words with which they refuse it."""
    found: dict[str, object] = {}
    readers: dict[str, Callable[[Path], object]] = {
        "observation": partial(recon.load_observation, frame_rate=30.0, image_size=(1280, 720)),
        "motion": recon.load_motion,
    }
    for name, read in readers.items():
        try:
            found[name] = read(path)
        except (recon.ReconError, OSError) as error:
            found[name] = str(error)
    return found


def refused_by_all(path: Path) -> None:
    """Check that no reader reads a file, and that `recon info` refuses it."""
    assert all(isinstance(said, str) for said in reading(path).values())
    refused_by_command("info", path)


def finite(value: object) -> bool:
    """Whether all numbers of a record, its records and its tensors are finite."""
    if isinstance(value, float):
        return bool(np.isfinite(value))
    if hasattr(value, "__array__"):
        array = np.asarray(value)
        return array.dtype.kind not in "fc" or bool(np.isfinite(array).all())
    if isinstance(value, list | tuple):
        return all(map(finite, value))
    return (
        all(map(finite, vars(value).values())) if hasattr(value, "__dataclass_fields__") else True
    )


def files_below(folder: Path) -> set[str]:
    """Names of the files below a folder."""
    return {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()}

"""The messages of a training run, also in a file."""

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Literal


@contextmanager
def logged_to(path: Path, mode: Literal["a", "w"]) -> Iterator[None]:
    """A context in which messages of `priors` also go to a file, each line with its time."""
    log = logging.FileHandler(path, mode=mode)
    log.setFormatter(logging.Formatter("%(asctime)s %(message)s"))
    package = logging.getLogger("priors")
    before = package.level
    package.addHandler(log)
    package.setLevel(logging.INFO)
    try:
        yield
    finally:
        package.removeHandler(log)
        package.setLevel(before)
        log.close()

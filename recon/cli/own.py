"""Priors and sensors by name, looked up before anything heavy is loaded."""

import os
import sys
from collections.abc import Iterable
from difflib import get_close_matches

from recon.method.plugins import PRIORS, registered


def check_plugs(prior: str, reader: str | None) -> None:
    """Refuse names of no prior, and let classes "module:Class" be found in the current folder.

    The folder comes last in Python's search, so that its files take no installed module's place.

    Raises:
        ValueError: names the priors there are.
    """
    known = registered(PRIORS)
    if prior not in known and ":" not in prior:
        near = get_close_matches(prior, known, n=1)
        hint = f" (did you mean {near[0]}?)" if near else ""
        raise ValueError(
            f"there is no prior {prior}{hint}; there are {', '.join(known)}, and "
            "package.module:Class of your own"
        )
    if reader is not None and ":" not in reader:
        raise ValueError(f"--reader takes package.module:Class, got {reader}")
    find_here((prior, reader or ""))


def find_here(names: Iterable[str]) -> None:
    """Let classes "module:Class", if any of the names is one, be found in the current folder."""
    if any(":" in name for name in names) and os.getcwd() not in sys.path:
        sys.path.append(os.getcwd())

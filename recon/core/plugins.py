"""Plug-ins of other packages, found by entry points or by "module:Class".

Imports nothing heavy.
"""

import tomllib
from collections.abc import Mapping
from functools import cache
from importlib import import_module
from importlib.metadata import entry_points
from pathlib import Path
from types import MappingProxyType
from typing import Any

from recon.core.errors import ReconError

PRIORS = "recon.priors"
"""Entry point group of priors: their names, and the places of their classes."""
SENSORS = "recon.observations"
"""Entry point group of sensors whose classes read files of their own."""
VERBS = "recon.verbs"
"""Entry point group of verbs of the command `recon`: their names, and places of functions."""
_CHECKOUT = Path(__file__).parents[2] / "pyproject.toml"


@cache
def registered(group: str) -> Mapping[str, str]:
    """Places "package.module:Class" of all classes of an entry point group, by their names.

    Those of this package come last, so that nobody else takes their names. In a source checkout
    they are read from its `pyproject.toml`, as what was installed may be older than the code.
    """
    found = {one.name: one.value for one in entry_points(group=group)}
    if _CHECKOUT.is_file():
        with _CHECKOUT.open("rb") as file:
            found |= tomllib.load(file)["project"]["entry-points"].get(group, {})
    return MappingProxyType(found)


def imported(place: str, what: str) -> Any:
    """The class at "package.module:Class".

    Args:
        place: of the class.
        what: it should be, for messages.

    Raises:
        ReconError: when there is no such module or class.
    """
    module, colon, name = place.partition(":")
    if not colon:
        raise ReconError(f"{what}: expected 'package.module:Class', got {place!r}")
    try:
        return getattr(import_module(module), name)
    except (ImportError, AttributeError, ValueError) as error:
        raise ReconError(f"{what}: {place!r} cannot be imported: {error}") from error

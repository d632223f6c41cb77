"""Names that are imported on first use: plug-ins of other packages, and names of our packages.

A plug-in is found by its entry point or by "package.module:Class".
"""

import sys
import tomllib
from collections.abc import Callable, Mapping
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
LOOKS = "recon.looks"
"""Entry point group of networks that propose motions: their names, and places of their classes."""
DETECTORS = "recon.detectors"
"""Entry point group of detectors of people in films: their names, and the places of classes."""
VERBS = "recon.verbs"
"""Entry point group of verbs of the command `recon`: their names, and places of functions."""
_CHECKOUT = Path(__file__).parents[2] / "pyproject.toml"


@cache
def registered_places(group: str) -> Mapping[str, str]:
    """Return {name: "package.module:Class"} of all plug-ins of an entry point group.

    Those of this package come last, so that nobody else takes their names. In a source checkout
    they are read from its `pyproject.toml`, as what was installed may be older than the code.
    """
    found = {one.name: one.value for one in entry_points(group=group)}
    if _CHECKOUT.is_file():
        with _CHECKOUT.open("rb") as file:
            found |= tomllib.load(file)["project"]["entry-points"].get(group, {})
    return MappingProxyType(found)


def imported_object(place: str, role: str) -> Any:
    """Import the class at "package.module:Class".

    Args:
        place: of the class.
        role: of the class, such as "reader", for messages.

    Raises:
        ReconError: when there is no such module or class.
    """
    module, colon, name = place.partition(":")
    if not colon:
        raise ReconError(f"{role}: expected 'package.module:Class', got {place!r}")
    try:
        return getattr(import_module(module), name)
    except (ImportError, AttributeError, ValueError) as error:
        raise ReconError(f"{role}: {place!r} cannot be imported: {error}") from error


def lazy_names(
    package: str, module_of: Mapping[str, str]
) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """Return `__getattr__` and `__dir__` for a package that imports its names on first use.

    Args:
        package: its name.
        module_of: the module of every name.
    """

    def import_name(name: str) -> Any:
        if name not in module_of:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        return getattr(import_module(module_of[name]), name)

    return import_name, lambda: sorted([*vars(sys.modules[package]), *module_of])

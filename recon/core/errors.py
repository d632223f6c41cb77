"""Errors that refuse input: all are `ValueError`s whose message says what to do."""

from importlib import import_module
from typing import Any


class ReconError(ValueError):
    """An input of recon is unusable; the base class of all errors that recon raises for input."""


class FormatError(ReconError):
    """A file cannot be read in the expected format."""


class UnitsError(ReconError):
    """Unit or axes of an input are unknown, or its numbers do not fit the expected unit."""


class ObservationError(ReconError):
    """An observation is damaged, or inconsistent with the others."""


class WeightsError(ReconError):
    """A prior does not exist, or its weights cannot be used."""


def optional_module(name: str, package: str, purpose: str, extra: str) -> Any:
    """Import an optional module; the error names the extra of recon that installs it.

    Args:
        name: of the module.
        package: that has the module.
        purpose: what it is needed for, as the subject of a sentence.
        extra: of this project's distribution that installs it.

    Raises:
        ReconError: when it is not installed, with what to do.
    """
    try:
        return import_module(name)
    except ImportError as error:
        lacking = "is not installed"
        if not isinstance(error, ModuleNotFoundError):  # the package fails while it is loaded
            lacking = f"cannot be loaded ({error})"
        raise ReconError(
            f"{purpose} needs the package {package}, which {lacking}: "
            f"pip install 'motion-recon[{extra}]'"
        ) from error

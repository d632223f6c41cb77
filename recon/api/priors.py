"""The prior that a caller means: by its name, by where its class is, or the object itself."""

from importlib import import_module
from typing import Any

from recon.core.errors import WeightsError
from recon.fitting.methods import NAMES
from recon.fitting.options import PriorObject


def prior_of(given: Any, weights: str) -> str | PriorObject:
    """A known name, or a prior that is loaded.

    Args:
        given: a name (humor, pose, anchor, humos), "package.module:Class", which is loaded by its
            `load()` or else made without arguments, or an object: a loaded `Humor`, `Humos`,
            `PosePrior` or `AnchorFrames`, or anything with `stages(data)`, a method.
        weights: of a prior that is given by its name.

    Raises:
        WeightsError: when it is none of these, or weights are given for what is no name.
    """
    if isinstance(given, str) and given in NAMES:
        return given
    if weights != "open":
        raise WeightsError(
            f"weights: {weights!r} are of a prior that is given by its name ({', '.join(NAMES)}); "
            "load the prior with them instead"
        )
    found = _imported(given) if isinstance(given, str) else given
    if isinstance(found, type) or not isinstance(found, PriorObject):
        raise WeightsError(
            f"prior: expected {', '.join(NAMES)}, 'package.module:Class', a loaded prior or an "
            f"object with a method stages(data), got {given!r:.80}"
        )
    return found


def _imported(place: str) -> Any:
    module, colon, name = place.partition(":")
    if not colon:
        raise WeightsError(
            f"prior: expected {', '.join(NAMES)} or 'package.module:Class', got {place!r}"
        )
    try:
        kind = getattr(import_module(module), name)
    except (ImportError, AttributeError) as error:
        raise WeightsError(f"prior: {place!r} cannot be imported: {error}") from error
    return kind.load() if hasattr(kind, "load") else kind()

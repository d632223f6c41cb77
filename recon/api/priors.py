"""The prior that a caller means: by its name, by where its class is, or the object itself."""

from typing import Any

from recon.core.errors import WeightsError
from recon.fitting.priors import PriorObject, checked_method, class_of
from recon.method.plugins import PRIORS, registered


def prior_of(given: Any, weights: str, method: str | None = None) -> str | PriorObject:
    """A name or place whose class is there, or a prior that is loaded.

    Args:
        given: a registered name (ours are humor, pose, anchor and recording), a place
            "package.module:Class", or an object: a loaded prior, or anything with `stages(data)`,
            a method.
        weights: of a prior that is given by its name or place.
        method: the way to fit it, one of its `methods`; None is the usual one.

    Raises:
        WeightsError: when it is none of these, or weights are given for an object.
        ReconError: when the prior has no such method.
    """
    if isinstance(given, str):
        class_of(given)
        checked_method(given, method)
        return given
    names = ", ".join(registered(PRIORS))
    if weights != "open":
        raise WeightsError(
            f"weights: {weights!r} are of a prior that is given by its name ({names}); "
            "load the prior with them instead"
        )
    if isinstance(given, type) or not isinstance(given, PriorObject):
        raise WeightsError(
            f"prior: expected {names}, 'package.module:Class', a loaded prior or an object with a "
            f"method stages(data), got {given!r:.80}"
        )
    checked_method(given, method)
    return given

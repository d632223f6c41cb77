"""Which prior is meant: a registered name, the place of a class, or the object itself."""

from typing import Any

from recon.body.model import BodyModel
from recon.core.errors import ReconError, WeightsError
from recon.method.plugins import PRIORS, imported, registered
from recon.method.priors import CyclePrior, NoisyPrior, Traits, methods_of, traits_of
from recon.method.reconstruction import Method

PriorObject = Method | NoisyPrior | CyclePrior
"""A prior that is loaded already, or a method of the caller's own."""


def class_of(prior: str) -> Any:
    """The class of a prior, by its registered name or its place "package.module:Class".

    Raises:
        WeightsError: when there is no such prior.
    """
    known = registered(PRIORS)
    if prior not in known and ":" not in prior:
        raise WeightsError(
            f"prior: expected {', '.join(known)} or 'package.module:Class', got {prior!r}"
        )
    try:
        return imported(known.get(prior, prior), "prior")
    except ReconError as error:
        raise WeightsError(str(error)) from error


def loaded(prior: str | PriorObject, weights: str, body: BodyModel) -> PriorObject:
    """The prior with its weights, those of an object being its own.

    A class is loaded by `load(weights, body)`; without such a method it is made without arguments.

    Raises:
        FileNotFoundError: when there are no such weights.
        WeightsError: when there is no such prior, or it takes no weights.
    """
    if not isinstance(prior, str):
        return prior
    kind = class_of(prior)
    if hasattr(kind, "load"):
        found = kind.load(weights, body)
    elif weights == "open":
        found = kind()
    else:
        raise WeightsError(f"weights: {prior!r} has none: it has no method load(weights, body)")
    if not isinstance(found, PriorObject):
        raise WeightsError(
            f"prior: {prior!r} needs a method stages(data) or method(noise, body), got a "
            f"{type(found).__name__}"
        )
    return found


def traits(prior: str | PriorObject) -> Traits:
    """What is known of a prior without its weights."""
    return traits_of(class_of(prior) if isinstance(prior, str) else prior)


def checked_method(prior: str | PriorObject, name: str | None) -> str | None:
    """The name of a way to fit a prior, one of its `methods`, or None for the usual one.

    Raises:
        ReconError: when the prior has no such method.
    """
    if name is None:
        return None
    known = methods_of(class_of(prior) if isinstance(prior, str) else prior)
    if name in known:
        return name
    whose = repr(prior) if isinstance(prior, str) else f"a {type(prior).__name__}"
    if len(known) == 0:
        raise ReconError(f"method: {whose} is fitted in one way only, got {name!r}; leave it out")
    raise ReconError(f"method: {whose} is fitted by {' or '.join(known)}, got {name!r}")

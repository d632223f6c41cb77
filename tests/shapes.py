"""Checks shapes and types at the first `CALLS` calls of each function in every test.

A fit calls some functions thousands of times; checks of all calls took 25 to 39 % of its time.
"""

import functools
from collections import Counter
from types import FunctionType
from typing import Any

import jaxtyping
from jaxtyping import _decorator

CALLS = 30
"""Number of calls of a function that are checked in each test."""

counts: Counter[FunctionType] = Counter()
"""Calls of every function in the present test."""


def install(*packages: str) -> None:
    """Check shapes and types of packages that are imported later."""
    original = _decorator.jaxtyped

    def checked_at_first(fn: Any = None, *, typechecker: Any) -> Any:
        if fn is None:
            return functools.partial(checked_at_first, typechecker=typechecker)
        checked = original(fn, typechecker=typechecker)
        if not isinstance(fn, FunctionType):
            return checked

        @functools.wraps(checked)
        def call(*args: Any, **kwargs: Any) -> Any:
            counts[fn] += 1
            return (fn if counts[fn] > CALLS else checked)(*args, **kwargs)

        return call

    # jaxtyping calls the first of these for methods and properties, decorated modules the second
    _decorator.jaxtyped = jaxtyping.jaxtyped = checked_at_first
    jaxtyping.install_import_hook(list(packages), "beartype.beartype")

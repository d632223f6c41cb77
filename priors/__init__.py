"""Learned priors: which motions are likely, and what part of a body a point shows."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

import recon

if getattr(recon, "__distribution__", None) != "motion-recon":
    raise ImportError(
        f"the package 'recon' at {recon.__file__} is not motion-recon's: another distribution of "
        "that name was installed over it; run `pip uninstall recon`, then "
        "`pip install --force-reinstall motion-recon`"
    )

if TYPE_CHECKING:
    from priors.humor.collocation import Collocation as Collocation
    from priors.humor.prior import Humor as Humor
    from priors.humor.shooting import Shooting as Shooting
    from priors.pose.prior import PosePrior as PosePrior

_HOMES = {
    "Collocation": "priors.humor.collocation",
    "Humor": "priors.humor.prior",
    "Shooting": "priors.humor.shooting",
    "PosePrior": "priors.pose.prior",
}


def __getattr__(name: str) -> Any:
    """A prior, loaded on first use."""
    if name in _HOMES:
        return getattr(import_module(_HOMES[name]), name)
    raise AttributeError(f"module 'priors' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted([*globals(), *_HOMES])

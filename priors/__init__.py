"""Learned priors over motions, and a network that labels each point of a cloud by body part."""

from typing import TYPE_CHECKING

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

from recon.core.plugins import lazy_names  # after the check that this is our package `recon`

_HOMES = {
    "Collocation": "priors.humor.collocation",
    "Humor": "priors.humor.prior",
    "Shooting": "priors.humor.shooting",
    "PosePrior": "priors.pose.prior",
}

__getattr__, __dir__ = lazy_names(__name__, _HOMES)

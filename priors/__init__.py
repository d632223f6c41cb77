"""Learned motion priors: what is likely."""

import recon

if getattr(recon, "__distribution__", None) != "motion-recon":
    raise ImportError(
        f"the package 'recon' at {recon.__file__} is not motion-recon's: another distribution of "
        "that name was installed over it; run `pip uninstall recon`, then "
        "`pip install --force-reinstall motion-recon`"
    )

from priors.humor import Humor as Humor
from priors.humor_collocation import Collocation as Collocation
from priors.humor_shooting import Shooting as Shooting
from priors.pose import PosePrior as PosePrior

"""Observations: one adapter per sensor, each an energy with data inside."""

import recon

if getattr(recon, "__distribution__", None) != "motion-recon":
    raise ImportError(
        f"the package 'recon' at {recon.__file__} is not motion-recon's: another distribution of "
        "that name was installed over it; run `pip uninstall recon`, then "
        "`pip install --force-reinstall motion-recon`"
    )

from observations.joints3d import Joints3D as Joints3D
from observations.markers3d import Markers3D as Markers3D

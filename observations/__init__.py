"""Sensor classes: each holds the data of one kind of sensor and computes their energy."""

from typing import TYPE_CHECKING

import recon

if getattr(recon, "__distribution__", None) != "motion-recon":
    raise ImportError(
        f"the package 'recon' at {recon.__file__} is not motion-recon's: another distribution of "
        "that name was installed over it; run `pip uninstall recon`, then "
        "`pip install --force-reinstall motion-recon`"
    )

if TYPE_CHECKING:
    from observations.joints3d import Joints3D as Joints3D
    from observations.markers3d import Markers3D as Markers3D

from recon.core.plugins import lazy_names  # after the check that this is our package `recon`

_HOMES = {"Joints3D": "observations.joints3d", "Markers3D": "observations.markers3d"}

__getattr__, __dir__ = lazy_names(__name__, _HOMES)

"""Observations: one adapter per sensor, each an energy with data inside."""

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
    from observations.joints3d import Joints3D as Joints3D
    from observations.markers3d import Markers3D as Markers3D

_HOMES = {"Joints3D": "observations.joints3d", "Markers3D": "observations.markers3d"}


def __getattr__(name: str) -> Any:
    """A sensor, loaded on first use."""
    if name in _HOMES:
        return getattr(import_module(_HOMES[name]), name)
    raise AttributeError(f"module 'observations' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted([*globals(), *_HOMES])

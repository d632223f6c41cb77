"""How a fit is put together and run: sensors, protocols, terms, stages and their loop."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from recon.body.model import PosedBody as PosedBody
    from recon.method.sensor import Sensor as Sensor

_HOMES = {"Sensor": "recon.method.sensor", "PosedBody": "recon.body.model"}


def __getattr__(name: str) -> Any:
    """What a sensor of one's own is made of, loaded on first use."""
    if name in _HOMES:
        return getattr(import_module(_HOMES[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")

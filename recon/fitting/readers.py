"""Files of sensors that other packages bring, and markers: who reads which."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, runtime_checkable

from recon.body.model import BodyModel
from recon.core.errors import ObservationError
from recon.formats.mocap.recording import MarkerRecording
from recon.method.plugins import SENSORS, imported, registered
from recon.method.protocols import Sensor


@dataclass(frozen=True)
class SeenMarkers:
    """Markers of a recording as an observation."""

    markers: Sensor
    """Observation with a leading axis of length one."""
    decisions: tuple[str, ...]
    """What was read, told or put right, one sentence each."""


PlaceMarkers = Callable[[MarkerRecording, BodyModel, Path | None, float | None], SeenMarkers]
"""Says where a recording's markers sit on a body: recording, body, file of the caller's mapping,
distance in metres beyond which a marker counts ever less."""


@runtime_checkable
class Reader(Protocol):
    """A class of sensors that have files of their own."""

    def reads(self, path: Path) -> bool:
        """Whether a file or folder is one of these; quick, and false rather than an error."""
        ...

    def load(self, path: Path, body: BodyModel) -> Sensor:
        """The sensor's data.

        Raises:
            ValueError: when the file is damaged; says what was expected.
        """
        ...


def readers(named: str | None) -> list[Reader]:
    """The class that the caller named, then those that are registered as `recon.observations`.

    Raises:
        ReconError: when one of them cannot be imported, or reads no files.
    """
    places = [*([] if named is None else [named]), *registered(SENSORS).values()]
    found = [imported(place, "reader") for place in places]
    for place, kind in zip(places, found, strict=True):
        if not isinstance(kind, Reader):
            raise ObservationError(
                f"reader: {place!r} needs the class methods reads(path) and load(path, body)"
            )
    return found


def read_by(own: Sequence[Reader], path: Path, body: BodyModel) -> Sensor | None:
    """What the first class that knows a file reads of it, with a leading axis of clips."""
    for reader in own:
        if reader.reads(path):
            seen = reader.load(path, body)
            return seen[None] if seen.clips == () else seen
    return None

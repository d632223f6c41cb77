"""Finds the sensor class of another package that reads a file."""

from collections.abc import Sequence
from pathlib import Path
from typing import Protocol, runtime_checkable

from recon.body.model import BodyModel
from recon.core.errors import ObservationError
from recon.core.plugins import SENSORS, imported_object, registered_places
from recon.method.sensor import Sensor


@runtime_checkable
class Reader(Protocol):
    """A sensor class that reads files of its own."""

    def reads(self, path: Path) -> bool:
        """Whether a file or folder is for this sensor; quick, and false rather than an error."""
        ...

    def load(self, path: Path, body: BodyModel) -> Sensor:
        """The sensor's data.

        Raises:
            ValueError: when the file is damaged; says what was expected.
        """
        ...


def readers(named_class: str | None) -> list[Reader]:
    """The class that the caller named, then those that are registered as `recon.observations`.

    Raises:
        ReconError: when one of them cannot be imported, or reads no files.
    """
    places = [
        *([] if named_class is None else [named_class]),
        *registered_places(SENSORS).values(),
    ]
    found = [imported_object(place, "reader") for place in places]
    for place, kind in zip(places, found, strict=True):
        if not isinstance(kind, Reader):
            raise ObservationError(
                f"reader: {place!r} needs the class methods reads(path) and load(path, body)"
            )
    return found


def read_by(classes: Sequence[Reader], path: Path, body: BodyModel) -> Sensor | None:
    """The sensor that the first fitting class reads from a file, with a leading axis of clips."""
    for reader in classes:
        if reader.reads(path):
            seen = reader.load(path, body)
            return seen[None] if seen.clips == () else seen
    return None

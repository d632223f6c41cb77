"""Quick refusals of files that cannot be fitted or converted, before torch is loaded."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from recon.cli.own import check_plugs

_ENDINGS = (".c3d", ".trc")


def look_at(given: Mapping[str, Any]) -> None:
    """Refuse what cannot be fitted or converted: unknown priors, foreign files, unknown markers.

    Args:
        given: a verb's arguments by name.

    Raises:
        ValueError: says what was seen and what would fit.
    """
    if (settings := given.get("settings")) is not None:
        check_plugs(settings.prior, settings.reader)
        from recon.formats.foreign import is_estimate, refuse_foreign
        from recon.method.plugins import SENSORS, registered

        paths = given.get("observations", ())
        if settings.reader is None and not registered(SENSORS) and not is_estimate(paths):
            refuse_foreign(paths)
            if settings.up is None:
                refuse_unknown_markers(paths, settings.mapping, settings.unit)
    recording = given.get("recording", given.get("trial"))
    is_motion = "trial" in given and recording.suffix.lower() == ".npz"
    if recording is not None and not is_motion and given["mapping"] is None:
        refuse_unknown_recording(recording, given["unit"], given["up"])


def refuse_unknown_recording(path: Path, unit: str | None, up: str | None) -> None:
    """Refuse a recording whose skeleton or markers are not known.

    Raises:
        ValueError: says what was seen, and which mapping file to write.
    """
    from recon.mocap.reader import refuse_unknown_skeleton

    refuse_unknown_skeleton(path)
    if up is None:
        refuse_unknown_markers([path], None, unit)


def refuse_unknown_markers(paths: Sequence[Path], mapping: Path | None, unit: str | None) -> None:
    """Refuse recordings that cannot be read or have too few markers of known places.

    With a mapping, and for files of other kinds, nothing is done. Callers who know the up axis
    need no look, which would ask for it.

    Raises:
        ValueError: says what was seen, and which mapping file to write.
    """
    marked = [one for one in paths if one.name.lower().endswith(_ENDINGS) and one.is_file()]
    if mapping is not None or not marked:
        return
    import numpy as np

    from recon.body.marker_labels import FEWEST_MARKERS, mapping_to_write, match_markers
    from recon.core.errors import FormatError
    from recon.keypoints3d.labels import STUDY, are_keypoints
    from recon.mocap.reader import read_recording
    from recon.mocap.recording import MarkerRecording

    for path in marked:
        recording = read_recording(path, unit=unit)
        assert isinstance(recording, MarkerRecording)
        shown = np.flatnonzero(recording.visible.sum(0))
        labels = [recording.marker_names[k] for k in shown]
        if are_keypoints(labels) or any(label.endswith(STUDY) for label in labels):
            continue
        known, unknown = match_markers(labels)
        if len(known) < FEWEST_MARKERS:
            raise FormatError(
                f"{path}: expected at least {FEWEST_MARKERS} markers of known places, got "
                f"{len(known)} ({', '.join(known) or 'none'}); labels not known: "
                f"{', '.join(unknown[:12])}{', ...' if len(unknown) > 12 else ''}; "
                f"{mapping_to_write(unknown)}"
            )

"""Recordings that nobody can place on a body, refused at a look, before torch is loaded."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from recon.body.landmarks import FEWEST_MARKERS, mapping_to_write, match_markers
from recon.core.errors import FormatError
from recon.formats.keypoints3d.labels import STUDY, are_keypoints
from recon.formats.mocap.reader import read_recording
from recon.formats.mocap.recording import MarkerRecording

_ENDINGS = (".c3d", ".trc")


def refuse_unknown_markers(paths: Sequence[Path], mapping: Path | None, unit: str | None) -> None:
    """Refuse recordings that cannot be read or have too few markers of known places.

    With a mapping, and for files of other kinds, nothing is done. Callers who know the up axis
    need no look, which would ask for it.

    Raises:
        ValueError: says what was seen, and which mapping file to write.
    """
    if mapping is not None:
        return
    for path in paths:
        if not path.name.lower().endswith(_ENDINGS) or not path.is_file():
            continue
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

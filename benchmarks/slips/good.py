"""300 good windows: whatever is said about them is a false alarm.

    python -m benchmarks.slips.good CORPUS OBSERVATIONS

writes the committed list (`benchmarks/slips/good_windows.json`). Half are test windows as sensors
see them in ordinary use: other noise than the slips', points hidden by a table, points missing,
frames missing. Half are real recordings whose markers are landmarks of the body, as anybody who
maps marker names would give them: ballroom dance (choreonet), runs on a treadmill and over ground
(hamner, sprinter), walks, squats and stands. Markers whose place is only roughly known (clusters
on thigh and shank) are left out, as are windows of which a quarter or more was not seen. For
thresholds there are windows of validation people in the same manner, and real recordings of
people who are in no part.

What is so may be said: that what was hidden is inferred, that a treadmill is a treadmill, that
somebody sits, or stands on a box or a beam (drop jumps begin on one of 30 cm), and that two
recordings have their ground several centimetres above or below z = 0, as their lowest markers show
(-3 cm and 8 cm; 2 to 6 elsewhere).
"""

import argparse
import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from benchmarks.slips.recorded import VIEWS, cut, views
from benchmarks.slips.recordings import Sensor, recording_of, windows_of
from recon.benchmark.dataset import Part
from recon.benchmark.windows import TrueWindows
from recon.body.model import BodyModel
from recon.diagnosis.findings import Code, Finding
from recon.formats.mocap.reader import read_recording
from recon.formats.mocap.recording import MarkerRecording
from recon.ingest.markers.coverage import full_body_markers
from recon.method.protocols import Sensor as Seen
from recon.simulation.points import Corruption

LIST = Path(__file__).with_name("good_windows.json")
SECONDS = 2.0
_SHORTEST = 1.2
"""Seconds: shorter recordings are left out."""
_SEEN = 0.75
"""Share of the points that must be seen in a window."""
SIMULATED = {"test": 150, "validation": 75}
_HIDDEN = {"hide_below": 0.9, "during": (0.67, 1.33)}

VARIANTS: tuple[tuple[str, Sensor, Corruption], ...] = (
    ("1 cm", "joints3d", Corruption(noise=0.01)),
    ("5 mm", "markers3d", Corruption(noise=0.005)),
    ("6 px", "cameras", Corruption(noise=6.0)),
    ("4 cm", "joints3d", Corruption(noise=0.04)),
    ("2 cm", "markers3d", Corruption(noise=0.02)),
    ("3 px", "camera", Corruption(noise=3.0)),
    ("2 cm, legs hidden for a third", "joints3d", Corruption(noise=0.02, **_HIDDEN)),
    ("1 cm, legs hidden for a third", "markers3d", Corruption(noise=0.01, **_HIDDEN)),
    ("3 px, legs hidden for a third", "cameras", Corruption(noise=3.0, **_HIDDEN)),
    ("2 cm, a fifth missing", "joints3d", Corruption(noise=0.02, missing_points=0.2)),
    ("1 cm, a fifth missing", "markers3d", Corruption(noise=0.01, missing_points=0.2)),
    ("6 px, a tenth missing", "camera", Corruption(noise=6.0, missing_points=0.1)),
    ("2 cm, a tenth of the frames missing", "joints3d",
     Corruption(noise=0.02, missing_frames=0.1)),
    ("1 cm, a tenth of the frames missing", "markers3d",
     Corruption(noise=0.01, missing_frames=0.1)),
    ("3 px, a tenth missing", "cameras", Corruption(noise=3.0, missing_points=0.1)),
)  # fmt: skip

FOLDERS: dict[str, tuple[str, ...]] = {
    "test": ("choreonet", "opensim", "nimblephysics", "biomechzoo"),
    "validation": (
        "cmu_c3d/06_01.c3d",
        "mocaprecovery",
        "rehazenter",
        "pycgm",
        "pose2sim/single_balancing.zip",
    ),
}
REAL: dict[str, int] = {"test": 150, "validation": 45}
_SO: dict[str, tuple[Code, ...]] = {
    "hamner_subject02_running": ("treadmill",), "hamner04_run": ("treadmill",),
    "gait2354_subject01_walk": ("treadmill",),
    "_STS": ("uneven ground",), "_DJ": ("uneven ground", "floor"),
    "nick_freeform": ("floor",), "sehoon_squat": ("floor",), "balancing": ("uneven ground",),
}  # fmt: skip
"""What is true of recordings whose path contains this."""


@dataclass(frozen=True)
class GoodWindow:
    """One window of the list."""

    source: str
    """Name of a listed window, or path of a real recording."""
    variant: str = ""
    """The variant of a listed window: its sensor and its name in `VARIANTS`, `sensor: name`."""
    start: float = 0.0
    """Beginning in a real recording, seconds from its first frame."""

    @property
    def name(self) -> str:
        """The window's name for people."""
        return f"{self.source} {self.variant}" if self.variant else f"{self.source}@{self.start:g}"

    @property
    def allowed(self) -> tuple[Code, ...]:
        """What may be said about it because it is so."""
        so: Iterator[Code] = (
            code for part, codes in _SO.items() if part in self.source for code in codes
        )
        return ("unseen", "gap", *so)


def listed(part: Part) -> tuple[GoodWindow, ...]:
    """The committed windows of a part."""
    rows = json.loads(LIST.read_text())[part]
    return tuple(GoodWindow(**row) for row in rows)


def alarms(window: GoodWindow, findings: Sequence[Finding]) -> tuple[Finding, ...]:
    """Findings that are not so."""
    return tuple(finding for finding in findings if finding.code not in window.allowed)


@dataclass(frozen=True)
class GoodWindows:
    """The folders that windows are loaded from."""

    windows: TrueWindows
    """All that are listed of a part."""
    observations: Path
    """Folder of real recordings."""
    body: BodyModel

    def load(self, window: GoodWindow) -> tuple[tuple[Seen, ...], tuple[str, ...]]:
        """What was seen, and the names of the observations.

        Raises:
            ValueError: when the listed windows are not those that the list was made of.
        """
        if window.variant:
            if window.source not in self.windows.names:
                raise ValueError(
                    f"{LIST}: {window.source} is not a listed window of this corpus; make the "
                    "list again with python -m benchmarks.slips.good CORPUS OBSERVATIONS"
                )
            corruption, sensor = _variant(window.variant)
            number = self.windows.names.index(window.source)
            recording = recording_of(self.windows, number, sensor, self.body, corruption)
            return recording.clean, recording.names
        path = self.observations / window.source
        if path.suffix == VIEWS:
            return views(path, self.body)
        return (cut(path, window.start, self.body),), ("markers",)


def _variant(name: str) -> tuple[Corruption, Sensor]:
    return next((c, sensor) for own, sensor, c in VARIANTS if f"{sensor}: {own}" == name)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("corpus", type=Path)
    parser.add_argument("observations", type=Path)
    arguments = parser.parse_args()
    body = BodyModel.load()
    rows: dict[str, list[dict[str, object]]] = {}
    parts: tuple[Part, ...] = ("test", "validation")
    for part in parts:
        windows = windows_of(arguments.corpus, part, body)
        real = some_of(recorded_windows(arguments.observations, part, body), REAL[part])
        chosen = (*simulated_windows(windows.names, SIMULATED[part]), *real)
        rows[part] = [
            {key: value for key, value in vars(window).items() if value not in ("", 0.0)}
            for window in chosen
        ]
        print(f"{part}: {len(chosen)} windows, {len(real)} of them of real recordings")
    lines = [
        f'"{part}": [\n' + ",\n".join(json.dumps(row) for row in rows[part]) + "\n]"
        for part in rows
    ]
    LIST.write_text("{\n" + ",\n".join(lines) + "\n}\n")


def simulated_windows(names: Sequence[str], count: int) -> list[GoodWindow]:
    """Listed windows in turn, each time under another variant."""
    found: list[GoodWindow] = []
    for k in range(count):
        own, sensor, _ = VARIANTS[(k + k // len(names)) % len(VARIANTS)]
        found.append(GoodWindow(names[k % len(names)], f"{sensor}: {own}"))
    return found


def recorded_windows(observations: Path, part: Part, body: BodyModel) -> list[GoodWindow]:
    """Stretches that follow each other of all whole-body recordings of a part."""
    found: list[GoodWindow] = []
    for place in FOLDERS[part]:
        path = observations / place
        files = [path] if path.is_file() else sorted(path.iterdir())
        found += [GoodWindow(str(f.relative_to(observations))) for f in files if f.suffix == VIEWS]
        for file in (f for f in files if f.suffix.lower() in (".c3d", ".trc")):
            try:
                recording = read_recording(file)
                assert isinstance(recording, MarkerRecording)
                chosen = recording.select(full_body_markers(recording, body).labels)
            except ValueError as error:
                print(f"left out: {error}")
                continue
            length = chosen.frames / chosen.fps
            starts = [SECONDS * k for k in range(int(length / SECONDS))]
            if len(starts) == 0 and length >= _SHORTEST:
                starts = [0.0]
            name = str(file.relative_to(observations))
            for start in starts:
                window = GoodWindow(name, start=start)
                if float(cut(file, start, body).visible.float().mean()) > _SEEN:
                    found.append(window)
    return found


def some_of(windows: Sequence[GoodWindow], count: int) -> list[GoodWindow]:
    """Some windows of a list, so many, evenly spread."""
    step = max(len(windows) / count, 1.0)
    return [windows[int(k * step)] for k in range(min(count, len(windows)))]


if __name__ == "__main__":
    main()

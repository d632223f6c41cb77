"""Loads 300 good windows, about which every finding that is not true is a false alarm.

`good_windows.json` lists them. Half are test windows as sensors see them in ordinary use: with
other noise than that of the slips, points hidden by a table, points or frames missing. Half are
real recordings whose markers are landmarks of the body, as users who map marker names give them:
ballroom dance (choreonet), runs on a treadmill and over ground (hamner, sprinter), walks, squats
and stands. Markers whose place is only roughly known (clusters on thigh and shank) are left out,
as are windows of which a quarter or more was not seen. For the choice of thresholds there are
windows of validation people of the same kind, and real recordings of people who are in no part.

True findings are allowed: that hidden parts are inferred, that a treadmill is a treadmill, that a
person sits, or stands on a box or a beam (drop jumps begin on one of 30 cm), and that two
recordings have their ground several centimetres above or below z = 0, as their lowest markers show
(-3 cm and 8 cm; 2 to 6 elsewhere).
"""

import json
import tempfile
import zipfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import torch

import recon
from benchmarks.slips.recordings import Sensor, recording_of
from recon import BodyModel, Markers3D
from recon.benchmark.dataset import Part
from recon.benchmark.windows import FPS, FRAMES, TrueWindows
from recon.diagnosis.findings import Code, Finding
from recon.ingest.marker_sets import full_body_markers
from recon.method.sensor import Sensor as Seen
from recon.mocap.reader import read_recording
from recon.mocap.recording import MarkerRecording
from recon.simulation.points import Corruption

LIST = Path(__file__).with_name("good_windows.json")
VIEWS = ".zip"
"""Suffix of files that contain the detections of several cameras."""
_DETECTIONS, _CALIBRATION, _RATE = "pose-associated", "Calib_qualisys.toml", 60.0
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

_TRUE_FINDINGS: dict[str, tuple[Code, ...]] = {
    "hamner_subject02_running": ("treadmill",), "hamner04_run": ("treadmill",),
    "gait2354_subject01_walk": ("treadmill",),
    "_STS": ("uneven ground",), "_DJ": ("uneven ground", "floor"),
    "nick_freeform": ("floor",), "sehoon_squat": ("floor",), "balancing": ("uneven ground",),
}  # fmt: skip
"""Codes of findings that are true of recordings, by a part of their path."""


@dataclass(frozen=True)
class GoodWindow:
    """One listed window without a mistake."""

    source: str
    """Name of a listed window, or path of a real recording."""
    variant: str = ""
    """The variant of a listed window: its sensor and its name in `VARIANTS`, `sensor: name`."""
    start: float = 0.0
    """Start of the window in a real recording (s)."""

    @property
    def name(self) -> str:
        """The window's name for people."""
        return f"{self.source} {self.variant}" if self.variant else f"{self.source}@{self.start:g}"

    @property
    def allowed(self) -> tuple[Code, ...]:
        """Codes of the findings that are true of the window."""
        so: Iterator[Code] = (
            code for part, codes in _TRUE_FINDINGS.items() if part in self.source for code in codes
        )
        return ("unseen", "gap", *so)


def listed(part: Part) -> tuple[GoodWindow, ...]:
    """Return the committed windows of a part."""
    rows = json.loads(LIST.read_text())[part]
    return tuple(GoodWindow(**row) for row in rows)


def alarms(window: GoodWindow, findings: Sequence[Finding]) -> tuple[Finding, ...]:
    """Return the findings that are not true of the window."""
    return tuple(finding for finding in findings if finding.code not in window.allowed)


@dataclass(frozen=True)
class GoodWindows:
    """Loads windows from the folders of their data."""

    windows: TrueWindows
    """All listed windows of a part."""
    observations: Path
    """Folder of real recordings."""
    body: BodyModel

    def load(self, window: GoodWindow) -> Sequence[Seen]:
        """Return the observations of a window.

        Raises:
            ValueError: when the listed windows are not those that the list was made of.
        """
        if window.variant:
            if window.source not in self.windows.names:
                raise ValueError(
                    f"{LIST}: expected windows of this corpus and its splits, got {window.source}"
                )
            corruption, sensor = _variant(window.variant)
            number = self.windows.names.index(window.source)
            return recording_of(self.windows, number, sensor, self.body, corruption).clean
        path = self.observations / window.source
        if path.suffix == VIEWS:
            return views(path)
        return (cut(path, window.start, self.body),)


def _variant(name: str) -> tuple[Corruption, Sensor]:
    return next((c, sensor) for own, sensor, c in VARIANTS if f"{sensor}: {own}" == name)


def some_of(windows: Sequence[GoodWindow], count: int) -> list[GoodWindow]:
    """Choose `count` windows, evenly spread over a list."""
    step = max(len(windows) / count, 1.0)
    return [windows[int(k * step)] for k in range(min(count, len(windows)))]


def cut(path: Path, start: float, body: BodyModel) -> Markers3D:
    """Read two seconds of a recording's precisely placed markers, thinned to about 30 Hz."""
    recording = read_recording(path)
    if not isinstance(recording, MarkerRecording):
        raise ValueError(f"{path}: expected a recording of markers, got a skeleton")
    markers = full_body_markers(recording, body)
    rows = zip(markers.labels, markers.vertices, markers.loose, strict=True)
    firm = [(label, vertex) for label, vertex, loose in rows if not loose]
    chosen = recording.select([label for label, _ in firm])
    step = max(1, round(chosen.fps / FPS))
    first = round(start * chosen.fps)
    frames = slice(first, first + FRAMES * step, step)
    return Markers3D(
        positions=torch.from_numpy(chosen.positions[frames]).float()[None],
        visible=torch.from_numpy(chosen.visible[frames])[None],
        vertices=tuple(vertex for _, vertex in firm),
        fps=chosen.fps / step,
    )


def views(path: Path) -> list[Seen]:
    """Read all detections of a Pose2Sim recording with their calibration."""
    with tempfile.TemporaryDirectory() as scratch:
        with zipfile.ZipFile(path) as archive:
            archive.extractall(scratch)
        found = recon.load_observation(
            Path(scratch) / _DETECTIONS, camera=path.with_name(_CALIBRATION), frame_rate=_RATE
        )
    return found if isinstance(found, list) else [found]

"""Windows of real recordings, as people who fit them would give them."""

import tempfile
import zipfile
from pathlib import Path

import torch

from observations.markers3d import Markers3D
from recon.benchmark.windows import FPS, FRAMES
from recon.body.model import BodyModel
from recon.fitting.settings import FitSettings
from recon.formats.mocap.reader import read_recording
from recon.formats.mocap.recording import MarkerRecording
from recon.ingest.markers.coverage import full_body_markers
from recon.method.protocols import Sensor as Seen
from recon.reading.clip import load_clip

VIEWS = ".zip"
"""Detections of several cameras are packed in these."""
_DETECTIONS, _CALIBRATION, _RATE = "pose-associated", "Calib_qualisys.toml", 60.0


def cut(path: Path, start: float, body: BodyModel) -> Markers3D:
    """Two seconds of a recording's precisely placed markers, thinned to about 30 Hz."""
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


def views(path: Path, body: BodyModel) -> tuple[tuple[Seen, ...], tuple[str, ...]]:
    """All detections of a Pose2Sim recording with their calibration, and the cameras' names."""
    settings = FitSettings(camera=path.with_name(_CALIBRATION), frame_rate=_RATE)
    with tempfile.TemporaryDirectory() as scratch:
        with zipfile.ZipFile(path) as archive:
            archive.extractall(scratch)
        clip = load_clip([Path(scratch) / _DETECTIONS], settings, body)
    return clip.observations, tuple(Path(name).name for name in clip.names)

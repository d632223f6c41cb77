"""One cycle of gait from a real marker recording: what is given of it, and what is left out.

A left-out marker's constant offset, in the frame of its bone, is the mean over every tenth frame
on the body that is judged; its error is measured in the other frames, as benchmarks/markers.py
does.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from benchmarks.scans import observed_frames
from observations.markers3d import Markers3D
from recon.body.cycles import find_cycles
from recon.body.landmarks import LANDMARKS_16, landmark
from recon.body.model import BodyModel
from recon.core.motion import Motion
from recon.core.struct import concatenate
from recon.formats.mocap.recording import MarkerRecording
from recon.ingest.markers.coverage import MarkerSet, full_body_markers, nominal_offsets
from recon.ingest.markers.fit import fit_markers

RATE = 50
"""Frames per second that recordings are thinned to, or a little more."""
SECONDS = 4.0
"""Seconds about the middle of a recording, in which cycles are sought."""
OFFSET_EVERY = 10


@dataclass(frozen=True)
class RealCycle:
    """One recorded cycle; all of it at one rate from zero seconds on."""

    name: str
    given: Markers3D
    """The 16 landmarks; those that the recording lacks are never visible."""
    labels: tuple[str, ...]
    """Markers left out."""
    vertices: tuple[int, ...]
    positions: Float[Tensor, "time markers 3"]
    visible: Bool[Tensor, "time markers"]
    everything: Motion
    """Fitted to all markers."""

    @property
    def landmarks(self) -> int:
        """How many of the 16 there are."""
        return int(self.given.visible.any(1).sum())

    def seen(self, observed: int | None) -> Markers3D:
        """The landmarks, in some of 100 frames."""
        if observed is None:
            return self.given
        frames = self.given.visible.shape[1]
        kept = torch.zeros(frames, dtype=torch.bool)
        kept[torch.from_numpy(observed_frames(frames, observed))] = True
        visible = self.given.visible & kept[:, None]
        return self.given.replace(
            visible=visible, positions=self.given.positions.where(visible[..., None], 0.0)
        )


def real_cycle(name: str, recording: MarkerRecording, body: BodyModel) -> RealCycle:
    """The middle cycle of a recording.

    Raises:
        ValueError: when its markers do not cover the body, or no cycle is found.
    """
    markers = full_body_markers(recording, body)
    chosen = thinned(recording.select(markers.labels))
    motion = fit_markers(chosen, markers, body).motion
    cycles = find_cycles(motion)
    if not cycles:
        raise ValueError(f"{name}: no cycle of gait found in {chosen.frames / chosen.fps:.2f} s")
    middle = motion.times[-1].item() / 2
    cycle = min(cycles, key=lambda one: abs((one.start + one.stop) / 2 - middle))
    first, last = round(cycle.start * chosen.fps), round(cycle.stop * chosen.fps)
    positions = torch.from_numpy(chosen.positions[first : last + 1]).float()
    visible = torch.from_numpy(chosen.visible[first : last + 1])
    positions = positions.where(visible[..., None], 0.0)
    used, rest = divided(markers, visible)
    return RealCycle(
        name=name,
        given=sixteen([markers.vertices[k] for k in used], positions[:, used], visible[:, used],
                      chosen.fps),
        labels=tuple(markers.labels[k] for k in rest),
        vertices=tuple(markers.vertices[k] for k in rest),
        positions=positions[:, rest],
        visible=visible[:, rest],
        everything=motion.window(first, last + 1).replace(start_time=0.0),
    )  # fmt: skip


def sixteen(
    vertices: Sequence[int],
    positions: Float[Tensor, "time some 3"],
    visible: Bool[Tensor, "time some"],
    fps: float,
) -> Markers3D:
    """Some of the 16 landmarks as all of them, the others never visible: all batches alike."""
    every = tuple(landmark(name) for name in LANDMARKS_16)
    columns = [every.index(vertex) for vertex in vertices]
    place = positions.new_zeros(1, len(positions), len(every), 3)
    there = visible.new_zeros(1, len(positions), len(every))
    place[0, :, columns], there[0, :, columns] = positions, visible
    return Markers3D(place, there, every, fps)


def divided(
    markers: MarkerSet, visible: Bool[Tensor, "time markers"]
) -> tuple[list[int], list[int]]:
    """One marker, the most often seen, for each of the 16; and those on other landmarks."""
    places = [landmark(name) for name in LANDMARKS_16]
    often = visible.sum(0).tolist()
    used: list[int] = []
    for vertex in places:
        there = [k for k, own in enumerate(markers.vertices) if own == vertex and often[k]]
        used += [max(there, key=lambda k: often[k])] if there else []
    rest = [k for k, own in enumerate(markers.vertices) if own not in places and often[k]]
    return used, rest


def thinned(recording: MarkerRecording) -> MarkerRecording:
    """The middle seconds, at 50 Hz or a little more."""
    step = max(1, int(recording.fps // RATE))
    count = min(recording.frames, int(SECONDS * recording.fps))
    first = (recording.frames - count) // 2
    part = slice(first, first + count, step)
    return MarkerRecording(
        name=recording.name,
        marker_names=recording.marker_names,
        positions=recording.positions[part],
        visible=recording.visible[part],
        fps=recording.fps / step,
        decisions=recording.decisions,
    )


def judged(motion: Motion, cycle: RealCycle, body: BodyModel) -> dict[str, dict[str, float]]:
    """Mean error over the judged frames of each left-out marker, mm; with offset and nominal."""
    times = torch.arange(len(cycle.positions), dtype=torch.float64) / cycle.given.fps
    times = times[times <= motion.times[-1] + 1e-6]
    posed = body.pose(motion.at(times, cycle.given.fps))
    turns = posed.orientations[:, body.weights[list(cycle.vertices)].argmax(-1)]
    skin = posed.points(torch.tensor(cycle.vertices))
    there, visible = cycle.positions[: len(times)], cycle.visible[: len(times)]
    local = (turns.mT @ (there - skin)[..., None])[..., 0]
    measured = visible[::OFFSET_EVERY, :, None]
    own = local[::OFFSET_EVERY].where(measured, 0.0).sum(0) / measured.sum(0).clamp(min=1)
    scored = visible.clone()
    scored[::OFFSET_EVERY] = False
    known = measured.any(0)[:, 0] & scored.any(0)
    found: dict[str, dict[str, float]] = {}
    offsets = {"left out": own, "nominal": nominal_offsets(body, cycle.vertices)}
    for column, offset in offsets.items():
        apart = 1000 * (local - offset).norm(dim=-1).where(scored, 0.0).sum(0)
        mean = (apart / scored.sum(0).clamp(min=1)).tolist()
        found[column] = {
            label: round(value, 1)
            for label, value, ok in zip(cycle.labels, mean, known.tolist(), strict=True)
            if ok
        }
    return found


def together(seen: Sequence[Markers3D]) -> Markers3D:
    """Cycles of one rate as a batch; shorter ones see nothing at their end."""
    longest = max(one.visible.shape[1] for one in seen)
    return concatenate(
        [
            one.replace(
                positions=_padded(one.positions, longest), visible=_padded(one.visible, longest)
            )
            for one in seen
        ]
    )


def _padded(tensor: Tensor, longest: int) -> Tensor:
    more = tensor.new_zeros(tensor.shape[0], longest - tensor.shape[1], *tensor.shape[2:])
    return torch.cat((tensor, more), 1)

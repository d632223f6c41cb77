"""Converts a single recording of any kind to a motion of the body model."""

from dataclasses import replace
from pathlib import Path

from recon.body.model import BodyModel
from recon.core.arrays import usable_frame_rate
from recon.core.units import Hand, Up
from recon.formats.producers import refuse_unsupported
from recon.ingest.conversion import Conversion, convert_skeletons, resampled
from recon.ingest.maps import recognise, right_handed_skeleton
from recon.ingest.marker_conversion import convert_markers
from recon.ingest.subject import SubjectModel, calibrate
from recon.mocap.reader import read_recording
from recon.mocap.recording import MarkerRecording, SkeletonRecording, drop_lead_in


def convert(
    recording: str | Path | SkeletonRecording | MarkerRecording,
    body: BodyModel | None = None,
    *,
    unit: str | None = None,
    up: Up | None = None,
    hand: Hand | None = None,
    subject: SubjectModel | None = None,
    mapping: str | Path | None = None,
    fps: float | None = None,
    keep_frame: bool = False,
) -> Conversion:
    """Convert a recording of a body's joints or markers to a motion of the body model.

    Args:
        recording: a file (.bvh, .amc, .c3d, .trc, ...) or what its reader made of it.
        body: the body model; None is the bundled one.
        unit: unit of the file's lengths; None finds it out.
        up: axis of the file that points up, or down; None finds it out.
        hand: handedness of the axes; None finds it out.
        subject: shape, offsets and alignments from other recordings of the same skeleton; None
            finds them from this one.
        mapping: TOML or JSON file that maps the model's joints or landmarks to the recording's.
        fps: resample to this rate; None keeps the recording's.
        keep_frame: leave the motion where the recording has it, z up, instead of on z = 0.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: when it cannot be read, its unit or axis cannot be told, its skeleton or
            markers are not known or do not cover the body, or the rate is not positive.
    """
    if fps is not None:
        usable_frame_rate(fps, "fps")
    if isinstance(recording, (str, Path)):
        refuse_unsupported(Path(recording), "convert")
        recording = read_recording(recording, unit=unit, up=up)
    body = BodyModel.load() if body is None else body
    if isinstance(recording, MarkerRecording):
        found = convert_markers(recording, body, mapping=mapping, keep_frame=keep_frame, hand=hand)
    else:
        skeleton = recognise(recording, mapping) if subject is None else subject.skeleton
        recording = right_handed_skeleton(drop_lead_in(recording), skeleton, hand)
        if subject is None:
            said = (*recording.decisions, f"skeleton: {skeleton.name}")
            recording = replace(recording, decisions=said)
            subject = calibrate([recording], skeleton, body)
        (found,) = convert_skeletons([recording], subject, body, keep_frame=keep_frame)
        found = replace(found, motion=found.motion.replace(start_time=recording.start_time))
    return found if fps is None or fps == found.motion.fps else resampled(found, body, fps)

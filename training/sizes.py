"""Which people of CMU have the same bones: numbers of CMU are sessions, and not always people.

    python -m training.sizes DATA

For every number on bones of its own it logs the known numbers that are nearest, by the root mean
square of the relative differences of bone lengths.
"""

import logging
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import tyro
from jaxtyping import Float
from tyro.conf import Positional

from recon.benchmark.dataset import Splits
from recon.core.skeleton import joint_index
from recon.ingest.maps import recognise
from recon.mocap.reader import read_recording
from recon.mocap.recording import SkeletonRecording
from training.sources import COMMON, skeleton_clips

_BONES = tuple(
    (joint_index(f"{side}_{start}"), joint_index(f"{side}_{end}"))
    for start, end in (("hip", "knee"), ("knee", "ankle"), ("ankle", "foot"),
                       ("shoulder", "elbow"), ("elbow", "wrist"))
    for side in ("left", "right")
)  # fmt: skip
_HIPS = (joint_index("left_hip"), joint_index("right_hip"))
_KNOWN, _NEW = ("cmu",), ("cmu_amc",)
_UNKNOWN = "unknown"
LOG = logging.getLogger("training")


def bone_lengths(recording: SkeletonRecording) -> Float[np.ndarray, "11"]:
    """Lengths of both thighs, shanks, feet, upper arms and forearms, and the width of the hips.

    Metres, of the first frame; bones are rigid.
    """
    places = dict(recognise(recording).positions)
    at = {ours: recording.positions[0, recording.joint(theirs)] for ours, theirs in places.items()}
    return np.array([np.linalg.norm(at[a] - at[b]) for a, b in (*_BONES, _HIPS)])


def bone_differences(
    person: Float[np.ndarray, " bones"], others: Mapping[str, Float[np.ndarray, " bones"]]
) -> list[tuple[float, str]]:
    """Root mean square of the relative differences of bones, per cent, from the nearest on."""
    apart = {
        name: np.sqrt(np.mean(np.square(bones / person - 1))) for name, bones in others.items()
    }
    return sorted((100 * float(value), name) for name, value in apart.items())


def sizes(data: Positional[Path]) -> None:
    """Compare the bones of all subjects with the subjects of version 0.2.0.

    Args:
        data: folder of all real recordings.
    """
    splits = Splits.load()
    people: dict[str, dict[str, np.ndarray]] = {}
    for clips in skeleton_clips(data):
        own = people.setdefault(clips[0].collection, {})
        for clip in clips:
            name = splits.subject(clip.name)
            known = clip.collection not in (*_KNOWN, *_NEW) or name in own or name == _UNKNOWN
            if not known and COMMON not in clip.notes.get("skeleton", ""):
                recording = read_recording(clip.path)
                assert isinstance(recording, SkeletonRecording)
                own[name] = bone_lengths(recording)
    old = people[_KNOWN[0]]
    for title, some in (("new", people[_NEW[0]]), ("known", old)):
        for name, bones in sorted(some.items()):
            others = {other: value for other, value in old.items() if other != name}
            near = ", ".join(
                f"{other} {value:.1f}" for value, other in bone_differences(bones, others)[:3]
            )
            LOG.info("%s %s: %s %%", title, name, near)


if __name__ == "__main__":
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    tyro.cli(sizes, prog="python -m training.sizes")

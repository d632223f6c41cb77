"""Do these markers show a whole body, and where on it do they sit?"""

import logging
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor

from recon.body.landmarks import landmark, load_marker_map, match_markers
from recon.body.model import BodyModel
from recon.core.errors import ReconError
from recon.core.skeleton import descendants, joint_index
from recon.formats.mocap.recording import MarkerRecording
from recon.ingest.markers.joint_centres import are_keypoints, keypoint_of, keypoint_places

logger = logging.getLogger(__name__)

_LOOSE = re.compile(r"thigh|shank|upper_arm|deltoid|forearm$|forearm_|scapula$|chest")
"""Landmarks that are a region: markers are put anywhere on it."""
STANDOFF = 0.0095
"""Metres from the skin to a marker's centre, along the normal (MoSh)."""
_LEAST = 10
_STUDY = "_study"
"""Suffix of OpenCap's augmented markers."""


@dataclass(frozen=True)
class MarkerSet:
    """Markers whose place on the body is known."""

    labels: tuple[str, ...]
    vertices: tuple[int, ...]
    loose: tuple[bool, ...]
    """Whether the place is only roughly known."""
    nominal: Float[Tensor, "markers 3"]
    """Expected offset of each marker from its vertex, in the frame of its bone, metres."""
    unknown: tuple[str, ...]
    """Labels nobody knows: virtual markers, joint centres, unlabelled points."""
    inside: bool = False
    """Whether they are joint centres that a detector found, rather than markers on the skin."""


def full_body_markers(
    recording: MarkerRecording, body: BodyModel, mapping: str | Path | None = None
) -> MarkerSet:
    """The known markers of a recording that are ever visible.

    Args:
        recording: with labels of any protocol.
        body: on whose mesh they sit.
        mapping: TOML file, marker label = landmark or vertex; None uses the known labels.

    Raises:
        FileNotFoundError: when there is no such mapping file.
        ValueError: when the body is not the bundled one and no mapping gives its vertices, or
            when too few markers are known or parts of the body have none.
    """
    if mapping is None and body.checksum != BodyModel.load().checksum:
        raise ReconError(
            f"marker names are points of the bundled body, not of {body.name!r}; give vertex "
            "numbers of that body with --mapping"
        )
    seen = [
        label
        for marker, label in enumerate(recording.marker_names)
        if recording.visible[:, marker].any()
    ]
    if mapping is None and are_keypoints(seen):
        return _keypoints(seen, body)
    if mapping is None:
        # OpenCap adds markers that a network placed beside the keypoints they were made from
        study = {label.removesuffix(_STUDY): label for label in seen if label.endswith(_STUDY)}
        known, unknown = match_markers(study if len(study) >= _LEAST else seen)
        names = {study.get(label, label): name for label, name in known.items()}
        unknown = tuple(label for label in seen if label not in names)
        vertices = {label: landmark(name) for label, name in names.items()}
        loose = {label: _LOOSE.search(name) is not None for label, name in names.items()}
    else:
        given = load_marker_map(mapping)
        vertices = {label: given[label] for label in seen if label in given}
        unknown = tuple(label for label in seen if label not in given)
        loose = dict.fromkeys(vertices, False)
    if unknown:
        logger.info("%s: markers not known: %s", recording.name, ", ".join(unknown))
    _check_cover(recording.name, vertices, unknown, body)
    labels = tuple(vertices)
    return MarkerSet(
        labels=labels,
        vertices=tuple(vertices.values()),
        loose=tuple(loose[label] for label in labels),
        nominal=nominal_offsets(body, tuple(vertices.values())),
        unknown=unknown,
    )


def _keypoints(labels: Sequence[str], body: BodyModel) -> MarkerSet:
    known = tuple(label for label in labels if keypoint_of(label) is not None)
    vertices, nominal = keypoint_places(known, body)
    return MarkerSet(
        labels=known,
        vertices=vertices,
        # what detectors call a joint is some centimetres off the body's own joint
        loose=(True,) * len(known),
        nominal=nominal,
        unknown=tuple(label for label in labels if label not in known),
        inside=True,
    )


def _check_cover(
    name: str, vertices: dict[str, int], unknown: tuple[str, ...], body: BodyModel
) -> None:
    bones = body.weights[list(vertices.values())].argmax(-1).tolist() if vertices else []
    parts: dict[str, tuple[int, ...]] = {"pelvis": (0, 1, 2, 3)}
    for side in ("left", "right"):
        knee = joint_index(f"{side}_knee")
        parts[f"{side} thigh or knee"] = (joint_index(f"{side}_hip"), knee)
        parts[f"{side} shank or foot"] = descendants(knee)
    parts["trunk"] = descendants(joint_index("spine2"))
    bare = [part for part, joints in parts.items() if not any(b in joints for b in bones)]
    left = f"; labels not known: {', '.join(unknown)}" if unknown else ""
    how = "; say where markers sit in a TOML file, label = landmark, with --mapping"
    if bare == ["trunk"]:
        raise ReconError(f"{name}: lower-body only: no marker on the trunk{left}{how}")
    if bare or len(bones) < _LEAST:
        raise ReconError(
            f"{name}: expected a full-body marker set of at least {_LEAST} known markers, got "
            f"{len(bones)} ({', '.join(vertices)}); without a marker: {', '.join(bare) or 'none'}"
            f"{left}{how}"
        )


def nominal_offsets(body: BodyModel, vertices: Sequence[int]) -> Float[Tensor, "markers 3"]:
    """A marker's centre off the skin, along the normal of the rest body, metres."""
    corners = body.template[body.faces]
    normals = torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    total = torch.zeros_like(body.template)
    for corner in range(3):
        total.index_add_(0, body.faces[:, corner], normals)
    chosen = total[list(vertices)]
    return STANDOFF * chosen / chosen.norm(dim=-1, keepdim=True)

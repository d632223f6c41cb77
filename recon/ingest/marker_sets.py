"""Finds where on the body model the markers of a recording sit, and which parts they cover."""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor

from observations.correspondences import PLACES
from observations.start.rigid import TORSO
from recon.body.landmarks import landmark, landmarks
from recon.body.marker_labels import (
    FEWEST_MARKERS,
    advice_on_mapping,
    load_marker_map,
    marker_sets,
    match_markers,
)
from recon.body.model import BodyModel
from recon.core.errors import ReconError
from recon.core.hands import right_handed_signs
from recon.core.raster import differentiable_normals
from recon.core.skeleton import JOINTS, descendants, joint_index
from recon.core.units import Hand
from recon.diagnosis.findings import Finding, listed
from recon.keypoints3d.labels import STUDY, are_keypoints, keypoints_of_labels
from recon.mocap.recording import MarkerRecording

_TRUNK = {"neck": "spine3", "thorax": "spine3", "spine": "spine2", "mid_hip": "pelvis"}
"""Bones that move those keypoints that lie between joints of both sides."""


def keypoint_places(
    labels: Sequence[str], body: BodyModel
) -> tuple[tuple[int, ...], Float[Tensor, "points 3"]]:
    """Return for each keypoint a vertex that moves with its bone, and its offset (m) from there.

    Offsets are those on the average body at rest.
    """
    vertices: list[int] = []
    offsets: list[Tensor] = []
    for label, name in zip(labels, keypoints_of_labels(labels), strict=True):
        if name is None or name not in PLACES:
            raise ReconError(f"{label!r} is no keypoint; known are {', '.join(PLACES)}")
        place = PLACES[name]
        points = [body.joint_template[joint_index(joint)] for joint in place.joints]
        points += [body.template[landmark(one)] for one in place.landmarks]
        centre = torch.stack(points).mean(0)
        if name in _TRUNK:
            bone = JOINTS.index(_TRUNK[name])
        elif place.joints:
            bone = joint_index(place.joints[0])
        else:
            marks = [landmark(one) for one in place.landmarks]
            bone = int(body.weights[marks].sum(0).argmax())
        rigid = body.weights[:, bone] > body.weights[:, bone].max() - 1e-3
        away = (body.template - centre).norm(dim=-1).where(rigid, torch.inf)
        vertices.append(int(away.argmin()))
        offsets.append(centre - body.template[vertices[-1]])
    return tuple(vertices), torch.stack(offsets)


def keypoint_finding(labels: Sequence[str]) -> Finding:
    """Make the finding that a recording's points are keypoints inside the body, not markers."""
    return Finding(
        "joint centres",
        f"the points are joint centres by their names ({listed(labels)}), as detectors of "
        "keypoints give them: they lie inside the body and are no markers on the skin. With the "
        "images' keypoints and calibrated cameras, `recon fit` is more accurate",
        value=float(len(labels)),
    )


_LOOSE = re.compile(r"thigh|shank|upper_arm|deltoid|forearm$|forearm_|scapula$|chest")
"""Matches names of landmarks that are regions: markers may sit anywhere on them."""
STANDOFF = 0.0095
"""Distance (m) from the skin to a marker's centre, along the normal (MoSh)."""
_BONES_ABOVE, _ON_TORSO = 3, 3
"""Fewest bones from the chest up with a marker, and of torso markers, to place an upper body."""


@dataclass(frozen=True)
class MarkerSet:
    """Markers with their labels, and the vertices of the body model at which they sit."""

    labels: tuple[str, ...]
    vertices: tuple[int, ...]
    loose: tuple[bool, ...]
    """Whether each marker's place is known only roughly, as anywhere on a thigh."""
    nominal: Float[Tensor, "markers 3"]
    """Expected offset of each marker from its vertex, in the frame of its bone, metres."""
    bones: tuple[int, ...]
    """The bone that moves each marker most."""
    unknown: tuple[str, ...]
    """Labels without a known vertex: of virtual markers, joint centres, unlabelled points."""
    inside: bool = False
    """Whether the points are joint centres from a detector, rather than markers on the skin."""
    bare: tuple[str, ...] = ()
    """Parts of the body without a marker: trunk, pelvis, left shank or foot, ..."""
    decisions: tuple[str, ...] = ()
    """What was chosen among the points, one sentence each."""
    guessed: bool = False
    """Whether names were guessed by usual places of markers, so that they may be wrong."""


def full_body_markers(
    recording: MarkerRecording, body: BodyModel, mapping: str | Path | None = None
) -> MarkerSet:
    """Find the vertices of the body at which the visible markers with known labels sit.

    Args:
        recording: with labels of any protocol; of several subjects the one seen most is taken.
        body: the body model on whose mesh the markers sit.
        mapping: JSON or TOML file, marker label = landmark or vertex, for labels that are not
            known or that mean another place here; None uses the known labels.

    Raises:
        FileNotFoundError: when there is no such mapping file.
        ValueError: when the body is not the bundled one and no mapping gives its vertices, or
            when too few markers are known to place legs or trunk.
    """
    bundled = body.checksum == BodyModel.load().checksum
    if mapping is None and not bundled:
        raise ReconError(
            f"marker names are points of the bundled body, not of {body.name!r}; give vertex "
            "numbers of that body with --mapping"
        )
    seen = [
        label
        for marker, label in enumerate(recording.marker_names)
        if recording.visible[:, marker].any()
    ]
    # OpenCap's files have keypoints, and markers computed from these, named with `_study`
    study = {label.removesuffix(STUDY): label for label in seen if label.endswith(STUDY)}
    if len(study) < FEWEST_MARKERS and mapping is None and are_keypoints(seen):
        return _marker_set_of_keypoints(seen, body)
    seen, decisions = _labels_of_one_subject(recording, seen)
    vertices: dict[str, int] = {}
    loose: dict[str, bool] = {}
    if bundled:
        known, _ = match_markers(study if len(study) >= FEWEST_MARKERS else seen)
        names = {study.get(label, label): name for label, name in known.items()}
        vertices = {label: landmark(name) for label, name in names.items()}
        loose = {label: _LOOSE.search(name) is not None for label, name in names.items()}
    if mapping is not None:
        given = load_marker_map(mapping)
        for label in (label for label in seen if label in given):
            vertices.pop(label, None)
            if (vertex := given[label]) is not None:
                vertices[label], loose[label] = vertex, False
    vertices = {label: vertices[label] for label in seen if label in vertices}
    unknown = tuple(label for label in seen if label not in vertices)
    bare = _parts_without_markers(recording.name, vertices, unknown, body)
    found = markers_at(vertices, loose, body)
    return replace(found, unknown=unknown, bare=bare, decisions=decisions)


def markers_at(
    vertices: Mapping[str, int], loose: Mapping[str, bool], body: BodyModel
) -> MarkerSet:
    """Make a set of markers on the skin at given vertices of the body."""
    places = tuple(vertices.values())
    return MarkerSet(
        labels=tuple(vertices),
        vertices=places,
        loose=tuple(loose[label] for label in vertices),
        nominal=nominal_offsets(body, places),
        bones=_bones_of_vertices(places, body),
        unknown=(),
    )


def markers_of_set(name: str | Path, body: BodyModel) -> MarkerSet:
    """Return a known set of markers by its name (pig, cmu, ...), or one from a mapping file.

    Raises:
        FileNotFoundError: when there is no such set and no such file.
        ReconError: when the file is damaged, or gives fewer than ten markers on the skin.
    """
    known = landmarks()
    if (table := marker_sets().get(str(name))) is not None:
        vertices = {label: known[place] for label, place in table.items() if place in known}
    elif Path(name).suffix:
        given = load_marker_map(name)
        vertices = {label: vertex for label, vertex in given.items() if vertex is not None}
    else:
        raise ReconError(
            f"{name}: expected one of the marker sets {', '.join(marker_sets())}, or a .toml "
            "or .json file with lines marker = landmark"
        )
    if len(vertices) < FEWEST_MARKERS:
        raise ReconError(
            f"{name}: expected {FEWEST_MARKERS} markers on the skin or more, got {len(vertices)}"
        )
    places = {vertex: place for place, vertex in known.items()}
    loose = {label: bool(_LOOSE.search(places.get(v, ""))) for label, v in vertices.items()}
    return markers_at(vertices, loose, body)


def right_handed_markers(
    recording: MarkerRecording, markers: MarkerSet, hand: Hand | None
) -> MarkerRecording:
    """Return the recording in right-handed axes, with a note in it if it was mirrored."""
    chosen = recording.select(markers.labels)
    meant = keypoints_of_labels(markers.labels) if markers.inside else ()
    places = {landmark(name): name for name in landmarks()}
    names = [str(name) for name in meant] or [places.get(one, "") for one in markers.vertices]
    factors, said = right_handed_signs(names, chosen.positions, chosen.visible, hand)
    return replace(
        recording,
        positions=recording.positions * factors,
        decisions=(*recording.decisions, *said),
    )


def _labels_of_one_subject(
    recording: MarkerRecording, seen: Sequence[str]
) -> tuple[list[str], tuple[str, ...]]:
    """Return labels without those of all but the most seen person (Ann:LASI, Bob:LASI).

    Labels without a prefix belong to anybody, unless one repeats a person's (LASI): then they
    are another person's.
    """
    shown = dict(zip(recording.marker_names, recording.visible.sum(0).tolist(), strict=True))
    twins = {label.split(":", 1)[-1] for label in seen if ":" in label} & set(seen)
    subjects: dict[str, str] = {}
    counts: dict[str, int] = {}
    for label in seen:
        if ":" in label or (twins and not label.startswith("*")):
            subjects[label] = label.split(":")[0] if ":" in label else "(no prefix)"
            counts[subjects[label]] = counts.get(subjects[label], 0) + shown[label]
    if len(counts) < 2:
        return list(seen), ()
    chosen = max(counts, key=lambda subject: counts[subject])
    others = [subject for subject in counts if subject != chosen]
    return [label for label in seen if subjects.get(label, chosen) == chosen], (
        f"markers of {len(counts)} subjects: those of {chosen} were taken, which are seen most; "
        f"left out: {', '.join(others)}",
    )


def _marker_set_of_keypoints(labels: Sequence[str], body: BodyModel) -> MarkerSet:
    meant = zip(labels, keypoints_of_labels(labels), strict=True)
    known = tuple(label for label, name in meant if name in PLACES)
    vertices, nominal = keypoint_places(known, body)
    return MarkerSet(
        labels=known,
        vertices=vertices,
        # detectors place joints some centimetres away from the body model's joints
        loose=(True,) * len(known),
        nominal=nominal,
        bones=_bones_of_vertices(vertices, body),
        unknown=tuple(label for label in labels if label not in known),
        inside=True,
    )


def _bones_of_vertices(vertices: Iterable[int], body: BodyModel) -> tuple[int, ...]:
    return tuple(body.weights[list(vertices)].argmax(-1).tolist())


def _parts_without_markers(
    name: str, vertices: dict[str, int], unknown: tuple[str, ...], body: BodyModel
) -> tuple[str, ...]:
    """Return the names of those parts of the body on which no marker sits.

    Raises:
        ValueError: when the markers cover neither both legs and the pelvis nor the trunk.
    """
    bones = _bones_of_vertices(vertices.values(), body)
    parts: dict[str, tuple[int, ...]] = {"pelvis": (0, 1, 2, 3)}
    for side in ("left", "right"):
        knee = joint_index(f"{side}_knee")
        parts[f"{side} thigh or knee"] = (joint_index(f"{side}_hip"), knee)
        parts[f"{side} shank or foot"] = descendants(knee)
    trunk = descendants(joint_index("spine2"))
    parts["trunk"] = trunk
    bare = tuple(part for part, some in parts.items() if not any(b in some for b in bones))
    legs = set(bare) <= {"trunk"}
    upper = len({b for b in bones if b in trunk}) >= _BONES_ABOVE and (
        sum(b in TORSO for b in bones) >= _ON_TORSO
    )
    if (legs or upper) and len(bones) >= FEWEST_MARKERS:
        return bare
    raise ReconError(
        f"{name}: expected at least {FEWEST_MARKERS} markers of known places, on pelvis and both "
        f"legs or on the trunk, got {len(bones)} ({', '.join(vertices) or 'none'}); without a "
        f"marker: {', '.join(bare) or 'none'}; labels not known: {', '.join(unknown) or 'none'}; "
        f"{advice_on_mapping(unknown or tuple(vertices))}"
    )


def nominal_offsets(body: BodyModel, vertices: Sequence[int]) -> Float[Tensor, "markers 3"]:
    """Return offsets (m) of markers' centres from the skin, along the normals of the rest body."""
    return STANDOFF * differentiable_normals(body.template, body.faces)[list(vertices)]

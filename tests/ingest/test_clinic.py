"""Recordings of laboratories: legs or trunk alone, the laboratory's frame, several subjects."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
import torch

from observations.markers3d import Markers3D
from recon.body.landmarks import landmark
from recon.body.model import BodyModel
from recon.core.motion import Motion
from recon.core.skeleton import ARMS, FEET, LEGS, joint_index
from recon.ingest import convert
from recon.ingest.marker_fit import fit_markers
from recon.ingest.marker_observation import seen_markers
from recon.ingest.marker_sets import full_body_markers
from recon.method.protocols import Estimate
from recon.mocap.recording import MarkerRecording
from tests.ingest.walker import MARKERS

LEG_MARKERS = [
    label for label, name in MARKERS.items()
    if any(part in name for part in ("asis", "psis", "thigh", "knee", "shank", "ankle", "heel",
                                     "toe"))
]  # fmt: skip
UPPER_MARKERS = [label for label in MARKERS if label not in LEG_MARKERS]


@pytest.fixture(scope="module")
def markers(markers: MarkerRecording) -> MarkerRecording:
    """What markers on the skin of the walker show, from 2 s of the recording's clock on."""
    return dataclasses.replace(markers, start_time=2.0)


def test_legs_alone_are_converted_and_the_rest_is_inferred(
    markers: MarkerRecording, walk: Motion, single: BodyModel
) -> None:
    """Sets of the lower body, the usual ones of gait laboratories, were refused."""
    found = convert(markers.select(LEG_MARKERS), single)
    assert found.observed is not None
    assert found.observed[:, list(LEGS)].all()
    assert not found.observed[:, list(ARMS)].any()
    truth = single.pose(walk).joints[:, list(LEGS)]
    away = found.joints[:, list(LEGS)] - truth
    assert (away - away.mean((0, 1))).norm(dim=-1).mean() < 0.02
    (unseen,) = (one for one in found.warnings if one.code == "unseen")
    assert "trunk (never seen)" in unseen.message
    assert "left arm (never seen)" in unseen.message
    # arms hang: in a T-pose, hands are as high as shoulders
    heights = found.joints[..., 2]
    assert (
        heights[:, joint_index("left_wrist")] < heights[:, joint_index("left_hip")] + 0.2
    ).all()
    assert found.motion.start_time == 2.0


def test_a_trunk_alone_keeps_its_height(markers: MarkerRecording, single: BodyModel) -> None:
    """Without a marker on the feet nothing tells the ground, so nothing is put on it."""
    upper = markers.select(UPPER_MARKERS)
    found = convert(upper, single)
    assert found.observed is not None
    assert not found.observed[:, list(FEET)].any()
    assert found.ground_shift == 0
    assert any("no foot is ever observed" in said for said in found.decisions)
    neck = upper.positions[:, upper.marker_names.index("C7")]
    away = found.joints[:, joint_index("neck")].numpy() - neck
    assert np.linalg.norm(away, axis=-1).max() < 0.15


def test_the_frame_of_the_laboratory_is_kept_where_it_is_wanted(
    markers: MarkerRecording, single: BodyModel
) -> None:
    """A converted motion could not be laid over force plates: it was lowered and levelled."""
    raised = dataclasses.replace(markers, positions=markers.positions + np.array((1.0, 2.0, 0.3)))
    kept, lowered = convert(raised, single, keep_frame=True), convert(raised, single)
    assert kept.ground[:3] == pytest.approx((0.0, 0.0, 1.0), abs=1e-6)
    assert kept.ground[3] == pytest.approx(lowered.ground_shift, abs=1e-5)
    assert kept.ground_shift == 0
    shift = torch.tensor([0.0, 0.0, lowered.ground_shift])
    torch.testing.assert_close(kept.joints, lowered.joints + shift, atol=1e-5, rtol=0)
    torch.testing.assert_close(kept.contacts, lowered.contacts)
    written = kept.file(single).ground
    assert written is not None
    assert written.tolist() == pytest.approx(kept.ground)


@pytest.mark.parametrize(("prefix", "left"), [("Ann:", "Ann"), ("", "(no prefix)")])
def test_of_two_subjects_the_one_seen_most_is_taken(
    markers: MarkerRecording, single: BodyModel, prefix: str, left: str
) -> None:
    """Markers of both were fitted as those of one body, or those without a prefix were."""
    both = dataclasses.replace(
        markers,
        marker_names=tuple(f"{who}{n}" for who in (prefix, "Bob:") for n in markers.marker_names),
        positions=np.concatenate(
            (markers.positions, markers.positions + np.array((2.0, 0.0, 0.0))), 1
        ),
        visible=np.concatenate((markers.visible, markers.visible), 1),
    )
    both.visible[:5, : len(markers.marker_names)] = False
    chosen = full_body_markers(both, single)
    assert {label.split(":")[0] for label in chosen.labels} == {"Bob"}
    assert f"left out: {left}" in chosen.decisions[0]


def test_a_mapping_adds_to_the_known_labels(
    markers: MarkerRecording, single: BodyModel, tmp_path: Path
) -> None:
    names = ["Channel7" if name == "C7" else name for name in markers.marker_names]
    recording = dataclasses.replace(markers, marker_names=tuple(names))
    path = tmp_path / "names.json"
    path.write_text(json.dumps({"Channel7": "c7", "LASI": ""}))
    found = full_body_markers(recording, single, path)
    assert found.vertices[found.labels.index("Channel7")] == landmark("c7")
    assert "LASI" not in found.labels
    assert found.unknown == ("LASI",)
    assert len(found.labels) == len(names) - 1


def test_unnamed_markers_are_refused_with_the_file_to_write(
    markers: MarkerRecording, single: BodyModel
) -> None:
    names = tuple(f"Channel{k}" for k in range(len(markers.marker_names)))
    unnamed = dataclasses.replace(markers, marker_names=names)
    with pytest.raises(
        ValueError, match=r'names\.json that says where markers sit, \{"Channel0": "LANDMARK"'
    ):
        full_body_markers(unnamed, single)


def test_markers_are_seen_where_they_sit_on_the_body(
    markers: MarkerRecording, single: BodyModel
) -> None:
    """As an observation they lay on the landmarks of their names, centimetres from the skin."""
    wide = markers.positions.copy()
    elbow = markers.marker_names.index("LELB")
    towards = wide[:, elbow] - wide[:, markers.marker_names.index("LWRA")]
    wide[:, elbow] += 0.04 * towards / np.linalg.norm(towards, axis=-1)[:, None]
    seen, _ = seen_markers(dataclasses.replace(markers, positions=wide), single)
    assert isinstance(seen, Markers3D)
    assert seen.start_time == 2.0
    assert seen.ground_known
    assert seen.labels == markers.marker_names
    assert seen.point_names(single) == markers.marker_names
    assert seen.offsets is not None
    offset = np.array(seen.offsets)[elbow]
    assert 0.015 < np.linalg.norm(offset) < 0.07
    assert seen.std is not None
    assert float(seen.std[seen.visible].min()) >= 0.0099
    upper, decisions = seen_markers(markers.select(UPPER_MARKERS), single)
    assert not upper.ground_known
    assert any(said.startswith("no marker on left thigh or knee") for said in decisions)


def test_offsets_turn_with_their_bones(walk: Motion, single: BodyModel) -> None:
    """The energy of points at known offsets is zero at the truth, by both ways to compute it."""
    generator = torch.Generator().manual_seed(0)
    vertices = tuple(landmark(name) for name in ("left_elbow_lateral", "right_toe2_base", "c7"))
    offsets = 0.05 * torch.randn(3, 3, generator=generator)
    posed = single.pose(walk[None])
    bones = single.weights[list(vertices)].argmax(-1)
    turns = posed.orientations[..., bones, :, :]
    places = posed.points(torch.tensor(vertices)) + (turns @ offsets[..., None])[..., 0]
    seen = Markers3D(
        places, torch.ones(places.shape[:-1], dtype=torch.bool), vertices, walk.fps,
        start_time=walk.start_time, offsets=offsets,
    )  # fmt: skip
    estimate = Estimate.of_clip(walk, single)
    assert float(seen(estimate)) < 1e-9
    carried = seen.on_bones(single, walk.shape)
    again = carried.positions(posed.orientations[0], posed.joints[0])
    torch.testing.assert_close(again, places[0], atol=1e-5, rtol=0)
    assert float(seen.replace(offsets=None)(estimate)) > 1e-3


def test_offsets_that_are_none_are_refused() -> None:
    points, visible = torch.zeros(1, 2, 1, 3), torch.ones(1, 2, 1, dtype=torch.bool)
    with pytest.raises(ValueError, match=r"shape \(1, 3\); got the shape \(2, 3\)"):
        Markers3D(points, visible, [5], 30.0, offsets=np.zeros((2, 3)))
    with pytest.raises(ValueError, match="divide millimetres by 1000"):
        Markers3D(points, visible, [5], 30.0, offsets=[[9.0, 0.0, 0.0]])


def test_a_marker_seen_where_others_are_not_gets_its_offset(
    markers: MarkerRecording, single: BodyModel
) -> None:
    """Offsets were found from the frames that show most markers, in which some had none."""
    visible, positions = markers.visible.copy(), markers.positions.copy()
    neck = markers.marker_names.index("C7")
    positions[:, neck, 2] += 0.04
    visible[:18, neck] = False
    for marker in range(6):
        visible[18:, (neck + 3 * marker + 1) % len(markers.marker_names)] = False
    spoiled = dataclasses.replace(markers, visible=visible, positions=positions)
    chosen = full_body_markers(spoiled, single)
    fit = fit_markers(spoiled.select(chosen.labels), chosen, single)
    row = chosen.labels.index("C7")
    assert float((fit.offsets[row] - chosen.nominal[row]).norm()) > 0.01

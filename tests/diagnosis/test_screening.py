"""Mistakes in points of space are found, named and put right before the fit."""

from typing import NamedTuple

import numpy as np
import pytest
import torch

from observations.joints3d import Joints3D
from observations.points import TrackedPoints as Points
from recon.core import rotations as so3
from recon.core.motion import Motion
from recon.core.skeleton import JOINTS
from recon.diagnosis import quick_fit as quick
from recon.diagnosis.checks import BEFORE
from recon.diagnosis.examination import checked
from recon.diagnosis.findings import Findings
from recon.diagnosis.misplaced import exchanged_pairs
from recon.diagnosis.movement import in_belt_frame, motion_in_room
from recon.diagnosis.named_points import NamedPoints, PredictedPoints
from recon.diagnosis.points import screen_points
from recon.method.protocols import Estimate
from recon.simulation.points import Corruption, joints3d, markers3d
from tests.diagnosis.test_views import checked_clip
from tests.filmed import bundled, cameras, view, walk


class Screened(NamedTuple):
    points: Points
    said: Findings
    belt: torch.Tensor | None
    start: Motion | None


def seen(noise: float = 0.015) -> Joints3D:
    return joints3d(walk(), bundled(), Corruption(noise=noise), 0).map(lambda t: t[None])


def changed(change) -> Screened:
    """The clean clip's points after a change of their positions, screened."""
    clip = seen()
    positions = clip.positions.clone()
    return screened(clip.replace(positions=change(positions)))


def screened(points: Points) -> Screened:
    return Screened(*screen_points(points, bundled()))


def codes(found: Screened) -> tuple[list[str], list[str]]:
    return [f.code for f in found.said.repairs], [f.code for f in found.said.warnings]


def index(name: str) -> int:
    return NamedPoints.of(seen(), bundled()).names.index(name)


def counterparts() -> list[int]:
    return list(NamedPoints.of(seen(), bundled()).counterparts)


def test_good_points_are_left_alone_bit_for_bit():
    for clip in (seen(), markers3d(walk(), bundled(), Corruption(noise=0.01), 0).map(_batched)):
        found = screened(clip)
        assert codes(found) == ([], [])
        assert torch.equal(found.points.positions, clip.positions)
        assert torch.equal(found.points.visible, clip.visible)


def _batched(tensor):
    return tensor[None]


def test_every_joint_and_landmark_has_its_mirror_image():
    assert counterparts() == [0, 2, 1, 3, 5, 4, 6, 8, 7, 9, 11, 10, 12, 14, 13, 15, 17, 16,
                              19, 18, 21, 20]  # fmt: skip
    markers = markers3d(walk(), bundled(), Corruption(), 0).map(_batched)
    points = NamedPoints.of(markers, bundled())
    for name, other in zip(points.names, points.counterparts, strict=True):
        assert points.names[other] == name.replace("left", "|").replace("right", "left").replace(
            "|", "right"
        )


def test_sides_exchanged_in_a_stretch_are_exchanged_back():
    """A third of a clip with left and right exchanged was fitted 6.8 cm off without a word."""

    def change(positions):
        positions[:, 8:16] = positions[:, 8:16][:, :, counterparts()]
        return positions

    found = changed(change)
    assert codes(found) == (["sides exchanged"], [])
    assert found.said.repairs[0].frames == ((8, 15),)
    assert torch.equal(found.points.positions, seen().positions)


def test_sides_exchanged_throughout_are_told_by_the_body():
    found = changed(lambda positions: positions[:, :, counterparts()])
    assert codes(found) == (["sides exchanged"], ["sides exchanged"])
    assert torch.equal(found.points.positions, seen().positions)


def test_zeros_marked_as_visible_are_not_seen():
    """20 % of missing points written as visible zeros moved the fit by 43 cm."""
    chosen = torch.rand(seen().visible.shape, generator=torch.Generator().manual_seed(0)) < 0.2

    found = changed(lambda positions: positions.masked_fill(chosen[..., None], 0.0))
    assert codes(found) == (["zeros"], [])
    assert not found.points.visible[chosen].any()
    assert found.points.visible[~chosen].all()


def test_the_root_of_root_relative_points_is_no_zero():
    found = changed(lambda positions: positions - positions[:, :, :1])
    assert "zeros" not in codes(found)[0]


def test_a_held_point_is_not_seen_while_it_is_held():
    def change(positions):
        positions[:, 10:, index("left_wrist")] = positions[:, 9, None, index("left_wrist")]
        return positions

    found = changed(change)
    assert codes(found) == (["constant point"], [])
    assert found.said.repairs[0].joints == ("left_wrist",)
    assert found.points.visible[0, :, index("left_wrist")].tolist() == [True] * 10 + [False] * 14


def test_a_value_that_is_held_while_nobody_moves_is_no_fault():
    """Somebody who stands still moves by less than the last digit of some files."""
    clip = seen()
    still = clip.positions[:, :1].expand_as(clip.positions).clone()
    still += 1.5e-4 * torch.rand(still.shape, generator=torch.Generator().manual_seed(0))
    wrist = index("left_wrist")
    still[:, 6:10, wrist] = still[:, 6:7, wrist]
    found = screened(clip.replace(positions=still))
    assert "constant point" not in codes(found)[0]


def test_repeated_frames_are_not_seen():
    def change(positions):
        positions[:, 1::2] = positions[:, 0::2]
        return positions

    found = changed(change)
    assert codes(found)[0] == ["repeated frames"]
    assert found.points.visible[0].all(-1).tolist() == [True, False] * 12


def test_a_point_away_from_its_place_is_left_out():
    """A head half a metre too high made the person 2.10 m tall; cameras were blamed."""

    def change(positions):
        positions[:, :, index("head"), 2] += 0.5
        return positions

    found = changed(change)
    assert codes(found) == (["offset point"], ["offset point"])
    assert found.said.repairs[0].joints == ("head",)


def test_a_bone_that_no_person_has_ends_at_a_misplaced_joint():
    """The quick fit's neck reached for a head that was put 10 cm too high."""

    def change(positions):
        positions[:, :, index("head"), 2] += 0.1
        return positions

    found = changed(change)
    assert codes(found) == (["offset point"], ["offset point"])
    assert found.said.repairs[0].joints == ("head",)


def test_a_marker_of_one_side_alone_is_misplaced():
    """Markers may be 15 cm away from their landmark where both sides are, and a knee was."""
    clip = markers3d(walk(), bundled(), Corruption(noise=0.01), 0).map(_batched)
    knee = NamedPoints.of(clip, bundled()).names.index("right_knee_lateral")
    positions = clip.positions.clone()
    positions[:, :, knee, 2] += 0.1
    found = screened(clip.replace(positions=positions))
    assert codes(found) == (["offset point"], ["offset point"])
    assert found.said.repairs[0].joints == ("right_knee_lateral",)


def test_exchanged_ankles_are_exchanged_back():
    pair = [index("left_ankle"), index("right_ankle")]

    def change(positions):
        positions[:, :, pair] = positions[:, :, pair[::-1]]
        return positions

    found = changed(change)
    assert codes(found) == (["points exchanged"], [])
    assert torch.equal(found.points.positions, seen().positions)


@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize("first", [10, 40])
def test_a_wrist_and_its_elbow_exchanged_for_a_moment_are_exchanged_back(side, first):
    """Quick fits of few frames a second turned the arm about, and left its joints 3 cm off."""
    clip = joints3d(walk(60), bundled(), Corruption(noise=0.02), 0).map(lambda t: t[None])
    pair = [JOINTS.index(f"{side}_{name}") for name in ("wrist", "elbow")]
    positions = clip.positions.clone()
    positions[0, first : first + 6, pair] = positions[0, first : first + 6, pair[::-1]]
    found = screened(clip.replace(positions=positions))
    assert codes(found) == (["points exchanged"], [])
    assert torch.equal(found.points.positions, clip.positions)


@pytest.mark.numerics
@pytest.mark.parametrize("parts", [("hip", "knee"), ("shoulder", "elbow"), ("ankle", "foot")])
def test_a_part_of_both_limbs_with_exchanged_names_is_exchanged_back(parts):
    """Hips and knees of the other sides above right ankles cost 4 cm without a word.

    Thighs have their length then, and only shins are too long.
    """
    pairs = [(index(f"left_{part}"), index(f"right_{part}")) for part in parts]
    order = list(range(22))
    for a, b in pairs:
        order[a], order[b] = b, a
    clip = seen(0.005)
    found = screened(clip.replace(positions=clip.positions[:, :, order]))
    torch.testing.assert_close(found.points.positions, clip.positions)
    assert set(codes(found)[0]) == {"points exchanged"}
    assert codes(found)[1] == []


@pytest.mark.numerics
@pytest.mark.parametrize("frame", [0, -1])
def test_an_outlier_in_the_first_or_last_frame_is_left_out(frame):
    """It was kept, and a person of 19 m was fitted."""
    clip = seen(0.005)
    positions, wrist = clip.positions.clone(), index("left_wrist")
    positions[:, frame, wrist, 2] = -2000.0
    found = screened(clip.replace(positions=positions))
    assert not found.points.visible[0, frame, wrist]
    assert found.points.visible.sum() == clip.visible.sum() - 1


@pytest.mark.numerics
def test_outliers_are_left_out_and_the_rest_counts_robustly():
    generator = torch.Generator().manual_seed(0)
    wild = torch.rand(seen().visible.shape, generator=generator) < 0.25
    noise = torch.randn(seen().positions.shape, generator=generator) + 1

    found = changed(lambda positions: positions + noise * wild[..., None])
    assert codes(found) == (["outliers"], [])
    assert (found.points.visible & wild).float().mean() < 0.03
    assert found.points.kernel is not seen().kernel


def test_a_floor_at_another_height_is_estimated():
    for height in (0.1, -0.1):
        found = changed(lambda positions, h=height: positions + torch.tensor([0.0, 0.0, h]))
        assert codes(found) == (["floor"], ["floor"])
        assert found.said.repairs[0].value == pytest.approx(height, abs=0.03)
        assert "where z is not up (--up)" in found.said.repairs[0].message
        assert not found.points.ground_known


def test_frames_out_of_order_are_said():
    clip = joints3d(walk(60), bundled(), Corruption(noise=0.015), 0).map(_batched)
    order = torch.randperm(60, generator=torch.Generator().manual_seed(1))
    shuffled = clip.replace(positions=clip.positions[:, order])
    assert codes(screened(shuffled)) == ([], ["frame order"])


def test_short_blocks_out_of_order_are_said():
    """Frames in random order within blocks of four were fitted without a word."""
    clip = joints3d(walk(60), bundled(), Corruption(noise=0.01), 0).map(_batched)
    blocks = np.arange(60).reshape(15, 4)
    order = np.random.default_rng(0).permuted(blocks, axis=1).ravel()
    shuffled = clip.replace(positions=clip.positions[:, order])
    assert codes(screened(shuffled)) == ([], ["frame order"])


def test_a_jump_to_somebody_else_is_said():
    def change(positions):
        positions[:, 12:] += torch.tensor([0.6, 0.0, 0.0])
        return positions

    found = changed(change)
    assert codes(found) == ([], ["identity change"])
    assert found.said.warnings[0].frames == ((12, 12),)


def test_giants_are_said():
    assert "scale" in codes(changed(lambda positions: positions * 1.4))[1]


def test_a_treadmill_is_left_and_entered_again():
    belt = torch.tensor([-1.0, 0.2])
    clip = seen()
    away = in_belt_frame(clip, belt)
    back = in_belt_frame(away, -belt)
    assert torch.allclose(back.positions, clip.positions, atol=1e-5)
    motion = walk()
    moved = motion_in_room(motion, belt)
    drift = (moved.translation - motion.translation)[-1] - (
        moved.translation - motion.translation
    )[0]
    seconds = (motion.frames - 1) / motion.fps
    assert np.allclose(drift[:2].numpy(), seconds * belt.numpy(), atol=1e-5)


def test_a_walk_on_a_treadmill_is_told():
    motion = walk(60)
    step = motion.translation[-1] - motion.translation[0]
    belt = -step[:2] / ((motion.frames - 1) / motion.fps)
    clip = joints3d(motion, bundled(), Corruption(noise=0.005), 0).map(_batched)
    on_belt = in_belt_frame(clip, -belt)
    found = checked(checked_clip(on_belt), BEFORE)
    assert [finding.code for finding in found.repairs] == ["treadmill"]
    assert torch.allclose(found.belt, belt, atol=0.15)
    moved = in_belt_frame(on_belt, found.belt)
    assert torch.equal(found.observations[0].positions, moved.positions)
    # a camera that stays in the room
    beside = checked(checked_clip(on_belt, view(motion, cameras(motion)[0])), BEFORE)
    assert beside.belt is None
    assert [finding.code for finding in beside.warnings] == ["treadmill"]


def test_a_pair_that_jumps_to_each_other_and_back_is_told_by_its_paths():
    """A quick fit crosses its legs to reach exchanged ankles, so that they seem to be in place."""
    clip = seen()
    pair = [index("left_wrist"), index("right_wrist")]
    positions = clip.positions.clone()
    positions[:, 8:12, pair] = positions[:, 8:12, pair[::-1]]
    (found,) = exchanged_pairs(NamedPoints.of(clip.replace(positions=positions), bundled()))
    assert found[0] == tuple(pair)
    assert np.flatnonzero(found[1]).tolist() == [8, 9, 10, 11]
    assert exchanged_pairs(NamedPoints.of(clip, bundled())) == []


def test_a_limb_that_the_quick_fit_lost_reaches_for_its_points_before_they_are_blamed():
    """Hands of a handspring and a head that looked round were said to be out of place."""
    points, body = seen(), bundled()
    truth = walk()
    turned = truth.rotations.clone()
    turned[..., JOINTS.index("left_shoulder"), :, :] @= so3.exp(torch.tensor([0.0, 2.0, 0.0]))
    lost = Estimate.of_clip(truth.replace(rotations=turned), body)
    found = quick.with_second_start(quick.QuickFit(points, lost, cost=1.0), body)
    wrist = index("left_wrist")
    before, after = (
        PredictedPoints.of(NamedPoints.of(points, body), points, estimate).typical[wrist]
        for estimate in (lost, found.estimate)
    )
    assert before > 0.3
    assert after < 0.04

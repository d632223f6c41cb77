"""Steps that no marker makes: found, solved again, and spread where they remain."""

import torch

from recon.body.landmarks import landmark
from recon.body.model import BodyModel
from recon.core import rotations as so3
from recon.core.motion import Motion
from recon.core.skeleton import joint_index
from recon.ingest.marker_frames import (
    jump_findings,
    unsupported_steps,
    with_doubtful_frames_solved,
    with_jumps_spread,
)
from recon.ingest.marker_sets import STANDOFF
from recon.mocap.recording import MarkerRecording
from tests.ingest.test_markers import codes
from tests.ingest.walker import MARKERS


def test_a_body_that_leaves_its_markers_is_solved_again(
    markers: MarkerRecording, walk: Motion, single: BodyModel
) -> None:
    """A foot flipped over for six frames while its markers went on; `n_glitch` said 0."""
    wrong = walk.rotations.clone()
    ankle = joint_index("left_ankle")
    wrong[10:16, ankle] = wrong[10:16, ankle] @ torch.diag(torch.tensor([1.0, -1.0, -1.0]))
    positions = torch.from_numpy(markers.positions).float()
    visible = torch.from_numpy(markers.visible)
    vertices = [landmark(name) for name in MARKERS.values()]
    bones = tuple(single.weights[vertices].argmax(-1).tolist())

    def unsupported(motion: Motion) -> torch.Tensor:
        return unsupported_steps(single.pose(motion).joints, positions, visible, bones)

    def residuals(motion: Motion) -> torch.Tensor:
        away = single.pose(motion).points(torch.tensor(vertices)) - positions
        return (away.norm(dim=-1) - STANDOFF).abs()

    asked: list[int] = []

    def solve(frames: torch.Tensor, start: Motion) -> Motion:
        asked.extend(frames.tolist())
        # what the frames are solved from is already near the truth
        assert (start.rotations - walk.rotations).square().sum((-1, -2)).max() < 0.5
        return walk

    jumped = unsupported(walk.replace(rotations=wrong))
    assert jumped.any(-1).nonzero()[:, 0].tolist() == [9, 15]
    assert jumped.any(0).nonzero()[:, 0].tolist() == [joint_index("left_foot")]
    found, changed = with_doubtful_frames_solved(
        walk.replace(rotations=wrong), unsupported, residuals, solve
    )
    assert set(range(10, 16)) <= set(asked)
    assert changed[10:16].all()
    torch.testing.assert_close(found.rotations, walk.rotations)
    repairs, warnings = jump_findings(unsupported(found), changed)
    assert (codes(tuple(repairs)), warnings) == (["jump"], [])
    _, warnings = jump_findings(jumped, torch.zeros(walk.frames, dtype=torch.bool))
    assert (warnings[0].frames, warnings[0].value) == (((10, 10), (16, 16)), 2.0)
    assert warnings[0].joints == ("left_foot",)


def test_a_solution_that_is_worse_is_not_taken(walk: Motion) -> None:
    jumps = torch.zeros(walk.frames - 1, 22, dtype=torch.bool)
    jumps[9, 3] = True
    far = torch.zeros(walk.frames, 4)
    found, changed = with_doubtful_frames_solved(
        walk,
        lambda _: jumps,
        lambda motion: far if motion is walk else far + 0.05,
        lambda *_: walk.replace(translation=walk.translation + 0.05),
    )
    assert not changed.any()
    assert found is walk


def test_what_did_not_become_better_is_not_solved_twice(walk: Motion) -> None:
    """A good part of a conversion with exchanged markers went into the same solution again."""
    jumps = torch.zeros(walk.frames - 1, 22, dtype=torch.bool)
    jumps[22, 3] = True
    first = jumps.clone()
    first[5, 3] = True
    far = torch.zeros(walk.frames, 4)
    asked: list[list[int]] = []

    def solve(frames: torch.Tensor, start: Motion) -> Motion:
        asked.append(frames.tolist())
        return start.replace(translation=start.translation + 0.01)

    _, changed = with_doubtful_frames_solved(
        walk, lambda m: first if m is walk else jumps, lambda _: far, solve
    )
    assert asked == [[*range(3, 9), *range(20, 26)]]
    assert changed.nonzero()[:, 0].tolist() == list(range(3, 9))


def test_a_step_that_remains_is_spread(walk: Motion, single: BodyModel) -> None:
    """A foot turned within one frame where its markers changed places; no other pose fitted."""
    flipped = walk.rotations.clone()
    ankle = joint_index("left_ankle")
    flipped[15:, ankle] = flipped[15:, ankle] @ so3.exp(torch.tensor([1.0, 0.0, 0.0]))
    wrong = walk.replace(rotations=flipped)
    positions = single.pose(walk).joints
    visible = torch.ones(positions.shape[:2], dtype=torch.bool)

    def unsupported(motion: Motion) -> torch.Tensor:
        return unsupported_steps(single.pose(motion).joints, positions, visible, tuple(range(22)))

    asked: list[tuple[list[int], torch.Tensor]] = []

    def solve(frames: torch.Tensor, start: Motion, turning: torch.Tensor) -> Motion:
        asked.append((frames.tolist(), turning))
        return start if len(asked) == 2 else wrong

    assert unsupported(wrong).any(-1).nonzero()[:, 0].tolist() == [14]
    found, changed = with_jumps_spread(wrong, unsupported, solve)
    around = list(range(12, 18))
    assert changed.nonzero()[:, 0].tolist() == around
    assert not unsupported(found).any()
    assert [frames for frames, _ in asked] == [around, around]
    stiff = [turning > 1 for _, turning in asked]
    assert stiff[0].nonzero()[:, 0].tolist() == [joint_index("left_knee"), ankle]
    assert asked[1][1][ankle] > asked[0][1][ankle]
    # with nothing unmade nothing is asked
    same, none = with_jumps_spread(walk, unsupported, solve)
    assert same is walk
    assert not none.any()

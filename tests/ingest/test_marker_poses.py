"""The second-order fit of markers: its energies, derivatives and optima, beside L-BFGS."""

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from observations.markers3d import Markers3D
from recon.body.landmarks import landmark
from recon.body.model import BodyModel
from recon.body.soles import Soles
from recon.core import rotations as so3
from recon.core.motion import Motion
from recon.core.residuals import geman_mcclure
from recon.core.scene import Scene
from recon.ingest.marker_calibration import CalibratedFrames, SubjectEnergies
from recon.ingest.marker_fit import (
    GROUND_WEIGHT,
    OUTLIER,
    REST_WEIGHT,
    TURNING_WEIGHT,
    fit_markers,
)
from recon.ingest.marker_poses import PoseEnergies, Poses, SkinPoints, natural_pose
from recon.ingest.marker_sets import full_body_markers, nominal_offsets
from recon.ingest.tied_frames import LevenbergMarquardt, minimise_frames
from recon.method.free import FreeMotion
from recon.method.protocols import REFERENCE_FPS, Decoded, Estimate
from recon.method.running import run_stages
from recon.method.stages import Stage
from recon.method.terms import Term
from recon.mocap.reader import read_recording
from recon.mocap.recording import MarkerRecording
from recon.solver.lbfgs import LBFGS
from tests.ingest.walker import MARKERS

STEP = 1e-6
FRAMES = 4


def random(*shape: int) -> Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(7), dtype=torch.float64)


def natural(estimate: Estimate) -> Tensor:
    """Σ (1 - cos angle) of the body joints away from the natural pose, at 30 Hz."""
    away = estimate.motion.rotations[..., 1:, :, :] - natural_pose().to(estimate.motion.rotations)
    return away.square().sum((-1, -2, -3)).sum(-1) / 4 * (REFERENCE_FPS / estimate.motion.fps)


def above_ground(points: Tensor, estimate: Estimate) -> Tensor:
    """½ Σ min(z, 0)², the mean over the vertices, at 30 Hz."""
    depth = estimate.body.points(points)[..., 2].clamp(max=0.0).square().mean(-1)
    return 0.5 * depth.sum(-1) * (REFERENCE_FPS / estimate.motion.fps)


def turning(estimate: Estimate) -> Tensor:
    """Σ (1 - cos angle) = ¼ |R_t - R_(t-1)|² of every joint's turn between frames, at 30 Hz."""
    turned = estimate.motion.rotations.diff(dim=-4).square().sum((-1, -2, -3)) / 4
    return turned.sum(-1) * (estimate.motion.fps / REFERENCE_FPS)


def terms_of(seen: Markers3D, soles: Tensor) -> tuple[Term, ...]:
    """The objective as energies of an estimate, for L-BFGS."""
    return (
        Term("markers", seen, 1.0),
        Term("natural", natural, REST_WEIGHT),
        Term("ground", partial(above_ground, soles), GROUND_WEIGHT),
        Term("turning", turning, TURNING_WEIGHT),
    )


def on(body: BodyModel, vertices: Tensor, motion: Motion, noise: float) -> Markers3D:
    points = body.pose(motion).points(vertices)
    points = points + noise * random(*points.shape).to(points)
    visible = random(*points.shape[:2]) > -1
    return Markers3D(
        points.where(visible[..., None], 0.0)[None], visible[None], tuple(vertices.tolist()),
        motion.fps, kernel=partial(geman_mcclure, sigma=OUTLIER), offset_rows=(0, len(vertices)),
    )  # fmt: skip


def energies_of(
    seen: Markers3D, offsets: Tensor, shape: Tensor, soles: Tensor, body: BodyModel
) -> PoseEnergies:
    rate = REFERENCE_FPS / seen.fps
    vertices = torch.tensor(seen.vertices)
    return PoseEnergies(
        rest=body.rest_joints(shape),
        markers=SkinPoints.of(body, shape, vertices, offsets),
        soles=SkinPoints.of(body, shape, soles),
        positions=seen.positions[0].mT,
        visible=seen.visible[0].to(shape),
        linked=torch.ones(seen.moments - 1, dtype=torch.bool),
        natural=natural_pose().to(shape)[None],
        pull=shape.new_full((1,), REST_WEIGHT),
        ground=GROUND_WEIGHT,
        turning=torch.full((22,), TURNING_WEIGHT / rate).to(shape),
        weight=rate,
        sigma=OUTLIER,
    )


def total(energies: PoseEnergies, poses: Poses) -> Tensor:
    value, _ = energies.energies_and_gradients(poses, torch.arange(len(poses.translation)))
    return value.sum() + energies.tie_energies(poses)[0].sum()


def crouching(body: BodyModel, vertices: Tensor) -> tuple[Motion, Markers3D]:
    """Random poses with feet below the ground, and markers on them."""
    rotations = so3.exp(0.3 * random(FRAMES, 22, 3)).to(body.template)
    low = body.template.new_tensor([0.0, 0.0, 0.1]).expand(FRAMES, 3)
    shape = random(body.shape_size).to(body.template)
    motion = Motion.create(low, rotations, shape, 120.0)
    return motion, on(body, vertices, motion, 0.05)


@pytest.fixture(params=["bundled", "with correctives"])
def anybody(request: pytest.FixtureRequest, body: BodyModel, toy_body: BodyModel) -> BodyModel:
    if request.param == "bundled":
        return body
    columns = 0.02 * random(189, 3 * len(toy_body.template))
    return toy_body.replace(pose_directions=columns.unflatten(1, (-1, 3)))


def some_vertices(body: BodyModel) -> Tensor:
    return torch.arange(0, len(body.template), len(body.template) // 12)


def test_energies_are_those_of_the_terms(anybody: BodyModel) -> None:
    """One objective, so that fits can be compared at equal values."""
    vertices, soles = some_vertices(anybody), torch.arange(5)
    motion, seen = crouching(anybody, vertices)
    offsets = 0.02 * random(len(vertices), 3)
    energies = energies_of(seen, offsets, motion.shape, soles, anybody)
    batch = motion.map(lambda tensor: tensor[None])
    estimate = Estimate(Decoded(batch), anybody.pose(batch), Scene(offsets[None]))
    expected = sum(term.weight * term.energy(estimate) for term in terms_of(seen, soles))
    found = total(energies, energies.poses_of(motion.translation, motion.rotations))
    torch.testing.assert_close(found, expected[0])  # pyright: ignore[reportIndexIssue]


def test_gradients(anybody: BodyModel) -> None:
    motion, seen = crouching(anybody, vertices := some_vertices(anybody))
    energies = energies_of(
        seen, 0.02 * random(len(vertices), 3), motion.shape, torch.arange(5), anybody
    )
    energies = replace(energies, linked=torch.tensor([True, False, True]))
    poses, rows = energies.poses_of(motion.translation, motion.rotations), torch.arange(FRAMES)
    gradient = energies.energies_and_gradients(poses, rows)[1] + energies.tie_energies(poses)[1]
    for k in range(gradient.shape[1]):
        step = torch.zeros_like(gradient)
        for frame in (k % 2, 2 + k % 2):
            step.zero_()[frame, k] = STEP
            ends = [total(energies, energies.moved(poses, rows, s * step)) for s in (1, -1)]
            difference = (ends[0] - ends[1]) / (2 * STEP)
            torch.testing.assert_close(gradient[frame, k], difference, atol=1e-7, rtol=0)


def test_equations_of_the_subject(body: BodyModel) -> None:
    """The gradient by poses, shape and offsets, and a step that solves a least squares problem."""
    motion, seen = crouching(body, vertices := some_vertices(body))
    soles, offsets = torch.arange(0, 60, 12), 0.02 * random(len(vertices), 3)
    poses = energies_of(seen, offsets, motion.shape, soles, body).untied()
    energies = SubjectEnergies(
        body, vertices, soles, nominal_offsets(body, vertices.tolist()),
        random(len(vertices)).square(), 0.1, replace(poses, weight=1.0), with_offsets=True,
    )  # fmt: skip
    state = CalibratedFrames(
        energies.for_body(motion.shape, offsets).poses_of(motion.translation, motion.rotations),
        motion.shape, offsets,
    )  # fmt: skip
    rows = torch.arange(1)
    gradient = energies.model(state, rows).gradient[0]

    def value(k: int, sign: float) -> Tensor:
        steps = torch.zeros_like(gradient).index_fill(0, torch.tensor(k), sign * STEP)
        return energies.value(energies.moved(state, rows, steps[None]), rows)[0, 0]

    border = len(gradient) - 69 * FRAMES
    for k in range(len(gradient) - border - 69, len(gradient)):
        difference = (value(k, 1) - value(k, -1)) / (2 * STEP)
        torch.testing.assert_close(gradient[k], difference, atol=1e-6, rtol=0)
    (hessian,) = energies.model(state, rows).hessian
    assert hessian.border.shape == (FRAMES, 69, border)
    frames = energies.frames(torch.tensor([0, 2]))
    (hessian,) = frames.model(replace(state, poses=state.poses[[0, 2]]), rows).hessian
    assert hessian.inner.shape[0] == 2


def test_frames_that_are_apart_are_not_tied(body: BodyModel) -> None:
    """Frames on either side of a gap were drawn to each other as if it were not there."""
    motion, seen = crouching(body, vertices := some_vertices(body))
    energies = energies_of(
        seen, 0.0 * random(len(vertices), 3), motion.shape, torch.arange(5), body
    )
    assert energies.frames(torch.tensor([0, 1, 3])).linked.tolist() == [True, False]
    broken = replace(energies, linked=torch.tensor([False, True, True]))
    assert broken.frames(torch.tensor([0, 1, 2])).linked.tolist() == [False, True]
    assert broken.frames(torch.tensor([1, 3])).linked.tolist() == [False]


@pytest.fixture(scope="module")
def walker() -> tuple[BodyModel, Markers3D, Tensor, Motion]:
    """Noisy markers on a walk, one of them far off, and the poses that they were made from."""
    from importlib import resources

    from recon.formats.motions import load_motion

    body = BodyModel.load()
    walk = load_motion(Path(str(resources.files("recon") / "assets" / "demo.npz"))).motion
    motion = walk.window(0, 12)
    vertices = torch.tensor([landmark(name) for name in MARKERS.values()])
    seen = on(body, vertices, motion, 0.01)
    positions = seen.positions.clone()
    positions[:, 3:6, 4] += 0.3
    return body, seen.replace(positions=positions), vertices, motion


@pytest.mark.numerics
def test_the_optimum_is_that_of_lbfgs(walker: tuple[BodyModel, Markers3D, Tensor, Motion]) -> None:
    body, seen, vertices, motion = walker
    soles, offsets = Soles.of(body).points.flatten(), torch.zeros(len(vertices), 3)
    turn = so3.exp(0.05 * random(12, 22, 3).float())
    start = motion.replace(rotations=motion.rotations @ turn)
    stage = Stage(
        "frames", FreeMotion(), terms_of(seen, soles), frozenset({"translation", "root", "pose"}),
        LBFGS(max_iterations=250, tolerance_decrease=1e-7),
    )  # fmt: skip
    batch = start.map(lambda tensor: tensor[None])
    estimate, _ = run_stages((stage,), body, batch, Scene(offsets[None]))
    energies = energies_of(seen, offsets, motion.shape, soles, body)
    settings = LevenbergMarquardt(tolerance=1e-6)
    found = minimise_frames(
        energies, energies.poses_of(start.translation, start.rotations), settings
    )
    assert found.converged.all()
    assert found.iterations < 30
    theirs = energies.poses_of(estimate.motion.translation[0], estimate.motion.rotations[0])
    assert found.total < float(total(energies, theirs)) * (1 + 1e-4)
    away = (found.state.bones - theirs.bones).unflatten(-1, (-1, 4))[..., 3]
    assert away.norm(dim=1).mean() < 2e-3


@pytest.mark.numerics
def test_a_real_recording_is_met_as_lbfgs_met_it(data: Path) -> None:
    """L-BFGS left 6.2 mm of this walk; version 0.1.0 likewise."""
    recording = read_recording(data / "observations" / "cmu_c3d" / "06_01.c3d")
    assert isinstance(recording, MarkerRecording)
    body = BodyModel.load()
    markers = full_body_markers(recording, body)
    part = slice(0, 240, 2)
    some = replace(
        recording.select(markers.labels),
        positions=recording.select(markers.labels).positions[part],
        visible=recording.select(markers.labels).visible[part],
        fps=60.0,
    )
    fit = fit_markers(some, markers, body)
    away = np.linalg.norm(fit.predicted.numpy() - some.positions, axis=-1)[some.visible]
    assert away.mean() < 0.0062
    assert not fit.repaired.any()
    assert not fit.unsupported.any()

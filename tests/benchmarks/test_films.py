"""What is measured on films: clocks, sides, places of points, and what a rendered person shows."""

import numpy as np
import torch

from benchmarks.films.real import at_frames, exchanged_sides
from benchmarks.films.rendered import CAMERAS
from benchmarks.films.rendering import Actor, Set, render
from recon.body.model import BodyModel
from recon.core.camera import full_hd_camera
from tests.laws import a_motion

BODY = BodyModel.load()


def test_joints_are_taken_at_the_moments_of_a_late_clock() -> None:
    joints = torch.arange(6.0, dtype=torch.float64)[:, None, None].expand(6, 22, 3)
    found, kept = at_frames(joints, fps=30.0, started=2.0, frames=10, late=-1.0)
    assert kept.tolist() == [False] * 3 + [True] * 7
    assert torch.allclose(found[:, 0, 0], torch.arange(7.0, dtype=torch.float64) / 2)


def test_frames_with_left_for_right_are_counted() -> None:
    true = torch.randn(4, 22, 3, generator=torch.Generator().manual_seed(0))
    found = true.clone()
    found[0, [1, 4, 7, 10]], found[0, [2, 5, 8, 11]] = (
        true[0, [2, 5, 8, 11]],
        true[0, [1, 4, 7, 10]],
    )
    assert exchanged_sides(found, true) == 0.25


def test_a_rendered_person_stands_where_the_camera_projects_them() -> None:
    motion = a_motion(BODY, clips=1, frames=4).to(dtype=torch.float32)[0]
    posed = BODY.pose(motion)
    middle = posed.joints[0].mean(0)
    camera = full_hd_camera().placed(middle + torch.tensor([3.0, 0.0, 0.2]), middle)
    actor, scene = Actor.drawn(BODY, 0), Set.drawn(0, float(middle[:2].abs().max()) + 4)
    skin = actor.body.pose(motion).vertices[0].numpy()
    there, empty = (render(scene, camera, own, np.random.default_rng(0)).astype(int)
                    for own in ([(actor, skin)], []))  # fmt: skip
    changed = np.abs(there - empty).max(-1) > 5
    seen = camera.project(posed.joints[0]).pixels.long()
    assert changed[seen[:, 1], seen[:, 0]].all()
    assert changed.mean() < 0.5


def test_moving_cameras_go_where_they_say() -> None:
    path = torch.stack((torch.linspace(0, 3, 60), torch.zeros(60), torch.full((60,), 0.9)), -1)
    away = torch.tensor([0.0, 3.0, 0.5])
    moved = {kind: carrying(path, away, np.random.default_rng(0))[0].std(0).sum()
             for kind, carrying in CAMERAS.items()}  # fmt: skip
    assert moved["still"] == moved["pan"] == 0
    assert 0.02 < moved["hand"] < 0.3 < moved["alongside"]

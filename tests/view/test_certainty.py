"""Spheres of one standard deviation: as large as they say, and switched on and off."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from recon.body.model import BodyModel
from recon.core.motion import MotionFile
from recon.core.skeleton import joint_index
from recon.formats.motions import save_motion
from recon.view import Figure, Show
from recon.view.files import show_of_files, view
from recon.view.html import write_html
from recon.view.painter import paint
from recon.view.scene import CERTAINTY
from recon.view.viewpoint import viewpoints
from tests.view.test_view import embedded, walk

WRIST = joint_index("left_wrist")
FRAMES = 3


def unsure(body: BodyModel, radius: float = 0.15) -> Show:
    """A walk whose left wrist is known to so many metres and all other joints exactly."""
    std = torch.zeros(FRAMES, 22)
    std[:, WRIST] = radius
    figure = Figure(body, walk(body, FRAMES), joint_std=std)
    return Show("unsure", (figure,), certainty=True)


def test_a_sphere_of_one_standard_deviation_is_drawn_around_its_joint(body: BodyModel) -> None:
    show = unsure(body)
    (view,) = viewpoints(show, (300, 360))[:1]
    plain = paint(replace(show, certainty=False), 0, view).astype(int)
    changed = np.abs(paint(show, 0, view).astype(int) - plain).max(-1) > 1
    centre, depth = view.project(show.figures[0].posed.joints[0, [WRIST]].double().numpy())
    radius = 0.15 * view.focal / depth[0]  # pixels
    row, column = np.nonzero(changed)
    near = np.hypot(column - centre[0, 0], row - centre[0, 1]) < 2 * radius
    row, column = row[near], column[near]  # other joints have a dot
    assert len(row) == pytest.approx(np.pi * radius**2, rel=0.15)
    middle = np.array([column.mean(), row.mean()]) + 0.5
    assert np.abs(middle - centre[0]).max() < 0.15 * radius
    assert ("one standard deviation", CERTAINTY) in show.legend
    assert len(replace(show, certainty=False).legend) == len(show.legend) - 1


@pytest.mark.parametrize("asked", [False, True])
def test_a_page_has_the_spheres_as_a_layer(body: BodyModel, tmp_path, asked: bool) -> None:
    write_html(tmp_path / "page.html", replace(unsure(body), certainty=asked))
    messages = embedded((tmp_path / "page.html").read_text(encoding="utf-8"))["messages"]
    name = "/world/reconstruction/standard deviation"
    own = [message for _, message in messages if message.get("name") == name]
    assert own
    visible = [m["visible"] for m in own if m["type"] == "SetSceneNodeVisibilityMessage"]
    assert visible == [asked]


def test_files_are_drawn_with_what_they_know(body: BodyModel, tmp_path) -> None:
    motion = walk(body, FRAMES)
    save_motion(tmp_path / "sure.npz", MotionFile(motion, joint_std=torch.full((FRAMES, 22), 0.1)))
    save_motion(tmp_path / "bare.npz", motion)
    show = show_of_files(tmp_path / "sure.npz", certainty=True)
    assert show.figures[0].joint_std is not None
    beside = show_of_files(tmp_path / "sure.npz", side=tmp_path / "bare.npz")
    assert [figure.joint_std is None for figure in beside.figures] == [False, True]
    with pytest.raises(ValueError, match=r"bare\.npz: no standard deviations"):
        view(tmp_path / "bare.npz", html=tmp_path / "page.html", std=True)
    with pytest.raises(ValueError, match="--frame-rate is that of a film"):
        view(tmp_path / "bare.npz", html=tmp_path / "page.html", frame_rate=30.0)

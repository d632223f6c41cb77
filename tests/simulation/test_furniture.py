"""Furniture: closed meshes where they should stand, seen and left over by a depth sensor."""

import numpy as np
import pytest
import torch

from recon.core.camera import depth_camera
from recon.core.errors import ReconError
from recon.simulation.depth import PERFECT, PixelSurface, depth_image, depth_points
from recon.simulation.points import Corruption
from recon.simulation.scenery import box, chair, furniture_around, joined_meshes, table
from recon.simulation.sensors import refuse_other_options
from recon.simulation.settings import FILM_DEFAULTS, SurfaceSettings
from tests import laws


@pytest.mark.parametrize("mesh", [box((1.0, 2.0, 0.5)), chair(), table()])
def test_faces_look_outwards(mesh):
    """Volumes by the divergence theorem are positive where faces run counter-clockwise."""
    a, b, c = mesh.vertices[mesh.faces].swapaxes(0, 1)
    assert (a * np.cross(b, c)).sum() / 6 > 0.01
    edges = set(map(tuple, np.concatenate([mesh.faces[:, [k, (k + 1) % 3]] for k in range(3)])))
    assert all((j, i) in edges for i, j in edges)
    assert mesh.vertices[:, 2].min() == 0.0


def test_furniture_stands_where_it_is_said_to():
    middle = np.array([1.0, 2.0, 0.9])
    along_x = furniture_around(("chair",), middle, 0.0).vertices.mean(0)
    assert along_x[0] < 0.7
    assert along_x[1] == pytest.approx(2.0, abs=1e-9)
    assert furniture_around(("table",), middle, 0.0).vertices[:, 1].mean() > 2.5
    assert furniture_around(("box",), middle, 0.0).vertices[:, 1].mean() < 1.5
    assert furniture_around(("board",), middle, np.pi / 2).vertices[:, 1].mean() > 2.4


def test_a_board_hides_what_is_behind_it(body):
    """A sensor sees the board instead of the shins, and nothing of it is left unless asked for."""
    motion = laws.a_motion(body, clips=1, frames=1)[0]
    vertices = body.pose(motion).vertices[0]
    middle = vertices.median(0).values
    eye = middle + torch.tensor([3.0, 0.0, 0.0]).double()
    camera = depth_camera().to(dtype=torch.float64).placed(eye, middle)
    low = float(vertices[:, 2].min())
    # between sensor and body, as high as the middle of the body
    board = box((0.05, 4.0, 0.5 * (float(middle[2]) - low))).placed(
        (float(vertices[:, 0].max()) + 0.3, float(middle[1]), low)
    )
    faces = body.faces.numpy()
    free = depth_image(vertices, faces, camera, None)[1]
    depth, surface = depth_image(vertices, faces, camera, None, board)
    hidden = (free == PixelSurface.BODY) & (surface != PixelSurface.BODY)
    assert hidden.sum() > 200
    assert (surface[hidden] == PixelSurface.FURNITURE).all()
    front = float(eye[0]) - float(vertices[:, 0].max()) - 0.325
    assert depth[hidden].min() == pytest.approx(front, abs=0.02)

    def seen(*surfaces):
        return depth_points(
            motion, body, camera, Corruption(), 0,
            sensor=PERFECT, points=10**6, surfaces=surfaces, furniture=board,
        ).points  # fmt: skip

    assert len(seen(PixelSurface.BODY)) == (surface == PixelSurface.BODY).sum()
    both = seen(PixelSurface.BODY, PixelSurface.FURNITURE)
    assert len(both) == np.isin(surface, (PixelSurface.BODY, PixelSurface.FURNITURE)).sum()


def test_meshes_together_keep_their_faces():
    both = joined_meshes([chair(), table()])
    assert both.faces.max() == len(both.vertices) - 1
    assert len(joined_meshes([]).faces) == 0


@pytest.mark.parametrize(
    ("kind", "surface", "words"),
    [
        ("scans", SurfaceSettings(furniture=("chair",)), "are options for depth"),
        ("depth", SurfaceSettings(left_over=("furniture",)), "no furniture was given"),
    ],
)
def test_options_without_effect_are_refused(kind, surface, words):
    with pytest.raises(ReconError, match=words):
        refuse_other_options(kind, FILM_DEFAULTS, surface, Corruption())

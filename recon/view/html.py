"""One self-contained page that plays a show in any browser, offline (viser's player inside)."""

import contextlib
import html
import io
import logging
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, Shaped
from torch import Tensor
from viser import SceneApi, ViserServer

from recon.core import rotations as so3
from recon.core.skeleton import CONTACT_JOINTS
from recon.formats.opening import replacing
from recon.view.drawing.stage import Plane
from recon.view.layers import Spheres, camera_node, legend, node_of
from recon.view.scene import (
    CAMERA,
    CERTAINTY,
    CLOUD,
    CONTACT,
    GROUND,
    MISSING,
    VISIBLE,
    Colour,
    Figure,
    Points,
    Show,
)
from recon.view.viewpoint import Viewpoint, follow, viewpoints
from recon.view.views import View

logger = logging.getLogger(__name__)

Layer = Callable[[int], None]
"""Shows one frame of something."""

INFLUENCES = 4
"""Joints per vertex that a browser's skinning takes."""
CONTACT_RADIUS = 0.055
CLOUD_LIMIT = 1500
"""Points of a scan kept per frame: 90 frames stay below 2 MB."""
SEE_THROUGH = 0.62
"""Opacity of solid bodies while points or contacts, which lie inside, are shown."""
HALO_OPACITY = 0.35
"""Opacity of the spheres of standard deviations."""

DEEPEN = 0.82
"""Factor on colours: the player's lights brighten them by about its inverse."""


def write_html(path: str | Path, show: Show) -> None:
    """Write the page: play, pause and scrub a timeline, turn the view, toggle the layers.

    The page holds everything it needs and asks no server for anything. A body is stored once
    and skinned in the browser (its pose-dependent offsets, if it has any, are left out).

    Raises:
        FileNotFoundError: when the folder of `path` does not exist.
    """
    # viser greets on standard output whatever its verbosity.
    with replacing(Path(path)) as scratch, contextlib.redirect_stdout(io.StringIO()):
        server = ViserServer(host="127.0.0.1", verbose=False)
        try:
            page = _record(server, show)
        finally:
            server.stop()
        title = f"<title>{html.escape(show.title)}</title>"
        page = page.replace("<title>Viser</title>", title, 1)
        page = page.replace("</body>", legend(show, follows=_follows(show)) + "</body>", 1)
        scratch.write_text(page, encoding="utf-8")
    logger.info("wrote %s: %d frames, %.1f MB", path, show.frames, len(page) / 1e6)


def prune_weights(
    weights: Float[np.ndarray, "vertices joints"],
) -> Float[np.ndarray, "vertices joints"]:
    """The `INFLUENCES` largest weights of every vertex, scaled to sum to one again.

    Without the scaling a vertex with five influences would be drawn towards the origin.
    """
    kept = np.zeros_like(weights)
    largest = np.argsort(weights, axis=1)[:, -INFLUENCES:]
    np.put_along_axis(kept, largest, np.take_along_axis(weights, largest, 1), 1)
    return kept / kept.sum(1, keepdims=True)


def _record(server: ViserServer, show: Show) -> str:
    """Play the show once on a local server and keep every message it would send."""
    scene = server.scene
    scene.set_up_direction("+z")
    touching = any(bool(figure.touching.any()) for figure in show.figures)
    inside = SEE_THROUGH if touching or show.points is not None else 1.0
    layers = [_stage(server, show)]
    for figure in show.figures:
        layers.append(_body(scene, figure, figure.opacity * inside))
        if bool(figure.touching.any()):
            layers.append(_contacts(scene, figure))
        if figure.joint_std is not None:
            layers.append(_certainty(scene, figure, figure.joint_std, shown=show.certainty))
    if show.points is not None:
        layers += _points(scene, show.points)
    if show.cloud is not None:
        layers.append(_scan(scene, show.cloud))
    layers += [_frustum(scene, view) for view in show.cameras]
    serializer = server.get_scene_serializer()
    for frame in range(show.frames):
        for layer in layers:
            layer(frame)
        serializer.insert_sleep(1 / show.fps)
    return serializer.as_html()


def _stage(server: ViserServer, show: Show) -> Layer:
    """The ground and a first view; the world glides so that the person stays in it.

    Where cameras are shown, the world stands still until the page is told to follow.
    """
    views = viewpoints([show], (1280, 800))
    path = follow(show.figures, (1280, 800))
    glide = np.stack([path[0].target - view.target for view in path])
    world = server.scene.add_frame("/world", show_axes=False)
    reach = float(np.abs(glide).max())
    wxyz, position = _floor(show, views[0])
    server.scene.add_grid(
        "/world/ground",
        width=2 * reach + 16,
        height=2 * reach + 16,
        cell_size=0.5,
        section_size=1.0,
        cell_color=(216, 220, 226),
        section_color=GROUND,
        plane_color=(244, 245, 248),
        plane_opacity=1.0,
        shadow_opacity=0.25,
        wxyz=wxyz,
        position=position,
    )
    camera, view = server.initial_camera, views[0]
    camera.position, camera.look_at = view.position, view.target
    camera.fov = float(2 * np.arctan(view.size[1] / 2 / view.focal))

    def show_frame(frame: int) -> None:
        world.position = glide[frame]

    return show_frame


def _follows(show: Show) -> bool:
    """Whether the page follows the person before it is told to."""
    return len(show.cameras) == 0


def _floor(show: Show, view: Viewpoint) -> tuple[np.ndarray, np.ndarray]:
    """The ground's turn (w, x, y, z), and a point of it, a little sunk, near what is looked at."""
    plane = Plane.of(show.ground)
    depth = view.target @ plane.normal - plane.offset + 0.004
    axes = torch.from_numpy(np.column_stack([plane.tiles, plane.normal]))
    wxyz = so3.to_quaternion(axes).roll(1, -1).numpy()
    return wxyz, view.target - depth * plane.normal


def _body(scene: SceneApi, figure: Figure, opacity: float) -> Layer:
    shape = figure.posed.shape
    turns = so3.to_quaternion(figure.posed.orientations).roll(1, -1).numpy()
    joints = figure.posed.joints.numpy()
    mesh = scene.add_mesh_skinned(
        node_of(figure, "body"),
        figure.posed.model.rest_vertices(shape).numpy(),
        figure.body.faces.cpu().numpy(),
        bone_wxyzs=np.tile([1.0, 0.0, 0.0, 0.0], (joints.shape[1], 1)),
        bone_positions=figure.posed.rest.numpy(),
        skin_weights=prune_weights(figure.body.weights.cpu().double().numpy()),
        color=_deep(figure.colour),
        # two skins at one place would fight for the same depth
        wireframe=figure.opacity < 1,
        opacity=None if opacity == 1 else opacity,
    )

    def show(frame: int) -> None:
        for bone, wxyz, position in zip(mesh.bones, turns[frame], joints[frame], strict=True):
            bone.wxyz, bone.position = wxyz, position

    return show


def _contacts(scene: SceneApi, figure: Figure) -> Layer:
    carrying = list(CONTACT_JOINTS)
    joints = figure.posed.joints[:, carrying]
    touching = figure.touching[:, carrying]
    name = node_of(figure, "contacts")
    return _spheres(scene, name, joints, touching, CONTACT_RADIUS, CONTACT)


def _certainty(
    scene: SceneApi, figure: Figure, joint_std: Float[Tensor, "time 22"], *, shown: bool
) -> Layer:
    """Spheres of one standard deviation around the joints."""
    name = node_of(figure, "standard deviation")
    joints = figure.posed.joints
    return _spheres(
        scene, name, joints, joint_std, 1.0, CERTAINTY, opacity=HALO_OPACITY, shown=shown
    )


def _points(scene: SceneApi, points: Points) -> list[Layer]:
    seen, radius = points.visible, points.radius
    layers = [_spheres(scene, "/world/points/observed", points.positions, seen, radius, VISIBLE)]
    if points.estimated is not None and not bool(seen.all()):
        layers.append(
            _spheres(scene, "/world/points/missing", points.estimated, ~seen, radius, MISSING)
        )
    return layers


def _spheres(
    scene: SceneApi,
    name: str,
    centres: Float[Tensor, "time points 3"],
    scales: Shaped[Tensor, "time points"],
    radius: float,
    colour: Colour,
    *,
    opacity: float | None = None,
    shown: bool = True,
) -> Layer:
    """Spheres of one colour, `scales` times as large as the radius; zero leaves one out."""
    places, sizes = (values.detach().cpu().float().numpy() for values in (centres, scales))
    return Spheres(
        scene, name, places, radius * sizes, _deep(colour), opacity=opacity, shown=shown
    )


def _scan(scene: SceneApi, cloud: tuple[Tensor, ...]) -> Layer:
    def thinned(frame: int) -> np.ndarray:
        points = cloud[frame].detach().cpu().float().numpy()
        return points[:: max(1, -(-len(points) // CLOUD_LIMIT))]

    handle = scene.add_point_cloud(
        "/world/scan", thinned(0), colors=_deep(CLOUD), point_size=0.008
    )

    def show(frame: int) -> None:
        handle.points = thinned(frame)

    return show


def _frustum(scene: SceneApi, view: View) -> Layer:
    """A camera's pyramid; moving cameras move, lenses do not zoom."""
    camera, moving = view.at(0), view.camera.T_camera_world.ndim == 3
    width, height = camera.image_size
    handle = scene.add_camera_frustum(
        camera_node(view),
        fov=float(2 * torch.atan(height / 2 / camera.camera_matrix[1, 1])),
        aspect=width / height,
        scale=0.3,
        color=_deep(CAMERA),
        cast_shadow=False,
        receive_shadow=False,
    )

    def show(frame: int) -> None:
        if frame == 0 or moving:
            T = view.at(frame).T_world_camera
            handle.wxyz = so3.to_quaternion(T[:3, :3]).roll(1, -1).numpy()
            handle.position = T[:3, 3].numpy()

    return show


def _deep(colour: Colour) -> Colour:
    red, green, blue = (round(DEEPEN * part) for part in colour)
    return red, green, blue

"""Writes a self-contained page that plays a scene in any browser, by viser's player."""

import contextlib
import html
import io
import json
import logging
from collections.abc import Callable
from importlib import resources
from pathlib import Path

import numpy as np
import torch
import trimesh
from jaxtyping import Float
from torch import Tensor
from viser import SceneApi, ViserServer

from recon.core import rotations as so3
from recon.core.skeleton import CONTACT_JOINTS
from recon.core.visible import visible
from recon.formats.replacing import replacing
from recon.view.html_films import films_html
from recon.view.painter import Plane
from recon.view.scene import (
    CAMERA,
    CERTAINTY,
    CLOUD,
    CONTACT,
    FAINT,
    GROUND,
    MISSING,
    VISIBLE,
    Colour,
    Figure,
    Show,
    View,
    at_most_points,
)
from recon.view.viewpoint import following_viewpoints, viewpoints

logger = logging.getLogger(__name__)

Layer = Callable[[int], None]
"""Function that moves one part of the page's scene to its state in a frame."""

INFLUENCES = 4
"""Most joints per vertex in a browser's skinning."""
CONTACT_RADIUS_M = 0.055
CLOUD_LIMIT = 1500
"""Most points of a scan that are kept per frame: 90 frames stay below 2 MB."""
SEE_THROUGH = 0.62
"""Opacity of solid bodies while points or contacts, which lie inside, are shown."""
TETRAHEDRON = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) / 3**0.5
"""Directions of the four bones around a sphere that scale it by skinning, three radii away."""
SUNK_M = 0.004
"""Depth of the drawn ground below the true one, metres: soles may sink a little."""
HIDDEN_M = -1e4
"""Height to which spheres that are not shown are moved, metres."""
HALO_OPACITY = 0.35
"""Opacity of the spheres of standard deviations."""

DEEPEN = 0.82
"""Factor on colours: the player's lights brighten them by about its inverse."""


def write_html(path: str | Path, show: Show, overlay: Path | None = None) -> None:
    """Write a page with a timeline, a view that can be turned, and layers to switch.

    The page holds everything it needs and asks no server for anything. A body is stored once
    and skinned in the browser (its pose-dependent offsets, if it has any, are left out).

    Args:
        path: file to write.
        show: the scene to draw.
        overlay: film that `write_overlay` drew of the scene; None draws it now.

    Raises:
        FileNotFoundError: when the folder of `path` does not exist.
    """
    # viser prints a greeting even if it is not verbose
    with replacing(Path(path)) as scratch, contextlib.redirect_stdout(io.StringIO()):
        server = ViserServer(host="127.0.0.1", verbose=False)
        try:
            page = _recorded_page(server, show)
        finally:
            server.stop()
        title = f"<title>{html.escape(visible(show.title))}</title>"
        page = page.replace("<title>Viser</title>", title, 1)
        page = page.replace(
            "</body>", _legend_html(show) + films_html(show, Path(path), overlay) + "</body>", 1
        )
        scratch.write_text(page, encoding="utf-8")
    logger.info("wrote %s: %d frames, %.1f MB", path, show.frames, len(page) / 1e6)


def prune_weights(
    weights: Float[np.ndarray, "vertices joints"],
) -> Float[np.ndarray, "vertices joints"]:
    """Keep the largest skinning weights of every vertex, scaled to sum to one.

    Without the scaling a vertex with five influences would be drawn towards the origin.
    """
    kept = np.zeros_like(weights)
    largest = np.argsort(weights, axis=1)[:, -INFLUENCES:]
    np.put_along_axis(kept, largest, np.take_along_axis(weights, largest, 1), 1)
    return kept / kept.sum(1, keepdims=True)


def _recorded_page(server: ViserServer, show: Show) -> str:
    """Play the scene on a local server, and return the page that replays its messages."""
    scene = server.scene
    scene.set_up_direction("+z")
    touching = any(bool(figure.touching.any()) for figure in show.figures)
    inside = SEE_THROUGH if touching or show.points is not None else 1.0
    layers = [_add_ground_and_view(server, show)]
    for figure in show.figures:
        layers.append(_add_body(scene, figure, figure.opacity * inside))
        joints, node = figure.posed.joints, figure.node("contacts")
        if bool(figure.touching.any()):
            own = list(CONTACT_JOINTS)
            radii = CONTACT_RADIUS_M * figure.touching[:, own]
            layers.append(_add_spheres(scene, node, joints[:, own], radii, CONTACT))
        if figure.joint_std is not None:
            node, std, shown = figure.node("standard deviation"), figure.joint_std, show.certainty
            layers.append(
                _add_spheres(scene, node, joints, std, CERTAINTY, HALO_OPACITY, shown=shown)
            )
    if (points := show.points) is not None:
        seen, node = points.visible, "/world/points/observed"
        layers.append(_add_spheres(scene, node, points.positions, points.radius * seen, VISIBLE))
        if points.estimated is not None and not bool(seen.all()):
            radii, node = points.radius * ~seen, "/world/points/missing"
            layers.append(_add_spheres(scene, node, points.estimated, radii, MISSING))
    if show.cloud is not None:
        layers.append(_add_scan(scene, show.cloud))
    layers += [_add_frustum(scene, view) for view in show.cameras]
    # an invisible frame: the films of the page read the time of playback from its position
    clock = scene.add_frame("/clock", show_axes=False)
    serializer = server.get_scene_serializer()
    for frame in range(show.frames):
        for layer in layers:
            layer(frame)
        clock.position = (frame / show.fps, 0.0, 0.0)
        serializer.insert_sleep(1 / show.fps)
    return serializer.as_html()


def _add_ground_and_view(server: ViserServer, show: Show) -> Layer:
    """Add the ground and a first view; the world moves so that the person stays in view.

    Where cameras are shown, the world stands still until the page is told to follow.
    """
    view, plane = viewpoints(show, (1280, 800))[0], Plane.of(show.ground)
    path = following_viewpoints(show.figures, (1280, 800))
    glide = np.stack([path[0].target - place.target for place in path])
    world = server.scene.add_frame("/world", show_axes=False)
    reach = float(np.abs(glide).max())
    axes = torch.from_numpy(np.column_stack([plane.tiles, plane.normal]))
    depth = view.target @ plane.normal - plane.offset + SUNK_M
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
        wxyz=so3.to_quaternion(axes).roll(1, -1).numpy(),
        position=view.target - depth * plane.normal,
    )
    camera = server.initial_camera
    camera.position, camera.look_at = view.position, view.target
    camera.fov = float(2 * np.arctan(view.size[1] / 2 / view.focal))

    def show_frame(frame: int) -> None:
        world.position = glide[frame]

    return show_frame


def _add_body(scene: SceneApi, figure: Figure, opacity: float) -> Layer:
    shape = figure.posed.shape
    turns = so3.to_quaternion(figure.posed.orientations).roll(1, -1).numpy()
    joints = figure.posed.joints.numpy()
    mesh = scene.add_mesh_skinned(
        figure.node("body"),
        figure.posed.model.rest_vertices(shape).numpy(),
        figure.body.faces.cpu().numpy(),
        bone_wxyzs=np.tile([1.0, 0.0, 0.0, 0.0], (joints.shape[1], 1)),
        bone_positions=figure.posed.rest.numpy(),
        skin_weights=prune_weights(figure.body.weights.cpu().double().numpy()),
        color=_darker_colour(figure.colour),
        # a translucent body is a wireframe, as two surfaces at the same depth would flicker
        wireframe=figure.opacity < 1,
        opacity=None if opacity == 1 else opacity,
    )

    def show(frame: int) -> None:
        for bone, wxyz, position in zip(mesh.bones, turns[frame], joints[frame], strict=True):
            bone.wxyz, bone.position = wxyz, position

    return show


def _add_spheres(
    scene: SceneApi,
    name: str,
    centres: Float[Tensor, "time points 3"],
    radii: Float[Tensor, "time points"],
    colour: Colour,
    opacity: float | None = None,
    *,
    shown: bool = True,
) -> Layer:
    """Add spheres of one colour, without those of radius zero.

    One skin with a bone per sphere moves together with the bodies. Where radii differ, every
    sphere hangs between four bones, which move apart when it grows.
    """
    places, sizes = (values.detach().cpu().float().numpy() for values in (centres, radii))
    largest, count = float(sizes.max(initial=0)), sizes.shape[1]
    grows = bool((sizes[sizes > 0] < largest).any())
    ball = trimesh.creation.icosphere(subdivisions=2 if grows else 1)
    directions = np.asarray(ball.vertices)
    if grows:
        corners, rest = 3 * TETRAHEDRON, 1.0
        weights = (1 + directions @ TETRAHEDRON.T) / 4
        bones = places[:, :, None] + sizes[..., None, None] * corners.astype(np.float32)
    else:
        corners, rest = np.zeros((1, 3)), largest or 1.0
        weights = np.ones((len(directions), 1))
        bones = np.where(sizes[..., None] > 0, places, np.array([0, 0, HIDDEN_M], np.float32))
    bones = bones.reshape(len(places), -1, 3)
    offset = np.arange(count)[:, None, None] * len(directions)
    mesh = scene.add_mesh_skinned(
        name,
        np.tile(rest * directions, (count, 1)),
        (np.asarray(ball.faces)[None] + offset).reshape(-1, 3),
        bone_wxyzs=np.tile([1.0, 0.0, 0.0, 0.0], (bones.shape[1], 1)),
        bone_positions=np.tile(corners, (count, 1)),
        skin_weights=np.kron(np.eye(count), weights),
        color=_darker_colour(colour),
        opacity=opacity,
        cast_shadow=False,
        receive_shadow=False,
        visible=shown,
    )

    def show(frame: int) -> None:
        # bones that have not moved are not sent again
        moved = (bones[frame] != bones[max(frame - 1, 0)]).any(-1) | (frame == 0)
        for k in np.flatnonzero(moved).tolist():
            mesh.bones[k].position = bones[frame, k]

    return show


def _add_scan(scene: SceneApi, cloud: tuple[Tensor, ...]) -> Layer:
    def points(frame: int) -> np.ndarray:
        return at_most_points(cloud[frame], CLOUD_LIMIT).detach().cpu().float().numpy()

    handle = scene.add_point_cloud(
        "/world/scan", points(0), colors=_darker_colour(CLOUD), point_size=0.008
    )

    def show(frame: int) -> None:
        handle.points = points(frame)

    return show


def _add_frustum(scene: SceneApi, view: View) -> Layer:
    """Add a camera's pyramid, which follows a moving camera."""
    camera, moving = view.at(0), view.camera.T_camera_world.ndim == 3
    width, height = camera.image_size
    handle = scene.add_camera_frustum(
        view.node,
        fov=float(2 * torch.atan(height / 2 / camera.camera_matrix[1, 1])),
        aspect=width / height,
        scale=0.3,
        color=_darker_colour(CAMERA),
        cast_shadow=False,
        receive_shadow=False,
    )

    def show(frame: int) -> None:
        if frame == 0 or moving:
            T = view.at(frame).T_world_camera
            handle.wxyz = so3.to_quaternion(T[:3, :3]).roll(1, -1).numpy()
            handle.position = T[:3, 3].numpy()

    return show


def _darker_colour(colour: Colour) -> Colour:
    red, green, blue = (round(DEEPEN * part) for part in colour)
    return red, green, blue


def _legend_html(show: Show) -> str:
    """Return HTML of the title and a legend with switches, in the page's upper left corner."""
    rows = [
        _legend_row(
            one.word, one.colour, f"data-nodes='{html.escape(json.dumps(one.nodes))}'", one.shown
        )
        for one in show.layers
    ]
    follows = len(show.cameras) == 0  # scenes with cameras begin with a still view
    rows.append(_legend_row("follow the person", FAINT, "data-follow", follows))
    assets = resources.files("recon") / "assets"
    style = (assets / "layers.css").read_text(encoding="utf-8")
    script = (assets / "layers.js").read_text(encoding="utf-8")
    return (
        f'<style>{style}</style><div id="recon-legend"><details open>'
        f"<summary>{html.escape(visible(show.title))}</summary>{''.join(rows)}</details></div>"
        "<script>if (innerWidth <= 600) "
        'document.querySelector("#recon-legend details").open = false;</script>'
        f"<script>{script}</script>"
    )


def _legend_row(word: str, colour: Colour, data: str, shown: bool) -> str:
    checked = " checked" if shown else ""
    return (
        f'<label style="--colour:rgb{colour}"><input type="checkbox" role="switch" {data}'
        f"{checked}><i></i><span>{html.escape(visible(word))}</span></label>"
    )

"""The layers of a page: what its legend names, and switches on and off."""

import html
import json
from dataclasses import dataclass
from importlib import resources

import numpy as np
import trimesh
from jaxtyping import Float
from viser import SceneApi

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
)
from recon.view.views import View


@dataclass(frozen=True)
class LegendLayer:
    """Nodes of the page's scene that are switched together."""

    word: str
    """What the legend calls it."""
    colour: Colour
    nodes: tuple[str, ...]
    """Names of the nodes in the tree of the scene."""
    shown: bool = True
    """Whether it is shown at first."""


def layers(show: Show) -> tuple[LegendLayer, ...]:
    """Everything that a page shows, in the order of its legend."""
    figures, points = show.figures, show.points
    touching = [f for f in figures if bool(f.touching.any())]
    sure = [f for f in figures if f.joint_std is not None]
    found = [LegendLayer(f.name, f.colour, (node_of(f, "body"),)) for f in figures]
    if touching:
        nodes = tuple(node_of(figure, "contacts") for figure in touching)
        found.append(LegendLayer("contact", CONTACT, nodes))
    if sure:
        nodes = tuple(node_of(figure, "standard deviation") for figure in sure)
        found.append(LegendLayer("one standard deviation", CERTAINTY, nodes, shown=show.certainty))
    if points is not None:
        found.append(LegendLayer("observed point", VISIBLE, ("/world/points/observed",)))
        if points.estimated is not None and not bool(points.visible.all()):
            found.append(
                LegendLayer("missing point, estimated", MISSING, ("/world/points/missing",))
            )
    if show.cloud is not None:
        found.append(LegendLayer("scan", CLOUD, ("/world/scan",)))
    if show.cameras:
        found.append(
            LegendLayer("camera", CAMERA, tuple(camera_node(view) for view in show.cameras))
        )
    found.append(LegendLayer("ground", GROUND, ("/world/ground",)))
    return tuple(found)


def node_of(figure: Figure, part: str) -> str:
    """Name of a node that belongs to a figure."""
    return f"/world/{_word(figure.name)}/{part}"


def camera_node(view: View) -> str:
    """Name of a camera's node."""
    return f"/world/cameras/{_word(view.name)}"


def _word(name: str) -> str:
    """A name as part of a node's; a slash would open a new level of the tree."""
    return name.replace("/", "-").strip() or "unnamed"


def legend(show: Show, *, follows: bool) -> str:
    """Title and legend with switches, laid over the page's upper left corner.

    Args:
        show: what the page shows.
        follows: whether the camera follows the person at first.
    """
    rows = [
        _row(layer.word, layer.colour, f"data-nodes='{_attribute(layer.nodes)}'", layer.shown)
        for layer in layers(show)
    ]
    rows.append(_row("follow the person", FAINT, "data-follow", follows))
    assets = resources.files("recon") / "assets"
    style = (assets / "layers.css").read_text(encoding="utf-8")
    script = (assets / "layers.js").read_text(encoding="utf-8")
    return (
        f'<style>{style}</style><div id="recon-legend"><details open>'
        f"<summary>{html.escape(show.title)}</summary>{''.join(rows)}</details></div>"
        "<script>if (innerWidth <= 600) "
        'document.querySelector("#recon-legend details").open = false;</script>'
        f"<script>{script}</script>"
    )


def _row(word: str, colour: Colour, data: str, shown: bool) -> str:
    checked = " checked" if shown else ""
    return (
        f'<label style="--colour:rgb{colour}"><input type="checkbox" role="switch" {data}'
        f"{checked}><i></i><span>{html.escape(word)}</span></label>"
    )


def _attribute(nodes: tuple[str, ...]) -> str:
    return html.escape(json.dumps(nodes), quote=True)


_HIDDEN = -1e4
"""Height at which spheres are that are not shown, metres."""
_TETRAHEDRON = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) / 3**0.5
"""Directions of four bones with which a sphere can grow; three radii away they hold it inside."""


class Spheres:
    """Spheres of one colour; a radius of zero leaves one out."""

    def __init__(
        self,
        scene: SceneApi,
        name: str,
        centres: Float[np.ndarray, "time points 3"],
        radii: Float[np.ndarray, "time points"],
        colour: Colour,
        *,
        opacity: float | None = None,
        shown: bool = True,
    ) -> None:
        """Add them to a scene.

        Args:
            scene: to add them to.
            name: of the node.
            centres: metres.
            radii: metres.
            colour: of all of them.
            opacity: None is solid.
            shown: whether they are visible at first.
        """
        sizes = np.unique(radii[radii > 0])
        grows = len(sizes) > 1
        corners = 3 * _TETRAHEDRON if grows else np.zeros((1, 3))
        ball = trimesh.creation.icosphere(subdivisions=2 if grows else 1)
        directions = np.asarray(ball.vertices)
        weights = (1 + directions @ _TETRAHEDRON.T) / 4 if grows else np.ones((len(directions), 1))
        count, rest = radii.shape[1], 1.0 if grows or len(sizes) == 0 else float(sizes[0])
        offset = np.arange(count)[:, None, None] * len(directions)
        self._places = _bones(centres, radii, corners, grows=grows)
        self._mesh = scene.add_mesh_skinned(
            name,
            np.tile(rest * directions, (count, 1)),
            (np.asarray(ball.faces)[None] + offset).reshape(-1, 3),
            bone_wxyzs=np.tile([1.0, 0.0, 0.0, 0.0], (count * len(corners), 1)),
            bone_positions=np.tile(corners, (count, 1)),
            skin_weights=np.kron(np.eye(count), weights),
            color=colour,
            opacity=opacity,
            cast_shadow=False,
            receive_shadow=False,
            visible=shown,
        )

    def __call__(self, frame: int) -> None:
        """Show one frame; bones that have not moved are not told again."""
        here = self._places[frame]
        moved = np.ones(len(here), dtype=bool)
        if frame > 0:
            moved = np.asarray((here != self._places[frame - 1]).any(-1))
        for k in np.flatnonzero(moved):
            self._mesh.bones[int(k)].position = here[k]


def _bones(
    centres: Float[np.ndarray, "time points 3"],
    radii: Float[np.ndarray, "time points"],
    corners: Float[np.ndarray, "corners 3"],
    *,
    grows: bool,
) -> Float[np.ndarray, "time bones 3"]:
    """Positions of the bones of all spheres in every frame, metres."""
    if not grows:
        below = np.array([0.0, 0.0, _HIDDEN], dtype=centres.dtype)
        return np.where(radii[..., None] > 0, centres, below)
    found = centres[:, :, None] + radii[..., None, None] * corners
    return found.reshape(len(centres), -1, 3).astype(centres.dtype)

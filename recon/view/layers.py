"""The layers of a page: what its legend names, and switches on and off."""

import html
import json
from dataclasses import dataclass
from importlib import resources

from recon.view.show.colours import (
    CAMERA,
    CERTAINTY,
    CLOUD,
    CONTACT,
    FAINT,
    GROUND,
    MISSING,
    VISIBLE,
    Colour,
)
from recon.view.show.scene import Figure, Show
from recon.view.show.views import View


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

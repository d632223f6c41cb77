"""Spheres in a page, moved by bones as bodies are: points lie on the bodies of the same frame.

The viewer applies bones in the frame in which their messages come. Instances of a mesh it moves
later, on a slow computer by many frames, so that points lagged behind the bodies by metres.
"""

import numpy as np
import trimesh
from jaxtyping import Float
from viser import SceneApi

from recon.view.show.colours import Colour

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

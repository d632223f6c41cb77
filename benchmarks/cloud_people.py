"""Windows of `benchmarks.clouds` in which one of MakeHuman's people does the motion.

The person (`benchmarks.people`) wears drawn clothes and turns the joints as the truth does. True
joints are our skeleton placed by the dense correspondence; surfaces are compared from points to
surface, since the meshes differ.
"""

import functools
from dataclasses import dataclass, field

import numpy as np
import torch
from jaxtyping import Float
from scipy.spatial import KDTree
from torch import Tensor

from benchmarks.cloud_cases import Seen
from benchmarks.labels import worn_by
from benchmarks.people import People
from recon.core.motion import Motion
from recon.simulation.depth import Shown
from recon.simulation.scenery import Clothing

_COMPARED = 3
"""Every so many true vertices are compared."""


@dataclass(frozen=True)
class SeenPerson(Seen):
    """One window with one of MakeHuman's people in it."""

    people: People = field(kw_only=True)

    @functools.cached_property
    def _posed(self) -> tuple[Shown, Float[np.ndarray, "time 22"]]:
        random = np.random.default_rng([self.number, len(self.people.vertices)])
        person = self.number % len(self.people.vertices)
        clothing = Clothing(loose=random.uniform(0.005, 0.02))
        posed = self.body.pose(self.truth)
        vertices, joints, unsure = self.people.posed(
            person,
            posed.orientations.double().numpy(),
            posed.joints[:, 0].double().numpy(),
            curl=random.uniform(0.0, 1.2),
            offset=worn_by(self.people, person, self.body, self.number, clothing),
        )
        # other legs than the truth's: the lowest point of the clip is on the ground
        rise = np.array([0.0, 0.0, vertices[..., 2].min()])
        shown = Shown(
            torch.from_numpy(vertices - rise).float(),
            self.people.faces,
            torch.from_numpy(joints - rise).float(),
        )
        return shown, unsure

    @functools.cached_property
    def shown(self) -> Shown:
        """The person; joints are those of our skeleton, by the correspondence."""
        return self._posed[0]

    @property
    def unsure(self) -> float:
        """Mean error of the true joints, metres: half of what two bones disagree about them."""
        return float(self._posed[1].mean())

    def surface_errors(self, motion: Motion) -> dict[str, float]:
        """Mean distances of the person's vertices from the surface of a fitted motion, metres."""
        frames = [k for k in self.shown_frames if k < motion.frames]
        fitted = self.body.pose(motion).vertices
        faces = self.body.faces.cpu()
        away = [
            from_surface(self.shown.vertices[k, ::_COMPARED], fitted[k], faces) for k in frames
        ]
        visible = self.visible_vertices[: len(frames), ::_COMPARED]
        every = torch.stack(away)
        return {
            "surface": float(every.mean()),
            "surface_visible": float(every[visible].mean()),
        }


def from_surface(
    points: Float[Tensor, "points 3"], vertices: Float[Tensor, "vertices 3"], faces: Tensor
) -> Float[Tensor, " points"]:
    """Distances of points from a mesh, metres, along the normals of its nearest pieces.

    A piece is a vertex or the middle of a face; beyond its border, the distance is to the piece.
    """
    corners = vertices[faces]
    normals = torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = torch.nn.functional.normalize(normals, dim=-1)
    middles = corners.mean(1)
    radius = (corners - middles[:, None]).norm(dim=-1).amax(-1)
    _, index = KDTree(middles.double().numpy()).query(points.double().numpy())
    index = torch.from_numpy(np.asarray(index))
    apart = points - middles[index]
    along = (apart * normals[index]).sum(-1)
    beside = (apart - along[:, None] * normals[index]).norm(dim=-1)
    beyond = (beside - radius[index]).clamp(min=0)
    return (along.square() + beyond.square()).sqrt()

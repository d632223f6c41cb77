"""Distances between the markers of a set, from a trial in which they have names."""

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from recon.body.model import BodyModel
from recon.core.errors import ReconError
from recon.ingest.marker_distances import MarkerDistances
from recon.ingest.marker_fit import fit_markers
from recon.ingest.marker_poses import Poses, SkinPoints, drawn_poses
from recon.ingest.marker_sets import full_body_markers
from recon.mocap.recording import MarkerRecording

_POSES, _FITTED, _FRAMES = 120, 40, 120
"""Poses of the body, frames that it is fitted to, and frames whose distances are taken."""
_NOISE = 0.006
"""Metres by which distances of markers on one segment differ between trials."""


def distances_in_trial(trial: MarkerRecording, body: BodyModel) -> MarkerDistances:
    """How the markers of a named trial lie to each other, there and in other poses.

    A body is fitted to some frames; its markers are then seen in likely poses. Labels that no
    table knows are known from the trial alone.
    """
    count = len(trial.marker_names)
    poses = np.full((1, count, 3), np.nan)
    try:
        known = full_body_markers(trial, body)
        fit = fit_markers(trial.select(known.labels).evenly_spread(_FITTED), known, body)
        places = posed_markers(body, known.vertices, fit.offsets, fit.motion.shape)
        poses = np.full((len(places), count, 3), np.nan)
        poses[:, [trial.marker_names.index(label) for label in known.labels]] = places
    except ReconError:  # labels unknown to recon: distances in the trial alone must suffice
        pass
    some = trial.evenly_spread(_FRAMES)
    seen = np.where(some.visible[..., None], some.positions, np.nan)
    return MarkerDistances.of(trial.marker_names, seen, poses, _NOISE)


def posed_markers(
    body: BodyModel,
    vertices: tuple[int, ...],
    offsets: Float[Tensor, "markers 3"],
    shape: Float[Tensor, " shape"],
) -> Float[np.ndarray, "poses markers 3"]:
    """Places of markers on a body in poses drawn from the bundled density, metres."""
    turns = torch.cat(
        (torch.eye(3).to(shape).expand(_POSES, 1, 3, 3), drawn_poses(_POSES).to(shape)), 1
    )
    points = SkinPoints.of(body, shape, torch.tensor(vertices), offsets)
    poses = Poses.of(shape.new_zeros(_POSES, 3), turns, body.rest_joints(shape))
    return points.places(poses).mT.double().numpy()

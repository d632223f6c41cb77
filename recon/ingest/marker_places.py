"""A body with a set of markers on it: from a trial in which they have names, or from a table."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from recon.body.model import BodyModel
from recon.ingest.marker_calibration import calibrated
from recon.ingest.marker_fit import OUTLIER, fit_markers, subject_energies
from recon.ingest.marker_poses import PoseEnergies, Poses, SkinPoints, drawn_poses, natural_pose
from recon.ingest.marker_sets import MarkerSet, full_body_markers
from recon.mocap.recording import MarkerRecording

_FITTED, _DRAWN = 40, 100
"""Frames of a named trial that the body is fitted to, and poses drawn from the density."""
_KNOWN, _TABLE, _LOOSE_TABLE = 0.02, 0.05, 0.08
"""Standard deviations of a marker from its place, metres: once its offset is known, by a table,
and by a table that names no more than a region, such as the thigh."""
_JOINT_SPREAD = 0.6
"""Standard deviation of joints from the natural pose, radians."""
_STATURES = (-3.0, -1.5, 0.0, 1.5)
"""First coefficients of the shapes that somebody unknown may have: 1.3 to 1.9 m."""


@dataclass(frozen=True)
class MarkedBody:
    """A body of known shape with markers at known places, and poses it may have."""

    body: BodyModel
    markers: MarkerSet
    shape: Float[Tensor, " shape"]
    offsets: Float[Tensor, "markers 3"]
    spread: Float[np.ndarray, " markers"]
    """Standard deviation of each marker from its place, metres."""
    poses: Float[Tensor, "poses 21 3 3"]

    @property
    def usual_spread(self) -> float:
        """The median of `spread`, metres."""
        return float(np.median(self.spread))

    @cached_property
    def skin(self) -> SkinPoints:
        """The markers as points of the body."""
        return self._energies_without_markers.markers

    @cached_property
    def _energies_without_markers(self) -> PoseEnergies:
        """Energies of one frame in which no marker is seen."""
        count = len(self.markers.labels)
        nothing = np.zeros((1, count, 3)), np.zeros((1, count), bool)
        subject = subject_energies(self._recording(*nothing), self.markers, self.body)
        free = replace(subject, under=None).of(self.shape, self.offsets).untied()
        return replace(free, weight=1.0)

    def _recording(self, positions: np.ndarray, visible: np.ndarray) -> MarkerRecording:
        return MarkerRecording("", self.markers.labels, positions, visible, 30.0, ())

    def posed(self, translation: Tensor, rotations: Tensor) -> Poses:
        """Poses of this body from translations and joint rotations."""
        return Poses.of(translation, rotations, self._energies_without_markers.rest)

    def places(self, poses: Poses) -> Float[np.ndarray, "frames markers 3"]:
        """Positions of the markers in some poses, metres."""
        return self.skin.places(poses).mT.double().numpy()

    def energies(
        self,
        positions: Float[np.ndarray, "frames markers 3"],
        visible: Bool[np.ndarray, "frames markers"],
    ) -> PoseEnergies:
        """Energies of the poses of frames that do not depend on each other.

        Markers whose place is surer count more, and the natural pose less.
        """
        weight = torch.from_numpy((self.usual_spread / self.spread) ** 2).float()
        pull = (self.usual_spread / _JOINT_SPREAD) ** 2
        return replace(
            self._energies_without_markers,
            positions=torch.from_numpy(positions).float().mT.contiguous(),
            visible=torch.from_numpy(visible).float() * weight,
            linked=torch.zeros(len(visible) - 1, dtype=torch.bool),
            pull=torch.full((1,), pull),
        )

    def calibrated(
        self,
        positions: Float[np.ndarray, "frames markers 3"],
        visible: Bool[np.ndarray, "frames markers"],
        poses: Poses,
    ) -> "MarkedBody":
        """The body whose shape and offsets fit some frames, from rough poses in them."""
        some = subject_energies(self._recording(positions, visible), self.markers, self.body)
        free = replace(some.poses.untied(), weight=1.0)
        known = replace(some, under=None, poses=free)
        found = calibrated(known, poses.translation, poses.rotations, OUTLIER)
        spread = np.where(visible.any(0), _KNOWN, self.spread)
        return replace(self, shape=found.shape, offsets=found.offsets, spread=spread)


def body_of_trial(
    trial: MarkerRecording, body: BodyModel, markers: MarkerSet | None = None
) -> MarkedBody:
    """A body fitted to some frames of a named trial.

    Args:
        trial: named.
        body: fitted to it.
        markers: their places on the body; None takes the known labels.

    Raises:
        ReconError: when too few labels are known.
    """
    known = markers or full_body_markers(trial, body)
    fit = fit_markers(trial.select(known.labels).evenly_spread(_FITTED), known, body)
    poses = torch.cat((fit.motion.rotations[::4, 1:], _usual_poses()))
    spread = np.full(len(known.labels), _KNOWN)
    return MarkedBody(body, known, fit.motion.shape, fit.offsets, spread, poses)


def bodies_of_set(markers: MarkerSet, body: BodyModel) -> list[MarkedBody]:
    """Bodies of several statures, each with its markers where the table of the set puts them."""
    shapes = [torch.zeros(body.shape_size) for _ in _STATURES]
    for shape, stature in zip(shapes, _STATURES, strict=True):
        shape[0] = stature
    usual, spread = _usual_poses(), np.where(markers.loose, _LOOSE_TABLE, _TABLE)
    return [MarkedBody(body, markers, own, markers.nominal, spread, usual) for own in shapes]


def _usual_poses() -> Float[Tensor, "poses 21 3 3"]:
    return torch.cat((torch.eye(3).expand(1, 21, 3, 3), natural_pose()[None], drawn_poses(_DRAWN)))

"""Makes bodies with markers on them: from a trial whose markers have names, or from a table."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from recon.body.model import BodyModel
from recon.ingest.marker_calibration import calibrated_frames
from recon.ingest.marker_fit import OUTLIER, fit_markers, subject_energies
from recon.ingest.marker_poses import PoseEnergies, Poses, SkinPoints, drawn_poses, natural_pose
from recon.ingest.marker_sets import MarkerSet, full_body_markers
from recon.mocap.recording import MarkerRecording

_FITTED, _DRAWN = 40, 100
"""Number of frames of a named trial that the body is fitted to, and of poses drawn at random."""
_KNOWN, _TABLE, _LOOSE_TABLE = 0.02, 0.05, 0.08
"""Standard deviations (m) of a marker from its place on the body: with an offset from a fit, with
a place from a table, and with a table that names only a region, such as the thigh."""
_JOINT_SPREAD = 0.6
"""Standard deviation of joints from the natural pose, radians."""
_STATURES = (-3.0, -1.5, 0.0, 1.5)
"""First shape coefficients of the bodies that are tried for an unknown person: 1.3 to 1.9 m."""


@dataclass(frozen=True)
class MarkedBody:
    """A body of known shape with markers at known places, and usual poses to start fits from."""

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
        """The markers as points at constant offsets from the skin."""
        return self._energies_without_markers.markers

    @cached_property
    def _energies_without_markers(self) -> PoseEnergies:
        """Energies of one frame in which no marker is seen."""
        count = len(self.markers.labels)
        nothing = np.zeros((1, count, 3)), np.zeros((1, count), bool)
        subject = subject_energies(self._recording(*nothing), self.markers, self.body)
        free = replace(subject, under=None).for_body(self.shape, self.offsets).untied()
        return replace(free, weight=1.0)

    def _recording(self, positions: np.ndarray, visible: np.ndarray) -> MarkerRecording:
        return MarkerRecording("", self.markers.labels, positions, visible, 30.0, ())

    def posed(self, translation: Tensor, rotations: Tensor) -> Poses:
        """Return poses of this body, given translations (m) and joint rotations."""
        return Poses.of(translation, rotations, self._energies_without_markers.rest)

    def places(self, poses: Poses) -> Float[np.ndarray, "frames markers 3"]:
        """Return the positions of the markers in given poses, metres."""
        return self.skin.places(poses).mT.double().numpy()

    def energies(
        self,
        positions: Float[np.ndarray, "frames markers 3"],
        visible: Bool[np.ndarray, "frames markers"],
    ) -> PoseEnergies:
        """Return the energies of poses, given observed markers, without ties between frames.

        Markers with a smaller standard deviation have a larger weight.
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
        """Return this body with shape and offsets fitted to some frames, from rough poses."""
        some = subject_energies(self._recording(positions, visible), self.markers, self.body)
        free = replace(some.poses.untied(), weight=1.0)
        known = replace(some, under=None, poses=free)
        found = calibrated_frames(known, poses.translation, poses.rotations, OUTLIER)
        spread = np.where(visible.any(0), _KNOWN, self.spread)
        return replace(self, shape=found.shape, offsets=found.offsets, spread=spread)


def body_of_trial(
    trial: MarkerRecording, body: BodyModel, markers: MarkerSet | None = None
) -> MarkedBody:
    """Fit a body to some frames of a trial whose markers have names.

    Args:
        trial: recording of named markers.
        body: the body model that is fitted.
        markers: places of the markers on the body; None takes the known labels.

    Raises:
        ReconError: when too few labels are known.
    """
    known = markers or full_body_markers(trial, body)
    fit = fit_markers(trial.select(known.labels).evenly_spread(_FITTED), known, body)
    poses = torch.cat((fit.motion.rotations[::4, 1:], _usual_poses()))
    spread = np.full(len(known.labels), _KNOWN)
    return MarkedBody(body, known, fit.motion.shape, fit.offsets, spread, poses)


def bodies_of_set(markers: MarkerSet, body: BodyModel) -> list[MarkedBody]:
    """Return bodies of several statures, with markers where the table of their set puts them."""
    shapes = [torch.zeros(body.shape_size) for _ in _STATURES]
    for shape, stature in zip(shapes, _STATURES, strict=True):
        shape[0] = stature
    usual, spread = _usual_poses(), np.where(markers.loose, _LOOSE_TABLE, _TABLE)
    return [MarkedBody(body, markers, own, markers.nominal, spread, usual) for own in shapes]


def _usual_poses() -> Float[Tensor, "poses 21 3 3"]:
    return torch.cat((torch.eye(3).expand(1, 21, 3, 3), natural_pose()[None], drawn_poses(_DRAWN)))

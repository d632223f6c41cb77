"""Depth points on the body's surface, without known correspondences to points of the body."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from observations.checks import (
    camera_of_view,
    checked_clock,
    checked_positions,
)
from observations.matched import MatchedCloud, SurfaceDiscs
from observations.start.labelled import labelled_start
from observations.start.surface_steps import label_features, surfel_features
from observations.surfels import Surfels, tukey
from priors.labels.looking import CloudLabeller, PointLabels
from recon.body.model import BodyModel
from recon.core.arrays import Numbers, float_tensor, geometries_given
from recon.core.camera import Camera
from recon.core.clouds import cloud_points
from recon.core.errors import ObservationError
from recon.core.motion import Motion
from recon.core.nearest import nearest, nearest_alike
from recon.core.raster import are_facing_eye
from recon.core.residuals import Noise, Residuals
from recon.method.protocols import Estimate
from recon.method.sensor import Sensor

_FEW_POINTS, _FEW_SURFELS = 96, 500
_FLESH, _FLESH_POINTS = 0.15, 3
"""Metres from a joint within which this many points of a cloud show it."""
CLOUD_NOISE = 0.01
"""Metres that depth sensors, clothes and hair put between points and a smooth body."""
CLOUD_WORTH = 64
"""Patches of the surface that err independently of each other, as which the cloud of a frame
counts, however many points it has: what clothes and a smooth body miss is alike in neighbours.
Chosen on validation windows among 16, 64 and 128."""


@dataclass(frozen=True, init=False)
class PointCloud(Sensor):
    """Points of the body's surface that a depth sensor or a scanner measured.

    The energy is half the robust squared distance of every point from the surface, in metres².
    Points have no names: those of one moment do not correspond to those of the next.
    """

    sees = "surface"
    timed = ("points", "present", "labels", "std")
    points: Float[Tensor, "*batch moments points 3"]
    """Positions in metres, in the frame of the recording; zero where not present."""
    present: Bool[Tensor, "*batch moments points"]
    """Whether a row of `points` holds a point; moments may have different numbers of points."""
    surfels: Surfels
    """The body's surface as discs, to which points are compared."""
    fps: float
    """Rate of the moments in Hz."""
    start_time: float = 0.0
    """Time of the first moment, in seconds of the clock that all observations of a clip share."""
    camera: Camera | None = None
    """Camera of the sensor, with leading axes (batch, 1) for a fixed sensor and (batch, moments)
    for a moving one; its pose maps the frame of the recording to the sensor. None for scans from
    all sides."""
    kernel: Callable[[Tensor, Tensor], Tensor] = tukey
    """Robust kernel over the squared distances of a clip: `tukey` or `bounded`."""
    ground_known: bool = True
    """Whether the plane z = 0 of the recording is the ground."""
    ground_seen: bool = False
    """Whether the plane z = 0 of the recording was laid on a plane that the sensor sees."""
    labels: PointLabels | None = None
    """What is believed of every point, if a network or somebody has looked at the cloud."""
    std: Float[Tensor, "*batch moments"] | None = None
    """Standard deviation of the sensor's distances at every moment, metres, which errs point by
    point; None counts all moments alike. The published energy has none."""

    def __init__(
        self,
        points: Numbers,
        present: Numbers | None = None,
        surfels: Surfels | None = None,
        fps: float | None = None,
        start_time: float = 0.0,
        camera: Camera | None = None,
        kernel: Callable[[Tensor, Tensor], Tensor] = tukey,
        ground_known: bool = True,
        ground_seen: bool = False,
        labels: PointLabels | None = None,
        std: Numbers | None = None,
    ) -> None:
        """Takes points (moments, points, 3) and `std` (moments), in metres; `fps` is in Hz.

        `present` is (moments, points). Arrays of numpy become float32 tensors. A camera without
        leading axes stands still. Without `present`, the points are one cloud per moment,
        of any sizes: arrays (N, 3), or clouds and meshes of Open3D. Without `surfels`, the surface
        is that of the bundled body. The rate `fps` must be given.

        Raises:
            ValueError: naming the array, what was expected and what came.
        """
        if present is None:
            points, present = _padded_clouds(points)
        surfels = Surfels.of(BodyModel.load()) if surfels is None else surfels
        points, present = checked_positions("PointCloud", "points", points, "present", present)
        fps, start_time = checked_clock("PointCloud", fps, start_time)
        view = None if camera is None else camera_of_view("PointCloud", camera, points)
        if labels is not None and labels.present.shape != present.shape:
            raise ObservationError(
                "PointCloud: expected labels for all points, of the shape of `present`, "
                f"{tuple(present.shape)}, got {tuple(labels.present.shape)}"
            )
        deviation = None if std is None else float_tensor(std, "PointCloud.std").to(points)
        if deviation is not None and deviation.shape != present.shape[:-1]:
            raise ObservationError(
                "PointCloud: expected one std in metres per moment, of the shape "
                f"{tuple(present.shape[:-1])}, got {tuple(deviation.shape)}"
            )
        self._set_fields(
            points=points, present=present, surfels=surfels, fps=fps, start_time=start_time,
            camera=view, kernel=kernel, ground_known=ground_known,
            ground_seen=ground_seen, labels=labels, std=deviation,
        )  # fmt: skip

    @property
    def kind(self) -> str:
        """The sensor's name in reports."""
        return "points"

    @property
    def values(self) -> Tensor:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Positions of the points, frame of the recording, metres."""
        return self.points

    @property
    def shown(self) -> Tensor:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Mask of the points that exist; the other rows pad clouds with fewer points."""
        return self.present

    @property
    def level(self) -> bool:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Whether z points up: scans from all sides have z up, a depth sensor may be tilted."""
        return self.camera is None

    def noise(self, guess: Motion, body: BodyModel, given: float | None = None) -> Noise:
        """Noise as given or `CLOUD_NOISE`; a frame weighs no more than `CLOUD_WORTH` points."""
        del guess, body
        noise = CLOUD_NOISE if given is None else given
        count = self.present.sum(-1)
        typical = float(count[count > 0].float().median()) if bool((count > 0).any()) else 1.0
        return Noise(noise * max(typical / CLOUD_WORTH, 1.0) ** 0.5, noise)

    def shown_joints(self, estimate: Estimate) -> Bool[np.ndarray, "moments 22"]:
        """Mask (frames, 22) of the first clip's joints that have points of the cloud near them."""
        joints = estimate.scene.to_recording(estimate.body.joints)
        joints, covered = self.at_own_times(joints, estimate.motion)
        found = np.zeros((self.moments, joints.shape[-2]), dtype=bool)
        for moment in range(covered.start, covered.stop):
            points = self.points[0, moment][self.present[0, moment]]
            away = torch.cdist(joints[0, moment - covered.start], points)
            found[moment] = ((away < _FLESH).sum(-1) >= _FLESH_POINTS).cpu().numpy()
        return found

    def matched(self, estimate: Estimate) -> MatchedCloud:
        """The energy with the disc of every point and the kernel's scale fixed at an estimate."""
        with torch.no_grad():
            middles, normals, seen = self._discs_in_recording(estimate)
            pairs = torch.zeros(self.present.shape, dtype=torch.long, device=self.points.device)
            if self.present[..., seen, :].numel() > 0:
                pairs[..., seen, :] = self._nearest_discs(
                    estimate.body.model, middles, normals, seen
                )
            filled = self.present.any(-1).flatten(0, -2).any(0).nonzero()[:, 0]
            pairs = pairs[..., filled, :]
            variance, worth = self._relative_variances(filled)
            held = MatchedCloud(
                pairs, self.points[..., filled, :, :].mT.contiguous(),
                self.present[..., filled, :], variance, worth,
                SurfaceDiscs.of(self.surfels, estimate.body.model, pairs), self.surfels,
                self.kernel, tuple(filled.tolist()), self.fps, self.start_time, self.moments,
            )  # fmt: skip
            return held.with_tukey_scale(estimate) if self.kernel is tukey else held

    def __call__(self, estimate: Estimate) -> Float[Tensor, "*batch"]:
        """Energy ½ Σ kernel(distance²) over the points present, scaled to 30 Hz.

        One-way Chamfer: every point belongs to the nearest vertex of the body at its moment that
        faces the sensor. Where no vertex faces the sensor, all of them are searched.
        """
        return self.matched(estimate)(estimate)

    def residuals(self, estimate: Estimate) -> Residuals:
        """Distances of the cloud's points from the estimate's surface in all frames, metres."""
        return self.matched(estimate).residuals(estimate)

    def _relative_variances(
        self, seen: Tensor
    ) -> tuple[Float[Tensor, "*batch seen 1"], Float[Tensor, "*batch seen 1"]]:
        """Each frame's variance of distances, relative to `CLOUD_NOISE`², and each frame's weight.

        What a smooth body misses of a person is alike in a patch of the surface, of which a frame
        shows `CLOUD_WORTH`; what the sensor adds is another in each of the n points of the frame.
        So a frame tells as much as CLOUD_WORTH / (CLOUD_NOISE² + std² CLOUD_WORTH / n) does.
        """
        if self.std is None:
            one = self.points.new_ones(self.present[..., seen, :1].shape)
            return one, one
        added = (self.std / CLOUD_NOISE).square()[..., seen, None]
        count = self.present[..., seen, :].sum(-1, keepdim=True).clamp(min=CLOUD_WORTH)
        return 1 + added, (1 + added) / (1 + added * CLOUD_WORTH / count)

    def _nearest_discs(
        self, body: BodyModel, middles: Tensor, normals: Tensor, seen: slice
    ) -> Int[Tensor, "*batch seen points"]:
        """Index of the nearest surface disc of every point, among discs that face the sensor.

        Labels make discs of other parts of the body farther away. Discs that the estimate itself
        hides stay allowed: a leg that a wrong posture puts behind the other one would never get
        its points back.
        """
        points, present = self.points[..., seen, :, :], self.present[..., seen, :]
        allowed = torch.ones_like(middles[..., 0], dtype=torch.bool)
        if (eye := self.eye(range(seen.start, seen.stop))) is not None:
            allowed = are_facing_eye(middles.detach(), normals.detach(), eye)
        if self.labels is None:
            return nearest(points, present, middles, allowed)
        costs = label_features(self.labels)[..., seen, :, :]
        found = nearest_alike(
            points.flatten(0, -3), present.flatten(0, -2), costs.flatten(0, -3),
            middles.flatten(0, -3), allowed.flatten(0, -2), surfel_features(self.surfels, body),
        )  # fmt: skip
        return found.unflatten(0, present.shape[:-1])

    def _discs_in_recording(self, estimate: Estimate) -> tuple[Tensor, Tensor, slice]:
        """Disc centres and normals in the recording's frame, and the slice of frames covered."""
        (middles, normals), scene = self.surfels.posed(estimate.body), estimate.scene
        middles, seen = self.at_own_times(scene.to_recording(middles), estimate.motion)
        normals = scene.to_recording_directions(normals)
        return middles, self.at_own_times(normals, estimate.motion)[0], seen

    def eye(self, moments: range) -> Float[Tensor, "*batch moments 3"] | None:
        """Positions of the sensor at some frames, in the frame of the recording, metres.

        None for scans.
        """
        if self.camera is None:
            return None
        place = self.camera.at(moments).T_world_camera[..., :3, 3]
        return place.expand(*self.clips, len(moments), 3)

    def with_at_most_points(self, most: int) -> "PointCloud":
        """Keep at most `most` points per frame, taken evenly from the unordered points."""
        if self.points.shape[-2] <= most:
            return self
        number = torch.linspace(0, self.points.shape[-2] - 1, most).long()
        return self._with_numbered_points(number)

    def _with_numbered_points(self, number: Tensor) -> "PointCloud":
        """Return the cloud with only the points of the given indices in every frame."""
        axis = self.present.ndim - 1

        def pick(values: Tensor) -> Tensor:
            return values.index_select(axis, number.to(values.device))

        labels = None if self.labels is None else self.labels.map(pick)
        return self.derived(points=pick(self.points), present=pick(self.present), labels=labels)

    def coarse(self, body: BodyModel, step: int = 2) -> "PointCloud":
        """Return a smaller version of the cloud for a quick comparison of hypotheses.

        Few points, every `step`-th frame, few discs.
        """
        last = self.points.shape[-2] - 1
        number = torch.linspace(0, last, min(_FEW_POINTS, last + 1)).long()
        few = super().coarse(body, step)._with_numbered_points(number)
        return few.derived(surfels=Surfels.of(body, _FEW_SURFELS))

    def start(self, body: BodyModel) -> Motion:
        """First guess of the motion from body-part labels of the points; see `labelled_start`."""
        seen = self.labelled()
        assert seen.labels is not None
        return labelled_start(
            body, seen.points, seen.present, seen.labels, self.eye(range(self.moments)),
            fps=self.fps, start_time=self.start_time,
        )  # fmt: skip

    def labelled(self) -> "PointCloud":
        """Return the cloud with body-part labels, from the bundled network if it has none yet."""
        if self.labels is not None:
            return self
        level = self.ground_known or self.ground_seen
        eye = self.eye(range(self.moments))
        found = _bundled_labeller()(self.points, self.present, self.fps, eye, level=level)
        return self.derived(labels=found.to(dtype=self.points.dtype))


@cache
def _bundled_labeller() -> CloudLabeller:
    """The bundled labelling network, loaded once, when the first cloud needs it."""
    return CloudLabeller.load()


def _padded_clouds(given: Any) -> tuple[np.ndarray, np.ndarray]:
    """Pad clouds of different sizes, one per frame, to an array (frames, points, 3) and a mask.

    Args:
        given: arrays (N, 3), or clouds and meshes of Open3D, metres.

    Raises:
        ValueError: when one has no points of three coordinates, or all are empty.
    """
    several = geometries_given(given) or given
    clouds = [cloud_points(one, f"PointCloud, moment {k}") for k, one in enumerate(several)]
    most = max(map(len, clouds), default=0)
    if most == 0:
        raise ObservationError("PointCloud: expected points, but all clouds are empty")
    present = np.arange(most) < np.array([len(one) for one in clouds])[:, None]
    points = np.zeros((*present.shape, 3))
    points[present] = np.concatenate(clouds)
    return points, present

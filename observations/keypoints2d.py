"""2D keypoints.

Pixels at which a detector found points of the body in a calibrated camera's image.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from observations.checks import (
    camera_of_view,
    check_mask_shape,
    checked_clock,
    checked_indices,
    hidden_as_zero,
    masked_points,
)
from observations.correspondences import BodyPoints
from observations.fingers import checked_fingers
from observations.noise import LIMITS, estimate_noise
from observations.points import OFFSET_UNIT, PointsOfBody
from observations.start.images import image_start
from recon.body.model import BodyModel
from recon.core.arrays import Numbers, float_tensor, positive_number, require_shape
from recon.core.camera import NEAREST, Camera, Projection
from recon.core.limits import CONFIDENCE, PIXEL
from recon.core.motion import Motion
from recon.core.residuals import Noise, Unit, geman_mcclure
from recon.core.scene import Scene
from recon.method.protocols import REFERENCE_FPS, Estimate
from recon.method.quadratic import PointModel

SIGMA = 100.0
"""Pixels; HuMoR's (section 6.9)."""
FAINT = 0.2
"""Share of the greatest confidence of a clip up to which a keypoint tells nothing of a joint."""


@dataclass(frozen=True, init=False)
class Keypoints2D(PointsOfBody):
    """2D keypoints that one calibrated camera saw.

    The energy is half the robust squared distance of every keypoint from the projection of the
    same point of the body, times the square of the confidence, in pixels².
    """

    sees = "image"
    unit: ClassVar[Unit] = "pixels"
    timed = ("pixels", "confidence", "fingers")
    offset_unit: ClassVar[float] = OFFSET_UNIT
    pixels: Float[Tensor, "*batch moments points 2"]
    """Pixels without lens distortion; zero where the confidence is zero."""
    confidence: Float[Tensor, "*batch moments points"]
    """Confidence of the detector, from 0 (not seen) to 1."""
    points: BodyPoints
    """The points of the body that the keypoints are detections of."""
    camera: Camera
    """Camera without lens distortion. Its leading axes are (batch, 1) for a fixed camera and
    (batch, moments) for a moving one; its pose maps the frame of the recording to the camera."""
    fps: float
    """Rate of the moments in Hz."""
    start_time: float = 0.0
    """Time of the first moment, in seconds of the clock that all observations of a clip share."""
    sigma: float = SIGMA
    """Scale of the robust kernel in pixels: larger errors count less and less."""
    ground_known: bool = True
    """Whether the plane z = 0 of the recording is the ground."""
    offset_rows: tuple[int, int] | None = None
    """First row, and the row after the last, of `Scene.offsets` that these points own, in units
    of `OFFSET_UNIT`: constant offsets of the keypoints on this person. None estimates none."""
    focal_std: float = 0.0
    """Standard deviation of the camera's focal length as a share of it; 0 where it is known. Else
    `Scene.lens` of a fit to this one view corrects it; the camera's pose must not be known."""
    level: bool | None = False
    """Whether the z axis of the recording's frame points up where its ground is not known."""
    unit_known: bool = True
    """Whether a moving camera's translations are metres; if not, a fit corrects their unit."""
    lens: tuple[float, ...] = ()
    """Coefficients of the distortion that was taken out of the pixels, as in `Camera`; no fit
    needs them, but who draws on the image does."""
    fingers: Float[Tensor, "*batch moments 42 3"] | None = None
    """Pixels (without distortion) and confidence of `recon.core.fingers.FINGER_POINTS`, to which
    fingers are fitted after the body; zero where not seen."""

    def __init__(
        self,
        pixels: Numbers,
        confidence: Numbers,
        points: BodyPoints,
        camera: Camera,
        fps: float,
        start_time: float = 0.0,
        sigma: float = SIGMA,
        ground_known: bool = True,
        offset_rows: tuple[int, int] | None = None,
        focal_std: float = 0.0,
        level: bool = False,
        unit_known: bool = True,
        lens: tuple[float, ...] = (),
        fingers: Numbers | None = None,
    ) -> None:
        """Takes pixels (moments, keypoints, 2) without lens distortion, and their confidence.

        `confidence` is (moments, keypoints), 0 where not seen; `fps` is in Hz. Arrays of numpy
        become float32 tensors. A camera without leading axes stands still.

        Raises:
            ValueError: naming the array, what was expected and what came.
        """
        pixels, confidence = _checked_pixels(pixels, confidence)
        checked_indices("Keypoints2D", "points", points.bones, pixels.shape[-2])
        fps, start_time = checked_clock("Keypoints2D", fps, start_time)
        self._set_fields(
            pixels=pixels, confidence=confidence, points=points,
            camera=camera_of_view("Keypoints2D", camera, pixels), fps=fps, start_time=start_time,
            sigma=positive_number(sigma, "Keypoints2D.sigma"), ground_known=ground_known,
            offset_rows=offset_rows, focal_std=focal_std, level=level, unit_known=unit_known,
            lens=lens, fingers=None if fingers is None else checked_fingers(fingers, pixels, 3),
        )  # fmt: skip

    def with_constants_of(self, scene: Scene) -> "Keypoints2D":
        """Return the view with the scene's estimated focal length, then taken as known."""
        if self.focal_std == 0 or scene.lens is None:
            return self
        return self.derived(camera=scene.lens.applied_to(self.camera), focal_std=0.0)

    @property
    def values(self) -> Tensor:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Pixels of the keypoints."""
        return self.pixels

    @property
    def shown(self) -> Tensor:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Mask of the keypoints that were seen."""
        return self.confidence > 0

    @property
    def weights(self) -> Float[Tensor, "*batch moments points"]:
        """Confidences."""
        return self.confidence

    def __call__(self, estimate: Estimate) -> Float[Tensor, "*batch"]:
        """Robust energy ½ Σ c² (ρ(Δu) + ρ(Δv)), ρ(e) = σ² e² / (σ² + e²), scaled to 30 Hz.

        Twice of it is HuMoR's joints2d (section 6.5).
        """
        points, seen = super().expected(estimate)
        part = self.with_constants_of(estimate.scene)
        if points.shape[-3] < self.moments:
            part = part.derived(**part.fields_at(range(seen.start, seen.stop)))
        return part.energy(points)

    def energy(self, points: Float[Tensor, "*batch frames points 3"]) -> Float[Tensor, "*batch"]:
        """Energy of predicted points (recording's frame, metres) in all frames of the view.

        A point behind the camera counts as the farthest error.
        """
        projected = self.camera.project(points)
        error = geman_mcclure((projected.pixels - self.pixels).square(), self.sigma)
        error = torch.where(projected.in_front[..., None], error, self.sigma**2).sum(-1)
        counted = self.confidence.square() * error
        return 0.5 * counted.sum((-2, -1)) * (REFERENCE_FPS / self.fps)

    def distances(self, points: Float[Tensor, "*batch frames points 3"]) -> Tensor:
        """Pixel distances of keypoints from predicted points, in metres at the predicted depth."""
        projected = self.camera.project(points)
        focal = self.camera.camera_matrix[..., [0, 1], [0, 1]].mean()
        pixels = (projected.pixels - self.pixels).norm(dim=-1)
        return pixels * projected.depth.clamp(min=NEAREST) / focal

    def project(self, estimate: Estimate) -> tuple[Projection, slice]:
        """Project the estimate's keypoints; also return the slice of frames that it covers."""
        points, seen = super().expected(estimate)
        camera = self.with_constants_of(estimate.scene).camera
        return camera.at(range(seen.start, seen.stop)).project(points), seen

    def expected(self, estimate: Estimate) -> tuple[Float[Tensor, "*batch seen points 2"], slice]:
        """Predicted pixels of the keypoints, and the slice of frames that the estimate covers."""
        projected, seen = self.project(estimate)
        return projected.pixels, seen

    def point_model(self, points: Float[Tensor, "*batch moments points 3"]) -> PointModel:
        """Quadratic approximation of the energy near given points (recording's frame, metres)."""
        seen = self.camera.to_camera(points)
        in_front = seen[..., 2] > NEAREST
        depth = torch.where(in_front, seen[..., 2], 1.0)[..., None]
        rays = seen[..., :2] / depth
        matrix = self.camera.camera_matrix
        predicted = rays @ matrix[..., :2, :2].mT + matrix[..., None, :2, 2]
        identity = torch.eye(2, dtype=rays.dtype, device=rays.device)
        bent = torch.cat((identity.expand(*rays.shape, 2), -rays[..., None]), -1)
        jacobian = matrix[..., None, :2, :2] @ (bent / depth[..., None])
        jacobian = jacobian @ self.camera.T_camera_world[..., None, :3, :3]
        away, scale = predicted - self.pixels, self.sigma**2
        error = torch.where(in_front[..., None], geman_mcclure(away.square(), self.sigma), scale)
        counts = REFERENCE_FPS / self.fps * self.confidence.square()
        slope = (scale / (scale + away.square())).square() * (counts * in_front)[..., None]
        weighted = slope[..., None] * jacobian
        return PointModel(
            0.5 * (counts * error.sum(-1)).sum((-2, -1)),
            (away[..., None, :] @ weighted)[..., 0, :],
            jacobian.mT @ weighted,
        )

    def transformed(self, T_new_old: Float[np.ndarray, "4 4"]) -> "Keypoints2D":
        """Return the view with its camera's pose in another frame of world coordinates."""
        return self.derived(camera=self.camera.moved(T_new_old))

    def noise(self, guess: Motion, body: BodyModel, given: float | None = None) -> Noise:
        """Noise of a pixel coordinate: as given, or estimated from the keypoints' paths.

        A detector's error is taken for no smaller than a centimetre at the body, as its idea of a
        knee is not the model's.
        """
        pixel = self.pixel_size(guess, body)
        limits = (LIMITS[0] / pixel, LIMITS[1] / pixel)
        found = given or estimate_noise(self.pixels, self.shown, limits)
        return Noise(found, found * pixel)

    def pixel_size(self, guess: Motion, body: BodyModel) -> float:
        """Width of a pixel at the body, metres: median distance over focal length."""
        pelvis = body.pose(guess).joints[..., :1, :].mean(-3, keepdim=True)
        distance = float(self.camera.to_camera(pelvis)[..., 2].clamp(min=0.1).median())
        return distance / float(self.camera.camera_matrix[..., [0, 1], [0, 1]].mean())

    def coarse(self, body: BodyModel, step: int = 2) -> "Keypoints2D":
        """Return the view unchanged: its energy is cheap, so no frame is left out."""
        del body, step
        return self

    def joints_located(self, body: BodyModel) -> Bool[Tensor, "*batch frames 22"]:
        """Whether a visible keypoint locates each joint in the image, in every frame.

        Detectors place legs beyond the edge of an image, too, but do not believe in them: a
        keypoint of less than a fifth of the greatest confidence tells nothing.
        """
        greatest = self.confidence.amax((-2, -1), keepdim=True)
        sure = self.confidence > FAINT * greatest
        return super(Keypoints2D, self.derived(confidence=self.confidence * sure)).joints_located(
            body
        )

    def start(self, body: BodyModel) -> Motion:
        """The rest pose placed by the keypoints of the torso; see `image_start`."""
        return image_start(
            body, self.points, self.pixels, self.confidence, self.camera,
            fps=self.fps, start_time=self.start_time,
        )  # fmt: skip


def _checked_pixels(
    pixels: Numbers, confidence: Numbers
) -> tuple[Float[Tensor, "*batch moments points 2"], Float[Tensor, "*batch moments points"]]:
    """Check pixels and confidences (0 to 1); return them with zeros where not seen.

    Raises:
        ValueError: for other shapes, NaN or infinity where the confidence is not zero, and
            numbers that are no pixels or no confidences.
    """
    hidden = masked_points(pixels)
    pixels = float_tensor(pixels, "Keypoints2D.pixels")
    require_shape(pixels, "Keypoints2D.pixels", ("moments", "points", 2))
    confidence = float_tensor(confidence, "Keypoints2D.confidence").to(pixels)
    check_mask_shape("Keypoints2D", "pixels", pixels, "confidence", confidence)
    confidence = confidence.where(~hidden, 0.0)
    CONFIDENCE.check(confidence.detach().cpu(), "Keypoints2D", "confidence")
    pixels = hidden_as_zero("Keypoints2D", "pixels", pixels, "confidence", confidence > 0)
    PIXEL.check(pixels.detach().cpu(), "Keypoints2D", "pixels")
    return pixels, confidence

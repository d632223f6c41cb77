"""A camera that filmed the scene, with what was found in its images and where the fit puts it."""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from recon.core.camera import Camera, Projection

UNSURE = 0.3
"""Confidence below which a detected point is drawn as a ring."""


@dataclass(frozen=True)
class View:
    """One camera of a scene, fixed or moving, with the points of its images if there are any."""

    name: str
    """Shown beside the camera and above its images."""
    camera: Camera
    """The camera in the world of the figures; poses () or one per frame."""
    pixels: Float[Tensor, "time points 2"] | None = None
    """Detected points."""
    confidence: Float[Tensor, "time points"] | None = None
    """0 where a point was not detected, 1 where it is certain; None: all are certain."""
    reprojected: Projection | None = None
    """Projections of the points on the estimated body in this camera, (time, points)."""

    def __post_init__(self) -> None:
        if self.camera.T_camera_world.ndim > 3 or self.camera.camera_matrix.ndim > 3:
            raise ValueError(
                f"view {self.name!r} needs one camera, with one pose or one per frame, got poses "
                f"{tuple(self.camera.T_camera_world.shape)}; select one clip"
            )
        if self.pixels is None and (self.confidence is not None or self.reprojected is not None):
            raise ValueError(
                f"view {self.name!r} has confidences or reprojected points but no pixels; give "
                "the detected points they belong to"
            )
        shapes: dict[str, tuple[int, ...]] = {}
        if self.pixels is not None:
            shapes["pixels"] = tuple(self.pixels.shape[:2])
        if self.confidence is not None:
            shapes["confidence"] = tuple(self.confidence.shape)
        if self.reprojected is not None:
            shapes["reprojected"] = tuple(self.reprojected.depth.shape)
        if len(set(shapes.values())) > 1:
            raise ValueError(f"view {self.name!r} needs one (time, points), got {shapes}")
        counts = {shape[0] for shape in shapes.values()} | set(_poses(self.camera))
        if len(counts) > 1:
            raise ValueError(
                f"view {self.name!r} needs as many camera poses as frames, got {sorted(counts)}"
            )

    @property
    def frames(self) -> int | None:
        """Number of frames; None for a fixed camera without points, which fits any clip."""
        if self.pixels is not None:
            return len(self.pixels)
        return next(iter(_poses(self.camera)), None)

    def at(self, frame: int) -> Camera:
        """The camera as it was in one frame, in double precision."""
        camera = self.camera.detach().to(device="cpu", dtype=torch.float64)
        matrix, lens, pose = camera.camera_matrix, camera.distortion, camera.T_camera_world
        return camera.derived(
            camera_matrix=matrix[frame] if matrix.ndim == 3 else matrix,
            distortion=lens[frame] if lens is not None and lens.ndim == 2 else lens,
            T_camera_world=pose[frame] if pose.ndim == 3 else pose,
        )

    @property
    def certainty(self) -> Float[Tensor, "time points"]:
        """Confidence of the detected points, between 0 and 1."""
        if self.pixels is None:
            return torch.zeros(0, 0)
        if self.confidence is None:
            return torch.ones(self.pixels.shape[:2])
        return self.confidence.detach().cpu().clamp(0, 1).float()

    @property
    def missing(self) -> Bool[Tensor, "time points"]:
        """Points that were not detected."""
        return self.certainty == 0

    @property
    def median_error(self) -> float | None:
        """Median distance of detected to reprojected points, pixels; rings do not count."""
        if self.pixels is None or self.reprojected is None:
            return None
        counted = (self.certainty >= UNSURE) & self.reprojected.in_front.cpu()
        if not bool(counted.any()):
            return None
        error = (self.pixels - self.reprojected.pixels).detach().cpu().norm(dim=-1)
        return float(error[counted].median())


def nearest_samples(
    times: Float[Tensor, " frames"], observed_at: Float[Tensor, " time"]
) -> tuple[Int[Tensor, " frames"], Bool[Tensor, " frames"]]:
    """The sample nearest to every moment, and whether it is at most half a sample away."""
    gap = (times[:, None].double() - observed_at[None].double()).abs()
    distance, nearest = gap.min(1)
    step = observed_at.double().diff().median() if len(observed_at) > 1 else gap.new_tensor(0)
    return nearest, distance <= 0.5 * step + 1e-6


def _poses(camera: Camera) -> set[int]:
    """Numbers of frames that the camera's tensors have, those of a fixed one left out."""
    tensors = (camera.camera_matrix, camera.distortion, camera.T_camera_world)
    dims = (3, 2, 3)
    return {
        len(tensor)
        for tensor, dim in zip(tensors, dims, strict=True)
        if tensor is not None and tensor.ndim == dim
    }

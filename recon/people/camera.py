"""Finds one camera pose, lens and ground for several people, from a fit of each alone."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from recon.api.result import Result
from recon.body.identities import nearest_shape
from recon.body.soles import Soles
from recon.core.motion import Motion
from recon.fitting.ground import camera_above
from recon.method.sensor import views_of

_SIZE = 0.02
"""Standard deviation of the logarithm of a person's size, and so of the distance from the camera,
beside what the fit of each alone says. Of 0.05, 0.03 and 0.02 the one that kept most of 22
training people within 1.1 times their errors alone and 5 % of their sizes; with 0.05 up is 1 to 3
degrees nearer to the truth, as sizes that differ tilt the ground otherwise."""
_UPRIGHT = 0.1
"""Standard deviation of the direction up that one person's posture tells, radians; runners lean by
0.2, and what cartwheels tell is far off and counts less and less."""
_LEVEL = 0.01
"""The same where straight lines of a film tell which way is up."""
_ON_GROUND = 0.015
"""Standard deviation of the height of a person's soles above the ground, metres."""
_PLACES = 20
"""Frames of a person whose soles are laid on the ground."""


@dataclass(frozen=True)
class SharedCamera:
    """The camera that filmed several people: intrinsics, pose above z = 0, and first guesses."""

    matrix: Float[Tensor, "3 3"]
    T_camera_world: Float[Tensor, "4 4"]
    starts: tuple[Motion, ...]
    """First guess of everybody's motion in that world; size and distance are scaled alike."""
    description: str
    """What was found, in a sentence."""


@dataclass(frozen=True)
class _SingleFit:
    """One person's separate fit, with what is compared: lens, depth, up axis, sole points."""

    result: Result
    focal: float
    depth: float
    """Mean distance of the pelvis along the viewing axis, metres."""
    up: Float[np.ndarray, "3"]
    places: Float[np.ndarray, "places 3"]
    """Lowest points of the soles in frames spread over the clip, metres: what was found to be up
    has no part in them, so that who runs uphill by it tells that it is wrong."""

    @classmethod
    def of(cls, result: Result) -> "_SingleFit":
        """Extract focal length, depth, up axis and sole points (camera frame) from a result."""
        (view,) = views_of(result.examined.fit.observations)
        T = result.T_world_camera
        assert T is not None
        back = torch.linalg.inv(T.double()).numpy()
        pelvis = result.joints[:, 0].double().numpy()
        rows = np.linspace(0, len(pelvis) - 1, min(_PLACES, len(pelvis))).round().astype(int)
        soles = result.body.pose(result.motion).points(Soles.of(result.body).points.flatten())
        points = soles.detach().double().numpy()[rows]
        below = points[np.arange(len(rows)), points[..., 2].argmin(1)]
        depth = (pelvis @ back[:3, :3].T + back[:3, 3])[:, 2].mean()
        return cls(
            result=result,
            focal=float(view.camera.camera_matrix[0, ..., 0, 0].mean()),
            depth=float(depth),
            up=back[:3, 2],
            places=below @ back[:3, :3].T + back[:3, 3],
        )

    def places_for(self, focal: float) -> Float[np.ndarray, "places 3"]:
        """Return the sole points (m) for another focal length, which moves them in depth."""
        return self.places + np.array([0.0, 0.0, (focal / self.focal - 1) * self.depth])


def shared_camera(results: Sequence[Result]) -> SharedCamera:
    """Find the camera that agrees best with the separate fits of several people.

    Focal lengths are averaged. The ground is fitted to the lowest points of all people and to the
    upward direction of each posture; every person's distance and size may be scaled together
    within the usual variation of body sizes.

    Args:
        results: fits to one camera of unknown pose, one per person.
    """
    alone = [_SingleFit.of(one) for one in results]
    seen = np.array([one.motion.frames for one in results], float)
    focal = float(np.exp(np.average([np.log(one.focal) for one in alone], weights=seen)))
    places = [one.places_for(focal) for one in alone]
    (view,) = views_of(results[0].examined.fit.observations)
    upright = _LEVEL if view.level else _UPRIGHT
    normal, above, factors = _common_ground(places, [one.up for one in alone], upright)
    T_world_camera = camera_above((*normal.tolist(), -above))
    T = torch.from_numpy(T_world_camera)
    starts = tuple(
        _motion_in_shared_world(one, T_world_camera, focal, float(factor), spots)
        for one, factor, spots in zip(alone, factors, places, strict=True)
    )
    matrix = view.camera.camera_matrix.reshape(-1, 3, 3)[0].double().cpu()
    zoomed = matrix.clone()
    zoomed[:2, :2] *= focal / alone[0].focal
    tilts = [np.degrees(np.arccos(np.clip(one.up @ normal, -1, 1))) for one in alone]
    return SharedCamera(
        matrix=zoomed.float(),
        T_camera_world=torch.linalg.inv(T).float(),
        starts=starts,
        description=(
            f"one camera for {len(alone)} people: {above:.2f} m above the ground, focal length "
            f"{focal:.0f} pixels (fitted each alone: "
            + ", ".join(f"{one.focal:.0f}" for one in alone)
            + "; their distances were multiplied by "
            + ", ".join(f"{factor:.2f}" for factor in factors)
            + "; their up directions differ from the shared one by "
            + ", ".join(f"{tilt:.1f}" for tilt in tilts) + " degrees)"
        ),
    )  # fmt: skip


def _common_ground(
    places: Sequence[Float[np.ndarray, "places 3"]],
    ups: Sequence[Float[np.ndarray, "3"]],
    upright: float,
) -> tuple[Float[np.ndarray, "3"], float, Float[np.ndarray, " people"]]:
    """Fit ground normal, height of the camera above it (m), and each person's distance factor.

    Args:
        places: lowest points of everybody's soles, metres.
        ups: what each fit takes for up.
        upright: standard deviation of these, radians.
    """
    from scipy.optimize import least_squares

    mean = np.mean(ups, axis=0)
    mean /= np.linalg.norm(mean)
    side = np.linalg.svd(mean[None])[2][1:]

    def ground_and_factors(x: np.ndarray) -> tuple[np.ndarray, float, np.ndarray]:
        normal = mean + x[:2] @ side
        return normal / np.linalg.norm(normal), float(np.exp(x[2])), np.exp(x[3:])

    def residuals(x: np.ndarray) -> np.ndarray:
        normal, altitude, factors = ground_and_factors(x)
        out = [x[3:] / _SIZE]
        for spots, up, factor in zip(places, ups, factors, strict=True):
            # heights are divided by the person's scale: else the smallest scales would fit best
            height = (spots @ normal + altitude / factor) / _ON_GROUND
            # heights above the ground, as of people who jump, count robustly, others in full
            height = np.where(height > 0, _pseudo_huber_residual(height), height)
            out.append(height / np.sqrt(len(spots)))
            lean = (up - normal) / upright
            size = np.linalg.norm(lean)
            out.append(lean * _pseudo_huber_residual(size) / max(size, 1e-9))
        return np.concatenate(out)

    altitude = max(float(np.mean([-(spots @ mean).min() for spots in places])), 0.1)
    found = least_squares(residuals, np.array([0.0, 0.0, np.log(altitude), *[0.0] * len(places)]))
    return ground_and_factors(found.x)


def _pseudo_huber_residual(residual: Any) -> Any:
    """Transform residuals so that half their squares are the pseudo-Huber loss (scale 1)."""
    return np.sqrt(2 * (np.sqrt(1 + np.square(residual)) - 1))


def _motion_in_shared_world(
    fit: _SingleFit,
    T_world_camera: Float[np.ndarray, "4 4"],
    focal: float,
    factor: float,
    places: Float[np.ndarray, "places 3"],
) -> Motion:
    """Transform a person's motion to the world of the shared camera, scaled by `factor`."""
    assert fit.result.T_world_camera is not None
    shift = np.eye(4)
    shift[:3, 3] = (0.0, 0.0, (focal / fit.focal - 1) * fit.depth)
    shift[:3, 3] += (factor - 1) * places.mean(0)
    T = T_world_camera @ shift @ np.linalg.inv(fit.result.T_world_camera.double().numpy())
    motion, body = fit.result.motion, fit.result.body
    carried = motion.carried(
        torch.from_numpy(T).to(motion.translation), body.rest_joints(motion.shape)[0]
    )
    every_direction = torch.eye(body.shape_size).to(motion.shape)
    tall = factor * float(body.height(motion.shape))
    shape = nearest_shape(motion.shape, (body.height,), (tall,), every_direction)
    return carried.replace(shape=shape)

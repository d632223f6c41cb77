"""A known motion as a network that looks at video would have told it, with the errors it makes.

Such networks are biased rather than noisy: joints are turned wrongly for seconds, limbs that are
hidden are guessed, left and right are exchanged for a moment, feet slide, and the path drifts.
"""

from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Generator, Tensor

from recon.core import rotations as so3
from recon.core.motion import Motion
from recon.core.skeleton import JOINTS, MIRROR

_LEGS = tuple(
    k for k, name in enumerate(JOINTS) if any(part in name for part in ("hip", "knee", "ankle"))
)
_LIMBS = tuple(
    tuple(JOINTS.index(f"{side}_{part}") for part in parts)
    for side in ("left", "right")
    for parts in (("hip", "knee", "ankle", "foot"), ("shoulder", "elbow", "wrist"))
)


@dataclass(frozen=True)
class RegressorErrors:
    """Sizes of the errors; the defaults are near what is published of networks on video.

    They give about 7 cm of joints after aligning the pelvis and 10 m/s² of acceleration, between
    what is published of networks that see a clip (WHAM, GVHMR on EMDB: 6 to 8 cm, 4 to 6 m/s²)
    and of those that see a frame (HMR 2.0: 7 to 12 cm, 18 to 25 m/s²).
    """

    bias: float = 0.05
    """Constant error of every joint's rotation, standard deviation per axis, radians."""
    slow: float = 0.05
    """Error of every joint's rotation that changes slowly, radians."""
    slow_seconds: float = 0.7
    """Time after which the correlation of what changes slowly has fallen to one half."""
    jitter: float = 0.006
    """Error of every joint's rotation that is another in every frame at 30 Hz, radians."""
    heading: float = 0.02
    """Drift of the heading, radians for every square root of a second."""
    drift: float = 0.08
    """Standard deviation per axis of the error of the path's velocity, m/s."""
    drift_seconds: float = 1.0
    """Time after which its correlation has fallen to one half."""
    place_jitter: float = 0.003
    """Error of the place that is another in every frame, metres per axis."""
    swaps: float = 0.1
    """Exchanges of the legs per second, each of 0.1 to 0.2 s."""
    occlusion: float = 1.0
    """Seconds for which one limb is hidden: it keeps its posture of the first moment."""
    occluded: float = 2.0
    """How many times as much its joints err then."""

    def scaled(self, factor: float) -> "RegressorErrors":
        """All angles and lengths multiplied."""
        return replace(
            self,
            **{
                name: factor * getattr(self, name)
                for name in ("bias", "slow", "jitter", "heading", "drift", "place_jitter")
            },
        )


def estimated(motion: Motion, errors: RegressorErrors, seed: int = 0) -> Motion:
    """The motion of one clip (no leading axis) as a network would have told it.

    Args:
        motion: the truth.
        errors: what the network gets wrong.
        seed: of the errors.
    """
    generator = torch.Generator().manual_seed(seed)
    frames, fps = motion.frames, motion.fps
    like = motion.translation

    def normal(*shape: int) -> Tensor:
        return torch.randn(*shape, generator=generator, dtype=torch.float64).to(like)

    turns = errors.bias * normal(1, len(JOINTS), 3)
    wander = errors.slow * _wander(normal(frames, len(JOINTS), 3), fps, errors.slow_seconds)
    shake = errors.jitter * normal(frames, len(JOINTS), 3)
    rotations, blame = _occluded(motion, errors, generator)
    rotations = _swapped(rotations, errors, fps, generator)
    rotations = rotations @ so3.exp((turns + wander) * blame[..., None] + shake)
    heading = (errors.heading / fps**0.5 * normal(frames)).cumsum(0)
    about = so3.about_z(heading)
    rotations = torch.cat((about[:, None] @ rotations[:, :1], rotations[:, 1:]), 1)
    velocity = errors.drift * _wander(normal(frames, 3), fps, errors.drift_seconds)
    steps = (about[:-1] @ motion.translation.diff(dim=0)[..., None])[..., 0]
    path = torch.cat((motion.translation[:1], motion.translation[:1] + steps.cumsum(0)))
    path = path + velocity.cumsum(0) / fps + errors.place_jitter * normal(frames, 3)
    return motion.replace(translation=path, rotations=rotations)


def _wander(
    white: Float[Tensor, "time ..."], fps: float, seconds: float
) -> Float[Tensor, "time ..."]:
    """Unit noise that changes smoothly (Matérn's of smoothness 3/2), from unit white noise."""
    times = torch.arange(len(white), dtype=torch.float64) / fps
    away = 3**0.5 * (times[:, None] - times).abs() / seconds
    covariance = (1 + away) * (-away).exp()
    root = torch.linalg.cholesky(covariance + 1e-9 * torch.eye(len(white), dtype=torch.float64))
    return torch.einsum("ts,s...->t...", root.to(white), white)


def _occluded(
    motion: Motion, errors: RegressorErrors, generator: Generator
) -> tuple[Float[Tensor, "time 22 3 3"], Float[Tensor, "time 22"]]:
    """One limb hidden for a while, and how many times as much every joint errs."""
    rotations, blame = motion.rotations.clone(), motion.translation.new_ones(motion.frames, 22)
    length = round(errors.occlusion * motion.fps)
    if not 0 < length < motion.frames:
        return rotations, blame
    first = int(torch.randint(motion.frames - length, (), generator=generator))
    limb = list(_LIMBS[int(torch.randint(len(_LIMBS), (), generator=generator))])
    rotations[first : first + length, limb] = rotations[first, limb]
    blame[first : first + length, limb] = errors.occluded
    return rotations, blame


def _swapped(
    rotations: Float[Tensor, "time 22 3 3"],
    errors: RegressorErrors,
    fps: float,
    generator: Generator,
) -> Float[Tensor, "time 22 3 3"]:
    """The legs exchanged for moments: each does what the other does, mirrored."""
    swapped = rotations.clone()
    flip = torch.tensor([-1.0, 1.0, 1.0]).to(rotations)
    mirrored = (flip[:, None] * rotations * flip)[:, list(MIRROR)]
    for start in range(len(rotations)):
        if float(torch.rand((), generator=generator)) < errors.swaps / fps:
            length = float(torch.rand((), generator=generator)) * 0.1 + 0.1
            frames = slice(start, start + max(round(length * fps), 1))
            swapped[frames, list(_LEGS)] = mirrored[frames, list(_LEGS)]
    return swapped

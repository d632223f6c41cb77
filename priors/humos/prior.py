"""HUMOS: motions as latent codes, decoded for a given body shape (Tripathi et al. 2024).

Codes and a shape decode to frames at 20 Hz that stand on the ground whoever performs them; beside
the codes there are details, which the codes leave out. Encoding is exact, so another shape in the
variables of a motion is the same motion as another body performs it.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from priors.cosines import cosines
from priors.humos.frames import (
    BodyFrames,
    existing_windows,
    lever_lengths,
    lowest_heights,
    rotation_about_vertical,
    window_count,
)
from priors.humos.networks import HumosWeights, load_weights
from recon.body.model import BodyModel
from recon.body.motion_files import leg_length
from recon.core import rotations as so3
from recon.core.errors import ReconError, WeightsError
from recon.core.motion import Motion
from recon.core.plugins import imported_object
from recon.core.struct import TensorStruct
from recon.method.priors import USUAL_NOISE, Prior
from recon.method.protocols import Decoded
from recon.method.stages import Stage
from recon.method.terms import Term

FPS = 20.0
"""Frames per second of the codes."""
TURN, PLACE = 0.2, 0.1
"""Radians and metres that one unit of the variables of placement stands for."""
_BEND, _SHIFT, _LIFT = 0.015, 0.01, 0.006
"""Standard deviations of details: metres at the end of a bone per axis; of the place and of the
clearance, in lengths of leg."""
_SLOW = 4.0
"""Hz from which on details are ever less likely."""


@dataclass(frozen=True)
class HumosVariables(TensorStruct):
    """Variables of the HUMOS prior: latent codes and details, one motion per clip."""

    latent: Float[Tensor, "*batch memory latent"]
    """Whitened codes of windows of time, 0.4 s apart."""
    shape: Float[Tensor, "*batch shape"]
    turn: Float[Tensor, "*batch"]
    """Rotation of the heading from `base`."""
    place: Float[Tensor, "*batch 2"]
    """Translation on the ground from `base`."""
    bend: Float[Tensor, "*batch time 22 3"]
    """Details of the orientations, in scaled cosines of time."""
    shift: Float[Tensor, "*batch time 3"]
    """Details of the position on the ground and of the height, in scaled cosines of time."""
    base: Float[Tensor, "*batch 4 4"]
    """T_world_frames before the steps, metres."""
    valid: Bool[Tensor, "*batch time"]
    fps: float
    start_time: float

    def carried(self, T: Float[Tensor, "*batch 4 4"], body: BodyModel) -> "HumosVariables":
        """Return variables of the motion moved by `T`, which must keep the vertical axis."""
        del body
        ahead = torch.nn.functional.pad(self.place, (0, 1))
        place = (T[..., :3, :3] @ ahead[..., None])[..., :2, 0]
        return self.replace(base=T @ self.base, place=place)


@dataclass(frozen=True)
class Humos(Prior[HumosVariables]):
    """The HUMOS prior: motions as latent codes that are decoded for a given body shape.

    Latent codes of windows of 0.8 s, with the density of recorded sequences.
    """

    weights: HumosWeights
    body: BodyModel

    @classmethod
    def load(cls, weights: str = "open", body: BodyModel | None = None) -> "Humos":
        """Load the bundled weights (`open`) or a file.

        Raises:
            FileNotFoundError: when there is no such file.
            ValueError: when it holds something else, or the body is not the bundled one.
        """
        body = BodyModel.load() if body is None else body.to(device="cpu")
        found = load_weights(weights)
        if body.checksum != BodyModel.load().checksum:
            raise ReconError(
                f"the HUMOS weights need the bundled body, got {body.name!r}; fit a motion "
                "of the bundled body first, or take the prior `humor`"
            )
        return cls(found, body)

    def stages(
        self,
        data: tuple[Term, ...],
        noise: float = USUAL_NOISE,
        body: BodyModel | None = None,
        method: str | None = None,
    ) -> tuple[Stage[Any], ...]:
        """The stages that fit the whole motion (`priors.humos.collocation`).

        Raises:
            WeightsError: when the body is not on the processor.
        """
        del method
        if body is not None and body.template.device.type != "cpu":
            raise WeightsError("the HUMOS prior runs on the CPU alone: leave --device at cpu")
        fitted = imported_object("priors.humos.collocation:CollocatedHumos", "method")
        return fitted(self).stages(data, noise)

    def encode(self, motion: Motion) -> HumosVariables:
        """Encode each clip as mean latent codes plus corrections that make decoding exact.

        Raises:
            ValueError: when the clips are longer than networks of one code per clip know.
        """
        coarse = at_network_rate(motion)
        frames, base = BodyFrames.of(coarse, self.body)
        exists = self.exists(motion.valid, motion.fps)
        with torch.no_grad():
            codes, _ = self.weights.networks.posterior(frames.pack(), motion.shape, exists)
        zero = torch.zeros_like(motion.rotations[..., 0])
        plain = HumosVariables(
            latent=self.weights.density.whitened(codes),
            shape=motion.shape,
            turn=zero[..., 0, 0, 0],
            place=zero[..., 0, 0, :2],
            bend=zero,
            shift=zero[..., 0, :],
            base=base,
            valid=motion.valid,
            fps=motion.fps,
            start_time=motion.start_time,
        )
        return self._corrected_towards(plain, motion)

    def decode(self, variables: HumosVariables) -> Decoded:
        """Return the motion in the clip's frames, and the parts of -log p.

        `latent` is that of codes following each other, `shape` and `details` are half squared
        Mahalanobis distances.
        """
        made = self.decoded_frames(variables)
        waves = _scaled_cosines(made.clearance.shape[-1], variables.fps)[0].to(variables.bend)
        steps = (waves @ variables.bend.flatten(-2)).unflatten(-1, (-1, 3))
        shift = waves @ variables.shift
        detailed = made.replace(
            orientations=made.orientations @ so3.exp(_sizes_of_corrections().to(steps) * steps),
            place=made.place + _SHIFT * shift[..., :2],
            clearance=made.clearance + _LIFT * shift[..., 2],
        )
        motion = detailed.motion(
            variables.shape, self.body, variables.fps, self._T_world_start(variables)
        )
        energies = {
            "latent": self.weights.density.energy(
                variables.latent, self.exists(variables.valid, variables.fps)
            ),
            "shape": 0.5 * variables.shape.square().sum(-1),
            "details": 0.5
            * (variables.bend.square().sum((-1, -2, -3)) + variables.shift.square().sum((-1, -2))),
        }
        return Decoded(
            motion.replace(valid=variables.valid, start_time=variables.start_time), energies
        )

    def decoded_frames(self, variables: HumosVariables) -> BodyFrames:
        """Frames decoded from the latent codes without details, relative to the first frame."""
        count = variables.valid.shape[-1]
        codes = self.weights.density.codes(variables.latent)
        coarse = count_at_network_rate(count, variables.fps)
        exists = self.exists(variables.valid, variables.fps)
        rows = self.weights.networks.decode(codes, variables.shape, exists, coarse)
        return BodyFrames.unpack(spline_matrix(coarse, count, variables.fps).to(rows) @ rows)

    def sample(
        self, shape: Float[Tensor, "clips shape"], seconds: float, generator: torch.Generator
    ) -> Motion:
        """Draw random motions at 20 Hz for bodies of given shapes, beginning at the origin.

        Raises:
            ValueError: when they would be shorter than a second.
        """
        if not 1 <= seconds < float("inf"):
            raise ReconError(f"expected at least 1 second, got {seconds:g}; ask for more")
        frames = round(seconds * FPS) + 1
        codes = self.weights.density.drawn_codes(len(shape), window_count(frames), generator)
        exists = torch.ones(len(shape), window_count(frames), dtype=torch.bool)
        with torch.no_grad():
            rows = self.weights.networks.decode(codes, shape, exists, frames)
        base = torch.eye(4).expand(len(shape), 4, 4)
        made = BodyFrames.unpack(rows)
        return made.motion(shape, self.body, FPS, base)

    def _corrected_towards(self, variables: HumosVariables, motion: Motion) -> HumosVariables:
        """Set `bend` and `shift` of the variables so that they decode to the given motion."""
        made, posed, base = (
            self.decoded_frames(variables),
            self.body.pose(motion),
            self._T_world_start(variables),
        )
        turn = base[..., None, :3, :3] @ rotation_about_vertical(made.direction)
        own = (turn[..., None, :, :] @ made.orientations).mT
        steps = so3.log(own @ posed.orientations) / _sizes_of_corrections().to(posed.joints)
        legs = leg_length(self.body, motion.shape)[..., None]
        pelvis = (posed.joints[..., 0, :] - base[..., None, :3, 3]) @ base[..., :3, :3]
        place = (pelvis[..., :2] / legs[..., None] - made.place) / _SHIFT
        lift = (lowest_heights(posed) / legs - made.clearance)[..., None] / _LIFT
        inverse = _scaled_cosines(motion.frames, variables.fps)[1].to(variables.bend)
        return variables.replace(
            bend=(inverse @ steps.flatten(-2)).unflatten(-1, (-1, 3)),
            shift=inverse @ torch.cat((place, lift), -1),
        )

    def _T_world_start(self, variables: HumosVariables) -> Float[Tensor, "*batch 4 4"]:
        turn = variables.base[..., :3, :3] @ so3.about_z(TURN * variables.turn)
        ahead = torch.nn.functional.pad(PLACE * variables.place, (0, 1))
        return so3.rigid(turn, variables.base[..., :3, 3] + ahead)

    def exists(
        self, valid: Bool[Tensor, "*batch time"], fps: float
    ) -> Bool[Tensor, "*batch windows"]:
        """Mask of windows with at least one valid frame."""
        count = ((valid.sum(-1, keepdim=True) - 1) * (FPS / fps)).ceil().long() + 1
        return existing_windows(count, count_at_network_rate(valid.shape[-1], fps))


@lru_cache(maxsize=1)
def _sizes_of_corrections() -> Float[Tensor, "22 1"]:
    """Standard deviation of the corrections to every bone's rotation, radians."""
    return _BEND / lever_lengths()[:, None]


def count_at_network_rate(frames: int, fps: float) -> int:
    """Number of frames at 20 Hz that cover a given number of frames at another rate."""
    return int(np.ceil((frames - 1) * FPS / fps - 1e-6)) + 1


def at_network_rate(motion: Motion) -> Motion:
    """The motion resampled to 20 Hz; the last frame is repeated to fill the last interval."""
    count = count_at_network_rate(motion.frames, motion.fps)
    times = motion.start_time + torch.arange(count, dtype=torch.float64) / FPS
    return motion.at(times.clamp(max=float(motion.times[-1])), FPS)


@lru_cache(maxsize=16)
def spline_matrix(coarse: int, frames: int, fps: float) -> Float[Tensor, "frames coarse"]:
    """Matrix from rows at 20 Hz to rows at another rate: the natural cubic spline through them."""
    if fps == FPS:
        return torch.eye(coarse)[:frames]
    from scipy.interpolate import CubicSpline

    through = CubicSpline(np.arange(coarse) / FPS, np.eye(coarse), bc_type="natural")
    return torch.from_numpy(through(np.arange(frames) / fps)).float()


@lru_cache(maxsize=16)
def _scaled_cosines(frames: int, fps: float) -> tuple[Tensor, Tensor]:
    """Matrix of cosines over frames, scaled to corrections' expected size, and its inverse.

    Together they have unit variance in every frame.
    """
    waves = cosines(frames, frames)
    hertz = torch.arange(frames) * fps / (2 * frames)
    size = 1 / (1 + (hertz / _SLOW) ** 2)
    size = size * frames**0.5 / size.norm()
    return (waves * size).float(), (waves / size).mT.float()

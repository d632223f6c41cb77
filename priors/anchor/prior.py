"""The anchor-frame prior: a whole cycle of motion as one latent code (Marsot et al. 2022).

A code and a shape decode to 100 anchors with their times; a rigid transform puts them into the
world, and reading them at even moments gives the motion. So data at any times meet the prior, and
what the duration of the cycle is, they tell as well.
"""

from dataclasses import dataclass, replace
from typing import Any

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from priors.anchor.frames import ANCHORS, POSED, Anchors, rest_pelvis
from priors.anchor.networks import AnchorWeights, load_weights
from priors.cosines import cosines
from recon.body.model import BodyModel
from recon.core import rotations as so3
from recon.core.errors import ReconError
from recon.core.motion import Motion
from recon.core.struct import TensorStruct, stack
from recon.method.cycle_prior import CyclePrior
from recon.method.protocols import Decoded
from recon.method.stages import Stage
from recon.method.terms import Term, prior_energy
from recon.solver.lbfgs import LBFGS

MODES = 16
"""Cosines of time that details may have."""
TURN, PLACE, BEGIN = 0.2, 0.1, 0.05
"""Radians, metres and seconds that one unit of the variables of placement stands for."""
_BEND, _SHIFT = 0.08, 0.02
"""Standard deviations of the slowest details: radians per joint and axis, metres."""
_FAST = 4
"""Cosines beyond which details are ever less likely."""
_ENDS = 0.02
"""Seconds by which the ends of cycle and recording are apart."""
_PLACING = frozenset({"turn", "place"})
_CYCLE = _PLACING | {"latent", "begin"}
_BODY = _CYCLE | {"shape"}
_SINK = 0.03
"""Metres by which soles may be above or below the ground."""


@dataclass(frozen=True)
class AnchorVariables(TensorStruct):
    """Variables of the anchor-frame prior: one cycle of gait per clip."""

    latent: Float[Tensor, "*batch latent"]
    """Whitened code: z = mean + root · latent."""
    shape: Float[Tensor, "*batch shape"]
    turn: Float[Tensor, "*batch 1"]
    """Rotation of the cycle from `base` about the vertical."""
    place: Float[Tensor, "*batch 3"]
    """Translation of the cycle from `base`."""
    begin: Float[Tensor, "*batch"]
    """Time from the first moment to the beginning of the cycle."""
    bend: Float[Tensor, "*batch modes 60"]
    """Details of the 20 joints that no code has, in scaled cosines of time."""
    shift: Float[Tensor, "*batch modes 3"]
    """Details of the translation that no code has, in scaled cosines of time."""
    base: Float[Tensor, "*batch 4 4"]
    """T_world_cycle before the steps, metres."""
    valid: Bool[Tensor, "*batch time"]
    fps: float
    start_time: float

    def carried(self, T: Float[Tensor, "*batch 4 4"], body: BodyModel) -> "AnchorVariables":
        """Variables of the same motion after a rigid transform."""
        del body
        place = (T[..., :3, :3] @ self.place[..., None])[..., 0]
        return self.replace(base=T @ self.base, place=place)


@dataclass(frozen=True)
class AnchorFrames(CyclePrior[AnchorVariables]):
    """The prior of whole gait cycles: normally distributed codes, small slow corrections."""

    weights: AnchorWeights
    body: BodyModel

    @classmethod
    def load(cls, weights: str = "open", body: BodyModel | None = None) -> "AnchorFrames":
        """Load the bundled weights (`open`) or a file.

        Raises:
            FileNotFoundError: when there is no such file.
            ValueError: when it holds something else, or the body has other shape coefficients.
        """
        body = BodyModel.load() if body is None else body
        found = load_weights(weights)
        expected = found.networks.shape
        if body.shape_size != expected:
            raise ReconError(
                f"the anchor weights are for bodies with {expected} shape coefficients, "
                f"{body.name!r} has {body.shape_size}; train weights for it"
            )
        return cls(found, body)

    @property
    def code_size(self) -> int:
        """Dimension of a latent code."""
        return self.weights.networks.latent

    @property
    def typical(self) -> Float[Tensor, "typical latent"]:
        """Latent codes of a few different recorded cycles, from which a fit's search starts."""
        return self.weights.spread.typical

    def paths(self, shape: Float[Tensor, " shape"]) -> Float[Tensor, "typical 100 3"]:
        """The pelvis' path in each typical cycle at 100 evenly spaced times, metres."""
        rows = self.weights.networks.decode(self.typical, shape.expand(len(self.typical), -1))
        return rows[..., -4:-1] + rest_pelvis(self.body, shape)

    def search(self, data: tuple[Term, ...], noise: float) -> tuple[Stage[Any], ...]:
        """Return the stages of a quick fit by which hypotheses of the cycle are ranked.

        Place and heading, then the latent code.
        """
        return (
            self._stage("place", data, noise, _PLACING, LBFGS(12)),
            self._stage("rough", data, noise, _CYCLE, LBFGS(30)),
        )

    def coded(self, data: tuple[Term, ...], noise: float) -> tuple[Stage[Any], ...]:
        """Return two stages: one over place, time and latent code, one with the shape as well."""
        return (
            self._stage("cycle", data, noise, _CYCLE, LBFGS(30, tolerance_decrease=1e-4)),
            self._stage("body", data, noise, _BODY, LBFGS(60, tolerance_decrease=1e-5)),
        )

    def details(self, data: tuple[Term, ...], noise: float) -> tuple[Stage[Any], ...]:
        """Return the last stage, for dense data, which adds corrections to the decoded cycle."""
        minimiser = LBFGS(60, tolerance_decrease=1e-5)
        stage = self._stage("details", data, noise, _BODY | {"bend", "shift"}, minimiser)
        penalty = Term("details", prior_energy("details"), noise**2)
        return (replace(stage, terms=(*stage.terms, penalty)),)

    def _stage(
        self,
        name: str,
        data: tuple[Term, ...],
        noise: float,
        free: frozenset[str],
        minimiser: LBFGS,
    ) -> Stage[AnchorVariables]:
        """Build a stage of data terms and the prior's energies (-log p in nats, times noise²)."""
        weights = {"latent": 1.0, "shape": 1.0, "ends": _ENDS**-2, "sink": 1.0}
        likely = (Term(one, prior_energy(one), w * noise**2) for one, w in weights.items())
        return Stage(name, self, (*data, *likely), free, minimiser)

    def encode(self, motion: Motion) -> AnchorVariables:
        """Return variables with the latent code of each clip, taken as one whole gait cycle.

        Details are what the decoder leaves out, as far as they are slow: of a recorded cycle
        they are left at zero, since it is codes that are looked for.
        """
        clips = [
            motion[row].window(0, int(count)) for row, count in enumerate(motion.valid.sum(-1))
        ]
        anchors = stack([Anchors.of(clip) for clip in clips])
        pelvis = rest_pelvis(self.body, motion.shape)
        aligned, T = anchors.aligned(pelvis)
        with torch.no_grad():
            mean, _ = self.weights.networks.posterior(aligned.pack())
        return self.variables(mean, motion.shape, T, motion.valid, motion.fps, motion.start_time)

    def variables(
        self,
        codes: Float[Tensor, "*batch latent"],
        shape: Float[Tensor, "*batch shape"],
        base: Float[Tensor, "*batch 4 4"],
        valid: Bool[Tensor, "*batch time"],
        fps: float,
        start_time: float = 0.0,
    ) -> AnchorVariables:
        """Variables of cycles with given latent codes, at given places in the world and times."""
        spread = self.weights.spread
        away = (codes - spread.mean)[..., None]
        latent = torch.linalg.solve_triangular(spread.root, away, upper=False)[..., 0]
        zero = torch.zeros_like(latent[..., :1])
        return AnchorVariables(
            latent=latent,
            shape=shape,
            turn=zero,
            place=zero.repeat_interleave(3, -1),
            begin=zero[..., 0],
            bend=zero[..., None].expand(*zero.shape[:-1], MODES, 3 * len(POSED)).clone(),
            shift=zero[..., None].expand(*zero.shape[:-1], MODES, 3).clone(),
            base=base,
            valid=valid,
            fps=fps,
            start_time=start_time,
        )

    def anchors(self, variables: AnchorVariables) -> Anchors:
        """The decoded cycles in the world, without the corrections."""
        anchors = Anchors.unpack(self.rows(variables))
        return anchors.carried(
            self._T_world_cycle(variables), rest_pelvis(self.body, variables.shape)
        )

    def rows(self, variables: AnchorVariables) -> Float[Tensor, "*batch 100 124"]:
        """Rows (`Anchors.pack`) of the decoded anchors, in the frame of the first anchor."""
        spread = self.weights.spread
        codes = spread.mean + variables.latent @ spread.root.mT
        return self.weights.networks.decode(codes, variables.shape)

    def decode(self, variables: AnchorVariables) -> Decoded:
        """Return the motion in the clip's frames, and the parts of -log p of the variables.

        Moments before the cycle or after it have its first or last anchor. `latent`, `shape` and
        `details` are half squared Mahalanobis distances; `ends` is half the squared time, in
        seconds, by which cycle and observation begin and end apart; `sink` half the squared
        height of the ground above the soles' own, over its variance.
        """
        rows = self.rows(variables)
        at = _interpolated_rows(rows, self._anchor_of_frames(variables, rows))
        anchors = Anchors.unpack(at)
        if any(
            detail.requires_grad or bool(detail.any())
            for detail in (variables.bend, variables.shift)
        ):
            anchors = with_corrections(anchors, variables.bend, variables.shift)
        placed = anchors.carried(
            self._T_world_cycle(variables), rest_pelvis(self.body, variables.shape)
        )
        motion = Motion(
            translation=placed.translation,
            rotations=placed.full_rotations,
            shape=variables.shape,
            valid=variables.valid,
            fps=variables.fps,
            start_time=variables.start_time,
        )
        observed = (variables.valid.sum(-1) - 1) / variables.fps
        late = BEGIN * variables.begin
        over = late + rows[..., -1, -1] - observed
        energies = {
            "latent": 0.5 * variables.latent.square().sum(-1),
            "shape": 0.5 * variables.shape.square().sum(-1),
            "ends": 0.5 * (late.square() + over.square()),
            "details": 0.5
            * (variables.bend.square().sum((-1, -2)) + variables.shift.square().sum((-1, -2))),
            "sink": 0.5 * (PLACE / _SINK * variables.place[..., 2]).square(),
        }
        return Decoded(motion, energies)

    def _anchor_of_frames(
        self, variables: AnchorVariables, rows: Float[Tensor, "*batch 100 124"]
    ) -> Float[Tensor, "*batch time"]:
        """Fractional anchor index of every frame: 0 at the cycle's begin, 99 at its end."""
        seconds = (
            torch.arange(variables.valid.shape[-1], dtype=rows.dtype, device=rows.device)
            / variables.fps
        )
        since = seconds - BEGIN * variables.begin[..., None]
        return since / rows[..., -1, -1:].clamp(min=1e-3) * (ANCHORS - 1)

    def _T_world_cycle(self, variables: AnchorVariables) -> Float[Tensor, "*batch 4 4"]:
        vector = torch.nn.functional.pad(TURN * variables.turn, (2, 0))
        turn = variables.base[..., :3, :3] @ so3.exp(vector)
        return so3.rigid(turn, variables.base[..., :3, 3] + PLACE * variables.place)


def with_corrections(
    anchors: Anchors,
    bend: Float[Tensor, "*batch modes 60"],
    shift: Float[Tensor, "*batch modes 3"],
) -> Anchors:
    """Add corrections, sums of cosines over time, to the poses and translations of anchors."""
    frames, modes = anchors.translation.shape[-2], bend.shape[-2]
    waves = torch.zeros(frames, modes, dtype=torch.float64)
    count = min(frames, modes)
    waves[:, :count] = cosines(frames, count) * frames**0.5
    waves = (waves / (1 + (torch.arange(modes) / _FAST) ** 2)).to(bend)
    turns = so3.exp(_BEND * (waves @ bend).unflatten(-1, (len(POSED), 3)))
    return anchors.replace(
        rotations=anchors.rotations @ turns,
        translation=anchors.translation + _SHIFT * (waves @ shift),
    )


def _interpolated_rows(
    rows: Float[Tensor, "*batch 100 124"], place: Float[Tensor, "*batch time"]
) -> Float[Tensor, "*batch time 124"]:
    """Interpolate anchor rows linearly at fractional anchor indices (0 to 99)."""
    place = place.clamp(0, ANCHORS - 1)
    before = place.detach().floor().long().clamp(max=ANCHORS - 2)
    fraction = (place - before)[..., None]
    pick = before[..., None].expand(*before.shape, rows.shape[-1])
    first, second = rows.gather(-2, pick), rows.gather(-2, pick + 1)
    return first + fraction * (second - first)

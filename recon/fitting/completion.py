"""Cycles from sparse scans, landmarks or few frames: many beginnings, the best fit of all.

A code knows what moves how, but neither which foot is in front nor where the body faces: energies
have minima for both. So typical codes are tried in several headings, all as one batch.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from time import perf_counter
from typing import Any

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from observations.depth import CLOUD_NOISE, CLOUD_WORTH, PointCloud, bounded
from observations.noise import weights_of
from observations.together import kinds
from observations.together.kinds import InSpace
from recon.body.cycles import LONGEST_CYCLE, SHORTEST_CYCLE
from recon.body.model import BodyModel
from recon.core import rotations as so3
from recon.core.errors import ObservationError, ReconError
from recon.core.residuals import Noise
from recon.core.scene import OFFSETS, Scene
from recon.core.struct import concatenate
from recon.fitting.clip import ClipFit
from recon.fitting.options import FitOptions
from recon.fitting.priors import loaded
from recon.method.priors import CycleMethod, CyclePrior
from recon.method.protocols import REFERENCE_FPS, Sensor
from recon.method.reconstruction import Reconstruction
from recon.method.stages import Stage, StageReport, Watch, evaluate_stage, run_stage
from recon.method.terms import Term, offsets

SEARCHED_HEADINGS = 8
"""Directions in which typical cycles are tried."""
TRIED, KEPT = 16, 3
"""Beginnings of a clip that are fitted roughly, and those of them that are fitted in full."""
NAMED_NOISE = 0.01
"""Metres that joints and markers are off by, beside a constant offset."""
MARKER_OFFSET_DEVIATION = 0.01
"""Metres per axis by which markers are not where the model has them."""
DENSE = 200
"""Points in the fullest frame from which on clouds tell what no code has."""
FITTED = 256
"""Points of a frame that are compared: smooth bodies need no more, and time grows with them."""
RATES = (30.0, 60.0)
"""Frames per second that cycles are decoded at, at least and at most."""
ROUGH_RATE = 15.0
"""Frames per second, about, while first guesses are compared: a code moves all moments
together."""
_AT_ONCE = 96
"""Beginnings that are looked at together."""


def complete(
    observations: Sequence[Sensor],
    options: FitOptions,
    body: BodyModel,
    watch: Watch | None = None,
    kind: Callable[..., CycleMethod] | None = None,
) -> ClipFit:
    """Fit one cycle to every clip of the batch.

    A clip lasts from its first moment to the last that shows anything; its cycle is taken to
    begin and end there, about.

    Args:
        observations: of the clips, which are independent of each other.
        options: of the fit; its prior is of cycles, by name or loaded.
        body: whose motion it is.
        watch: told about every iteration.
        kind: of method, called as kind(prior, noise, detailed=...), instead of the prior's own.

    Raises:
        ValueError: when nothing tells where the body is, a clip does not last 0.3 to 3 s, or
            physics, a shape that is held or further terms are asked for.
    """
    if options.physics != 0:
        raise ObservationError(
            "cycles are completed without physics; leave it out, or fit by another prior"
        )
    if options.shape is not None or options.shape_prior is not None or options.terms:
        raise ObservationError(
            "cycles are completed with a shape of their own and no further terms; leave shape and "
            "terms out, or fit by another prior"
        )
    device = body.template.device
    seen = tuple(o.to(device=device) for o in kinds.in_space(observations))
    if len(seen) < len(observations):
        raise ObservationError(
            "completing a cycle takes scans, landmarks or joints, got 2D keypoints as well; fit "
            "them with another prior"
        )
    prior = loaded(options.prior, options.weights, body)
    if not isinstance(prior, CyclePrior):
        raise ReconError(f"expected a prior of cycles, got a {type(prior).__name__}")
    seen, rows = _with_offsets(tuple(o.thinned(FITTED) for o in seen))
    noises = tuple(_noise(o, options.noise_of(row)) for row, o in enumerate(seen))
    dense = any(_fullest(o) >= DENSE for o in kinds.clouds(seen))
    noise = min(one.metres for one in noises)
    method = (
        prior.cycle_method(noise, detailed=dense)
        if kind is None
        else kind(prior, noise, detailed=dense)
    )
    return _Search(seen, noises, method, body, _Clock.of(seen), rows, watch).fitted()


@dataclass(frozen=True)
class _Clock:
    """The moments at which cycles are decoded."""

    valid: Bool[Tensor, "clips time"]
    fps: float
    start_time: float

    @classmethod
    def of(cls, observations: Sequence[InSpace]) -> "_Clock":
        """The first observation's rate or a multiple or part of it, over all that is seen.

        Raises:
            ValueError: when a clip shows one moment only, or lasts too short or too long.
        """
        fps, start = _rate(observations[0].fps), min(o.start_time for o in observations)
        ends = [_seen_from_to(o) for o in observations]
        first, last = (torch.stack(one) for one in zip(*ends, strict=True))
        if not bool((last.amax(0) > first.amin(0)).all()):
            raise ObservationError(
                "at most one moment shows anything, which tells no motion; give two or more"
            )
        last = last.amax(0) - start
        worst = last[((last < SHORTEST_CYCLE) | (last > LONGEST_CYCLE)).nonzero()[:1, 0]]
        if len(worst) > 0:
            raise ObservationError(
                f"a cycle of gait lasts {SHORTEST_CYCLE} to {LONGEST_CYCLE:g} s, what is seen "
                f"here {float(worst[0]):.2f} s; cut one cycle out (--between), or fit the whole "
                "with another prior"
            )
        count = (last * fps - 1e-6).ceil().long() + 1
        return cls(torch.arange(int(count.max())) < count[:, None], fps, start)


@dataclass(frozen=True)
class _Search:
    """What stays the same while beginnings are compared."""

    observations: tuple[InSpace, ...]
    noises: tuple[Noise, ...]
    method: CycleMethod
    body: BodyModel
    clock: _Clock
    offsets: int
    watch: Watch | None

    def fitted(self) -> ClipFit:
        """The best fit of every clip."""
        method, clips = self.method, len(self.clock.valid)
        variables, clip = self.searched()
        coded = self.with_offsets(method.coded(self.data(clip, self.observations)))
        variables, scene, reports = self.run(coded, variables, self.scene(clip))
        variables, clip, best = _best(variables, clip, self.misfit(variables, scene, clip), 1)
        reports, scene = [report.rows(best) for report in reports], scene[best]
        details = method.details(self.data(clip, self.observations))
        if details:
            variables, scene, more = self.run(self.with_offsets(details), variables, scene)
            reports += more
        estimate = evaluate_stage(reports[-1].stage, self.body, variables, scene)
        T = torch.eye(4).expand(clips, 4, 4)
        result = Reconstruction(estimate, tuple(reports))
        return ClipFit(result, self.noises, True, T, self.observations)

    def searched(self) -> tuple[Any, Int[Tensor, " rows"]]:
        """The beginnings that are roughly best, on a clock of few moments until they are found."""
        step = self.rough_step
        variables, clip = self.beginnings()
        variables = variables.replace(valid=variables.valid[:, ::step], fps=self.clock.fps / step)
        scene = self.scene(clip)
        variables, clip, _ = _best(variables, clip, self.misfit(variables, scene, clip), TRIED)
        rough = self.method.search(self.data(clip, self.rough))
        variables, scene, _ = self.run(rough, variables, self.scene(clip))
        variables, clip, _ = _best(variables, clip, self.misfit(variables, scene, clip), KEPT)
        return variables.replace(valid=self.clock.valid[clip], fps=self.clock.fps), clip

    def beginnings(self) -> tuple[Any, Int[Tensor, " rows"]]:
        """Every typical cycle in every heading, along the path that is seen; whose each is."""
        prior, clock = self.method.prior, self.clock
        typical = prior.typical
        angles = torch.arange(SEARCHED_HEADINGS) * (math.tau / SEARCHED_HEADINGS)
        turns = so3.about_z(angles.to(typical))
        shape = typical.new_zeros(self.body.shape_size)
        path = prior.paths(shape)
        variables: list[Any] = []
        for clip, (seen, there) in enumerate(zip(*self._seen_path(), strict=True)):
            last = int(clock.valid[clip].sum()) - 1
            place = torch.arange(len(seen)).clamp(max=last) / last * (path.shape[1] - 1)
            walked = path[:, place.round().long()]
            turned = walked[:, None] @ turns.mT
            away = (seen - turned).where(there[:, None], 0.0).sum(-2) / there.sum().clamp(min=1)
            T = torch.eye(4).to(typical).repeat(len(typical), SEARCHED_HEADINGS, 1, 1)
            T[..., :3, :3], T[..., :2, 3] = turns, away[..., :2]
            count = T.shape[0] * T.shape[1]
            variables.append(
                prior.variables(
                    typical.repeat_interleave(SEARCHED_HEADINGS, 0),
                    shape.expand(count, -1),
                    T.flatten(0, 1),
                    clock.valid[clip].expand(count, -1),
                    clock.fps,
                    clock.start_time,
                )
            )
        clip = torch.arange(len(variables)).repeat_interleave(len(variables[0].latent))
        return concatenate(variables), clip

    def run(
        self, stages: Sequence[Stage], variables: Any, scene: Scene
    ) -> tuple[Any, Scene, list[StageReport]]:
        """Some stages in turn."""
        reports: list[StageReport] = []
        for asked in stages:
            began = perf_counter()
            stage = self.method.adapted(asked, self.body, variables, scene)
            variables, scene, solution = run_stage(stage, self.body, variables, scene, self.watch)
            reports.append(StageReport(stage, solution, perf_counter() - began))
        return variables, scene, reports

    def misfit(
        self, variables: Any, scene: Scene, clip: Int[Tensor, " rows"]
    ) -> Float[Tensor, " rows"]:
        """A measure that compares fits of one clip: no scale of it depends on the fit."""
        found: list[Tensor] = []
        for rows in torch.arange(len(clip)).split(_AT_ONCE):
            stage = self.method.search(self.data(clip[rows], self.rough))[0]
            estimate = evaluate_stage(stage, self.body, variables[rows], scene[rows])
            with torch.no_grad():
                terms = [term.weight * term.energy(estimate) for term in stage.terms]
            found.append(torch.stack(terms).sum(0))
        return torch.cat(found)

    def scene(self, clip: Int[Tensor, " rows"]) -> Scene:
        """Markers where the model has them."""
        return Scene.create(len(clip), self.offsets, like=self.body.template)

    def data(self, clip: Int[Tensor, " rows"], seen: Sequence[InSpace]) -> tuple[Term, ...]:
        """Observations of the rows' clips as weighted terms."""
        weights = weights_of(self.noises)
        return tuple(
            Term("data" if len(seen) == 1 else f"data {k + 1}", one[clip], weight)
            for k, (one, weight) in enumerate(zip(seen, weights, strict=True))
        )

    @cached_property
    def rough(self) -> tuple[InSpace, ...]:
        """Few moments and points, a rough surface, a kernel of fixed scale."""
        rate = self.clock.fps / self.rough_step
        return tuple(_rough(o, max(round(o.fps / rate), 1), self.body) for o in self.observations)

    @property
    def rough_step(self) -> int:
        """Moments of the clock from one to the next of the rough one."""
        return max(round(self.clock.fps / ROUGH_RATE), 1)

    def with_offsets(self, stages: Sequence[Stage]) -> tuple[Stage, ...]:
        """The stages with offsets of markers, from the one in which they are near the body."""
        if self.offsets == 0:
            return tuple(stages)
        held = Term("offsets", offsets, (self.method.noise / MARKER_OFFSET_DEVIATION) ** 2)
        return tuple(
            replace(stage, terms=(*stage.terms, held), free=stage.free | OFFSETS)
            if "shape" in stage.free
            else stage
            for stage in stages
        )

    def _seen_path(
        self,
    ) -> tuple[Float[Tensor, "clips moments 3"], Bool[Tensor, "clips moments"]]:
        """The middle of what is seen at the clock's moments, and where anything is."""
        clips, moments = self.clock.valid.shape
        total = self.body.template.new_zeros(clips, moments, 3)
        count = self.body.template.new_zeros(clips, moments, 1)
        for one in self.observations:
            present = one.shown
            middle = one.places.where(present[..., None], torch.nan).nanmedian(-2).values
            there = present.any(-1)
            times = one.start_time - self.clock.start_time + torch.arange(there.shape[1]) / one.fps
            frame = (times * self.clock.fps).round().long().clamp(0, moments - 1)
            total.index_add_(1, frame, middle.nan_to_num(0.0))
            count.index_add_(1, frame, there[..., None].to(count))
        return total / count.clamp(min=1), count[..., 0] > 0


def _best(
    variables: Any,
    clip: Int[Tensor, " rows"],
    misfit: Float[Tensor, " rows"],
    count: int,
) -> tuple[Any, Int[Tensor, " kept"], Int[Tensor, " kept"]]:
    """The best so many rows of every clip; their clips and numbers."""
    ordered = misfit.nan_to_num(torch.inf).argsort()
    own = [ordered[clip[ordered] == k][:count] for k in range(int(clip.max()) + 1)]
    rows = torch.cat(own)
    return variables[rows], clip[rows], rows


def _seen_from_to(one: InSpace) -> tuple[Float[Tensor, " clips"], Float[Tensor, " clips"]]:
    """Times of the first and last moment of each clip that show anything; infinite where none."""
    there = one.shown.any(-1).cpu()
    times = one.start_time + torch.arange(there.shape[-1], dtype=torch.float64) / one.fps
    return times.where(there, torch.inf).amin(-1), times.where(there, -torch.inf).amax(-1)


def _rate(fps: float) -> float:
    """A rate between `RATES`, of which the observation's is a multiple or part."""
    if fps < RATES[0]:
        return fps * math.ceil(RATES[0] / fps)
    return fps / math.ceil(fps / RATES[1] - 1e-6)


def _rough(one: InSpace, step: int, body: BodyModel) -> InSpace:
    """Every `step`-th moment, of clouds few points and a kernel of fixed scale."""
    few = one.coarse(body, step)
    return few.derived(kernel=bounded) if kinds.clouds([few]) else few


def _fullest(cloud: PointCloud) -> int:
    return int(cloud.present.sum(-1).max())


def _noise(one: InSpace, told: float | None) -> Noise:
    """A frame's cloud is worth some points that know their place; few frames count one each.

    Energies are sums over all frames of the clock, empty or not, taken at 30 Hz.
    """
    count = one.shown.sum(-1)
    typical = float(count[count > 0].float().quantile(0.5)) if bool((count > 0).any()) else 1.0
    first, last = _seen_from_to(one)
    rate = ((count > 0).sum(-1).cpu() - 1) / (last - first)
    seen = rate.isfinite() & (rate > 0)
    often = float(rate[seen].median()) if bool(seen.any()) else one.fps
    worth = one.fps / max(often, REFERENCE_FPS)
    named = bool(kinds.tracked([one]))
    usual = NAMED_NOISE if named else CLOUD_NOISE
    noise = usual if told is None else told
    alike = 1.0 if named else max(typical / CLOUD_WORTH, 1.0)
    return Noise(noise * (alike / worth) ** 0.5, noise)


def _with_offsets(observations: tuple[InSpace, ...]) -> tuple[tuple[InSpace, ...], int]:
    """Markers stand off the skin: rows of their offsets, and how many."""
    changed: list[InSpace] = []
    count = 0
    for one in observations:
        for markers in kinds.markers([one]):
            rows = (count, count + len(markers.vertices))
            one, count = markers.replace(offset_rows=rows), rows[1]
        changed.append(one)
    return tuple(changed), count

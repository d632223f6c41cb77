"""`solve`: runs the stages of a prior on observations and returns the reconstruction."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from recon.body.contacts import contact_probabilities, rest_heights
from recon.body.model import BodyModel, PosedBody
from recon.core.arrays import finite_number
from recon.core.errors import ReconError
from recon.core.limits import ORTHOGONALITY, POSITION, SHAPE
from recon.core.motion import Motion
from recon.core.scene import Scene
from recon.method.priors import PriorLike, stages_of
from recon.method.protocols import REFERENCE_FPS, Decoded, Estimate
from recon.method.running import Hypotheses, run_hypotheses
from recon.method.sensor import Sensor
from recon.method.stages import StageReport, Stages, Watch
from recon.method.terms import Term
from recon.solver.lbfgs import Termination

_SLACK = 1e-3
"""Frames by which clocks that agree may differ."""


def checked_start(start: Motion, seen: Sequence[Sensor], body: BodyModel) -> Motion:
    """Check a first guess; return it with all shape coefficients, and the body's dtype and device.

    It has to cover the time of one observation or of all of them; its frame rate may be another.
    Missing last shape coefficients are set to zero.

    Raises:
        ValueError: when it has another number of clips, covers another time, has more shape
            coefficients than the body, or values that no person's motion has.
    """
    if start.translation.ndim != 3:
        raise ReconError(
            "start: expected one leading axis of clips, translation (clips, time, 3); got the "
            f"shape {tuple(start.translation.shape)}; add it by indexing with [None]"
        )
    counts = sorted({one.clips for one in seen})
    if counts and (len(start.translation),) not in counts:
        raise ReconError(
            f"start: expected a motion of {counts[0][0]} clips, as observed, got "
            f"{len(start.translation)}"
        )
    if seen and not (any(_covers_one(start, one) for one in seen) or _covers_all(start, seen)):
        first = seen[0]
        stop = first.start_time + first.duration
        frames = int(first.duration * start.fps + _SLACK) + 1
        raise ReconError(
            f"start: expected the time of an observation, {first.start_time:g} s to "
            f"{stop:g} s: {frames} frames at "
            f"{start.fps:g} per second from {first.start_time:g} s on; got {start.frames} frames "
            f"at {start.fps:g} from {start.start_time:g} s on; cut or extend the motion first"
        )
    missing = body.shape_size - start.shape.shape[-1]
    if missing < 0:
        raise ReconError(
            f"start: expected at most {body.shape_size} shape coefficients, those of the body "
            f"{body.name!r}, got {start.shape.shape[-1]}: it is a motion of another body"
        )
    product = start.rotations @ start.rotations.mT
    away = product - torch.eye(3, dtype=product.dtype, device=product.device)
    POSITION.check(start.translation.detach().cpu(), "start", "translation")
    ORTHOGONALITY.check(away.detach().abs().cpu(), "start", "rotations")
    SHAPE.check(start.shape.detach().cpu(), "start", "shape")
    shape = torch.nn.functional.pad(start.shape, (0, missing))
    like = body.template
    return start.replace(shape=shape).to(device=like.device, dtype=like.dtype)


def _covers_one(start: Motion, seen: Sensor) -> bool:
    """Return whether a motion covers the time of an observation to within about one frame."""
    start_offset = (start.start_time - seen.start_time) * start.fps
    end_offset = seen.duration * start.fps - (start.frames - 1)
    one_frame = max(1.0, start.fps / REFERENCE_FPS)
    return abs(start_offset) <= _SLACK and -_SLACK <= end_offset < one_frame - _SLACK


def _covers_all(start: Motion, seen: Sequence[Sensor]) -> bool:
    """Return whether a motion covers the time of all observations to within half a frame."""
    begin = min(one.start_time for one in seen)
    end = max(one.start_time + one.duration for one in seen)
    return (
        max(abs(start.start_time - begin), abs(start.stop_time - end)) * start.fps <= 0.5 + _SLACK
    )


@dataclass(frozen=True)
class Reconstruction:
    """The fitted motions of a batch of clips, with a report of every stage of the fit."""

    estimate: Estimate
    reports: tuple[StageReport, ...]
    chosen: tuple[int, ...] | None = field(default=None, kw_only=True)
    """Number of the hypothesis that every clip's motion was found from, the start being 0; None
    where there was one only."""
    windows: tuple[tuple[float, float], ...] = field(default=(), kw_only=True)
    """First and last moment, seconds, of each window by which a long recording was fitted."""
    failed_windows: tuple[int, ...] = field(default=(), kw_only=True)
    """Windows that met nan or inf; they hold their last finite estimate."""

    @property
    def motion(self) -> Motion:
        """The fitted motions, with one batch axis (clips)."""
        return self.estimate.motion

    @property
    def body(self) -> PosedBody:
        """The bodies posed by the motions; `vertices` are computed on first use."""
        return self.estimate.body

    @property
    def contacts(self) -> Float[Tensor, "clips time 22"]:
        """Probability that a joint touches the ground z = 0, by its height and speed.

        A prior's own prediction is `estimate.decoded.contacts`; on held-out people it is right
        less often than the heights and speeds of the fitted motion.
        """
        posed = self.estimate.body
        heights = rest_heights(posed.model, self.motion.shape)
        return contact_probabilities(posed.joints, heights, self.motion.fps)

    @property
    def failed(self) -> tuple[bool, ...]:
        """Whether each clip met NaN or infinity in a stage; it holds its last finite estimate."""
        return tuple(
            any(r.solution.termination[clip] is Termination.NONFINITE for r in self.reports)
            for clip in range(len(self.motion.translation))
        )

    def on_device_of(self, body: BodyModel) -> "Reconstruction":
        """The reconstruction with its estimate on the body's device; reports are not moved."""
        device, found = body.template.device, self.estimate.decoded
        if device == found.motion.translation.device:
            return self

        def on_device(one: Any) -> Any:
            return None if one is None else one.detach().to(device=device)

        motion, scene = on_device(found.motion), on_device(self.estimate.scene)
        energies = {name: on_device(one) for name, one in found.energies.items()}
        decoded = Decoded(motion, energies, on_device(found.contacts), on_device(found.joints))
        return replace(self, estimate=Estimate(decoded, body.pose(motion), scene))

    def clip(self, index: int) -> Motion:
        """Return the motion of one clip, without batch axis and padding."""
        motion = self.motion[index]
        return motion.window(0, int(motion.valid.sum()))

    def __str__(self) -> str:
        """Describe each stage and clip: weighted energies, iterations, and why it ended."""
        lines: list[str] = []
        for report in self.reports:
            solution, names = report.solution, [term.name for term in report.stage.terms]
            lines.append(f"{report.stage.name}: {report.seconds:.2f} s")
            for clip, reason in enumerate(solution.termination):
                energies = solution.trace[clip, -1].tolist()
                parts = ", ".join(
                    f"{name} {value:.4g}" for name, value in zip(names, energies, strict=True)
                )
                lines.append(
                    f"  clip {clip}: {parts}; {int(solution.iterations[clip])} iterations, "
                    f"{int(solution.evaluations[clip])} evaluations; {reason.value}"
                )
        return "\n".join(lines)


def solve(
    observations: Sequence[Sensor],
    prior: PriorLike | Stages,
    body: BodyModel | None = None,
    *,
    start: Motion | None = None,
    others: Sequence[Motion] = (),
    scene: Scene | None = None,
    weights: Sequence[float] | None = None,
    watch: Watch | None = None,
) -> Reconstruction:
    """Run the stages of a prior from a first guess, with given weights of the data.

    `recon.fit` estimates noise, weights, the first guess and the ground and then calls `solve`.
    Here the caller gives them; residuals in pixels and in metres are added as weighted.

    Energies of all observations are added. Every observation has a leading axis of clips, which
    are independent of each other. All data are converted to the precision of the body.

    Args:
        observations: sensors with their data; the first one gives the first guess.
        prior: the prior, which says which motions are likely and by which stages to fit; or a
            function from data to stages.
        body: whose motion it is; None is the bundled body.
        start: a first guess to continue from instead, for example the previous chunk's motion; it
            covers the time of an observation.
        others: further first guesses. Stages say how many hypotheses they keep; at the end, each
            clip gets the motion of lowest objective.
        scene: what surrounds the motion; None puts every tracked point on the model.
        weights: multiplier of each observation; None weighs all equally.
        watch: told about every iteration.

    Raises:
        ValueError: when there is no observation, their numbers of clips differ, there are not as
            many weights, or the start does not fit them or the body.
    """
    data, body, start, scene, weights = checked_arguments(
        observations, body, start, scene, weights
    )
    hypotheses = [checked_start(other, data, body) for other in others]
    return reconstruct(
        data, stages_of(prior), body, start=start, others=hypotheses, scene=scene, weights=weights,
        watch=watch,
    )  # fmt: skip


Admitted = tuple[list[Sensor], BodyModel, Motion | None, Scene | None, Sequence[float] | None]
"""Observations, body, start, scene and weights that fit each other."""


def checked_arguments(
    observations: Sequence[Sensor],
    body: BodyModel | None,
    start: Motion | None,
    scene: Scene | None,
    weights: Sequence[float] | None,
) -> Admitted:
    """Check the arguments of `solve`; return them in the body's precision and on its device.

    Raises:
        ValueError: when they do not fit each other.
    """
    if len(observations) == 0:
        raise ReconError("nothing to fit: expected at least one observation, got none")
    if body is None:
        body = BodyModel.load().to(device=observations[0].shown.device)
    like = body.template
    data = [one.to(device=like.device, dtype=like.dtype) for one in observations]
    if any(len(one.clips) != 1 for one in data):
        raise ReconError(
            "expected one leading axis of clips, positions (clips, time, points, 3); got leading "
            f"axes {data[0].clips}; add it by indexing with [None]"
        )
    if len({one.clips for one in data}) > 1:
        raise ReconError(
            "expected the same number of clips in all observations, got "
            f"{', '.join(str(one.clips[0]) for one in data)}; give equally many clips to each"
        )
    if start is not None:
        start = checked_start(start, data, body)
    if weights is not None:
        weights = [finite_number(weight, "weights") for weight in weights]
        if len(weights) != len(observations) or min(weights) < 0:
            raise ReconError(
                f"weights: expected {len(observations)} numbers from 0 on, one for each "
                f"observation, got {weights}"
            )
    scene = None if scene is None else scene.to(device=like.device, dtype=like.dtype)
    return data, body, start, scene, weights


def reconstruct(
    observations: Sequence[Sensor],
    stages_for: Stages,
    body: BodyModel,
    *,
    start: Motion | None = None,
    others: Sequence[Motion] = (),
    scene: Scene | None = None,
    weights: Sequence[float] | None = None,
    watch: Watch | None = None,
) -> Reconstruction:
    """Reconstruct from arguments that are known to fit each other; see `solve`."""
    if start is None:
        with torch.no_grad():
            start = observations[0].start(body)
    if scene is None:
        scene = Scene.create(len(start.translation), like=start.translation)
    weights = [1.0] * len(observations) if weights is None else weights
    stages = stages_for(data_terms(observations, weights))
    if others and stages[-1].kept is None:
        stages = (*stages[:-1], replace(stages[-1], kept=1))
    began = Hypotheses.of_motions(stages[0].prior, [start, *others], scene, body)
    found, reports = run_hypotheses(stages, body, began, watch)
    chosen = None if found.number is None else tuple(found.number.tolist())
    return Reconstruction(found.estimate(body), tuple(reports), chosen=chosen)


def data_terms(observations: Sequence[Sensor], weights: Sequence[float]) -> tuple[Term, ...]:
    """Return a weighted term for each observation: `data`, or `data 1`, `data 2`, ..."""
    many = len(observations) > 1
    return tuple(
        Term(f"data {k + 1}" if many else "data", observation, weight)
        for k, (observation, weight) in enumerate(zip(observations, weights, strict=True))
    )

"""`recon.complete`: a recording of which little was seen: sparse scans, landmarks, few frames."""

from collections.abc import Sequence

from recon.api.fit import fit
from recon.api.given import BodyLike
from recon.api.observations import GroundChoice, ObservationsLike
from recon.api.result import Result
from recon.fitting.methods import PriorObject
from recon.method.stages import Watch


def complete(
    observations: ObservationsLike,
    prior: str | PriorObject = "recording",
    *,
    weights: str = "open",
    body: BodyLike = None,
    noise: float | Sequence[float | None] | None = None,
    ground: GroundChoice = "auto",
    between: tuple[float, float] | None = None,
    fps: float | None = None,
    device: str = "cpu",
    callback: Watch | None = None,
    max_seconds: float | None = None,
    repair: bool = True,
) -> Result:
    """A recording of which little was seen, of any length and any motion.

    Few points of every frame, a few landmarks, few frames at odd times, or all of these; several
    observations of one clip add up. HuMoR's steps explain the whole, by windows, with one shape.
    Where few moments were seen, cycles of gait that explain the data join them, and one motion is
    fitted to all. `Result.stretches` says what was used when.

    With the prior `anchor` it is one whole cycle of gait (0.3 to 3 s) as one code, of which many
    are tried, so that there is no `start`. What is no cycle of gait is then completed all the
    same, with a warning; keypoints in images are not taken. `Result.cycle` has its duration in
    seconds, and how far its code is from those of recorded cycles.

    Args:
        observations: as of `recon.fit`: observations of one clip, or files and folders.
        prior: `recording`, or a `WholeRecording` with other priors; for one cycle `anchor`, or a
            loaded `AnchorFrames`.
        weights: of the prior given by its name: `open` or `nc` (not for commercial use), and for
            one cycle a file.
        body: a body, a SMPL-family file, or None for the bundled body.
        noise: standard deviation of every coordinate, metres: one number, or one per observation.
        ground: as of `recon.fit`.
        between: times from which and up to which to complete, seconds of the observations'
            clock; None takes all, which for one cycle must last 0.3 to 3 s.
        fps: rate of the result, frames per second; None is the first observation's, or the
            fit's where that is too slow to show a motion.
        device: where to compute, `cpu` or `cuda`.
        callback: called as callback(stage, progress) after every iteration; True ends the fit.
        max_seconds: time after which the fit is ended with its last estimate.
        repair: whether what is surely wrong with the data is repaired before the fit.

    Raises:
        ReconError: when nothing tells where the body is, at most one moment shows anything, or,
            for one cycle, what was seen does not last as long as one.
        FileNotFoundError: when there is no such file, body or weights.
    """
    return fit(
        observations, prior, weights=weights, body=body, noise=noise, ground=ground,
        between=between, fps=fps, device=device, callback=callback, max_seconds=max_seconds,
        repair=repair,
    )  # fmt: skip

"""`recon.fit_clips`: several clips, each on its own or all of one person."""

from collections.abc import Iterable, Sequence
from functools import partial
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from recon.api.fit import fit
from recon.api.observations import ObservationsLike
from recon.api.result import Result
from recon.batch.together import FRAMES, Raised, ended_together
from recon.core.arrays import positive
from recon.core.errors import ReconError
from recon.fitting.methods import PriorObject
from recon.method.protocols import Sensor

_FIRST = ("weights", "method", "physics", "terms", "shape", "start")
"""Arguments of a fit that do not concern the first look at shapes."""


def fit_clips(
    clips: Sequence[ObservationsLike] | Sensor,
    prior: str | PriorObject = "humor",
    *,
    subject: bool = False,
    together: int = FRAMES,
    **arguments: Any,
) -> list[Result]:
    """Several clips; a result for each, in their order.

    It is a function beside `recon.fit` so that one always returns a result and the other always
    a list. Every clip is fitted as `recon.fit` does, with its own noise, ground and repairs; what
    clips of like length minimise is minimised together, which takes less time. The results are
    those of one by one within the tolerances of the minimiser.

    Args:
        clips: the observations of every clip, each as `recon.fit` takes them; or one observation
            with a leading axis of clips.
        prior: as of `recon.fit`.
        subject: whether all clips are of one person, whose shape they then share: it is estimated
            from every clip by the pose prior, and the median of these is held in all of them.
        together: frames of several clips that are minimised together at most; memory grows with
            them, and 1 fits clips one by one.
        arguments: others of `recon.fit`, the same for all clips.

    Raises:
        ReconError: as `recon.fit`, naming the number of the clip; when there is no clip, or a
            shape is given that clips of one subject are to share.
        FileNotFoundError: as `recon.fit`.
    """
    every = _clips(clips)
    if not subject:
        return _fitted(every, prior, arguments, together)
    if arguments.get("shape") is not None:
        raise ReconError(
            "subject: estimates the shape that all clips share, but a shape is given; leave one "
            "of them out"
        )
    first = {name: value for name, value in arguments.items() if name not in _FIRST}
    shapes = [one.motion.shape for one in _fitted(every, "pose", first, together)]
    return _fitted(every, prior, arguments | {"shape": shared_shape(shapes)}, together)


def shared_shape(shapes: Sequence[Float[Tensor, " shape"]]) -> Float[Tensor, " shape"]:
    """The shape of a person of whom several clips tell: the median of every coefficient.

    Of an even number of clips it is the mean of the two in the middle.
    """
    return torch.stack(tuple(shapes)).double().quantile(0.5, dim=0).to(shapes[0])


def _clips(given: Any) -> list[Any]:
    if isinstance(given, Sensor):
        if given.clips == ():
            raise ReconError(
                "clips: expected a leading axis of clips, or a list with the observations of "
                "every clip; recon.fit takes those of one"
            )
        return [given[k] for k in range(given.clips[0])]
    if isinstance(given, str) or not isinstance(given, Iterable):
        raise ReconError(
            f"clips: expected a list with the observations of every clip, got {given!r:.60}"
        )
    every = list(given)
    if len(every) == 0:
        raise ReconError("clips: nothing to fit: expected at least one clip, got none")
    return every


def _fitted(
    clips: Sequence[Any], prior: str | PriorObject, arguments: dict[str, Any], together: int
) -> list[Result]:
    positive(together, "together")
    functions = [partial(fit, clip, prior, **arguments) for clip in clips]
    results: dict[int, Result] = {}
    for number, outcome in ended_together(functions, together):
        if not isinstance(outcome, Raised):
            results[number] = outcome
        elif isinstance(outcome.error, ReconError):
            raise type(outcome.error)(f"clip {number}: {outcome.error}") from outcome.error
        else:
            raise outcome.error
    return [results[number] for number in range(len(clips))]

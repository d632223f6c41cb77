"""`recon.fit_clips`: fits several clips, each on its own or all of one person."""

from collections.abc import Iterable, Sequence
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from recon.api.fit import fit
from recon.api.observations import ObservationsLike
from recon.api.result import Result
from recon.core.errors import ReconError
from recon.method.priors import PriorLike
from recon.method.sensor import Sensor

_FIRST = ("weights", "method", "physics", "terms", "shape", "start")
"""Arguments of a fit that do not concern the first look at shapes."""


def fit_clips(
    clips: Sequence[ObservationsLike] | Sensor,
    prior: str | PriorLike = "humor",
    *,
    subject: bool = False,
    **arguments: Any,
) -> list[Result]:
    """Fit several clips; returns a result for each, in their order.

    It is a function beside `recon.fit` so that one always returns a result and the other always
    a list. Clips are fitted in turn, each as `recon.fit` does, with its own noise, ground and
    repairs.

    Args:
        clips: the observations of every clip, each as `recon.fit` takes them; or one observation
            with a leading axis of clips.
        prior: as of `recon.fit`.
        subject: whether all clips are of one person, whose shape they then share: it is estimated
            from every clip by the pose prior, and the median of these is held in all of them.
        arguments: others of `recon.fit`, the same for all clips.

    Raises:
        ReconError: as `recon.fit`, naming the number of the clip; when there is no clip, or a
            shape is given that clips of one subject are to share.
        FileNotFoundError: as `recon.fit`.
    """
    every = _list_of_clips(clips)
    if not subject:
        return _fit_each(every, prior, arguments)
    if arguments.get("shape") is not None:
        raise ReconError(
            "subject: one shape is estimated for all clips, but a shape is given; leave one of "
            "them out"
        )
    first = {name: value for name, value in arguments.items() if name not in _FIRST}
    shapes = [one.motion.shape for one in _fit_each(every, "pose", first)]
    return _fit_each(every, prior, arguments | {"shape": shared_shape(shapes)})


def shared_shape(shapes: Sequence[Float[Tensor, " shape"]]) -> Float[Tensor, " shape"]:
    """A person's shape from those of several clips: the median of every coefficient.

    Of an even number of clips it is the mean of the two in the middle.
    """
    return torch.stack(tuple(shapes)).double().quantile(0.5, dim=0).to(shapes[0])


def _list_of_clips(given: Any) -> list[Any]:
    if isinstance(given, Sensor):
        if given.clips == ():
            raise ReconError(
                "clips: expected a leading axis of clips, or a list with the observations of "
                "every clip; fit a single clip with recon.fit"
            )
        return [given[k] for k in range(given.clips[0])]
    if isinstance(given, str) or not isinstance(given, Iterable):
        raise ReconError(
            f"clips: expected a list with the observations of every clip, got {given!r:.60}"
        )
    every = list(given)
    if len(every) == 0:
        raise ReconError("clips: expected at least one clip, got none")
    return every


def _fit_each(
    clips: Sequence[Any], prior: str | PriorLike, arguments: dict[str, Any]
) -> list[Result]:
    results: list[Result] = []
    for number, clip in enumerate(clips):
        try:
            results.append(fit(clip, prior, **arguments))
        except ReconError as error:
            raise type(error)(f"clip {number}: {error}") from error
    return results

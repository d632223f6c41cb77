"""How likely joints of a fit touch the ground, by its motion and how sure it is."""

from jaxtyping import Float
from torch import Tensor

from recon.body.contacts import contact_probabilities, rest_heights
from recon.fitting.clip import ClipFit
from recon.method.laplace.deviations import Deviations
from recon.method.priors import traits_of

_HELD = 0.3
"""Ratio of the standard deviation of a joint's height to that of its coordinates under a prior
that knows gravity, which holds standing feet to the ground. Both ratios were chosen by likelihood
on validation people, over all sensors of `benchmarks.uncertainty`."""
_FREE = 1.4
"""The ratio under the other priors, whose hidden feet may end anywhere."""


def fitted_contacts(fit: ClipFit, deviations: Deviations | None) -> Float[Tensor, "time 22"]:
    """Probability that each joint of the fit's only clip touches the ground z = 0.

    Args:
        fit: of one clip.
        deviations: how sure its joints are; None takes all as seen.
    """
    motion, posed = fit.result.clip(0).detach(), fit.result.body
    joints = posed.joints[0, : motion.frames].detach().cpu()
    heights = rest_heights(posed.model, motion.shape).cpu()
    if deviations is None:
        return contact_probabilities(joints, heights, motion.fps)
    held = traits_of(fit.result.reports[-1].stage.prior).knows_gravity
    std = (_HELD if held else _FREE) * deviations.joints[: motion.frames]
    return contact_probabilities(joints, heights, motion.fps, std.to(joints))

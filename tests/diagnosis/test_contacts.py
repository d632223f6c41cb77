"""How likely feet of a fit touch the ground: near one half where nothing tells."""

import torch

from observations.joints3d import Joints3D
from recon.core.skeleton import FEET, JOINTS, LEGS
from recon.diagnosis.certainty import certainty, fitted_contacts
from recon.fitting.clip import fit_clip
from recon.fitting.methods import FitOptions
from tests.filmed import bundled, walk

FRAMES = 24


def test_nobody_is_sure_of_feet_that_neither_data_nor_the_prior_hold():
    """Feet that nobody saw were said not to touch, and half of them did."""
    motion = walk(FRAMES)
    visible = torch.ones(FRAMES, len(JOINTS))
    visible[:, list(LEGS)] = 0
    joints = bundled().pose(motion).joints[None]
    seen = Joints3D(joints, visible[None], tuple(range(22)), motion.fps)
    fit = fit_clip([seen], FitOptions(prior="pose"), bundled())
    sure = certainty(fit)
    taken, said = fitted_contacts(fit, None)[:, list(FEET)], fitted_contacts(fit, sure)
    assert (said[:, list(FEET)] - 0.5).abs().max() < 0.25
    assert (taken - 0.5).abs().mean() > 2 * (said[:, list(FEET)] - 0.5).abs().mean()
    assert torch.equal(said[:, list(FEET)] > 0.5, taken > 0.5)
    assert said[:, JOINTS.index("head")].max() == 0

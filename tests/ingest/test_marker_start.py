"""Where a body is first found among markers without names."""

import numpy as np
import pytest
import torch

import recon
from recon.core import rotations as so3
from recon.ingest.marker_places import bodies_of_set
from recon.ingest.marker_sets import markers_of_set
from recon.ingest.marker_start import with_limb_turned


@pytest.mark.numerics
@pytest.mark.parametrize(("joint", "axis"), [(8, 1), (12, 1)])
def test_a_limb_found_turned_about_its_length_is_turned_back(joint, axis):
    """Of the foot or the head; a body that fits everywhere is left as it is."""
    model = recon.BodyModel.load()
    motion = recon.load_motion(recon.__path__[0] + "/assets/demo.npz").motion[::30]
    body = bodies_of_set(markers_of_set("pig", model), model)[1]
    true = body.posed(motion.translation, motion.rotations)
    clouds = list(body.places(true))
    assert with_limb_turned(body, true, clouds) is None
    wrong = motion.rotations.clone()
    wrong[:, joint] = wrong[:, joint] @ so3.exp(np.pi * torch.eye(3)[axis])
    turned = body.posed(motion.translation, wrong)
    assert np.abs(body.places(turned) - clouds).max() > 0.05
    found = with_limb_turned(body, turned, clouds)
    assert found is not None
    for one, cloud in zip(found, clouds, strict=True):
        assert np.abs(body.places(one.pose)[0] - cloud).max() < 0.02

"""HuMoR's own energies against golden numbers."""

import pytest
import torch

from priors.humor import shooting
from priors.humor.shooting import (
    bone_length,
    contact_height,
    contact_velocity,
    joint_consistency,
)
from recon.body.model import BodyModel
from recon.core.scene import Scene
from recon.method.free import FreeMotion
from recon.method.protocols import Decoded, Estimate
from tests.laws import a_motion, estimate_of
from tests.priors.test_humor_nets import golden


def golden_estimate(body: BodyModel) -> Estimate:
    """The golden joints as if a body had them."""
    g = golden("losses")
    motion = a_motion(body, clips=2, frames=8)
    joints = g["canonical_joints"].reshape(2, 8, 22, 3)
    decoded = Decoded(
        motion,
        contacts=g["contacts_conf"].reshape(2, 8, 22),
        joints=g["rollout_joints"].reshape(2, 8, 22, 3),
    )
    posed = body.pose(motion)
    posed = type(posed)(body, posed.shape, posed.rest, posed.local, joints, posed.orientations)
    return Estimate(decoded, posed, Scene.create(2, like=joints))


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("joint_consistency", "joint_consistency"),
        ("bone_length", "bone_length_smpl_tree"),
        ("contact_velocity", "contact_vel"),
        ("contact_height", "contact_height"),
    ],
)
def test_energies_equal_the_reference(body: BodyModel, name: str, expected: str) -> None:
    estimate = golden_estimate(body)
    value = getattr(shooting, name)(estimate)
    assert value.shape == (2,)
    torch.testing.assert_close(
        value.sum(), golden("losses")[f"value_{expected}"], rtol=1e-10, atol=0
    )


@pytest.mark.parametrize(
    "energy", [joint_consistency, bone_length, contact_velocity, contact_height]
)
def test_frames_that_do_not_exist_count_nothing(body: BodyModel, energy) -> None:
    whole = golden_estimate(body)
    valid = whole.motion.valid.clone()
    valid[:, 5:] = False
    motion = whole.motion.replace(valid=valid)
    decoded = Decoded(motion, {}, whole.decoded.contacts, whole.decoded.joints)
    cut = Estimate(decoded, whole.body, whole.scene)
    assert (energy(cut) < energy(whole)).all()
    assert (energy(cut) > 0).all()


def test_a_prior_without_predictions_is_refused(body: BodyModel) -> None:
    estimate = estimate_of(body, a_motion(body))
    assert FreeMotion().decode(FreeMotion().encode(a_motion(body))).joints is None
    with pytest.raises(ValueError, match="predicts joints"):
        joint_consistency(estimate)
    with pytest.raises(ValueError, match="predicts contacts"):
        contact_height(estimate)

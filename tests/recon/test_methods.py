"""From settings to methods: a prior for the noise, and stages left out or added."""

import pytest

from priors.humor_collocation import Collocation
from priors.pose import PosePrior
from recon.methods import WithoutRoot, method_of
from recon.settings import FitSettings
from recon.terms import Term
from tests.filmed import bundled


def data() -> tuple[Term, ...]:
    return (Term("data", lambda estimate: estimate.motion.translation.sum((-1, -2)), 1.0),)


def test_the_prior_asked_for_with_weights_for_the_noise():
    weak = method_of(FitSettings(prior="pose"), 0.02, bundled())
    strong = method_of(FitSettings(prior="pose"), 0.08, bundled())
    assert isinstance(weak, PosePrior)
    assert isinstance(strong, PosePrior)
    assert strong.weights.pose == pytest.approx(16 * weak.weights.pose)
    assert isinstance(method_of(FitSettings(prior="humor"), 0.02, bundled()), Collocation)


@pytest.mark.parametrize("prior", ["pose", "humor"])
def test_one_image_does_not_place_the_rest_body_again(prior):
    """It would trade stretched limbs against distance."""
    method = method_of(FitSettings(prior=prior), 0.02, bundled())
    every, some = method.stages(data()), WithoutRoot(method).stages(data())
    assert [stage.name for stage in every[-len(some) :]] == [stage.name for stage in some]
    assert not some[0].free <= {"translation", "root"}
    dropped = every[: len(every) - len(some)]
    assert all(stage.free <= {"translation", "root"} for stage in dropped)
    assert len(dropped) == 1


def test_missing_weights_are_refused(tmp_path):
    with pytest.raises(FileNotFoundError):
        method_of(FitSettings(weights=str(tmp_path / "none.safetensors")), 0.02, bundled())

"""Shapes are checked at the first calls of a function in every test, and no longer after these."""

import jaxtyping
import pytest
import torch

from recon.core.motion import carried_translation
from tests import shapes

TRANSLATION, BROADCAST = torch.zeros(2, 5, 3), (torch.eye(4)[None], torch.zeros(1, 3))
"""Arguments that work, but have other leading axes than the annotations say."""


def test_wrong_shapes_are_found_at_the_first_calls_of_a_test():
    for _ in range(shapes.CALLS):
        with pytest.raises(jaxtyping.TypeCheckError):
            carried_translation(TRANSLATION, *BROADCAST)
    assert carried_translation(TRANSLATION, *BROADCAST).shape == (2, 5, 3)


def test_every_test_checks_anew():
    with pytest.raises(jaxtyping.TypeCheckError):
        carried_translation(TRANSLATION, *BROADCAST)

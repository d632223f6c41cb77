"""What a fit says of its own doubts: guessed limbs, other motions, and a size nobody can tell."""

from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import torch

from observations.keypoints2d import Keypoints2D
from recon.core.skeleton import JOINTS, LEGS
from recon.diagnosis.cameras import size_is_unknown, with_unknown_size
from recon.diagnosis.certainty import AlternativeMotion, certainty
from recon.diagnosis.checks import guessed, other_motions
from recon.diagnosis.examination import ExaminedClip
from recon.diagnosis.findings import Finding
from recon.fitting.clip import fit_clip
from recon.fitting.methods import FitOptions
from recon.method.laplace import Deviations
from recon.reading.images import keypoints_of
from recon.simulation.images import keypoints2d
from recon.simulation.points import Corruption
from tests.filmed import bundled, cameras, walk

FRAMES = 24
OPTIONS = FitOptions(prior="pose")


def filmed(posed: bool) -> Keypoints2D:
    """The walk before one camera that knows where it stands, or does not."""
    truth = walk(FRAMES)
    file = keypoints2d(truth, bundled(), cameras(truth)[0], Corruption(noise=3.0), 0)
    if not posed:
        file = replace(file, camera=replace(file.camera, T_camera_world=None))
    return keypoints_of(file, bundled())


def test_one_camera_without_a_ground_cannot_tell_how_large_and_far_a_person_is():
    """Errors of 26 cm were said to be 7 cm: perspective tells less than exact bodies promise."""
    fit = fit_clip([filmed(False)], OPTIONS, bundled())
    assert size_is_unknown(fit)
    sure = certainty(fit)
    assert isinstance(sure, Deviations)
    assert sure.shape[0] > 0.9  # standard deviations of people
    assert sure.joints.median() > 0.1  # metres: 7.5 % of the four metres to the camera
    again = with_unknown_size(sure, fit)
    assert (again.joints > sure.joints).all()
    held = replace(OPTIONS, shape=torch.zeros(16))
    assert not size_is_unknown(fit_clip([filmed(False)], held, bundled()))


def test_a_camera_over_a_known_ground_tells_it():
    fit = fit_clip([filmed(True)], OPTIONS, bundled())
    assert not size_is_unknown(fit)
    sure = certainty(fit)
    assert isinstance(sure, Deviations)
    assert sure.joints.median() < 0.1


def std_of(legs: float, rest: float = 0.02) -> np.ndarray:
    std = np.full((60, 22), rest)
    std[:, list(LEGS)] = legs
    return std


def clip_of(**known: Any) -> ExaminedClip:
    """An examined clip of which only this is known."""
    clip = object.__new__(ExaminedClip)
    vars(clip).update(known)
    return clip


def guesses(std: np.ndarray, observed: np.ndarray) -> Sequence[Finding]:
    """What is said of joints with these standard deviations: data of 60 Hz, a fit of 30."""
    known, motion = SimpleNamespace(joints=torch.from_numpy(std)), SimpleNamespace(fps=30.0)
    clip = clip_of(
        deviations=known,
        observed=observed,
        motion=motion,
        observations=(SimpleNamespace(fps=60.0),),
    )
    return guessed(clip)[1].diagnosis


def test_limbs_that_nothing_holds_are_said_to_be_guessed():
    observed = np.ones((60, 22), dtype=bool)
    observed[10:40, list(LEGS)] = False
    (found,) = guesses(std_of(0.2), observed)
    assert found.code == "guessed"
    assert found.frames == ((20, 79),)  # of the data
    assert found.joints == tuple(JOINTS[k] for k in sorted(LEGS))
    assert found.value == 0.2
    assert "40 cm" in found.message
    assert guesses(std_of(0.05), observed) == ()
    assert guesses(std_of(0.2), np.ones((60, 22), dtype=bool)) == ()
    brief = observed | (np.arange(60) > 12)[:, None]
    assert guesses(std_of(0.2), brief) == ()


def other(energy: float) -> AlternativeMotion:
    return AlternativeMotion("heading", 180.0, 0.4, energy, 1.0)


def undecided(alternatives: Sequence[AlternativeMotion]) -> Sequence[Finding]:
    """What is said of these other motions."""
    return other_motions(clip_of(alternatives=alternatives))[1].warnings


def test_another_motion_is_said_where_it_is_nearly_as_likely():
    (found,) = undecided([other(1.02), other(1.1), other(2.0)])
    assert found.code == "undecided"
    assert "facing 180 degrees elsewhere" in found.message
    assert "and 1 more" in found.message
    assert undecided([other(1.3)]) == ()
    rough = AlternativeMotion("posture", 3.0, 0.08, 1.05, 1.0)
    assert undecided([rough]) == ()
    assert len(undecided([replace(rough, distance=0.3)])) == 1
    assert undecided([]) == ()

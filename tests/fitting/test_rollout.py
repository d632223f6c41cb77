"""HuMoR's roll-out through the front door: known and unknown ground, several sensors, windows."""

import dataclasses

import pytest

import recon
from priors.humor.collocation import Collocation
from priors.humor.prior import Humor
from priors.humor.shooting import IterationSchedule, Shooting
from priors.pose.prior import PosePrior
from recon.core.errors import ReconError
from recon.fitting.methods import FitOptions
from recon.fitting.stages import prior_stages
from recon.method.free import FreeMotion
from recon.method.stages import Stage
from recon.method.terms import Term
from recon.simulation.points import Corruption, joints3d
from recon.solver.lbfgs import LBFGS
from tests.filmed import bundled, cameras, joint_error, view, walk


def test_it_is_one_of_the_methods_of_humor():
    data = (Term("data", lambda estimate: estimate.motion.translation.sum((-1, -2)), 1.0),)

    def priors(options: FitOptions) -> list[type]:
        return [type(one.prior) for one in prior_stages(options, 0.02, bundled())(data)]

    begun = [FreeMotion, PosePrior, Collocation]
    assert priors(FitOptions(method="collocation")) == begun
    assert priors(FitOptions(method="rollout")) == [*begun, Humor]
    assert priors(FitOptions(prior=Humor.load(), method="rollout")) == [*begun, Humor]


@pytest.mark.parametrize(
    ("prior", "expected"),
    [
        ("humor", "by collocation or rollout or look, got 'roll'"),
        ("pose", "'pose' is fitted in one way only, got 'roll'"),
        (Collocation(Humor.load()), "a Collocation is fitted in one way only"),
    ],
)
def test_names_of_no_method_are_refused_at_the_door(prior, expected):
    seen = joints3d(walk(4), bundled(), Corruption(), 0)
    with pytest.raises(ReconError, match=expected):
        recon.fit(seen, prior, method="roll")


@dataclasses.dataclass(frozen=True)
class Hurried:
    """The roll-out after a few iterations of every stage."""

    iterations: int = 5
    posing: int = 30

    def stages(self, data) -> tuple[Stage, ...]:
        method = Shooting.for_noise(Humor.load(), 0.02)
        brief = dataclasses.replace(method, schedule=IterationSchedule(all=self.iterations))
        return tuple(
            dataclasses.replace(
                stage,
                minimiser=LBFGS(
                    self.posing if stage.name in {"root", "pose"} else self.iterations
                ),
            )
            for stage in brief.stages(data)
        )


def test_one_camera_of_unknown_ground():
    """First states could not be carried to another world: an unknown ground was refused."""
    truth = walk(12)
    posed = view(truth, cameras(truth)[0])
    lens = posed.camera.camera_matrix.flatten(0, -3)[0]
    unposed = posed.replace(camera=recon.Camera.create(lens, posed.camera.image_size))
    result = recon.fit(unposed, Hurried())
    assert not result.failed
    feet = result.joints[:, [7, 8, 10, 11], 2]
    assert (
        abs(float(feet.min()) - float(bundled().pose(truth).joints[:, [7, 8, 10, 11], 2].min()))
        < 0.1
    )


def test_joints_beside_a_camera_and_depth():
    truth = walk(12)
    [camera] = cameras(truth)
    joints = joints3d(truth, bundled(), Corruption(noise=0.02), 0)
    result = recon.fit([joints, view(truth, camera)], Hurried())
    assert joint_error(result.motion, truth) < 0.05


def test_windows_of_a_long_recording_join_without_a_seam():
    slow = walk(43).replace(fps=4.0)
    seen = joints3d(slow, bundled(), Corruption(), 0)
    result = recon.fit(seen, Hurried(2, 12))
    names = {stage["name"] for stage in result.report({}, {})["stages"]}
    assert {"apart: all", "tied: all"} <= names
    assert joint_error(result.motion.resample(4.0), slow) < 0.12

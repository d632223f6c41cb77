"""A fifth sensor in one file: alone, with others, in long recordings, cameras, from files."""

import json
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest
import torch

import recon
from recon import cli
from recon.core.errors import ObservationError, ReconError
from recon.core.motion import Motion
from recon.core.skeleton import JOINTS
from recon.fitting.long import LongReconstruction
from recon.formats.observations import PositionsFile, save_observation
from recon.method import PosedBody, Sensor
from recon.simulation.points import Corruption, joints3d
from tests.filmed import bundled, cameras, joint_error, view, walk
from tests.own import SENSOR, WORN, turns, units

FRAMES = 16


def posture_error(found: Motion, truth: Motion) -> float:
    """Mean distance of joints from where the pelvis is, metres."""
    away = bundled().pose(found).joints - bundled().pose(truth).joints
    return float((away - away[:, :1]).norm(dim=-1).mean())


def test_alone_it_tells_the_posture_of_a_body_of_known_size():
    truth = walk(FRAMES)
    result = recon.fit(units(truth, bundled()), "pose", shape=truth.shape)
    assert posture_error(result.motion, truth) < 0.04
    assert result.residuals[0].unit == "radians"
    assert "imus" in str(result)


def test_joints_of_the_trunk_and_units_tell_more_than_the_trunk():
    truth = walk(FRAMES)
    every = joints3d(truth, bundled(), Corruption(noise=0.02), 0)
    trunk = [0, 9, 16, 17]
    few = recon.Joints3D(
        every.positions[:, trunk], every.visible[:, trunk], trunk, truth.fps, ground_known=True
    )
    alone = recon.fit(few, "pose")
    for both in ([few, units(truth, bundled())], [units(truth, bundled()), few]):
        result = recon.fit(both, "pose")
        assert joint_error(result.motion, truth) < 0.7 * joint_error(alone.motion, truth)


def test_its_ground_may_be_unknown():
    """The height of the floor is found from how people stand; data with z up keep theirs."""
    truth = walk(24)
    raised = truth.replace(translation=truth.translation + torch.tensor([0.0, 0.0, 0.7]))
    every = joints3d(raised, bundled(), Corruption(noise=0.01), 0)
    seen = [every, units(raised, bundled())]
    result = recon.fit(seen, "pose", ground="unknown")
    assert joint_error(result.motion, raised) < 0.03
    assert float(result.ground[3]) == pytest.approx(0.7, abs=0.03)
    tilted = recon.fit(seen, "pose", ground=(0.0, 0.0, 1.0, 0.7))
    assert joint_error(tilted.motion, truth) < 0.03


@dataclass(frozen=True)
class Heights(Sensor):
    """Heights of heads above z = 0, metres: of which way is up it says nothing."""

    vectors: ClassVar = "numbers"
    typical_noise: ClassVar = (0.05, 0.05)
    values: torch.Tensor
    shown: torch.Tensor
    fps: float
    start_time: float = 0.0
    ground_known: bool = False

    def predict(self, body: PosedBody) -> torch.Tensor:
        return body.joints[..., 15:16, 2:]


def test_a_sensor_that_says_nothing_of_up_leaves_a_level_frame_level():
    """It turned the ground under level joints, which were then 20 cm off."""
    truth = walk(24)
    every = joints3d(truth, bundled(), Corruption(noise=0.01), 0).replace(ground_known=False)
    measured = bundled().pose(truth).joints[..., 15:16, 2:]
    heights = Heights(measured, measured[..., 0] > 0, truth.fps)
    result = recon.fit([every, heights], "pose")
    assert joint_error(result.motion, truth) < 0.03
    assert result.ground is not None
    assert result.ground[:3].tolist() == pytest.approx([0, 0, 1])
    with pytest.raises(ObservationError, match="ground_known: joints3d False, heights True"):
        recon.fit([every, heights.replace(ground_known=True)], "pose")


def test_beside_a_camera_its_posture_is_better():
    truth = walk(FRAMES)
    seen = view(truth, cameras(truth)[0], seed=3)
    alone = recon.fit(seen, "pose").motion
    both = recon.fit([seen, units(truth, bundled())], "pose").motion
    assert posture_error(both, truth) < 0.9 * posture_error(alone, truth)


@pytest.mark.slow
def test_long_recordings_are_cut_into_windows():
    slow = walk(43).replace(fps=4.0)
    every = joints3d(slow, bundled(), Corruption(noise=0.02), 0)
    result = recon.fit([units(slow, bundled()), every], "pose")
    assert isinstance(result.reconstruction, LongReconstruction)
    assert joint_error(result.motion, slow) < 0.04


def test_files_are_read_by_its_class(tmp_path, capsys):
    truth = walk(FRAMES)
    file, points, out = (tmp_path / name for name in ("units.npz", "joints.npz", "out.npz"))
    np.savez(file, orientations=turns(truth, bundled()), bones=WORN, fps=truth.fps)
    joints = joints3d(truth, bundled(), Corruption(noise=0.02), 0)
    named = PositionsFile(
        "joints3d", joints.positions.numpy(), joints.visible.numpy(), JOINTS, truth.fps
    )
    save_observation(points, named)
    both = recon.load_observation([points, file], reader=SENSOR)
    assert isinstance(both, list)
    assert [one.kind for one in both] == ["joints3d", "imus"]
    torch.testing.assert_close(both[1].values[0], units(truth, bundled()).values)
    words = f"fit {points} {file} --reader {SENSOR} --prior pose --json --out {out}"
    assert cli.run(words.split()) == cli.OK
    report = json.loads(capsys.readouterr().out)
    assert [one["unit"] for one in report["residuals"]] == ["metres", "radians"]
    assert joint_error(recon.load_motion(out).motion, truth) < 0.03
    with pytest.raises(ReconError, match="imported"):
        recon.load_observation(file, reader="nobody:Nothing")
    with pytest.raises(ObservationError, match="reads"):
        recon.load_observation(file, reader="pathlib:Path")


def test_a_sensor_whose_fields_do_not_fit_is_refused_by_name():
    """Shapes that broadcast were compared without a word; nan spoiled a fit after minutes."""
    seen = units(walk(FRAMES), bundled())
    spoiled = seen.values.clone()
    spoiled[0, 0] = torch.nan
    for wrong, words in (
        (seen.replace(shown=seen.shown[:, :1]), "Imus.shown: expected booleans"),
        (seen.replace(values=seen.values[..., :2]), "three coordinates"),
        (seen.replace(values=seen.values.numpy()), "Imus.values: expected a tensor of torch"),
        (seen.replace(values=seen.values[:, 0, 0]), r"Imus.values: .*got Tensor of \(16,\)"),
        (seen.replace(values=spoiled), "nan or inf"),
        (seen.replace(bones=seen.bones[:1]), "predict: expected axes"),
    ):
        with pytest.raises(ObservationError, match=words):
            recon.fit(wrong, "pose", shape=[0.0])


def test_a_sensor_without_the_fields_of_a_clock_is_refused():
    """Windows of long recordings would all have begun at its one start."""

    @dataclass(frozen=True)
    class Fixed(Sensor):
        values: torch.Tensor
        shown: torch.Tensor
        fps: float
        start_time: ClassVar[float] = 0.0
        ground_known: bool = True

        def predict(self, body: PosedBody) -> torch.Tensor:
            return body.joints[..., :1, :]

    seen = Fixed(torch.zeros(5, 1, 3), torch.ones(5, 1, dtype=torch.bool), 30.0)
    with pytest.raises(ObservationError, match="fields start_time"):
        recon.fit(seen, "pose")

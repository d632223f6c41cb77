"""Wrong calibrations and images, through files: said, or fitted correctly; never a traceback."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from recon.core.layouts import keypoint_names
from recon.core.motion import Motion
from recon.fitting.settings import FitSettings
from recon.formats.motions import load_motion
from recon.formats.observations import CameraArrays, KeypointsFile
from recon.simulation.images import camera_arrays, keypoints2d
from recon.simulation.points import Corruption
from tests.filmed import NOISE, bundled, cameras, joint_error, walk
from tests.keypoint_scene import write_openpose, write_toml
from tests.verbs import fit_files

FRAMES = 12
WIDTH = 1920
Person = np.ndarray
"""Keypoints of a frame: x, y, confidence."""


def same(person: Person) -> Person:
    return person


def unchanged(camera: CameraArrays) -> CameraArrays:
    return camera


@dataclass(frozen=True)
class Recording:
    """Folders as OpenPose writes them and a calibration, with something wrong."""

    views: int = 3
    camera: Callable[[CameraArrays], CameraArrays] = unchanged
    person: Callable[[Person], Person] = same
    scale: float = 1.0
    """Of the calibration's translations."""
    empty: tuple[int, ...] = ()
    """Frames with nobody."""
    another: tuple[float, float] | None = None
    """Where a second person walks beside the first, metres."""

    def write(self, folder: Path) -> tuple[list[Path], Path]:
        paths, found = [], {}
        for k, camera in enumerate(cameras(walk(FRAMES), self.views)):
            file = keypoints2d(walk(FRAMES), bundled(), camera, Corruption(noise=NOISE), k)
            frames = [[self.person(person)] for person in people(file)]
            if self.another is not None:
                beside = keypoints2d(self.second(), bundled(), camera, Corruption(noise=NOISE), 9)
                # their order in the file changes from frame to frame
                frames = [
                    [*mine, other][:: 1 if t % 2 else -1]
                    for t, (mine, other) in enumerate(zip(frames, people(beside), strict=True))
                ]
            frames = [[] if t in self.empty else frame for t, frame in enumerate(frames)]
            paths.append(write_openpose(folder / f"cam{k}", frames))
            arrays = replace(camera_arrays(camera), distortion=np.zeros(4))
            found[f"cam{k}"] = self.camera(arrays)
        return paths, write_toml(folder / "Calib.toml", found, self.scale)

    def second(self) -> Motion:
        assert self.another is not None
        shift = walk(FRAMES).translation.new_tensor([*self.another, 0.0])
        return walk(FRAMES).replace(translation=walk(FRAMES).translation + shift)


def people(file: KeypointsFile) -> list[Person]:
    return list(np.concatenate((file.pixels, file.confidence[..., None]), -1))


def focal(factor: float) -> Callable[[CameraArrays], CameraArrays]:
    def change(camera: CameraArrays) -> CameraArrays:
        matrix = camera.camera_matrix.copy()
        matrix[[0, 1], [0, 1]] *= factor
        return replace(camera, camera_matrix=matrix)

    return change


def swapped_size(camera: CameraArrays) -> CameraArrays:
    return replace(camera, image_size=camera.image_size[::-1])


def swapped(camera: CameraArrays) -> CameraArrays:
    """Size and principal point."""
    matrix = camera.camera_matrix.copy()
    matrix[:2, 2] = matrix[[1, 0], 2]
    return replace(swapped_size(camera), camera_matrix=matrix)


def mirrored(person: Person) -> Person:
    """What a detector finds in the mirrored image: a left arm that is the right one."""
    names = keypoint_names("openpose25")
    other = {"left": "right", "right": "left"}
    sides = [name.partition("_") for name in names]
    order = [names.index(f"{other[a]}_{b}" if a in other else a + _ + b) for a, _, b in sides]
    turned = person[order]
    return np.where([True, False, False], WIDTH - turned, turned)


def fitted(recording: Recording, folder: Path, **settings) -> tuple[Motion, str]:
    """The motion, and all repairs and warnings."""
    paths, calibration = recording.write(folder)
    given = FitSettings(
        prior="pose", camera=calibration, frame_rate=30.0, layout="openpose25", **settings
    )
    report = fit_files(paths, folder / "out.npz", given)
    assert not report["failed"]
    return load_motion(folder / "out.npz").motion, " ".join(
        finding["message"] for finding in (*report["repairs"], *report["warnings"])
    )


@pytest.mark.parametrize("views", [1, 3])
def test_good_files_are_fitted_without_a_word(views, tmp_path):
    motion, warnings = fitted(Recording(views), tmp_path)
    assert warnings == ""
    assert joint_error(motion, walk(FRAMES)) < (0.03 if views == 3 else 0.09)  # metres


@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_a_wrong_focal_length_makes_one_posed_view_a_giant_or_a_dwarf(factor, tmp_path):
    _, warnings = fitted(Recording(1, camera=focal(factor)), tmp_path)
    assert "m tall; check focal lengths" in warnings


def test_a_doubled_focal_length_of_three_views_is_said(tmp_path):
    _, warnings = fitted(Recording(camera=focal(2.0)), tmp_path)
    assert "m tall; check focal lengths" in warnings
    assert "soles stand at" in warnings


def test_a_halved_focal_length_of_three_views_is_refused(tmp_path):
    with pytest.raises(ValueError, match="trunk"):
        fitted(Recording(camera=focal(0.5)), tmp_path)


def test_a_swapped_size_alone_harms_nobody(tmp_path):
    motion, _ = fitted(Recording(1, camera=swapped_size), tmp_path)
    assert joint_error(motion, walk(FRAMES)) < 0.09


def test_width_and_height_swapped_in_one_posed_view_leave_soles_in_the_air(tmp_path):
    _, warnings = fitted(Recording(1, camera=swapped), tmp_path)
    assert "soles stand at" in warnings


def test_width_and_height_swapped_in_three_views_are_refused(tmp_path):
    with pytest.raises(ValueError, match="rays"):
        fitted(Recording(camera=swapped), tmp_path)


def test_a_calibration_in_millimetres_is_told_apart(tmp_path):
    motion, _ = fitted(Recording(3, scale=1000.0), tmp_path)
    assert joint_error(motion, walk(FRAMES)) < 0.03


def test_a_calibration_in_millimetres_that_is_said_to_be_metres_is_no_silent_error(tmp_path):
    _, warnings = fitted(Recording(1, scale=1000.0), tmp_path, camera_unit="m")
    assert "m from the camera" in warnings or "soles stand at" in warnings


def test_mirrored_images_of_three_views_are_said(tmp_path):
    """Around a person they fit together almost, as if the person stood the other way round."""
    _, said = fitted(Recording(person=mirrored), tmp_path)
    assert "mirrored" in said


def test_a_mirrored_view_alone_is_the_mirrored_motion(tmp_path):
    """It cannot be told from a person who did that; it is fitted as well as the true one."""
    motion, _ = fitted(Recording(1, person=mirrored), tmp_path)
    camera = cameras(walk(FRAMES))[0]

    def seen(one: Motion):
        # joints in the middle of the body, which have no other side
        return camera.to_camera(bundled().pose(one).joints[:, [0, 3, 6, 9, 12, 15]])

    flipped = seen(motion) * motion.translation.new_tensor([-1.0, 1.0, 1.0])
    assert (flipped - seen(walk(FRAMES))).norm(dim=-1).mean() < 0.1  # metres


def test_two_people_are_not_mixed(tmp_path):
    """Their order in the files changes with every frame."""
    recording = Recording(another=(0.9, 0.4))
    with pytest.raises(ValueError, match="--person"):
        fitted(recording, tmp_path / "which")
    motion, warnings = fitted(recording, tmp_path / "one", person=1)
    assert warnings == ""
    truths = (walk(FRAMES), recording.second())
    assert min(joint_error(motion, truth) for truth in truths) < 0.03


def test_the_person_asked_for_in_one_view_is_one_of_them(tmp_path):
    recording = Recording(1, another=(0.3, -0.9))
    motion, _ = fitted(recording, tmp_path, person=1)
    truths = (walk(FRAMES), recording.second())
    assert min(joint_error(motion, truth) for truth in truths) < 0.15


@pytest.mark.parametrize("views", [1, 3])
def test_frames_without_anybody_are_filled_in(views, tmp_path):
    motion, warnings = fitted(Recording(views, empty=(0, 1, 7, 8, 9)), tmp_path)
    assert warnings == ""
    assert motion.frames == FRAMES
    assert joint_error(motion, walk(FRAMES)) < (0.04 if views == 3 else 0.1)


def test_files_without_anybody_at_all_are_refused(tmp_path):
    with pytest.raises(ValueError, match="all 12 frames are empty"):
        fitted(Recording(1, empty=tuple(range(FRAMES))), tmp_path)
    assert not (tmp_path / "out.npz").exists()

"""Everybody in the detections of one film: a motion each, in one world."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

import recon
from recon.body.soles import ground_heights
from recon.core import rotations as so3
from recon.core.motion import MotionFile
from recon.core.rotations import transform
from recon.fitting.settings import FitSettings
from recon.people.camera import shared_camera
from recon.people.together import load_people
from recon.reading.clip import load_clip
from recon.reading.places import files_of_views
from recon.simulation.images import keypoints2d
from recon.simulation.points import Corruption
from recon.view.info import info
from tests.filmed import BESIDE, before_two, bundled, cameras, two_people, view, walk
from tests.verbs import report_of

FRAMES = 24


@pytest.fixture(scope="module")
def film(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Detections of OpenPose, which names nobody; people change places in its files."""
    camera = before_two()
    seen = [
        keypoints2d(motion, bundled(), camera, Corruption(noise=2.0), k)
        for k, motion in enumerate(two_people(FRAMES))
    ]
    folder = tmp_path_factory.mktemp("film") / "cam"
    folder.mkdir()
    for t in range(FRAMES):
        people = [
            np.concatenate((one.pixels[t], one.confidence[t][:, None]), 1).ravel().tolist()
            for one in (seen if t % 3 else seen[::-1])
        ]
        record = {"version": 1.3, "people": [{"pose_keypoints_2d": one} for one in people]}
        (folder / f"cam_{t:012d}_keypoints.json").write_text(json.dumps(record))
    return folder


def test_everybody_is_fitted_in_one_world(film: Path, tmp_path: Path) -> None:
    """Fits of one person each put their worlds and lenses where each liked best."""
    settings = FitSettings(prior="pose", frame_rate=30.0, image_size=(1920, 1080), person="all")
    report = report_of("fit-all", tmp_path / "people", observations=(film,), settings=settings)
    names = ["person_0.npz", "person_1.npz"]
    assert list(report["people"]) == list(report["summary"]) == names
    assert report["camera_shared"]
    assert any("one camera for 2 people" in line for line in report["read"])
    written = sorted(one.name for one in (tmp_path / "people").iterdir())
    assert written == [*names, "report.json"]
    files = [recon.load_motion(tmp_path / "people" / name) for name in names]
    assert files[0].T_world_camera is not None
    assert files[1].T_world_camera is not None
    assert torch.equal(files[0].T_world_camera, files[1].T_world_camera)
    assert all(one.ground is not None and float(one.ground[3]) == 0 for one in files)
    camera = torch.linalg.inv(files[0].T_world_camera[0])
    places = [transform(camera, bundled().pose(one.motion).joints)[:, 0].mean(0) for one in files]
    across = sorted(float(place[0]) for place in places)
    assert across[1] - across[0] == pytest.approx(BESIDE[1] - BESIDE[0], rel=0.25)
    assert abs(float(places[0][2] - places[1][2])) < 0.6
    assert all(abs(float(ground_heights(one.motion[None], bundled()))) < 0.04 for one in files)


def test_people_of_a_recording_are_clips_of_their_own(film: Path) -> None:
    people = load_people(film, frame_rate=30.0, image_size=(1920, 1080))
    assert [one.number for one in people] == [0, 1]
    means = [one.clip.observations[0].shown.sum() for one in people]  # type: ignore[union-attr]
    assert all(int(count) > 20 * FRAMES for count in means)


def test_between_leaves_out_who_is_gone_by_then(film: Path, tmp_path: Path) -> None:
    """A person who was seen outside of it alone made the fit of everybody fail."""
    (tmp_path / "cam").mkdir()
    for t, path in enumerate(sorted(film.iterdir())):
        record = json.loads(path.read_text())
        if t >= 16:
            del record["people"][1 if t % 3 else 0]
        (tmp_path / "cam" / path.name).write_text(json.dumps(record))
    how = {"frame_rate": 30.0, "image_size": (1920, 1080)}
    (one,) = load_people(tmp_path / "cam", between=(0.25, 0.8), **how)
    (view,) = one.clip.observations
    assert one.number == 1
    assert view.start_time == pytest.approx(0.25, abs=0.03)
    assert len(load_people(tmp_path / "cam", **how)) == 2
    with pytest.raises(recon.ReconError, match=r"--between 5 6: nobody is seen"):
        load_people(tmp_path / "cam", between=(5.0, 6.0), **how)


def test_one_clip_is_of_one_person(film: Path) -> None:
    settings = FitSettings(frame_rate=30.0, person="all")
    with pytest.raises(recon.ReconError, match="recon fit --person all"):
        load_clip([film], settings, bundled())


def test_nobody_is_no_recording() -> None:
    with pytest.raises(recon.ReconError, match="nobody to fit"):
        recon.fit_people([])


def test_masks_are_of_one_person(film: Path, tmp_path: Path) -> None:
    settings = FitSettings(frame_rate=30.0, person="all", masks=film)
    with pytest.raises(recon.ReconError, match="--masks"):
        report_of("fit-all", tmp_path / "people", observations=(film,), settings=settings)


def test_keypoints_at_the_border_of_the_image_are_not_seen(tmp_path):
    """Detectors clamp to the border what the image does not show: fits were twice as far off."""
    camera = cameras(walk(8))[0]
    seen = view(walk(8), camera)
    width, height = 1920, 1080
    pixels = seen.pixels[0].numpy().copy()
    pixels[2, 0, 1], pixels[3, 1, 0], pixels[4, 2, 0] = height - 1, 0.2, width + 30
    np.savez(tmp_path / "cam.npz", keypoints=pixels, scores=seen.confidence[0].numpy())
    np.savez(
        tmp_path / "lens.npz",
        camera_matrix=camera.camera_matrix.reshape(3, 3).numpy(),
        image_size=np.array([width, height]),
    )
    read = recon.load_observation(
        tmp_path / "cam.npz", camera=tmp_path / "lens.npz", frame_rate=30.0, layout="openpose25"
    )
    assert isinstance(read, recon.Keypoints2D)
    hidden = (read.confidence[0] == 0).nonzero().tolist()
    assert hidden == [[2, 0], [3, 1], [4, 2]]


def test_arrays_of_keypoints_are_taken_by_every_verb(tmp_path):
    """`info`, `refine` and a folder of views refused what `fit` took."""
    views = [view(walk(8), camera) for camera in cameras(walk(8), 2)]
    (tmp_path / "rig").mkdir()
    for k, seen in enumerate(views):
        pixels, scores = seen.pixels[0].numpy(), seen.confidence[0].numpy()
        np.savez(tmp_path / "rig" / f"cam{k}.npz", keypoints=pixels, scores=scores)
    assert info(tmp_path / "rig" / "cam0.npz")["people"][0].startswith("person 0: 8 frames")
    assert info(tmp_path / "rig")["format"] == "2D keypoints of 2 views"
    assert [one.name for one in files_of_views([tmp_path / "rig"])[0]] == ["cam0.npz", "cam1.npz"]
    for path in (tmp_path / "rig", tmp_path / "rig" / "cam0.npz"):
        with pytest.raises(recon.ReconError, match="`recon fit` takes it"):
            recon.refine(path, "pose")


def test_who_leans_does_not_tilt_the_ground(film: Path) -> None:
    """The ground was tilted by the mean lean of runners, who ran uphill by it; soles tell better.

    Two walkers are found in worlds that are rolled about the viewing axis by 12 degrees.
    """
    body, camera = bundled(), before_two().T_camera_world.reshape(4, 4)
    roll = torch.eye(4)
    roll[:3, :3] = so3.exp(torch.tensor([0.0, 0.21, 0.0]))
    results = []
    for person, truth in zip(load_people(film, frame_rate=30.0), two_people(60), strict=True):
        begun = recon.fit(person.clip, "pose", checks=(), max_seconds=0.01)
        rolled = truth.carried(roll, body.rest_joints(truth.shape)[0])
        T = roll @ torch.linalg.inv(camera)
        file = MotionFile(rolled, joints=body.pose(rolled).joints, T_world_camera=T[None])
        results.append(replace(begun, file=file))
    found = shared_camera(results).T_camera_world
    assert float(found[:3, 2] @ camera[:3, 2]) > np.cos(np.radians(4.0))


def test_who_is_in_the_air_and_upside_down_does_not_tilt_the_ground(film: Path) -> None:
    """Somebody who turned a cartwheel lay 20 cm above the ground of both, a third too large.

    One is as the truth, the other 0.4 m in the air in half of the frames, in a world that is off
    by 40 degrees.
    """
    body, camera = bundled(), before_two().T_camera_world.reshape(4, 4)
    roll = torch.eye(4)
    roll[:3, :3] = so3.exp(torch.tensor([0.0, 0.7, 0.0]))
    results = []
    for k, truth in enumerate(two_people(60)):
        (person,) = [p for p in load_people(film, frame_rate=30.0) if p.number == k]
        begun = recon.fit(person.clip, "pose", checks=(), max_seconds=0.01)
        up = torch.tensor([0.0, 0.0, 0.4]) * (k * (torch.arange(60) % 30 < 15))[:, None]
        T = roll if k else torch.eye(4)
        moved = truth.replace(translation=truth.translation + up)
        moved = moved.carried(T, body.rest_joints(truth.shape)[0])
        T_world_camera = (T @ torch.linalg.inv(camera))[None]
        file = MotionFile(moved, joints=body.pose(moved).joints, T_world_camera=T_world_camera)
        results.append(replace(begun, file=file))
    shared = shared_camera(results)
    found = shared.T_camera_world
    assert float(found[:3, 2] @ camera[:3, 2]) > np.cos(np.radians(3.0))
    sizes = [
        float(body.height(start.shape) / body.height(one.motion.shape))
        for start, one in zip(shared.starts, results, strict=True)
    ]
    assert np.allclose(sizes, 1.0, atol=0.05)

"""Cameras, images, clouds and the ground in pictures: drawn where the geometry says."""

import math
from pathlib import Path

import av
import cv2
import numpy as np
import pytest
import torch

from recon.body.model import BodyModel
from recon.core.camera import Camera, Ground, pose_looking_at
from recon.core.motion import MotionFile
from recon.core.skeleton import JOINTS, joint_index
from recon.formats.motions import load_motion, save_motion
from recon.formats.observations import CameraArrays, KeypointsFile, PointsFile, save_observation
from recon.view import Figure, Show, View
from recon.view.files import view
from recon.view.frames import write_mp4, write_png
from recon.view.html import write_html
from recon.view.images import clip_region, close_up_regions, paint_view, whole_image
from recon.view.observed import read_observed
from recon.view.painter import frustum, paint
from recon.view.scene import CAMERA, MISSING, REPROJECTED, VISIBLE
from recon.view.viewpoint import viewpoints
from tests.view.test_view import embedded, walk

WIDTH, HEIGHT = 640, 360
LENS = torch.tensor([-0.25, 0.05, 0.002, -0.001]).double()
LEGS = [joint_index("left_knee"), joint_index("right_knee")]


def camera(lens: torch.Tensor | None = LENS, angle: float = 0.4) -> Camera:
    """Four metres from where the walk begins, which is off the image's middle."""
    matrix = torch.tensor([[420.0, 0, 330], [0, 430, 170], [0, 0, 1]]).double()
    place = torch.tensor([4 * math.sin(angle), 4 * math.cos(angle), 1.4]).double()
    pose = pose_looking_at(place, torch.tensor([0.5, 0.0, 1.0]).double())
    return Camera.create(matrix, (WIDTH, HEIGHT), lens, pose)


def filmed(body: BodyModel, frames: int = 4, **fields) -> Show:
    figure = Figure(body, walk(body, frames))
    seen = camera()
    pixels = seen.project(figure.posed.joints.double())
    confidence = torch.ones(frames, len(JOINTS))
    confidence[:, LEGS[0]], confidence[:, LEGS[1]] = 0.1, 0.0
    shift = torch.zeros_like(pixels.pixels)
    shift[:, joint_index("head"), 1] = -20.0  # pixels
    found = torch.where(confidence[..., None] > 0, pixels.pixels + shift, 0.0)
    view = View("left", seen, found, confidence, pixels)
    return Show("filmed", (figure,), **{"cameras": (view,), **fields})


def near(colour: tuple[int, int, int], picture: np.ndarray, place: np.ndarray) -> bool:
    x, y = np.round(place).astype(int)
    patch = picture[y - 1 : y + 2, x - 1 : x + 2].astype(float)
    return bool(np.abs(patch - colour).sum(-1).min() < 60)


def test_body_is_painted_where_the_lens_puts_it(body: BodyModel) -> None:
    show = filmed(body)
    for lens in (LENS, None):
        view = View("bare", camera(lens))
        picture = paint_view(show, view, 1, whole_image(view), WIDTH).astype(float)
        assert picture.shape == (HEIGHT, WIDTH, 3)
        blue = picture[..., 2] - picture[..., 0] > 25
        surface = view.at(1).project(show.figures[0].posed.vertices[1].double()).pixels.numpy()
        rows, columns = np.nonzero(blue)
        box = [columns.min(), rows.min(), columns.max(), rows.max()]
        assert np.abs(np.array(box) - [*surface.min(0), *surface.max(0)]).max() < 2.5  # pixels


def test_points_are_dots_rings_and_lines(body: BodyModel) -> None:
    show = filmed(body)
    (view,) = show.cameras
    assert view.pixels is not None
    assert view.reprojected is not None
    part = whole_image(view)
    picture = paint_view(show, view, 2, part, 3 * WIDTH)
    found = part.place(view.pixels[2].numpy(), 3 * WIDTH)
    own = part.place(view.reprojected.pixels[2].double().numpy(), 3 * WIDTH)
    head = joint_index("head")
    assert near(VISIBLE, picture, found[head])
    assert near(REPROJECTED, picture, own[head])
    assert near(REPROJECTED, picture, (found[head] + own[head]) / 2)
    assert near(VISIBLE, picture, found[LEGS[0]] + (4.25, 0))
    assert near(MISSING, picture, own[LEGS[1]] + (4.25, 0))
    assert not near(MISSING, picture, own[LEGS[1]])
    assert not near(VISIBLE, picture, np.array([2.0, 2.0]))  # the unseen is not at pixel zero
    assert view.median_error == pytest.approx(0.0, abs=1e-3)  # pixels: 19 of 20 sure points
    words = dict(show.legend)
    assert "not detected, on the body" in words


def test_regions_hold_the_people(body: BodyModel) -> None:
    show = filmed(body, 30)
    (view,) = show.cameras
    surface = view.camera.project(show.figures[0].posed.vertices.double()).pixels.numpy()
    part = clip_region(show, view)
    assert part.width / part.height == pytest.approx(WIDTH / HEIGHT)
    inside = part.place(surface.reshape(-1, 2), 100)
    assert (inside >= 0).all()
    assert (inside <= part.size(100)).all()
    squares = close_up_regions(show, view, [0, 15, 29])
    assert len({square.width for square in squares}) == 1
    for frame, square in zip([0, 15, 29], squares, strict=True):
        inside = square.place(surface[frame], 100)
        assert (inside >= 0).all()
        assert (inside <= 100).all()
    behind = View("behind", camera().placed(torch.tensor([0, 9.0, 1]).double(),
                                            torch.tensor([0, 12.0, 1]).double()))  # fmt: skip
    assert clip_region(show, behind) == whole_image(behind)
    paint_view(show, behind, 0, whole_image(behind), 80)


def test_moving_camera_is_taken_frame_by_frame(body: BodyModel) -> None:
    show = filmed(body, 3)
    poses = torch.stack([camera(angle=angle).T_camera_world for angle in (0.4, 0.5, 0.6)])
    view = View("moving", camera().replace(T_camera_world=poses))
    assert view.frames == 3
    assert torch.equal(view.at(2).T_camera_world, poses[2])
    assert np.array_equal(
        paint_view(show, view, 2, whole_image(view), 160),
        paint_view(show, View("fixed", camera(angle=0.6)), 2, whole_image(view), 160),
    )


def test_scene_shows_cameras_and_keeps_them_in_view(body: BodyModel) -> None:
    show = filmed(body)
    stand = viewpoints(show, (240, 200))[0]
    lines = frustum(show.cameras[0].at(0))
    pixels, depth = stand.project(lines.reshape(-1, 3))
    assert (depth > 0).all()
    assert ((pixels > 0) & (pixels < (240, 200))).all()
    corners = (
        show.cameras[0].at(0).replace(distortion=None).project(torch.from_numpy(lines[:4, 1]))
    )
    wanted = [[0, 0], [WIDTH, 0], [WIDTH, HEIGHT], [0, HEIGHT]]
    assert np.abs(corners.pixels.numpy() - wanted).max() < 1e-6  # pixels
    picture = paint(show, 0, stand)
    assert near(CAMERA, picture, stand.project(lines[0].mean(0)[None])[0][0] - 0.5)


def test_ground_is_drawn_as_given(body: BodyModel) -> None:
    level = filmed(body)
    stand = viewpoints(level, (120, 100))[0]
    as_given = paint(level, 0, stand)
    zero = Ground(torch.tensor([0.0, 0, 1]), torch.tensor(0.0))
    assert np.array_equal(paint(filmed(body, ground=zero), 0, stand), as_given)
    tilted = Ground.create(torch.tensor([0.15, 0.1, 1.0]), torch.tensor(-0.05))
    assert np.abs(paint(filmed(body, ground=tilted), 0, stand).astype(int) - as_given).max() > 5
    # A ground above the head hides the body from a viewer above it.
    high = Ground(torch.tensor([0.0, 0, 1]), torch.tensor(float(stand.position[2]) - 0.05))
    covered = paint(filmed(body, ground=high, cameras=()), 0, stand).astype(float)
    assert (covered[..., 2] - covered[..., 0]).max() < 25


def test_page_holds_cameras_clouds_and_a_tilted_ground(body: BodyModel, tmp_path: Path) -> None:
    cloud = (torch.rand(30, 3), torch.zeros(0, 3), torch.rand(20, 3), torch.rand(10, 3))
    tilted = Ground.create(torch.tensor([0.0, 0.2, 1.0]), torch.tensor(0.1))
    show = filmed(body, cloud=cloud, ground=tilted)
    write_html(tmp_path / "page.html", show)
    page = (tmp_path / "page.html").read_text(encoding="utf-8")
    messages = [message for _, message in embedded(page)["messages"]]
    names = {message.get("name") for message in messages}
    assert {"/world/cameras/left", "/world/scan", "/world/ground"} <= names
    turn = next(
        message["wxyz"]
        for message in reversed(messages)
        if message.get("name") == "/world/ground" and "wxyz" in message
    )
    assert abs(turn[0]) == pytest.approx(math.cos(math.atan(0.2) / 2), abs=1e-4)
    stand = viewpoints(show, (120, 100))[0]
    for frame in (0, 1):
        paint(show, frame, stand)
        paint_view(show, show.cameras[0], frame, whole_image(show.cameras[0]), 80)


def test_sheet_and_film_of_views(body: BodyModel, tmp_path: Path) -> None:
    show = filmed(body, 5)
    second = View("right", camera(angle=-0.4))
    show = Show("two", show.figures, cameras=(*show.cameras, second))
    write_png(tmp_path / "views.png", show, frames=[0, 4], width=80)
    sheet = cv2.imread(str(tmp_path / "views.png"))
    assert sheet is not None
    assert sheet.shape[1] == 2 * 80 + 4
    assert sheet.shape[0] > 60 + 2 * 80 + 2 * 4
    write_mp4(tmp_path / "views.mp4", show, width=96)
    with av.open(str(tmp_path / "views.mp4")) as film:
        pictures = [picture.to_ndarray(format="rgb24") for picture in film.decode(video=0)]
    assert len(pictures) == 5
    assert pictures[0].shape[1] == 2 * 96 + 4
    assert sorted(path.name for path in tmp_path.iterdir()) == ["views.mp4", "views.png"]


def test_bad_views_are_refused(body: BodyModel) -> None:
    seen = camera()
    with pytest.raises(ValueError, match="but no pixels"):
        View("a", seen, confidence=torch.ones(3, 2))
    with pytest.raises(ValueError, match="arrays of different lengths"):
        View(
            "a", seen, torch.zeros(3, 2, 2), reprojected=seen.project(torch.ones(3, 1, 3).double())
        )
    moving = seen.replace(T_camera_world=seen.T_camera_world.expand(4, 4, 4))
    with pytest.raises(ValueError, match="as many camera poses"):
        View("a", moving, torch.zeros(3, 2, 2))
    with pytest.raises(ValueError, match="select one clip"):
        View("a", seen.replace(T_camera_world=seen.T_camera_world.expand(1, 3, 4, 4)))
    figures = filmed(body, 3).figures
    with pytest.raises(ValueError, match="different names"):
        Show("a", figures, cameras=(View("a", seen), View("a", seen)))
    with pytest.raises(ValueError, match="same number of frames"):
        Show("a", figures, cameras=(View("a", seen, torch.zeros(4, 2, 2)),))


def arrays(posed: bool = True) -> CameraArrays:
    seen = camera()
    pose = seen.T_camera_world[None].numpy() if posed else None
    return CameraArrays(seen.camera_matrix.numpy(), seen.image_size, LENS.numpy(), pose)


def test_files_of_images_become_views(tmp_path: Path) -> None:
    """A motion seen from its own camera has no error, whichever file knows the pose."""
    correspondences = pytest.importorskip("observations.correspondences")
    body, frames = BodyModel.load(), 4
    motion = walk(BodyModel.load().to(dtype=torch.float64), frames).to(dtype=torch.float32)
    save_motion(tmp_path / "fit.npz", MotionFile(motion))
    pose = camera().T_world_camera[None].float()
    save_motion(tmp_path / "own.npz", MotionFile(motion, T_world_camera=pose))
    points = correspondences.BodyPoints.of_layout("coco17", body).of(body.pose(motion))
    pixels = camera().project(points.double()).pixels.numpy()
    ones = np.ones(pixels.shape[:2])
    for name, posed in (("posed", True), ("unposed", False)):
        file = KeypointsFile(pixels, ones, "coco17", motion.fps, arrays(posed))
        save_observation(tmp_path / f"{name}.npz", file)
    for file, name in (("fit.npz", "posed.npz"), ("own.npz", "unposed.npz")):
        _, _, (seen,) = read_observed([tmp_path / name], load_motion(tmp_path / file), body)
        assert seen.median_error == pytest.approx(0.0, abs=0.01)  # pixels
    with pytest.raises(ValueError, match=r"unposed\.npz: the camera has no pose"):
        view(tmp_path / "fit.npz", obs=(tmp_path / "unposed.npz",), png=tmp_path / "a.png")
    half = KeypointsFile(pixels[:, :9], ones[:, :9], "coco17", motion.fps, arrays())
    save_observation(tmp_path / "half.npz", half)
    with pytest.raises(ValueError, match="layout coco17 has 17 points, the file 9"):
        view(tmp_path / "fit.npz", obs=(tmp_path / "half.npz",), png=tmp_path / "a.png")


def test_files_of_clouds_come_into_the_world(tmp_path: Path) -> None:
    motion = walk(BodyModel.load().to(dtype=torch.float64), 4).to(dtype=torch.float32)
    points = torch.rand(7, 3).double()
    frame = np.array([2, 0, 0, 2, 2, 0, 0])
    pose = camera().T_world_camera[None].float()
    file = MotionFile(motion, T_world_camera=pose)
    posed = PointsFile(points.numpy(), frame, motion.fps, arrays())
    local = PointsFile(camera().to_camera(points).numpy(), frame, motion.fps, arrays(posed=False))
    for name, cloud in (("posed", posed), ("local", local)):
        save_observation(tmp_path / f"{name}.npz", cloud)
        _, seen, (one,) = read_observed([tmp_path / f"{name}.npz"], file, BodyModel.load())
        assert seen is not None
        assert [len(part) for part in seen] == [4, 0, 3, 0]
        assert (seen[2] - points[[0, 3, 4]]).abs().max() < 1e-5  # metres
        assert (one.at(0).T_camera_world - camera().T_camera_world).abs().max() < 1e-5
    _, both, _ = read_observed(
        [tmp_path / "posed.npz", tmp_path / "local.npz"], file, BodyModel.load()
    )
    assert both is not None
    assert [len(part) for part in both] == [8, 0, 6, 0]

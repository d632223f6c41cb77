"""Pictures and pages: what is drawn is where it belongs, and files stand alone."""

import base64
import math
import re
from pathlib import Path

import av
import cv2
import msgspec
import numpy as np
import pytest
import torch
import zstandard

from recon.body.model import BodyModel
from recon.core import rotations as so3
from recon.core.motion import Motion
from recon.core.raster import rasterise, vertex_normals
from recon.core.skeleton import joint_index
from recon.view import Figure, Points, Show
from recon.view.frames import write_mp4, write_png
from recon.view.html import INFLUENCES, prune_weights, write_html
from recon.view.painter import paint
from recon.view.scene import CORAL, MISSING, VISIBLE, nearest_samples
from recon.view.viewpoint import following_viewpoints

TINY = (96, 120)


def walk(body: BodyModel, frames: int, fps: float = 30.0, speed: float = 1.2) -> Motion:
    """An upright body that faces and glides along +y with swinging thighs."""
    upright = so3.exp(torch.tensor([math.pi / 2, 0, 0]).double())
    rotations = torch.eye(3).double().repeat(frames, 22, 1, 1)
    rotations[:, 0] = so3.exp(torch.tensor([0, 0, math.pi]).double()) @ upright
    swing = torch.zeros(frames, 3).double()
    swing[:, 0] = 0.5 * torch.sin(torch.arange(frames) / 5)
    rotations[:, joint_index("left_hip")] = so3.exp(swing)
    rotations[:, joint_index("right_hip")] = so3.exp(-swing)
    place = torch.zeros(frames, 3).double()
    place[:, 1] = torch.arange(frames) * speed / fps
    still = Motion.create(place, rotations, torch.zeros(16).double(), fps)
    sole = body.pose(still).vertices[..., 2].amin(1)
    place[:, 2] = -sole
    return still.replace(translation=place)


def scene(body: BodyModel, frames: int, **fields) -> Show:
    motion = walk(body, frames)
    contacts = torch.zeros(frames, 22)
    contacts[:, joint_index("left_foot")] = 1.0
    joints = body.pose(motion).joints
    seen = joints[..., 2] > 0.5
    points = Points(torch.where(seen[..., None], joints, 0.0), seen, joints)
    figures = (Figure(body, motion, contacts=contacts),)
    return Show("A <title>", figures, **{"points": points, **fields})


def embedded(page: str) -> dict:
    """The recording inside a page, decoded the way viser's player does."""
    found = re.search(r'__VISER_EMBED_DATA__="([^"]+)"', page)
    assert found is not None
    packed = base64.b64decode(found.group(1))[8:]
    raw = zstandard.ZstdDecompressor().decompressobj().decompress(packed)
    return msgspec.msgpack.decode(raw[8 : 8 + int.from_bytes(raw[:8], "little")])


def test_page_is_self_contained_and_small(body: BodyModel, tmp_path: Path, capsys) -> None:
    path = tmp_path / "show.html"
    write_html(path, scene(body, 90))
    page = path.read_text(encoding="utf-8")
    assert (
        re.search(r"""(src|href)\s*=\s*["']?(https?:)?//""", page.split("<script", 1)[0]) is None
    )
    assert 'src="http' not in page
    assert '<link rel="stylesheet" href="http' not in page
    assert path.stat().st_size < 6e6  # bytes
    assert "A &lt;title&gt;" in page
    assert "A <title>" not in page
    assert "missing point, estimated" in page
    recording = embedded(page)
    assert recording["durationSeconds"] == pytest.approx(3.0, abs=1e-6)  # seconds
    kinds = [message["type"] for _, message in recording["messages"]]
    assert kinds.count("SkinnedMeshMessage") == 4  # the body, contacts, points seen and missing
    assert kinds.count("SetBoneOrientationMessage") > 90
    assert capsys.readouterr().out == ""
    assert [file.name for file in tmp_path.iterdir()] == ["show.html"]


def test_page_with_second_body_and_scan(body: BodyModel, tmp_path: Path) -> None:
    frames = 3
    cloud = tuple(torch.rand(2000 + k, 3) for k in range(frames))
    first = scene(body, frames, cloud=cloud)
    other = Figure(body, walk(body, frames, speed=0.5), "truth/A", CORAL, 0.5)
    show = Show("two", (*first.figures, other), first.points, cloud)
    write_html(tmp_path / "two.html", show)
    messages = embedded((tmp_path / "two.html").read_text(encoding="utf-8"))["messages"]
    names = {message.get("name") for _, message in messages}
    assert {"/world/truth-A/body", "/world/scan", "/world/points/missing"} <= names


def test_pruned_weights_sum_to_one_and_keep_small_rows() -> None:
    """A skinned page tore where more than four weights were cut and not rescaled."""
    generator = np.random.default_rng(0)
    weights = generator.random((50, 22))
    weights /= weights.sum(1, keepdims=True)
    pruned = prune_weights(weights)
    assert np.abs(pruned.sum(1) - 1).max() < 1e-12
    assert ((pruned > 0).sum(1) == INFLUENCES).all()
    assert np.abs(prune_weights(pruned) - pruned).max() < 1e-12


def test_raster_covers_a_triangle_and_the_nearer_wins() -> None:
    corners = np.array([[0.0, 0], [0, 40], [40, 0], [0, 40], [40, 40], [0, 0]])
    depth = np.array([1.0, 1, 1, 2, 2, 2])
    faces = np.array([[0, 1, 2], [3, 4, 5]])
    near = np.column_stack([corners, depth])
    picture = rasterise(corners, depth, faces, (40, 40), near)
    assert picture.depth[36, 1] == pytest.approx(1)  # in both triangles
    assert picture.depth[36, 20] == pytest.approx(2)
    assert not picture.covered[20, 36]
    row, column = np.nonzero(picture.covered)
    assert len(row) == pytest.approx(1200, abs=45)  # pixels: three quarters of 40 x 40
    seen = picture.values[row, column]
    assert np.abs(seen[:, :2] - np.stack([column, row], 1) - 0.5).max() < 1e-3
    assert np.abs(seen[:, 2] - picture.depth[row, column]).max() < 1e-5
    back = rasterise(corners, depth, np.array([[0, 2, 1]]), (40, 40))
    assert not back.covered.any()
    beyond = rasterise(corners - 100, depth, np.array([[0, 1, 2]]), (40, 40))
    assert not beyond.covered.any()
    assert not rasterise(corners, depth, faces[:0], (40, 40)).covered.any()
    with pytest.raises(ValueError, match="in front of the viewer"):
        rasterise(corners, -depth, faces, (40, 40))


def test_raster_interpolates_in_space() -> None:
    """Halfway between corners at 1 m and at 3 m the picture shows what is 1.5 m away."""
    corners = np.array([[0.0, 0], [0, 41], [41, 0]])
    picture = rasterise(corners, np.array([1.0, 1.0, 3.0]), np.array([[0, 1, 2]]), (41, 41))
    assert picture.depth[0, 20] == pytest.approx(1.5, abs=2e-2)


def test_raster_leaves_empty_pixels_empty_whatever_the_depths() -> None:
    """The end of OpenCV's range came back a rounding error nearer: all pixels seemed covered."""
    corners = np.array([[2.0, 2], [2, 6], [6, 2]])
    for depth in np.random.default_rng(0).uniform(0.1, 20, (300, 3)):
        picture = rasterise(corners, depth, np.array([[0, 1, 2]]), (9, 9))
        assert picture.covered.sum() == pytest.approx(8, abs=3)


def test_normals_of_the_body_point_outwards(body: BodyModel) -> None:
    vertices = body.template.numpy()
    normals = vertex_normals(vertices, body.faces.numpy())
    assert np.abs(np.linalg.norm(normals, axis=1) - 1).max() < 1e-9
    top = vertices[:, 1].argmax()
    assert normals[top, 1] > 0.8


def test_camera_follows_and_keeps_the_body_in_view(body: BodyModel) -> None:
    show = scene(body, 40)
    views = following_viewpoints(show.figures, TINY)
    for frame in (0, 20, 39):
        joints = show.figures[0].posed.joints[frame].double().numpy()
        pixels, depth = views[frame].project(joints)
        assert (depth > 0.5).all()  # metres
        assert ((pixels > 0) & (pixels < TINY)).mean() > 0.98
        assert abs(views[frame].target[1] - joints[0, 1]) < 0.02  # metres: no lag at the ends
    view = views[0]
    shown = view.coordinates_along(np.eye(3), np.full(TINY[::-1], 3.0, np.float32))[
        :, 17, 30
    ].astype(float)
    pixel, depth = view.project(shown[None])
    assert np.allclose(pixel, [[30.5, 17.5]], atol=1e-3)
    assert np.allclose(depth, 3.0, atol=1e-5)
    part, _ = view.part(10, 5, 60, 60).scaled(2).project(shown[None])
    assert np.allclose(part, [[41.0, 25.0]], atol=1e-3)
    front = show.figures[0].posed.orientations[0, 0, :, 2].double().numpy()
    assert (view.position - view.target) @ front > 0


def test_body_is_painted_where_it_projects(body: BodyModel) -> None:
    show = scene(body, 3, points=None)
    view = following_viewpoints(show.figures, TINY)[1]
    picture = paint(show, 1, view).astype(float)
    assert picture.shape == (TINY[1], TINY[0], 3)
    joints = show.figures[0].posed.joints[1].double().numpy()
    pixels, _ = view.project(joints)
    for name in ("pelvis", "spine2", "head", "left_knee"):
        x, y = pixels[joint_index(name)].astype(int)
        assert picture[y, x, 2] - picture[y, x, 0] > 25  # blue, while floor and sky are grey
    saturation = np.ptp(picture, axis=2)
    assert saturation[:, :4].max() < 12
    x, y = pixels[joint_index("left_foot")].astype(int)
    amber = picture[..., 0] - picture[..., 2] > 40  # where the foot touches, and nowhere else
    assert amber[y - 3 : y + 4, x - 3 : x + 4].any()
    amber[y - 8 : y + 9, x - 8 : x + 9] = False
    assert not amber.any()


def test_points_are_painted_in_their_colours(body: BodyModel) -> None:
    show = scene(body, 2)
    view = following_viewpoints(show.figures, (320, 400))[0]
    joints = show.figures[0].posed.joints[0].double().numpy()
    assert show.points is not None
    for name, colour in (("left_wrist", VISIBLE), ("left_knee", MISSING)):
        k = joint_index(name)
        without = paint(Show("bare", show.figures), 0, view).astype(float)
        x, y = view.project(joints)[0][k].astype(int)
        drawn = paint(show, 0, view)[y, x].astype(float)
        change = drawn - without[y, x]
        wanted = np.array(colour, float) - without[y, x]
        cosine = change @ wanted / np.linalg.norm(change) / np.linalg.norm(wanted)
        assert cosine > 0.8, name


def test_sheet_has_a_column_per_frame(body: BodyModel, tmp_path: Path) -> None:
    first = scene(body, 6, cloud=tuple(torch.rand(50, 3) for _ in range(6)))
    path = tmp_path / "sheet.png"
    write_png(path, first, frames=[0, 2, 5], width=96)
    sheet = cv2.imread(str(path))
    assert sheet is not None
    assert sheet.shape[1] == 3 * 96 + 2 * 4
    assert 117 < sheet.shape[0] < 2 * 117
    assert sheet.std() > 5
    write_png(path, first, width=96)
    sheet = cv2.imread(str(path))
    assert sheet is not None
    assert sheet.shape[1] == 5 * 96 + 4 * 4


def test_a_single_frame_is_a_show(body: BodyModel, tmp_path: Path) -> None:
    """The followed path of one frame has no slope; it used to become nan."""
    write_png(tmp_path / "one.png", scene(body, 1), width=96)
    sheet = cv2.imread(str(tmp_path / "one.png"))
    assert sheet is not None
    assert sheet[:117].std() > 5


def test_film_decodes_with_every_frame(body: BodyModel, tmp_path: Path) -> None:
    path = tmp_path / "film.mp4"
    write_mp4(path, scene(body, 7), width=161)
    with av.open(str(path)) as film:
        stream = film.streams.video[0]
        assert stream.codec_context.name == "h264"
        assert stream.codec_context.pix_fmt == "yuv420p"
        assert stream.average_rate == 30
        pictures = [picture.to_ndarray(format="rgb24") for picture in film.decode(stream)]
    assert len(pictures) == 7
    height, width = pictures[3].shape[:2]  # both even, as H.264 needs
    assert (height % 2, width) == (0, 162)
    assert pictures[3].std() > 5
    data = path.read_bytes()
    assert data.index(b"moov") < data.index(b"mdat")  # plays while it loads
    assert [file.name for file in tmp_path.iterdir()] == ["film.mp4"]


def test_points_move_to_other_times_by_the_nearest_sample() -> None:
    times, seen_at = torch.tensor([0.0, 0.11, 0.2, 0.5]), torch.tensor([0.0, 0.1, 0.2, 0.3])
    nearest, close = nearest_samples(times, seen_at)
    assert nearest.tolist() == [0, 1, 2, 3]
    assert close.tolist() == [True, True, True, False]


def test_bad_input_is_refused_and_leaves_files_alone(body: BodyModel, tmp_path: Path) -> None:
    show = scene(body, 4)
    motion = show.figures[0].motion
    path = tmp_path / "kept.png"
    path.write_bytes(b"old")
    with pytest.raises(ValueError, match=r"frames must be among 0, \.\.\., 3"):
        write_png(path, show, frames=[4], width=96)
    with pytest.raises(ValueError, match="pixels wide"):
        write_png(path, show, width=8)
    with pytest.raises(ValueError, match="pixels wide"):
        write_mp4(tmp_path / "large.mp4", show, width=4096)
    for write in (write_html, write_mp4):
        with pytest.raises(FileNotFoundError, match="folder"):
            write(tmp_path / "none" / "show", show)
    assert path.read_bytes() == b"old"
    assert [file.name for file in tmp_path.iterdir()] == ["kept.png"]
    with pytest.raises(ValueError, match="at least one figure"):
        Show("empty", ())
    with pytest.raises(ValueError, match="same number of frames"):
        Show("uneven", show.figures, Points(torch.zeros(3, 1, 3), torch.ones(3, 1).bool()))
    with pytest.raises(ValueError, match="different names"):
        Show("twins", (Figure(body, motion), Figure(body, motion)))
    with pytest.raises(ValueError, match="same frame rate"):
        Show("rates", (Figure(body, motion), Figure(body, motion.replace(fps=20.0), "b")))
    with pytest.raises(ValueError, match="one clip"):
        Figure(body, motion.map(lambda tensor: tensor[None]))
    with pytest.raises(ValueError, match="cut the padding"):
        Figure(body, motion.replace(valid=torch.tensor([True, True, True, False])))
    with pytest.raises(ValueError, match="opacity"):
        Figure(body, motion, opacity=0.0)
    with pytest.raises(ValueError, match="but 3 of contacts"):
        Figure(body, motion, contacts=torch.zeros(3, 22))

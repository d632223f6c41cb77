"""Folders of clouds and of depth images: read, thinned, and refused when unclear."""

import shutil

import cv2
import numpy as np
import pytest

from recon.formats.depth_images import read_depth_images
from recon.formats.observations import CameraArrays
from recon.formats.pcd import read_pcd
from recon.formats.scans import read_cloud, read_scans, write_ply

HEADER = "VERSION 0.7\nFIELDS x y z rgb\nSIZE 4 4 4 4\nTYPE F F F U\nCOUNT 1 1 1 1\n"


def person(frame, count=400):
    g = np.random.default_rng(frame)
    low, high = np.array([-0.3, -0.2, 0.0]), np.array([0.3, 0.2, 1.8])
    low[0], high[0] = low[0] + 0.1 * frame, high[0] + 0.1 * frame
    return g.uniform(low, high, (count, 3))


def pcd_header(count, data):
    return f"{HEADER}WIDTH {count}\nHEIGHT 1\nPOINTS {count}\nDATA {data}\n".encode()


def lzf_literal(data):
    runs = [data[k : k + 32] for k in range(0, len(data), 32)]
    return b"".join(bytes([len(run) - 1]) + run for run in runs)


def test_pcd_of_all_three_kinds(tmp_path):
    points = person(0, 30).astype(np.float32)
    points[3] = np.nan
    rows = np.zeros(30, [("p", "<f4", 3), ("c", "<u4")])
    rows["p"] = points
    text = "\n".join(f"{x} {y} {z} 7" for x, y, z in points.tolist())
    columns = points.T.tobytes() + bytes(120)
    # the zeros at the end as references one byte back: 3 + 9 and more
    packed = lzf_literal(columns[:361]) + bytes([7 << 5, 110, 0])
    sizes = len(packed).to_bytes(4, "little") + (480).to_bytes(4, "little")
    for name, body in (
        ("ascii", text.encode()),
        ("binary", rows.tobytes()),
        ("binary_compressed", sizes + packed),
    ):
        path = tmp_path / f"{name}.pcd"
        path.write_bytes(pcd_header(30, name) + body)
        read = read_pcd(path)
        assert np.allclose(read, np.delete(points, 3, 0)), name
        path.write_bytes((pcd_header(30, name) + body)[:-40])
        with pytest.raises(ValueError, match="expected a PCD file"):
            read_pcd(path)


def test_folders_count_naturally_and_units_are_found(tmp_path):
    for frame in (8, 9, 10, 11):
        write_ply(tmp_path / f"scan_{frame}.ply", 1000 * person(frame))
    file = read_scans(tmp_path, fps=30.0, points=100, outliers=None)
    assert np.bincount(file.frame).tolist() == [100] * 4
    middles = [file.points[file.frame == k][:, 0].mean() for k in range(4)]
    assert np.allclose(middles, [0.8, 0.9, 1.0, 1.1], atol=0.06)
    again = read_scans(tmp_path, fps=30.0, points=100, outliers=None)
    assert np.array_equal(file.points, again.points)
    turned = read_scans(tmp_path, fps=30.0, up="y", unit="mm")
    assert np.ptp(turned.points[:, 1]) == pytest.approx(1.8, abs=0.1)


@pytest.mark.parametrize(
    ("names", "frames", "said"),
    [
        (("0004", "0005", "0008", "0009"), [0, 1, 4, 5], ["2 frames are missing"]),
        (("10", "12", "14", "18"), [0, 1, 2, 4], ["step by 2", "1 frames are missing"]),
        (("1617012345.8", "1617012345.9", "1617012346.2", "1617012346.3"), [0, 1, 4, 5],
         ["2 frames are missing"]),
        (("1617012345_900000000", "1617012346_8", "1617012346_100000000"), [0, 1, 2], []),
        (("0.9", "1.0", "1.103", "2.0"), [0, 1, 2, 11], ["8 frames are missing"]),
        (("t_99ms", "t_200ms", "t_301ms", "t_701ms"), [0, 1, 2, 6],
         ["3 frames are missing"]),
        (("1760000000000000", "1760000000099980", "1760000000300020"), [0, 1, 3],
         ["1 frames are missing"]),
        (("a0b1", "a0c1", "b0a1"), [0, 1, 2], ["do not number frames"]),
    ],
)  # fmt: skip
def test_numbers_and_times_in_names_tell_dropped_clouds(names, frames, said, tmp_path):
    """Files were consecutive frames whatever their names, so that time was squeezed at gaps."""
    for name in names:
        write_ply(tmp_path / f"{name}.ply", person(0))
    file = read_scans(tmp_path, fps=10.0, points=100)
    assert np.unique(file.frame).tolist() == frames
    told = [one for one in file.decisions if "frames" in one]
    assert [part in one for part, one in zip(said, told, strict=True)] == [True] * len(said)


@pytest.mark.parametrize("name", ["cam{1}_{0:04d}", "{0:04d}_cam{1}", "left{1}.{0}"])
def test_clouds_of_several_sensors_are_no_sequence(name, tmp_path):
    """They were read in turns as one sequence at half speed."""
    for frame in range(3):
        for sensor in range(2):
            write_ply(tmp_path / f"{name.format(frame, sensor)}.ply", person(frame))
    with pytest.raises(ValueError, match=r"are both frame .*a folder of their own"):
        read_scans(tmp_path, fps=30.0)


@pytest.mark.parametrize("names", [("0.9", "1.0", "1.1"), ("0", "33", "67", "100")])
def test_times_in_names_of_another_rate_are_refused(names, tmp_path):
    """Milliseconds were frame numbers: 97 % of the frames were empty."""
    for name in names:
        write_ply(tmp_path / f"{name}.ply", person(0))
    with pytest.raises(ValueError, match=r"at 15 frames per|fit 15 frames per"):
        read_scans(tmp_path, fps=15.0)


def test_times_leave_dropped_frames_empty(tmp_path):
    for frame in range(4):
        write_ply(tmp_path / f"{frame}.ply", person(frame))
    (tmp_path / "times.csv").write_text("time\n2.0\n2.1\n2.3\n2.4\n")
    file = read_scans(tmp_path)
    assert file.fps == pytest.approx(10.0)
    assert file.start_time == 2.0
    assert sorted(set(file.frame.tolist())) == [0, 1, 3, 4]
    (tmp_path / "times.csv").write_text("3.ply,0.3\n0.ply,0.0\n1.ply,0.1\n2.ply,0.2\n")
    assert sorted(set(read_scans(tmp_path).frame.tolist())) == [0, 1, 2, 3]
    for text, message in (
        ("0\n1\n2\n", "expected 4 times"),
        ("0\n1\n1\n2\n", "rising"),
        ("0\n1\n2.5\n400\n", "evenly spaced"),
        ("0\n0.4\n0.401\n0.7\n", "leave one of the two out"),
        ("0.ply,0\n", "no time for 1.ply"),
        ("0.ply,0\n0.ply,1\n1.ply,2\n2.ply,3\n3.ply,4\n", "one time for every file"),
        ("file,frame\n0.ply,0\n1.ply,3\n2.ply,6\n3.ply,9\n", "the column 'frame'"),
    ):
        (tmp_path / "times.csv").write_text(text)
        with pytest.raises(ValueError, match=message):
            read_scans(tmp_path)


@pytest.mark.parametrize(
    ("heading", "step", "fps"),
    [
        ("file,time_ms", 100 / 3, 30.0), ("file time [us]", 2e5, 5.0), ("file,time", 33.333, 30.0),
        ("file,timestamp (ms)", 5.0, 200.0), ("file,seconds", 20.0, 0.05), ("file,time", 5.0, 0.2),
    ],
)  # fmt: skip
def test_times_of_scans_may_count_parts_of_seconds(heading, step, fps, tmp_path):
    """Milliseconds were read as seconds: clocks of 0.01 Hz, which took minutes to fit."""
    lines = [heading]
    for frame in range(4):
        write_ply(tmp_path / f"{frame}.ply", person(frame))
        lines.append(f"{frame}.ply {step * frame:.3f}")
    (tmp_path / "times.csv").write_text("\n".join(lines))
    file = read_scans(tmp_path)
    assert file.fps == pytest.approx(fps, rel=1e-4)
    assert np.unique(file.frame).tolist() == [0, 1, 2, 3]
    assert any("in a second" in line for line in file.decisions) == (step * fps > 1.1)
    (tmp_path / "times.csv").write_text("0\n900\n1800\n2700\n")
    with pytest.raises(ValueError, match="expected seconds, or the unit"):
        read_scans(tmp_path)


def test_scans_at_any_times_get_a_clock_with_a_frame_near_each(tmp_path):
    for frame, name in enumerate("acbd"):
        write_ply(tmp_path / f"{name}.ply", person(frame))
    table = tmp_path / "times.csv"
    table.write_text("a.ply,0.4\nc.ply,0.8\nb.ply,1.0\nd.ply,1.4\n")
    file = read_scans(tmp_path)  # frames 20, 40, 50 and 70 of 50 Hz
    assert file.fps == pytest.approx(5.0)
    assert sorted(set(file.frame.tolist())) == [0, 2, 3, 5]
    assert file.points[file.frame == 2][:, 0].mean() == pytest.approx(0.1, abs=0.04)
    assert any("another order" in line for line in file.decisions)
    random = np.random.default_rng(0)
    for _ in range(20):
        times = np.sort(random.uniform(0, 1, 4)) + 0.02 * np.arange(4)
        names = zip("acbd", times, strict=True)
        table.write_text("\n".join(f"{name}.ply {time:.6f}" for name, time in names))
        file = read_scans(tmp_path)
        frames = np.unique(file.frame)
        assert len(frames) == 4
        assert file.start_time + frames / file.fps == pytest.approx(times, abs=0.0071)
    table.write_text("0\n0.2\n0.1\n0.3\n")
    with pytest.raises(ValueError, match="name and time"):
        read_scans(tmp_path)
    table.write_text("a.ply,0\nb.ply,0.1\nc.ply,0.1\nd.ply,0.3\n")
    with pytest.raises(ValueError, match="no two alike"):
        read_scans(tmp_path)


def test_folders_that_say_too_little_are_refused(tmp_path):
    with pytest.raises(FileNotFoundError):
        read_scans(tmp_path / "nowhere", fps=30.0)
    with pytest.raises(ValueError, match="got none"):
        read_scans(tmp_path, fps=30.0)
    write_ply(tmp_path / "0.ply", 60 * person(0))
    with pytest.raises(ValueError, match="--frame-rate"):
        read_scans(tmp_path)
    with pytest.raises(ValueError, match="--unit"):
        read_scans(tmp_path, fps=30.0)


def test_lonely_points_are_left_out(tmp_path):
    points = np.concatenate([person(0), [[2.0, 2.0, 2.0]]])
    write_ply(tmp_path / "0.ply", points)
    assert len(read_scans(tmp_path, fps=30.0).points) <= 400
    assert len(read_scans(tmp_path, fps=30.0, outliers=None).points) == 401


@pytest.fixture
def images(tmp_path):
    """A wall at 3 m and, before it, a square at 2 m."""
    for folder in ("depth", "mask"):
        (tmp_path / folder).mkdir()
    depth = np.full((40, 60), 3000, np.uint16)
    depth[10:30, 20:40] = 2000
    depth[:5] = 0
    for name in ("1.png", "2.png"):
        cv2.imwrite(str(tmp_path / "depth" / name), depth)
        cv2.imwrite(str(tmp_path / "mask" / name), (depth == 2000).astype(np.uint8) * 255)
    matrix = np.array([[50.0, 0.0, 30.0], [0.0, 50.0, 20.0], [0.0, 0.0, 1.0]])
    return tmp_path, CameraArrays(matrix, (60, 40))


def test_depth_images_become_points(images):
    folder, camera = images
    file = read_depth_images(
        folder / "depth", camera, fps=30.0, masks=folder / "mask", points=10_000, outliers=None
    )
    assert np.bincount(file.frame).tolist() == [18 * 18] * 2  # without the edge
    assert np.allclose(file.points[:, 2], 2.0)
    assert np.abs(file.points[:, 0]).max() == pytest.approx(2.0 * 8.5 / 50)
    assert file.points.mean(0) == pytest.approx([0.0, 0.0, 2.0], abs=1e-9)
    pose = np.eye(4)
    pose[:3, 3] = 1.0, 2.0, 3.0
    placed = CameraArrays(camera.camera_matrix, (60, 40), T_camera_world=pose[None])
    world = read_depth_images(
        folder / "depth", placed, fps=30.0, masks=folder / "mask", points=10_000, outliers=None
    )
    assert np.allclose(world.points, file.points - [1.0, 2.0, 3.0])


def test_depth_images_may_lack_frames(images):
    """Files were consecutive frames whatever their names, so that time was squeezed at gaps."""
    folder, camera = images
    depth, poses = folder / "depth", np.tile(np.eye(4), (3, 1, 1))
    for kind in ("depth", "mask"):
        shutil.copy(folder / kind / "2.png", folder / kind / "5.png")
    poses[2, 2, 3] = 1.0
    moving = CameraArrays(camera.camera_matrix, (60, 40), T_camera_world=poses)
    file = read_depth_images(depth, moving, fps=30.0, masks=folder / "mask", outliers=None)
    assert np.unique(file.frame).tolist() == [0, 1, 4]
    assert "2 frames are missing" in file.decisions[0]
    assert np.allclose(file.points[file.frame == 4, 2], 1.0)
    assert file.camera.T_camera_world[:, 2, 3].tolist() == [0, 0, 0, 0, 1]
    with pytest.raises(ValueError, match="--frame-rate"):
        read_depth_images(depth, camera)
    (depth / "times.csv").write_text("1.png,2.5\n2.png,3.0\n5.png,2.0\n")
    file = read_depth_images(depth, camera)
    assert (file.fps, file.start_time, file.frame.max()) == (2.0, 2.0, 2)


def test_the_largest_number_of_depth_images_is_no_measurement(images):
    """It was taken for 65 m; the refusal took 18 s and asked for another scale."""
    folder, camera = images
    for path in (folder / "depth").iterdir():
        depth = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        cv2.imwrite(str(path), np.where(depth > 2000, 65535, depth).astype(np.uint16))
    file = read_depth_images(folder / "depth", camera, fps=30.0, outliers=None)
    assert np.allclose(file.points[:, 2], 2.0)
    assert "no measurement" in file.decisions[0]


def test_depth_images_of_another_sensor_are_refused(images):
    folder, camera = images
    swapped = CameraArrays(camera.camera_matrix, (40, 60))
    with pytest.raises(ValueError, match="60 x 40"):
        read_depth_images(folder / "depth", swapped, fps=30.0)
    with pytest.raises(ValueError, match="--depth-scale"):
        read_depth_images(folder / "depth", camera, fps=30.0, depth_scale=1.0)
    with pytest.raises(ValueError, match="16-bit"):
        read_depth_images(folder / "mask", camera, fps=30.0)
    (folder / "depth" / "3.png").write_bytes(b"no image")
    with pytest.raises(ValueError, match="damaged"):
        read_depth_images(folder / "depth", camera, fps=30.0)


def test_pixels_without_depth_may_all_have_one_place(tmp_path):
    """Half of the points lay at the sensor, and the body was fitted between them: 3 m off."""
    points = person(0)
    write_ply(tmp_path / "0.ply", np.concatenate((points, np.full((200, 3), -1.0))))
    assert len(read_cloud(tmp_path / "0.ply")) == len(points)

"""Whole files of every format that is read: real ones, cut short in time, and made ones."""

import json
import lzma
import pickle
import re
import tarfile
import zipfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path

import numpy as np

from benchmarks.fuzz_mutations import (
    ARRAYS,
    BYTES,
    TEXT,
    Mutation,
    inside_image,
    inside_xz,
)
from observations.people.places import Silhouettes, load_silhouettes
from recon.api.simulate import simulate
from recon.core.skeleton import PARENTS
from recon.formats.calibration import load_cameras
from recon.formats.depth_images import read_depth_images
from recon.formats.detections.reader import read_keypoints
from recon.formats.mocap.reader import read_recording
from recon.formats.motions import load_motion
from recon.formats.observations import CameraArrays, PointsFile, load_observation
from recon.formats.scans import read_scans, write_scans
from recon.formats.smpl import load_smpl
from recon.simulation.points import Corruption

Reader = Callable[[Path], object]


@dataclass(frozen=True)
class Seed:
    """One whole file and how it is read."""

    kind: str
    """Name of the format."""
    name: str
    data: bytes
    read: Reader
    """Given the path of the file, which has its name, among `beside`."""
    mutations: tuple[Mutation, ...] = BYTES
    beside: dict[str, bytes] = field(default_factory=dict)
    """Other files of its folder."""
    share: float = 1.0
    """Share of the mutants, against other kinds."""


def seeds(folder: Path, recordings: Path | None) -> list[Seed]:
    """All seeds; the real ones where the folder of recordings (RECON_DATA) is given."""
    found = [*_observations(folder), *_made(folder), *_weights()]
    if recordings is not None:
        found += [*_mocap(recordings), *_markers(recordings), *_detections(recordings)]
        found += _depth(recordings)
    return found


def _text(kind: str, name: str, data: bytes, read: Reader, **more: dict[str, bytes]) -> Seed:
    return Seed(kind, name, data, read, BYTES + TEXT, **more)  # type: ignore[arg-type]


def _observations(folder: Path) -> Iterator[Seed]:
    """The bundled motion and what simulated sensors see of it."""
    clean = Corruption(noise=0.01)
    with resources.as_file(resources.files("recon") / "assets" / "demo.npz") as demo:
        with np.load(demo) as file:
            arrays = {key: file[key] for key in file.files}
        frames = len(arrays["trans"])
        cut = {k: v[:12] if v.shape[:1] == (frames,) else v for k, v in arrays.items()}
        np.savez_compressed(folder / "motion.npz", allow_pickle=False, **cut)  # type: ignore[arg-type]
        yield Seed(
            "motion", "motion.npz", (folder / "motion.npz").read_bytes(), load_motion,
            BYTES[:3] + ARRAYS * 3, share=3,
        )  # fmt: skip
        for kind in ("joints3d", "markers3d", "keypoints2d", "depth"):
            path = folder / f"{kind}.npz"
            simulate(demo, kind, **vars(clean), frames=(0, 12)).save(path)  # type: ignore[arg-type]
            yield Seed(
                kind, path.name, path.read_bytes(), load_observation, BYTES[:3] + ARRAYS * 3,
                share=2,
            )  # fmt: skip


def _made(folder: Path) -> Iterator[Seed]:
    """Clouds, masks, calibrations and body models."""
    rng = np.random.default_rng(0)
    points = rng.standard_normal((300, 3)) * (0.2, 0.2, 0.5) + (0, 0, 0.9)
    record = PointsFile(points, np.repeat(np.arange(3), 100), 30.0)
    write_scans(folder / "scans", record)
    files = {p.name: p.read_bytes() for p in (folder / "scans").iterdir()}

    def scans(path: Path) -> object:
        return read_scans(path.parent, unit="m")

    for name in ("frame_000001.ply", "times.csv"):
        others = {key: value for key, value in files.items() if key != name}
        yield _text("scans", name, files[name], scans, beside=others)
    rows = "".join(f"{x:.4f} {y:.4f} {z:.4f}\n" for x, y, z in points[:100])
    head = "ply\nformat ascii 1.0\nelement vertex 100\nproperty float x\nproperty float y\n"
    yield _text("ply", "a.ply", (head + "property float z\nend_header\n" + rows).encode(), scans,
                beside={"b.ply": files["frame_000001.ply"], "times.csv": b"0\n0.1\n"})  # fmt: skip
    about = "VERSION .7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 100\nHEIGHT 1\n"
    binary = points[:100].astype("<f4")
    packed = b"".join(b"\x1f" + binary.T.tobytes()[k : k + 32] for k in range(0, 1184, 32))
    packed += b"\x0f" + binary.T.tobytes()[1184:]
    packed = len(packed).to_bytes(4, "little") + (1200).to_bytes(4, "little") + packed
    for word, body in (
        ("ascii", rows.encode()), ("binary", binary.tobytes()), ("binary_compressed", packed),
    ):  # fmt: skip
        data = (about + f"POINTS 100\nDATA {word}\n").encode() + body
        yield _text("pcd", "a.pcd", data, scans, beside={"b.pcd": data, "times.csv": b"0\n1\n"})
    mask = rng.integers(0, 2, (4, 48, 64)).astype(np.uint8)
    np.savez_compressed(folder / "mask.npz", mask=mask)
    yield Seed("masks", "mask.npz", (folder / "mask.npz").read_bytes(), _silhouettes,
               BYTES[:3] + ARRAYS)  # fmt: skip
    yield from _calibrations(folder)
    model = _model(rng)
    np.savez_compressed(folder / "smpl.npz", allow_pickle=False, **model)  # type: ignore[arg-type]
    yield Seed("body model", "smpl.npz", (folder / "smpl.npz").read_bytes(), load_smpl,
               BYTES[:3] + ARRAYS)  # fmt: skip
    yield Seed("body model", "smpl.pkl", pickle.dumps(model, protocol=2), load_smpl)


def _silhouettes(path: Path) -> object:
    masks: Silhouettes = load_silhouettes(path)
    return [masks.visible(frame) for frame in masks.images]


def _calibrations(folder: Path) -> Iterator[Seed]:
    K, pose = np.array([[900.0, 0, 640], [0, 905.0, 360], [0, 0, 1]]), np.eye(4)
    pose[:3, 3] = 0.1, 0.2, 3.0
    matrix = "!!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n   data: [ %s ]\n"
    intri = '%YAML:1.0\n---\nnames:\n   - "01"\nK_01: ' + matrix % ", ".join(map(str, K.ravel()))
    intri += "W_01: 1280\nH_01: 720\ndist_01: " + (matrix % "0.1, 0., 0., 0., 0.").replace(
        "rows: 3\n   cols: 3", "rows: 1\n   cols: 5"
    )
    extri = "%YAML:1.0\n---\nRot_01: " + matrix % ", ".join(map(str, np.eye(3).ravel()))
    extri += "T_01: " + (matrix % "0.1, 0.2, 3.").replace("cols: 3", "cols: 1")
    yield _text("calibration", "intri.yml", intri.encode(), load_cameras,
                beside={"extri.yml": extri.encode()})  # fmt: skip
    yield _text("calibration", "extri.yml", extri.encode(), load_cameras,
                beside={"intri.yml": intri.encode()})  # fmt: skip
    prox = {"camera_mtx": K.tolist(), "k": [0.1, 0, 0, 0, 0], "view_mtx": pose[:3].tolist()}
    yield _text("calibration", "prox.json", json.dumps(prox).encode(), _sized_cameras)
    np.savez(folder / "cam.npz", camera_matrix=K, image_size=[1280, 720], T_camera_world=pose)
    yield Seed("calibration", "cam.npz", (folder / "cam.npz").read_bytes(), load_cameras,
               BYTES[:3] + ARRAYS)  # fmt: skip


def _sized_cameras(path: Path) -> object:
    return load_cameras(path, image_size=(1280, 720), up="z")


def _model(rng: np.random.Generator) -> dict[str, np.ndarray]:
    weights, regressor = rng.random((40, 24)), rng.random((24, 40))
    tree = np.zeros((2, 24), np.uint32)
    tree[1], tree[0, :22], tree[0, 22:] = np.arange(24), np.array(PARENTS).astype(np.uint32), 20
    return {
        "v_template": 0.5 * rng.normal(size=(40, 3)),
        "shapedirs": 0.01 * rng.normal(size=(40, 3, 10)),
        "posedirs": 0.01 * rng.normal(size=(40, 3, 207)),
        "J_regressor": regressor / regressor.sum(1, keepdims=True),
        "weights": weights / weights.sum(1, keepdims=True),
        "kintree_table": tree,
        "f": rng.integers(0, 40, (30, 3)).astype(np.uint32),
    }


def _weights() -> Iterator[Seed]:
    from priors.checkpoints import load_checkpoint

    data = (resources.files("priors") / "weights" / "pose.safetensors").read_bytes()
    yield Seed("weights", "pose.safetensors", data, lambda path: load_checkpoint(path, "pose"),
               BYTES + TEXT)  # fmt: skip


def _mocap(data: Path) -> Iterator[Seed]:
    """Motion capture skeletons of the CMU database, some frames of each."""
    folder = data / "mocap" / "cmu"
    for name in ("bvh31/02_01.bvh.xz", "bvh43/14_19.bvh.xz", "bvh_max/131_01.bvh.xz"):
        lines = lzma.decompress((folder / name).read_bytes()).splitlines(keepends=True)
        first = next(k for k, line in enumerate(lines) if line.startswith(b"Frame Time")) + 1
        text = b"".join(lines[: first + 8])
        text = re.sub(rb"Frames:\s*\d+", b"Frames: 8", text)
        short = Path(name).name.removesuffix(".xz")
        yield _text("bvh", short, text, read_recording)
        yield Seed("bvh.xz", f"{short}.xz", lzma.compress(text), read_recording,
                   BYTES[:3] + tuple(inside_xz(m) for m in BYTES + TEXT))  # fmt: skip
    asf = lzma.decompress((folder / "asfamc" / "01.asf.xz").read_bytes())
    amc = lzma.decompress((folder / "asfamc" / "01_01.amc.xz").read_bytes())
    ninth = re.search(rb"^9\s*$", amc, re.MULTILINE)
    assert ninth is not None
    amc = amc[: ninth.start()]
    yield _text("amc", "01_01.amc", amc, read_recording, beside={"01.asf": asf})

    def by_asf(path: Path) -> object:
        return read_recording(path.with_name("01_01.amc"))

    yield _text("asf", "01.asf", asf, by_asf, beside={"01_01.amc": amc})
    with tarfile.open(data / "mocap" / "bandai-namco" / "dataset-2_gestures.tar.xz") as archive:
        member = next(m for m in archive if m.name.endswith(".bvh"))
        file = archive.extractfile(member)
        assert file is not None
        lines = file.read().splitlines(keepends=True)
    first = next(k for k, line in enumerate(lines) if line.startswith(b"Frame Time")) + 1
    text = re.sub(rb"Frames:\s*\d+", b"Frames: 8", b"".join(lines[: first + 8]))
    yield _text("bvh", "bandai.bvh", text, read_recording)


def _markers(data: Path) -> Iterator[Seed]:
    """Vendors' samples of C3D and TRC, and MATLAB's."""
    for path in sorted((data / "observations").rglob("*")):
        if path.suffix.lower() == ".c3d" and path.stat().st_size < 350_000:
            yield Seed("c3d", path.name, path.read_bytes(), _any_way, share=0.4)
        elif path.suffix == ".trc" and path.stat().st_size < 700_000:
            lines = path.read_bytes().splitlines(keepends=True)[:18]
            if len(lines) < 18 or len(lines[2].split()) < 3:
                continue
            count = lines[2].split()[2]
            lines[2] = re.sub(rb"(?<=\s)" + count + rb"(?=\s)", b"9", lines[2])
            text = b"".join(lines)
            yield Seed("trc", path.name, text, _any_way, BYTES + TEXT, share=0.4)
    mat = data / "observations" / "mocaptoolbox" / "mcdemodata.mat"
    yield Seed("mat", mat.name, mat.read_bytes(), lambda p: read_recording(f"{p}::dance1"),
               share=0.12)  # fmt: skip


def _any_way(path: Path) -> object:
    try:
        return read_recording(path)
    except ValueError:
        return read_recording(path, unit="mm", up="z")


def _detections(data: Path) -> Iterator[Seed]:
    """Every producer's detections, and the calibration of Pose2Sim."""
    folder = data / "observations"
    calibration = (folder / "pose2sim" / "Calib_qualisys.toml").read_bytes()
    yield _text("calibration", "Calib.toml", calibration, load_cameras)
    with zipfile.ZipFile(folder / "pose2sim" / "single_static.zip") as archive:
        names = [n for n in archive.namelist() if "pose-associated/cam01" in n and ".json" in n]
        files = {Path(name).name: archive.read(name) for name in names[:6]}
    chosen = sorted(files)[2]
    yield _text(
        "openpose", chosen, files.pop(chosen),
        lambda path: read_keypoints(path.parent, layout=None), beside=files,
    )  # fmt: skip
    doors = folder / "doors"
    for path in (*sorted(doors.glob("*.json")), doors / "dlc.csv"):
        try:
            read_keypoints(path, image_size=(1280, 720))
        except ValueError:
            continue
        yield _text(path.stem, path.name, path.read_bytes(), _sized_keypoints)
    for path in sorted(doors.glob("*.npz")):
        for read in (load_motion, load_observation, load_cameras):
            try:
                read(path)
            except ValueError:
                continue
            yield Seed("foreign npz", path.name, path.read_bytes(), read, BYTES[:3] + ARRAYS)


def _sized_keypoints(path: Path) -> object:
    return read_keypoints(path, image_size=(1280, 720))


def _depth(data: Path) -> Iterator[Seed]:
    """Depth images of a Kinect."""
    paths = sorted((data / "observations" / "kinect_turn").glob("*_depth.png"))[:2]
    camera = CameraArrays(np.array([[365.0, 0, 256], [0, 365.0, 212], [0, 0, 1]]), (512, 424))
    beside = {paths[1].name: paths[1].read_bytes()}

    def read(path: Path) -> object:
        import cv2

        size = cv2.imdecode(np.frombuffer(beside[paths[1].name], np.uint8), -1)
        assert size is not None
        fitting = CameraArrays(camera.camera_matrix, (size.shape[1], size.shape[0]))
        return read_depth_images(path.parent, fitting, fps=30.0, outliers=None)

    yield Seed("depth images", paths[0].name, paths[0].read_bytes(), read,
               (*BYTES, inside_image, inside_image, inside_image), beside, 0.3)  # fmt: skip

"""Where on the body the detector's 33 points lie, beside the places that recon takes them for.

On rendered people of the validation part, whose motion is known, and on the real films with the
fit of OpenPose's detections in all calibrated views as the truth. Each point has the place in the
frame of its bone (hips in the pelvis') whose projections are nearest to the detections over all
frames and films, with weights that fall with the distance. Tables have its offset from the present
place on a person of 1.70 m: outwards from the middle, up and forwards, as the bone lies at rest.
"""

import argparse
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

import recon
from benchmarks.films.real import CAMERAS, FPS, ONE, add_detections, laid_out, reading
from benchmarks.films.rendered import FPS as RENDERED_FPS
from benchmarks.films.rendered import FRAMES, SEED, SIZE, shots, source
from benchmarks.protocol import Cell, Table, number, recordings_source, tell
from observations.correspondences import BodyPoints
from observations.keypoints2d import Keypoints2D
from recon import BodyModel, Camera, Motion
from recon.benchmark.dataset import Splits
from recon.benchmark.windows import load_windows

SCALE, STEPS, TALL = 0.03, 15, 1.70
"""Metres from which on a detection counts ever less, re-weightings, and the height of a person."""
LAYOUT = "mediapipe33"


@dataclass(frozen=True)
class Sighting:
    """What the detector saw of a known motion."""

    seen: Keypoints2D
    truth: Motion
    """At the moments of the detections."""
    camera: Camera
    body: BodyModel

    def rays(self) -> tuple[Tensor, Tensor]:
        """The camera's place and the directions of the detections, world, of every frame."""
        T = self.camera.T_world_camera.double().expand(self.truth.frames, 4, 4)
        pixels = self.seen.pixels[0].double()
        rays = torch.cat((pixels, torch.ones_like(pixels[..., :1])), -1)
        matrix = self.camera.camera_matrix.double()
        ways = rays @ torch.linalg.inv(matrix).mT @ T[:, :3, :3].mT
        return T[:, None, :3, 3], ways / ways.norm(dim=-1, keepdim=True)


def add_arguments(arguments: argparse.ArgumentParser) -> None:
    """What `places` takes beside the folder of recordings."""
    arguments.add_argument("corpus", type=Path, help="folder of all converted motions")
    arguments.add_argument("--people", type=int, default=10)
    arguments.add_argument("--kinds", nargs="+", default=["still", "alongside"])
    arguments.add_argument("--films", type=Path, required=True, help="folder of rendered films")
    arguments.add_argument("--rendered-detections", type=Path, help="FILM.npz for these")
    add_detections(arguments)


def measure(given: argparse.Namespace) -> None:
    """Find the places by both sources, print and write."""
    body = BodyModel.load()
    points = BodyPoints.of_layout(LAYOUT, body)
    with tempfile.TemporaryDirectory() as name:
        found = [offsets(list(own), points) for own in
                 (of_rendered(given, body), of_real(given, Path(name), body))]  # fmt: skip
    rows: list[list[Cell]] = []
    for left, right in pairs(points.names):
        both = [(own[left] + own[right] * own[right].new_tensor([-1, 1, 1])) / 2 for own in found]
        cells = [number(float(v), 100) for own in both for v in (*own, own.norm())]
        apart = number(float((both[0] - both[1]).norm()), 100)
        rows.append([points.names[left].removeprefix("left_"), *cells, apart])
    ways = ("outwards", "up", "forwards", "in all")
    heads = [(f"{source}: {way}", 1) for source in ("rendered", "real") for way in ways]
    table = Table([("point, cm", None), *heads, ("apart", 1)], rows)
    tell(given.out, SEED, recordings_source(given.observations, ["pose2sim"]), {"places": table})


def pairs(names: tuple[str, ...]) -> Iterator[tuple[int, int]]:
    """Numbers of left and right points, or twice the number of one in the middle."""
    for row, name in enumerate(names):
        if not name.startswith("right_"):
            yield row, names.index(name.replace("left_", "right_"))


def of_rendered(given: argparse.Namespace, body: BodyModel) -> Iterator[Sighting]:
    """Rendered people of the validation part."""
    windows = load_windows(given.corpus, Splits.load(), "validation", body, SEED, FRAMES)
    for kind in given.kinds:
        for shot in shots(windows, kind, given.people, body):
            path = source(shot, given.films, given.rendered_detections)
            told = (
                {} if path.suffix == ".mp4" else {"frame_rate": RENDERED_FPS, "image_size": SIZE}
            )
            seen = recon.read(path, body=body, **told)
            assert isinstance(seen, Keypoints2D)
            times = shot.truth.start_time + seen.start_time + torch.arange(seen.moments) / seen.fps
            inside = times <= shot.truth.stop_time + 1e-6
            truth = shot.truth.at(times[inside], seen.fps)
            frames = (times[inside] * RENDERED_FPS).round().long()
            poses = shot.camera.T_camera_world[frames]
            yield Sighting(seen, truth, shot.camera.replace(T_camera_world=poses), body)


def of_real(given: argparse.Namespace, folder: Path, body: BodyModel) -> Iterator[Sighting]:
    """The films of one person, each at the clock offset at which the present places fit best."""
    scene = laid_out(given.observations / "pose2sim", given.detections, folder)
    everything = [scene.openpose[ONE, camera] for camera in CAMERAS]
    truth = recon.fit(everything, body=body, camera=scene.calibration, frame_rate=FPS).motion
    for camera in CAMERAS:
        path = scene.films[ONE, camera]
        options = {"camera": scene.calibration}
        seen = recon.read(path, body=body, **reading(path, camera, options))
        assert isinstance(seen, Keypoints2D)
        own = seen.camera.replace(
            camera_matrix=seen.camera.camera_matrix[0],
            T_camera_world=seen.camera.T_camera_world[0],
        )
        best: tuple[float, Sighting] | None = None
        for late in np.arange(-3, 3.01, 0.5):
            times = seen.start_time + (torch.arange(seen.moments) - late) / FPS
            inside = (times >= truth.start_time) & (times <= truth.stop_time)
            some = {name: getattr(seen, name)[:, inside] for name in ("pixels", "confidence")}
            there = seen.derived(**some)
            sight = Sighting(there, truth.at(times[inside], FPS), own, body)
            points = seen.points.of(body.pose(sight.truth))
            away = (own.project(points).pixels - sight.seen.pixels[0]).norm(dim=-1)
            error = float(away[sight.seen.confidence[0] > 0.3].median())
            if best is None or error < best[0]:
                best = error, sight
        assert best is not None
        yield best[1]


def offsets(sightings: list[Sighting], points: BodyPoints) -> Tensor:
    """Offset of every point from its present place, (33, 3), metres on a person of `TALL`."""
    bones = [0 if name.endswith("hip") else bone
             for name, bone in zip(points.names, points.bones, strict=True)]  # fmt: skip
    turns, ways, weights = [], [], []
    for one in sightings:
        frames = min(one.truth.frames, one.seen.moments)
        posed = one.body.pose(one.truth)
        turn = posed.orientations[:frames, bones].double()
        scale = float(one.body.height(one.truth.shape)) / TALL
        eye, rays = one.rays()
        away = points.of(posed).double()[:frames] - eye[:frames]
        rays = rays[:frames]
        across = torch.eye(3, dtype=torch.float64) - rays[..., :, None] * rays[..., None, :]
        turns.append(scale * across @ turn)
        ways.append((across @ away[..., None])[..., 0])
        weights.append(one.seen.confidence[0, :frames].double().square())
    A, b, w = (torch.cat(own) for own in (turns, ways, weights))
    out = torch.zeros(len(bones), 3, dtype=torch.float64)
    for _ in range(STEPS):
        left = ((A @ out[..., None])[..., 0] + b).norm(dim=-1)
        share = w / (1 + (left / SCALE).square()).square()
        normal = torch.einsum("tp,tpij,tpik->pjk", share, A, A)
        pull = torch.einsum("tp,tpij,tpi->pj", share, A, b)
        out = -torch.linalg.solve(normal + 1e-6 * torch.eye(3, dtype=torch.float64), pull)
    return out

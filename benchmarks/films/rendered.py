"""Measures fits of rendered films of people, from still and moving cameras.

Each person (`recon.body.identities`, of random height and weight) makes the motion of a listed
window of 100 frames at 30 Hz, in random clothes and a random room (`benchmarks.films.rendering`),
before a camera that stands still, pans, walks alongside, or is held in the hand, of a focal length
within 15 % of a phone's. `recon.fit` gets only the film. Errors in the world are those of
`recon.metrics.world`; those about the pelvis are in the camera's frame of every moment.
"""

import argparse
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import av
import numpy as np
import torch
from jaxtyping import Float
from scipy.ndimage import gaussian_filter1d
from torch import Tensor

import recon
from benchmarks.films.real import about_pelvis, exchanged_sides
from benchmarks.films.rendering import Actor, Set, render
from benchmarks.protocol import Metrics, Table, columns_of, spread, tell_of
from recon import BodyModel, Camera, Motion
from recon.benchmark.dataset import Splits
from recon.benchmark.table import mean_with_interval
from recon.benchmark.windows import TrueWindows, load_windows
from recon.body.identities import identity
from recon.body.motion_files import with_shape
from recon.core import rotations as so3
from recon.core.camera import pose_looking_at
from recon.formats.cameras import guessed_camera
from recon.metrics.errors import point_errors, similarity_aligned
from recon.metrics.world import world_errors

SEED, FRAMES, FPS, SIZE = 0, 100, 30.0, (540, 720)
COLUMNS: Metrics = {
    "w_mpjpe": ("W-MPJPE cm", 100, 1), "wa_mpjpe": ("WA-MPJPE cm", 100, 1),
    "rte": ("RTE %", 100, 1), "jitter": ("jitter 10 m/s³", 0.1, 1),
    "jitter_truth": ("truth's", 0.1, 1), "foot_sliding": ("foot sliding cm", 100, 2),
    "pelvis": ("about pelvis cm", 100, 1), "aligned": ("Procrustes cm", 100, 1),
    "size": ("|size| %", 100, 1), "sides": ("sides exchanged %", 100, 1),
    "seen": ("frames %", 100, 0), "seconds": ("CPU s", 1, 1),
}  # fmt: skip


@dataclass(frozen=True)
class Shot:
    """People, motions, camera and room of a film, as its truth."""

    name: str
    subject: str
    actor: Actor
    truth: Motion
    camera: Camera
    """Camera with a pose for every frame."""
    scene: Set
    others: tuple[tuple[Actor, Motion], ...] = ()
    """Further people in the film, with their motions."""
    size: tuple[int, int] = SIZE

    def film(self, folder: Path, seed: int = SEED) -> Path:
        """Return the path of the film, and render it if it is not in the folder yet."""
        path = folder / f"{self.name}.mp4"
        if path.is_file():
            return path
        folder.mkdir(parents=True, exist_ok=True)
        people = ((self.actor, self.truth), *self.others)
        skins = [one.body.pose(motion).vertices.numpy() for one, motion in people]
        rng, part = np.random.default_rng([seed, 3]), path.with_suffix(".part.mp4")
        with av.open(str(part), "w") as box:
            stream = box.add_stream("libx264", rate=int(FPS), options={"crf": "18"})
            stream.width, stream.height, stream.pix_fmt = *self.size, "yuv420p"
            for frame in range(self.truth.frames):
                view = self.camera.replace(T_camera_world=self.camera.T_camera_world[frame])
                seen = [(own, skin[frame]) for (own, _), skin in zip(people, skins, strict=True)]
                image = render(self.scene, view, seen, rng)
                box.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="rgb24")))
            box.mux(stream.encode())
        part.rename(path)
        return path


Path3 = Float[Tensor, "time 3"]
Carrying = Callable[[Path3, Tensor, np.random.Generator], tuple[Path3, Path3, Path3]]
"""Function that moves a camera: from the pelvis' path and the offset of the camera from the
person's middle it makes places and aims of the camera, and rotation vectors in its own frame."""


def wobble(rng: np.random.Generator, frames: int, size: float, seconds: float = 0.25) -> Path3:
    """Return smooth noise with a given standard deviation, in three axes."""
    white = gaussian_filter1d(rng.standard_normal((frames, 3)), seconds * FPS, axis=0)
    return torch.from_numpy(size * white / white.std()).float()


def _still(pelvis: Path3, away: Tensor, _: np.random.Generator) -> tuple[Path3, Path3, Path3]:
    middle = ((pelvis.amin(0) + pelvis.amax(0)) / 2).expand_as(pelvis)
    return middle + away, middle, torch.zeros_like(pelvis)


def _hand(pelvis: Path3, away: Tensor, rng: np.random.Generator) -> tuple[Path3, Path3, Path3]:
    place, aim, _ = _still(pelvis, away, rng)
    frames = len(pelvis)
    return place + wobble(rng, frames, 0.03, 0.4), aim, wobble(rng, frames, 0.015)


def _pan(pelvis: Path3, away: Tensor, rng: np.random.Generator) -> tuple[Path3, Path3, Path3]:
    place, _, turn = _still(pelvis, away, rng)
    return place, _followed(pelvis), turn + wobble(rng, len(pelvis), 0.004)


def _alongside(
    pelvis: Path3, away: Tensor, rng: np.random.Generator
) -> tuple[Path3, Path3, Path3]:
    aim, frames = _followed(pelvis), len(pelvis)
    steps = 0.02 * torch.sin(2 * torch.pi * 1.8 * torch.arange(frames) / FPS)
    bob = torch.stack((torch.zeros(frames), torch.zeros(frames), steps), -1)
    return aim + away + bob + wobble(rng, frames, 0.03, 0.4), aim, wobble(rng, frames, 0.01)


def _followed(pelvis: Path3) -> Path3:
    """Return the pelvis' path as a camera that follows it: level, late and smooth."""
    smooth = gaussian_filter1d(pelvis.double().numpy(), 0.4 * FPS, axis=0, mode="nearest")
    level = torch.from_numpy(smooth).float()
    return torch.cat((level[:, :2], level[:, 2:].mean(0, keepdim=True).expand(len(level), 1)), -1)


CAMERAS: dict[str, Carrying] = {
    "still": _still, "pan": _pan, "alongside": _alongside, "hand": _hand
}  # fmt: skip


def add_arguments(arguments: argparse.ArgumentParser) -> None:
    """Add the options of `rendered` to its command line."""
    arguments.add_argument("--part", choices=("test", "validation"), default="test")
    arguments.add_argument("--people", type=int, default=20)
    arguments.add_argument("--kinds", nargs="+", choices=CAMERAS, default=list(CAMERAS))
    arguments.add_argument("--films", type=Path, required=True, help="folder that keeps films")
    arguments.add_argument("--detections", type=Path, help="folder of FILM.npz, for the films")


def measure(given: argparse.Namespace) -> None:
    """Render, fit, compare, print and write the table."""
    body, rows = BodyModel.load(), list[list[object]]()
    windows = load_windows(given.corpus, Splits.load(), given.part, body, SEED, FRAMES)
    for kind in given.kinds:
        found: list[dict[str, float | None]] = []
        people: list[str] = []
        for shot in shots(windows, kind, given.people, body):
            found.append(judged(shot, source(shot, given.films, given.detections), body))
            people.append(shot.subject)
            told = {k: None if v is None else round(v * COLUMNS[k][1], 1)
                    for k, v in found[-1].items()}  # fmt: skip
            print(f"{shot.name}: {told}", flush=True)
        names = [str(k) for k in range(len(found))]
        means = [
            spread(mean_with_interval([row[key] for row in found], names, people), factor)
            for key, (_, factor, _) in COLUMNS.items()
        ]
        rows.append([f"{kind} ({len(found)} films)", *means])
    tables = {"films-rendered": Table(columns_of("camera", COLUMNS), rows)}  # pyright: ignore[reportArgumentType]
    tell_of(given, SEED, tables, windows.files)


def source(shot: Shot, films: Path, detections: Path | None) -> Path:
    """Return the film, or the file of detections that is used instead."""
    return shot.film(films) if detections is None else detections / f"{shot.name}.npz"


def shots(windows: TrueWindows, kind: str, people: int, body: BodyModel) -> Iterator[Shot]:
    """Yield films of people in motions of the listed windows, with one kind of camera."""
    order = np.random.default_rng(SEED).permutation(len(windows.names))
    for number in range(people):
        row = int(order[number % len(order)])
        motion = drawn_person(windows.truth[row], number, body)
        path = body.pose(motion).joints[:, 0]
        middle = (path.amin(0) + path.amax(0)) / 2 * torch.tensor([1.0, 1.0, 0.0])
        motion = motion.replace(translation=motion.translation - middle)
        actor = Actor.drawn(body, number)
        camera = carried(kind, actor, motion, np.random.default_rng([SEED, number, 4]))
        places = camera.T_world_camera[:, :2, 3]
        reach = float(torch.cat((places, path[:, :2] - middle[:2])).abs().max()) + 0.5
        yield Shot(
            f"{kind}-{number:02}", windows.subjects[row], actor, motion, camera,
            Set.drawn(number, reach),
        )  # fmt: skip


def drawn_person(motion: Motion, number: int, body: BodyModel) -> Motion:
    """Return a motion performed by a person of random height and weight."""
    rng = np.random.default_rng([SEED, number])
    sex, tall = ("man", "woman")[number % 2], rng.uniform(1.52, 1.80) + 0.12 * (number % 2 < 1)
    weight = rng.uniform(19.5, 29.0) * tall**2
    shape = identity(f"{sex},height={tall:.3f},weight={weight:.1f}", body)
    return with_shape(motion, body, shape)


def carried(kind: str, actor: Actor, motion: Motion, rng: np.random.Generator) -> Camera:
    """Return a camera of random direction and height, near but showing all of the person."""
    skin, pelvis = actor.body.pose(motion).vertices[:, ::50], actor.body.pose(motion).joints[:, 0]
    matrix = torch.from_numpy(guessed_camera(SIZE).camera_matrix).float()
    matrix[[0, 1], [0, 1]] *= rng.uniform(0.85, 1.15)
    way, high, seed = rng.uniform(0, 2 * np.pi), rng.uniform(1.1, 1.8), int(rng.integers(2**31))
    for far in np.arange(2.0, 15.0, 0.1):
        away = torch.tensor([far * np.cos(way), far * np.sin(way), 0.0]).float()
        away[2] = high - pelvis[:, 2].mean()
        place, aim, turn = CAMERAS[kind](pelvis, away, np.random.default_rng(seed))
        poses = [pose_looking_at(*ends) for ends in zip(place, aim, strict=True)]
        T = so3.rigid(so3.exp(turn), torch.zeros_like(turn)) @ torch.stack(poses)
        camera = Camera.create(matrix, SIZE, T_camera_world=T)
        seen = camera.project(skin)
        inside = (seen.pixels > 15) & (seen.pixels < torch.tensor(SIZE) - 15)
        if bool(seen.in_front.all()) and bool(inside.all()):
            return camera
    raise ValueError(f"no camera within 15 m shows all of a motion of {motion.frames} frames")


def judged(shot: Shot, path: Path, body: BodyModel) -> dict[str, float | None]:
    """Fit a film and return the errors of the motion."""
    told = {} if path.suffix == ".mp4" else {"frame_rate": FPS, "image_size": SIZE}
    began = time.process_time()
    result = recon.fit(path, body=body, **told)
    seconds = time.process_time() - began
    first = round(result.motion.start_time * FPS)
    kept = slice(first, first + result.motion.frames)
    truth = body.pose(shot.truth).joints[kept].double()
    found = result.joints[: len(truth)].double()
    T = result.file.T_world_camera
    here = found if T is None else so3.transform(so3.inverse_rigid(T.double()), found)
    there = so3.transform(shot.camera.T_camera_world[kept].double(), truth)
    tall = float(body.height(result.motion.shape) / body.height(shot.truth.shape))
    return world_errors(found, truth, FPS) | {
        "pelvis": float(about_pelvis(here, there).mean()),
        "aligned": float(point_errors(similarity_aligned(here, there), there).mean()),
        "size": abs(tall - 1),
        "sides": exchanged_sides(here, there),
        "seen": len(truth) / FRAMES,
        "seconds": seconds,
    }

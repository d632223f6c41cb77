"""Compares fits of real films with fits of other detections in calibrated views.

One person balances before three cameras whose calibration is known; in another recording a woman,
drawn into the films half as large as a person, moves before him. The reference of a film of one
person is `recon.fit` of OpenPose's detections in the other calibrated views, that of a film of two
in all three. Besides every fit of a film there is one of OpenPose's detections of the same view.
Errors are over 22 joints in the camera's frame, about the pelvis and after a similarity, with one
clock offset per fit, as films and detections begin up to 2.5 frames apart. Reprojection errors are
medians, in pixels of what was fitted. Feet stand where those of the fit of all three views do.
"""

import argparse
import tempfile
import time
import tomllib
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import normalize

import recon
from benchmarks.protocol import Cell, Metrics, Table, columns_of, number, recordings_source, tell
from recon.core.rotations import inverse_rigid, transform
from recon.formats.calibration import load_cameras
from recon.metrics.errors import point_errors, root_aligned, similarity_aligned, slip_speed
from recon.people.together import fit_people, load_people

FPS, CAMERAS = 60.0, (1, 2, 3)
ONE, TWO = "singleperson", "multiperson"
ZIPS = {ONE: "single_balancing.zip", TWO: "multi_participants12.zip"}
LATEST, STEP = 6.0, 0.5
"""Largest tested clock offset, and the step between tested ones, in frames."""
LEFT, RIGHT = (1, 4, 7, 10), (2, 5, 8, 11)
KNOWN = ("nothing", "height", "lens", "pose")
"""Knowledge that is given with one film."""
CASES = (*KNOWN, "three", "found", "two", "two-three")
COLUMNS: Metrics = {
    "error": ("about pelvis cm", 100, 1), "aligned": ("Procrustes cm", 100, 1),
    "error_all": ("beside all views cm", 100, 1), "legs": ("legs %", 100, 0),
    "size": ("height, std", 1, 1), "sides": ("sides exchanged %", 100, 0),
    "followed": ("followed %", 100, 0),
    "up": ("up °", 1, 0), "slip": ("slip cm/s", 100, 1), "slip_reference": ("reference's", 100, 1),
    "pixels": ("reprojection px", 1, 1), "clock": ("clock, frames", 1, 1),
    "turned": ("cameras turned °", 1, 1), "apart": ("and apart %", 100, 1),
    "seconds": ("CPU s", 1, 1),
}  # fmt: skip
"""Columns of the table: `beside all views` is the error against the fit of all three views, this
one among them, and `height, std` the error of the height in its own standard deviations. Of
cameras that were found, `turned` and `apart` are the largest errors of a pair's relative rotation
and distance."""


@dataclass(frozen=True)
class Scene:
    """Paths of detections and films by trial and camera, and the calibration."""

    calibration: Path
    openpose: Mapping[tuple[str, int], Path]
    films: Mapping[tuple[str, int], Path]
    """Films, or files of detections instead; their names are those of the cameras."""
    body: recon.BodyModel

    def pose(self, camera: int) -> Float[Tensor, "4 4"]:
        """Return T_camera_world of a camera."""
        found = load_cameras(self.calibration).cameras[f"cam_0{camera}"].T_camera_world
        return torch.from_numpy(np.asarray(found)).double().reshape(4, 4)

    def given(self, known: str, camera: int, tall: float) -> dict[str, Any]:
        """Return options of `recon.fit` for one film, by what is known of it."""
        if known == "pose":
            return {"camera": self.calibration}
        if known == "lens":
            own = tomllib.loads(self.calibration.read_text())[f"cam_0{camera}"]
            file = Path(self.calibration.parent / f"lens{camera}.toml")
            kept = [f"{key} = {own[key]}\n" for key in ("size", "matrix", "distortions")]
            file.write_text(f'[cam_0{camera}]\nname = "cam_0{camera}"\n' + "".join(kept))
            return {"camera": file}
        return {"shape": tall} if known == "height" else {}


def add_arguments(arguments: argparse.ArgumentParser) -> None:
    """Add the options of `real` to its command line."""
    arguments.add_argument("--cases", nargs="+", choices=CASES, default=list(CASES))
    arguments.add_argument("--cameras", nargs="+", type=int, choices=CAMERAS, default=CAMERAS)
    add_detections(arguments)
    arguments.add_argument("--without-others", action="store_true", help="fit no OpenPose")
    arguments.add_argument("--references", type=Path, help="folder that keeps the references")


def add_detections(arguments: argparse.ArgumentParser) -> None:
    """Add the option to use files of detections instead of films."""
    arguments.add_argument(
        "--detections", type=Path, help="folder of singleperson_cam01.npz and so on, for films"
    )


def measure(given: argparse.Namespace) -> None:
    """Fit, compare, print and write the table."""
    source = given.observations / "pose2sim"
    with tempfile.TemporaryDirectory() as name:
        scene = laid_out(source, given.detections, Path(name))
        detectors = {"film": scene.films} | (
            {} if given.without_others else {"OpenPose": scene.openpose}
        )
        rows: list[list[Cell]] = []
        for title, found in measured(scene, detectors, given):
            rows.append([title, *(number(found.get(k), f) for k, (_, f, _) in COLUMNS.items())])
            told = {h: round(found[k] * f, 1) for k, (h, f, _) in COLUMNS.items() if k in found}
            print(f"{title}: {told}", flush=True)
    tables = {"films-real": Table(columns_of("what is known: film: detector", COLUMNS), rows)}
    tell(given.out, None, recordings_source(given.observations, ["pose2sim"]), tables)


def laid_out(source: Path, detections: Path | None, folder: Path) -> Scene:
    """Arrange all files below one folder, with the names of the calibration's cameras."""
    calibration = folder / "calibration.toml"
    calibration.write_bytes((source / "Calib_qualisys.toml").read_bytes())
    openpose: dict[tuple[str, int], Path] = {}
    films: dict[tuple[str, int], Path] = {}
    for trial, packed in ZIPS.items():
        zipfile.ZipFile(source / packed).extractall(folder / "packed" / trial)
        for camera in CAMERAS:
            openpose[trial, camera] = folder / "openpose" / trial / f"cam_0{camera}"
            openpose[trial, camera].parent.mkdir(parents=True, exist_ok=True)
            unpacked = folder / "packed" / trial / "pose" / f"cam0{camera}_json"
            openpose[trial, camera].symlink_to(unpacked, target_is_directory=True)
            stem = f"{trial}_cam0{camera}"
            film = source / "films" / f"{stem}.mp4"
            if detections is not None:
                film = detections.resolve() / f"{stem}.npz"
            films[trial, camera] = folder / "films" / trial / f"cam_0{camera}{film.suffix}"
            films[trial, camera].parent.mkdir(parents=True, exist_ok=True)
            films[trial, camera].symlink_to(film)
    return Scene(calibration, openpose, films, recon.BodyModel.load())


@dataclass(frozen=True)
class Reference:
    """Motion that is fitted to detections of calibrated views, in their world."""

    joints: Float[Tensor, "time 22 3"]
    contacts: Float[Tensor, "time 22"]
    tall: float

    @classmethod
    def of(cls, result: recon.Result) -> "Reference":
        """Take joints, contacts and height from a fit."""
        tall = float(result.body.height(result.motion.shape))
        return cls(result.joints.double(), result.contacts, tall)


def references(scene: Scene, trial: str, cameras: Sequence[int], kept: Path | None) -> Any:
    """Fit everybody in OpenPose's detections in some calibrated views, longest path first."""
    name = f"{trial}-{''.join(map(str, cameras))}.pt"
    if kept is not None and (kept / name).is_file():
        return [Reference(**own) for own in torch.load(kept / name)]
    paths = [scene.openpose[trial, camera] for camera in cameras]
    how: dict[str, Any] = {"camera": scene.calibration, "frame_rate": FPS}
    if trial == ONE:
        found = [Reference.of(recon.fit(paths, body=scene.body, **how))]
    else:
        people = fit_people(load_people(paths, body=scene.body, **how), body=scene.body)
        found = sorted(map(Reference.of, people), key=lambda one: -moved(one.joints))
    if kept is not None:
        kept.mkdir(parents=True, exist_ok=True)
        torch.save([vars(one) for one in found], kept / name)
    return found


def moved(joints: Float[Tensor, "time 22 3"]) -> float:
    """Return the mean length (m) of the joints' paths."""
    return float(joints.diff(dim=0).norm(dim=-1).sum(0).mean())


def measured(
    scene: Scene,
    detectors: Mapping[str, Mapping[tuple[str, int], Path]],
    given: argparse.Namespace,
) -> Iterator[tuple[str, dict[str, float]]]:
    """Yield every row's title and numbers (SI units)."""
    cases, kept = given.cases, given.references
    (whole,) = references(scene, ONE, CAMERAS, kept)
    for camera in given.cameras if {*cases} & {*KNOWN} else ():
        (others,) = references(scene, ONE, [c for c in CAMERAS if c != camera], kept)
        for known in KNOWN:
            for detector, paths in detectors.items() if known in cases else ():
                options = scene.given(known, camera, whole.tall)
                found, seconds = fitted(paths[ONE, camera], scene, camera, options)
                row = compared(found, others, scene, camera) | {"seconds": seconds}
                beside = compared(found, whole, scene, camera)
                row |= {key: beside[key] for key in beside if key.startswith("slip")}
                row["error_all"] = beside["error"]
                yield f"{known}: {camera}: {detector}", row
    for detector, paths in detectors.items() if "three" in cases else ():
        films = [paths[ONE, camera] for camera in CAMERAS]
        found, seconds = fitted(films, scene, 1, {"camera": scene.calibration})
        row = compared(found, whole, scene, 1) | {"seconds": seconds}
        yield f"calibrated: 1-3: {detector}", row
        for camera, one in zip(CAMERAS, found.residuals, strict=True):
            yield f"calibrated: in view {camera}: {detector}", {"pixels": float(one.median or 0)}
    for detector, paths in detectors.items() if "found" in cases else ():
        films = [paths[ONE, camera] for camera in CAMERAS]
        yield f"cameras found, height known: 1-3: {detector}", of_found(films, scene, whole)
    if not {*cases} & {"two", "two-three"}:
        return
    man, woman, *_ = references(scene, TWO, CAMERAS, kept)
    for detector, paths in detectors.items():
        if "two" in cases:
            for camera in given.cameras:
                yield from of_people(detector, paths, [camera], scene, (man, woman))
        if "two-three" in cases:
            yield from of_people(detector, paths, CAMERAS, scene, (man, woman))


def fitted(
    paths: Path | Sequence[Path], scene: Scene, camera: int, options: Mapping[str, Any]
) -> tuple[recon.Result, float]:
    """Return a fit and its CPU seconds."""
    began = time.process_time()
    result = recon.fit(paths, body=scene.body, **reading(paths, camera, options))  # pyright: ignore[reportArgumentType]
    return result, time.process_time() - began


def reading(
    paths: Path | Sequence[Path], camera: int, options: Mapping[str, Any]
) -> dict[str, Any]:
    """Add the frame rate and image size that files of detections lack to the options of a fit."""
    first = paths if isinstance(paths, Path) else paths[0]
    how = dict(options)
    if first.suffix != ".mp4":
        how["frame_rate"] = FPS
        if "camera" not in how:
            how["image_size"] = (1088 if camera == 3 else 1080, 1920)
    return how


def of_found(films: Sequence[Path], scene: Scene, whole: Reference) -> dict[str, float]:
    """Return a row for films whose cameras are found from the person in them."""
    began, rate = time.process_time(), None if films[0].suffix == ".mp4" else FPS
    rig = recon.calibrate(films, height=whole.tall, frame_rate=rate)
    spent = time.process_time() - began
    (file,) = rig.save(scene.calibration.parent / "found.toml", overwrite=True)
    found, seconds = fitted(films, scene, 1, {"camera": file})
    poses = [
        torch.from_numpy(np.asarray(one.T_camera_world)).double().reshape(4, 4)
        for one in rig.cameras.values()
    ]
    row = compared(found, whole, scene, 1, poses[0]) | {"seconds": spent + seconds}
    turned, apart = [], []
    for a, b in combinations(range(len(CAMERAS)), 2):
        steps = [T[b] @ inverse_rigid(T[a]) for T in (poses, [scene.pose(c) for c in CAMERAS])]
        cosine = ((steps[0][:3, :3] * steps[1][:3, :3]).sum() - 1) / 2
        turned.append(float(torch.rad2deg(torch.arccos(cosine.clamp(-1, 1)))))
        apart.append(abs(float(steps[0][:3, 3].norm() / steps[1][:3, 3].norm()) - 1))
    return row | {"turned": max(turned), "apart": max(apart)}


def of_people(
    detector: str, paths: Mapping[tuple[str, int], Path], cameras: Sequence[int], scene: Scene,
    everyone: Sequence[Reference],
) -> Iterator[tuple[str, dict[str, float]]]:  # fmt: skip
    """Yield rows of the people in the reference, each compared with the most similar result."""
    films = [paths[TWO, camera] for camera in cameras]
    alone = len(cameras) == 1
    options = {} if alone else {"camera": scene.calibration}
    people = load_people(films, body=scene.body, **reading(films, cameras[0], options))
    results = fit_people(people, body=scene.body)
    label = str(cameras[0]) if alone else "1-3"
    for name, own in zip(("man", "woman"), everyone, strict=True):
        each = [compared(found, own, scene, cameras[0]) for found in results]
        best = min(each, key=lambda row: row["error"] + row["away"])
        of_woman = ("aligned", "sides", "followed", "pixels", "clock")
        kept = best if name == "man" else {key: best[key] for key in of_woman}
        yield f"two people: {label}: {detector}, {name}", kept


def compared(
    result: recon.Result,
    reference: Reference,
    scene: Scene,
    camera: int,
    pose: Tensor | None = None,
) -> dict[str, float]:
    """Return errors of a fit in the camera's frame, at the best clock offset.

    `pose` is T_camera_world of a camera that was found before the fit.
    """
    T_true = scene.pose(camera)
    T = T_true if pose is None else pose
    if result.T_world_camera is not None:
        T = inverse_rigid(result.T_world_camera.double())
    here, there = transform(T, result.joints.double()), transform(T_true, reference.joints)
    started = result.motion.start_time * FPS
    choices = np.arange(-LATEST, LATEST + STEP / 2, STEP)
    offsets = [float(own) for own in choices]
    at = {own: at_frames(here, result.motion.fps, started, len(there), own) for own in offsets}
    usable = {own: pair for own, pair in at.items() if int(pair[1].sum()) > 0}
    error = {own: about_pelvis(found, there[kept]) for own, (found, kept) in usable.items()}
    clock = min(error, key=lambda own: float(error[own].mean()))
    found, kept = usable[clock]
    true = there[kept]
    world = at_frames(result.joints.double(), result.motion.fps, started, len(there), clock)[0]
    contacts = reference.contacts[kept] > 0.5
    slips = slip_speed(world, contacts, FPS), slip_speed(reference.joints[kept], contacts, FPS)
    residuals = [one.median for one in result.residuals if one.median is not None]
    ways = [normalize(joints[:, 0], dim=-1) for joints in (found, true)]
    cosine = (T[:3, 2] @ T_true[:3, 2]).clamp(-1, 1)
    row = {
        "error": float(error[clock].mean()),
        "aligned": float(point_errors(similarity_aligned(found, true), true).mean()),
        "legs": leg_length(found) / leg_length(true) - 1,
        "sides": exchanged_sides(found, true),
        "followed": len(found) / len(there),
        "clock": clock,
        "pixels": float(np.mean(residuals)),
        "away": float((ways[0] - ways[1]).norm(dim=-1).mean()),
    }
    if result.T_world_camera is not None:
        row["up"] = float(torch.rad2deg(torch.arccos(cosine)))
    if (deviation := height_std(result)) is not None:
        tall = float(scene.body.height(result.motion.shape))
        row["size"] = abs(tall - reference.tall) / deviation
    named = zip(("slip", "slip_reference"), slips, strict=True)
    return row | {name: value for name, value in named if value is not None}


def about_pelvis(found: Tensor, true: Tensor) -> Float[Tensor, "time 22"]:
    """Return distances of joints about the pelvis (m)."""
    return point_errors(root_aligned(found), root_aligned(true))


def height_std(result: recon.Result) -> float | None:
    """Return the standard deviation (m) of the height that a fit states, or None."""
    if result.shape_std is None:
        return None
    shape = result.motion.shape.detach().clone().requires_grad_()
    (slope,) = torch.autograd.grad(result.body.height(shape), shape)
    return float((slope * result.shape_std).norm())


def exchanged_sides(found: Tensor, true: Tensor) -> float:
    """Return the share of frames in which the legs fit better with left and right exchanged."""
    legs, swapped = (*LEFT, *RIGHT), true.clone()
    swapped[:, legs] = true[:, (*RIGHT, *LEFT)]
    same, other = (about_pelvis(found, own)[:, legs].mean(-1) for own in (true, swapped))
    return float((other < same).double().mean())


def leg_length(joints: Float[Tensor, "time 22 3"]) -> float:
    """Return the mean length (m) of thigh and shank together."""
    hips, knees, ankles = joints[:, [1, 2]], joints[:, [4, 5]], joints[:, [7, 8]]
    return float((knees - hips).norm(dim=-1).mean() + (ankles - knees).norm(dim=-1).mean())


def at_frames(
    joints: Float[Tensor, "time 22 3"], fps: float, started: float, frames: int, late: float
) -> tuple[Float[Tensor, "kept 22 3"], Tensor]:
    """Interpolate joints linearly at the reference's frames; also return a mask of these.

    Args:
        joints: joints of a fit at its own frames.
        fps: frame rate of the fit, Hz.
        started: frame of the reference's clock at which the fit begins.
        frames: number of frames of the reference.
        late: frames by which the film's clock is ahead of the reference's.
    """
    x = (torch.arange(frames, dtype=torch.float64) + late - started) * (fps / FPS)
    kept = (x >= 0) & (x <= len(joints) - 1)
    before = x[kept].floor().long().clamp(max=len(joints) - 2)
    share = (x[kept] - before)[:, None, None]
    return joints[before] * (1 - share) + joints[before + 1] * share, kept

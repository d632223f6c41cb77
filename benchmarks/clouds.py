"""Depth clouds alone and with other sensors, fitted as `recon fit` does, beside version 0.1.0.

    python -m benchmarks.clouds CORPUS --baseline VERSION_0.1.0 --json clouds.json
    python -m benchmarks.clouds CORPUS --part validation --only 12 --methods recon
    python -m benchmarks.clouds CORPUS --cases 'depth, MakeHuman' --people PEOPLE.npz

VERSION_0.1.0 is a source checkout of that version (commit 0ce0517). Windows of 90 frames, written
to observation files and fitted with the default prior (HuMoR by collocation). The sensor has 512 x
424 pixels, noise, holes and flying pixels, and sees body and ground; nothing below 0.9 m is seen
in the middle third. `depth` knows the pose of its sensor; `depth, sensor unknown`, `2D` and
`2D + depth` do not, nor where the ground is; 2D keypoints are in the sensor's own image, with one
pixel of noise; joints have 3 cm. In `depth, MakeHuman` the pose is known as well, and people who
are not quite our body do the motion (`benchmarks.cloud_people`); PEOPLE.npz is that of
`benchmarks.people`. `spoiled` is a fit with labels of the simulation
(`benchmarks.spoiled_labels`) in place of the network's; `turned` is one that starts at the first
guess turned about the vertical by half a turn, without labels, to see whether wrong fits are said.

Joints about the pelvis and vertices in the world (by way of the true sensor) are in metres;
`wrong` is whether at least a fifth of the frames face elsewhere by more than 60 degrees or have
legs, where they are in sight, exchanged. `first` is the first guess. CPU s are of the first guess
with its labels, and of the whole fit of files that were read. Where nobody is in the reach of the
sensor (8 m), the files are refused, which the JSON says. Windows that the JSON has already,
of the same commit, are not fitted again.
"""

import argparse
import json
import math
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from rich.console import Console
from torch import Tensor

from benchmarks.arguments import over_windows
from benchmarks.cloud_cases import CASES, OTHERS, Seen, write_files
from benchmarks.cloud_people import SeenPerson
from benchmarks.humor import evenly
from benchmarks.people import People
from benchmarks.results import corpus_source, earlier, write
from benchmarks.scores import Columns, Row, by_subject, rounded, tables
from benchmarks.spoiled_labels import spoiled, vertices_of
from benchmarks.uncertainty import NINE_TENTHS
from observations.depth import PointCloud
from observations.first_guess import first_guess, labelled
from recon.api.fit import fit
from recon.benchmark.dataset import Splits
from recon.benchmark.windows import TrueWindows, load_windows
from recon.body.model import BodyModel
from recon.core import rotations as so3
from recon.core.errors import ObservationError
from recon.core.motion import Motion
from recon.core.skeleton import LEGS, MIRROR
from recon.fitting.settings import FitSettings
from recon.formats.motions import load_motion
from recon.metrics.evaluation import evaluate, ground_errors
from recon.reading.clip import Clip, load_clip

SEED, FRAMES = 0, 90
_TURNED = math.radians(60)
_OFTEN = 0.2
"""A window faces elsewhere, or has its legs exchanged, if at least this share of frames does."""
_IN_SIGHT = 0.5
"""Share of the joints of both legs that the sensor sees in a frame with legs in sight."""
_APART = 0.1
"""Mean distance of leg joints from the truth, metres, from which on legs may be exchanged."""

USUAL = [case for case in CASES if case != OTHERS]
METHODS = ("recon", "0.1.0", "spoiled", "turned")
COLUMNS: Columns = {
    "root_visible": ("visible", 100), "root_hidden": ("hidden", 100), "root_all": ("all", 100),
    "vertices_visible": ("vertices visible", 100), "vertices": ("vertices", 100),
    "turned": ("turned %", 100), "exchanged": ("legs exch. %", 100), "wrong": ("wrong %", 100),
    "first": ("first", 100), "normal": ("normal °", 1), "height": ("height", 100),
    "covered_visible": ("within, seen", 1), "covered_hidden": ("within, hidden", 1),
    "surface": ("surface", 100), "surface_visible": ("surface seen", 100),
    "said": ("warned %", 100), "first_seconds": ("first CPU s", 1), "seconds": ("CPU s", 1),
}  # fmt: skip

Found = dict[str, dict[str, dict[str, dict[str, Any]]]]
"""Values by case, method, window and metric."""


@dataclass(frozen=True)
class Fit:
    """The result of one version for one case: its motions, and poses of the sensor where found."""

    motion: Motion
    T_world_camera: Float[Tensor, "4 4"] | None
    first: Motion
    T_recording_camera: Float[Tensor, "4 4"] | None
    first_seconds: float
    seconds: float
    warnings: tuple[str, ...]
    std: Float[Tensor, "time 22"] | None = None
    """Standard deviations of the joints, metres; of fits in the true world only."""


def main() -> None:
    parser = over_windows(__doc__)
    parser.add_argument("--only", type=int, default=None, help="use so many windows in all")
    parser.add_argument("--windows", nargs="+", default=None, help="names of the only windows")
    parser.add_argument("--cases", nargs="+", choices=CASES, default=USUAL)
    parser.add_argument("--methods", nargs="+", choices=METHODS, default=["recon"])
    parser.add_argument("--baseline", type=Path, default=None, help="a checkout of version 0.1.0")
    parser.add_argument("--people", type=Path, default=None, help="of benchmarks.people")
    parser.add_argument("--keep", type=Path, default=None, help="a folder for files and motions")
    parser.set_defaults(part="validation")
    given = parser.parse_args()
    if "0.1.0" in given.methods and given.baseline is None:
        parser.error("0.1.0 needs --baseline, a source checkout of that version")
    if OTHERS in given.cases and given.people is None:
        parser.error(f"{OTHERS} needs --people, a file that benchmarks.people wrote")
    people = None if given.people is None else People.load(given.people)
    body, splits = BodyModel.load(), Splits.load(given.splits)
    windows = load_windows(given.corpus, splits, given.part, body, SEED, FRAMES)
    chosen = evenly(windows, given.only)
    if given.windows is not None:
        chosen = [k for k in chosen if windows.names[k] in given.windows]
    some, found = windows.take(chosen), earlier(given.json, "values")
    every = list(zip(chosen, some.names, strict=True))
    for number, name in (*every[::2], *every[1::2]):  # so that a part covers all subjects
        with tempfile.TemporaryDirectory() as folder:
            seen = Seen(windows.truth[number], body, number)
            kept = Path(folder) if given.keep is None else given.keep / name
            kept.mkdir(parents=True, exist_ok=True)
            compare(seen, people, name, given, kept, found)
        if given.json is not None:
            about = {"part": given.part, **some.about}
            write(given.json, SEED, corpus_source(given.corpus, windows.files), **about,
                  values=found)  # fmt: skip
    for case in given.cases:
        rows = {method: shown(some, values) for method, values in found.get(case, {}).items()}
        for table in tables(f"{case}, {given.part}", COLUMNS, rows) if rows else ():
            Console(width=190).print(table)


def shown(windows: TrueWindows, values: dict[str, dict[str, Any]]) -> dict[str, Row]:
    """Means over subjects of the windows that a method has fitted."""
    fitted = {name for name, row in values.items() if "refused" not in row}
    there = [k for k, name in enumerate(windows.names) if name in fitted]
    some = windows.take(there)
    return by_subject(some, [{k: values[name].get(k) for k in COLUMNS} for name in some.names])


def compare(
    usual: Seen,
    people: People | None,
    name: str,
    given: argparse.Namespace,
    folder: Path,
    found: Found,
) -> None:
    """Fit all cases of a window that are not known yet, by all methods."""
    for case in given.cases:
        seen = usual
        if case == OTHERS:
            assert people is not None
            seen = SeenPerson(usual.truth, usual.body, usual.number, people=people)
        for method in given.methods:
            values = found.setdefault(case, {}).setdefault(method, {})
            if name in values or (method in ("spoiled", "turned") and "depth" not in case):
                continue
            files = write_files(seen, case, folder)
            out = folder / f"{case}, {method}.npz"
            try:
                done = (
                    fitted_by(given.baseline, files, out)
                    if method == "0.1.0"
                    else fitted_here(files, out, seen, method)
                )
            except ObservationError as error:
                values[name] = {"refused": str(error)}
                print(name, case, method, error, flush=True)
                continue
            values[name] = measured(seen, done)
            row = {k: v for k, v in values[name].items() if isinstance(v, float)}
            print(name, case, method, {k: f"{v:.3g}" for k, v in row.items()}, flush=True)
            print("   ", [text[:80] for text in done.warnings], flush=True)


def fitted_here(files: list[Path], out: Path, seen: Seen, method: str) -> Fit:
    """The fit of the files by this version; the motion is written as well."""
    clip = load_clip(files, FitSettings(), seen.body)
    if method == "spoiled":
        clip = with_spoiled_labels(clip, seen)
    began = time.process_time()
    first = first_guess(labelled(clip.observations), seen.body).motion[0]
    between = time.process_time()
    result = fit(clip, body=seen.body, start=turned_about(first) if method == "turned" else None)
    ended = time.process_time()
    result.save(out, overwrite=True)
    place = clip.T_recording_camera
    return Fit(
        result.motion, result.T_world_camera, first,
        None if place is None else torch.from_numpy(place).float(),
        between - began, ended - between,
        tuple(f"{one.code}: {one.message}" for one in result.examined.warnings),
        result.joint_std if place is None else None,
    )  # fmt: skip


def turned_about(motion: Motion) -> Motion:
    """The motion turned by half a turn about the vertical, every frame about its pelvis."""
    half = torch.diag(torch.tensor([-1.0, -1.0, 1.0])).to(motion.rotations)
    rotations = motion.rotations.clone()
    rotations[:, 0] = half @ rotations[:, 0]
    return motion.replace(rotations=rotations)


def with_spoiled_labels(clip: Clip, seen: Seen) -> Clip:
    """The clip with labels of the simulation for its clouds."""
    [row] = [k for k, one in enumerate(clip.observations) if isinstance(one, PointCloud)]
    cloud = clip.observations[row]
    assert isinstance(cloud, PointCloud)
    truth = seen.truth
    if clip.T_recording_camera is not None:
        T = torch.from_numpy(clip.T_recording_camera).float() @ seen.camera.T_camera_world
        truth = truth.carried(T, seen.body.rest_joints(truth.shape)[0])
    labels = spoiled(seen.body, cloud, vertices_of(cloud, truth, seen.body), seen.number)
    sensors = list(clip.observations)
    sensors[row] = cloud.replace(labels=labels)
    return Clip(tuple(sensors), clip.names, clip.notes, clip.T_recording_camera)


def fitted_by(checkout: Path, files: list[Path], out: Path) -> Fit:
    """The fit of the files by version 0.1.0, in a process of its own."""
    first = out.with_name(f"{out.stem}, first.npz")
    asked = {"files": [str(f.resolve()) for f in files], "out": str(out.resolve()),
             "first": str(first.resolve())}  # fmt: skip
    environment = os.environ | {"PYTHONPATH": str(checkout), "OMP_NUM_THREADS": "1"}
    ran = subprocess.run(
        [sys.executable, str(Path(__file__).with_name("fitter.py"))], cwd=checkout,
        env=environment, input=json.dumps(asked) + "\n", text=True, check=True,
        stdout=subprocess.PIPE,
    )  # fmt: skip
    answer = json.loads(ran.stdout)
    file = load_motion(out)
    with np.load(first) as arrays:
        there = {key: torch.from_numpy(arrays[key]).float() for key in arrays.files}
    begun = Motion.create(there["translation"], there["rotations"], there["shape"],
                          float(there["fps"]))  # fmt: skip
    pose = file.T_world_camera
    return Fit(
        file.motion, None if pose is None else pose[0], begun, there["T_recording_camera"],
        answer["first_seconds"], answer["seconds"],
        tuple(str(one) for one in answer["warnings"]),
    )  # fmt: skip


def measured(seen: Seen, done: Fit) -> dict[str, Any]:
    """One window's columns, errors in the true world by way of the true sensor."""
    body, camera = seen.body, seen.camera.T_world_camera
    found = done.T_world_camera
    motion = placed(done.motion, None if found is None else camera @ found.inverse(), body)
    place = None if found is None else done.T_recording_camera
    first = placed(done.first, None if place is None else camera @ place.inverse(), body)
    values: dict[str, Any] = {
        **errors_of(motion, seen), **mistaken(motion, seen), **covered(motion, done.std, seen),
        "first": errors_of(first, seen)["root_all"],
        "first_seconds": done.first_seconds, "seconds": done.seconds,
        "said": float(len(done.warnings) > 0),
    }  # fmt: skip
    if found is not None:
        errors = ground_errors(found, camera)
        values |= {"normal": math.degrees(errors["ground_normal"]),
                   "height": errors["ground_height"]}  # fmt: skip
    return {**{k: rounded(v) for k, v in values.items()}, "warnings": codes(done.warnings)}


def errors_of(motion: Motion, seen: Seen) -> Row:
    """Errors of joints about the pelvis and of the surface, metres."""
    if isinstance(seen, SeenPerson):
        away, visible = about_the_pelvis(motion, seen).norm(dim=-1), seen.visible_joints
        visible = visible[: len(away)]
        return {
            "root_visible": float(away[visible].mean()),
            "root_hidden": float(away[~visible].mean()), "root_all": float(away.mean()),
            "unsure": seen.unsure, **seen.surface_errors(motion),
        }  # fmt: skip
    errors = evaluate(motion, seen.truth, seen.body, truth_visible=seen.visible_joints)
    return {
        "root_visible": errors["root_joints_visible"], "root_hidden": errors["root_joints_hidden"],
        "root_all": errors["root_joints_all"], "vertices": errors["vertices"],
        **vertices_visible(motion, seen),
    }  # fmt: skip


def about_the_pelvis(motion: Motion, seen: Seen) -> Float[Tensor, "time 22 3"]:
    """Errors of joints about the pelvis, metres."""
    own, true = seen.body.pose(motion).joints, seen.shown.joints[: motion.frames]
    return (own - own[:, :1]) - (true - true[:, :1])


def covered(motion: Motion, std: Float[Tensor, "time 22"] | None, seen: Seen) -> Row:
    """Shares of errors of seen and of hidden joints, along an axis, within 1.645 deviations."""
    if std is None:
        return {}
    own, true = seen.body.pose(motion).joints, seen.shown.joints[: motion.frames]
    within = ((own - true).abs() <= NINE_TENTHS * std[..., None]).float().mean(-1)
    visible = seen.visible_joints[: len(within)]
    hidden = None if bool(visible.all()) else float(within[~visible].mean())
    return {"covered_visible": float(within[visible].mean()), "covered_hidden": hidden}


def placed(motion: Motion, T: Float[Tensor, "4 4"] | None, body: BodyModel) -> Motion:
    """The motion after a rigid transform."""
    return motion if T is None else motion.carried(T, body.rest_joints(motion.shape)[0])


def vertices_visible(motion: Motion, seen: Seen) -> Row:
    """Mean distance of the vertices that the sensor saw from where they were, metres."""
    frames = [k for k in seen.shown_frames if k < motion.frames]
    own, true = (
        torch.stack([one.vertices[k] for k in frames])
        for one in (seen.body.pose(motion), seen.body.pose(seen.truth))
    )
    visible = seen.visible_vertices[: len(frames)]
    return {"vertices_visible": float((own - true).norm(dim=-1)[visible].mean())}


def mistaken(motion: Motion, seen: Seen) -> Row:
    """Shares of frames that face elsewhere and, of those with legs in sight, exchange them."""
    frames = min(motion.frames, seen.truth.frames)
    motion, truth = motion.window(0, frames), seen.truth.window(0, frames)
    away = so3.geodesic(motion.rotations[:, 0], truth.rotations[:, 0])
    own, true = (
        joints - joints[:, :1]
        for joints in (seen.body.pose(motion).joints, seen.shown.joints[:frames])
    )
    legs, others = list(LEGS), [MIRROR[k] for k in LEGS]
    shown = seen.visible_joints[:frames, legs].float().mean(-1) >= _IN_SIGHT
    right = (own[:, legs] - true[:, legs]).norm(dim=-1).mean(-1)
    crossed = (own[:, others] - true[:, legs]).norm(dim=-1).mean(-1)
    turned = float((away > _TURNED).float().mean())
    swapped = shown & (crossed < right) & (right > _APART)
    exchanged = float(swapped.sum() / shown.sum().clamp(min=1))
    wrong = turned >= _OFTEN or exchanged >= _OFTEN
    return {"turned": turned, "exchanged": exchanged, "wrong": float(wrong)}


def codes(warnings: tuple[str, ...]) -> list[str]:
    """The first words of warnings, up to a colon."""
    return [text.split(":")[0] for text in warnings]


if __name__ == "__main__":
    main()

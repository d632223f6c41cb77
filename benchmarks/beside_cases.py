"""The cases for a comparison of two checkouts: sensors' files, calls, and errors of results.

Errors are in metres unless said otherwise: `error` of joints in the world (noisy, three cameras,
gaps by `convert`, live), about the pelvis (one camera, depth), of hidden points (hidden, gaps) or
of vertices (completion). Retargeting has the five errors of `benchmarks.retarget`, on average as
shares of the plain copy's; generation the mean displacement of four predictions from the truth;
slips the error relative to the other checkout's fit of the clean clip, and the shares that are not
caught and not named. `crps` is the continuous ranked probability score of joints under the
standard deviations that the fit states; it is small where these are both right and small.
"""

import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import torch

import recon
from benchmarks.retarget import COPY, PHYSICS, errors, grounded, pooled, soles_down
from benchmarks.slips.judging import claimed_samples, motion_error, truly_placed, verdict_of
from benchmarks.slips.kinds import SLIPS, Slip
from benchmarks.slips.points import point_names, values_of, weights_of
from benchmarks.slips.recordings import SENSORS, Recording, Sensor, recording_of
from benchmarks.speed import fitted_joints, manifest, there_and_back
from observations.keypoints2d import Keypoints2D
from recon.benchmark.windows import TrueWindows
from recon.body.motion_files import with_equal_pelvis_path
from recon.core.motion import MotionFile
from recon.diagnosis.findings import Finding
from recon.formats.motions import load_motion
from recon.formats.observations import (
    KeypointsFile,
    PositionsFile,
    load_observation,
    save_observation,
)
from recon.physics.metrics import physics_samples
from recon.simulation.images import camera_arrays
from scripts.frozen.exports import export

Values = dict[str, float | None]
_LEGS_HIDDEN = {"hide_below": 0.9, "during": (0.67, 1.33)}
"""Options that hide the legs in the middle third of the two seconds."""
_GAP_SHARE, _GAP_SECONDS = 0.3, (0.2, 1.0)
"""Share of every marker's positions that are in gaps, and range of the gaps' durations (s)."""
_SHAPES = ("height=1.60", "height=1.90,weight=95", "woman,short", "man,heavy")
BATCH = 16
"""Number of clips of a batch, which two processes fit."""
_SLIPS_EVERY = 3
"""Number of windows over which all slips are distributed: each has every third one."""


@dataclass(frozen=True)
class Window:
    """One listed window of a true motion, with the files that it is read from and written to."""

    name: str
    subject: str
    windows: TrueWindows
    number: int
    """Index of the window in `windows`."""
    path: Path
    """Motion file of the true motion of this window."""
    source: Path
    """Motion file that the window was cut from."""
    body: recon.BodyModel

    @property
    def truth(self) -> recon.Motion:
        """The true motion."""
        return self.windows.truth[self.number]

    def of(self, values: Sequence[str]) -> str:
        """Choose one of some values, the next one for the next window."""
        return values[self.number % len(values)]

    def save(self, motion: recon.Motion, path: Path) -> None:
        """Write a motion of the body to a motion file."""
        recon.save_motion(path, MotionFile(motion, self.body.name, self.body.checksum))

    def recording(self, sensor: Sensor) -> Recording:
        """Simulate the clean recording of a sensor, in which slips are made."""
        return recording_of(self.windows, self.number, sensor, self.body)


See = Callable[[Window, Path], list[Path]]
"""Function that writes a window's files into a folder, and returns those that the call is
given."""
Judge = Callable[[Window, Sequence[Path], Path], Values]
"""Function that computes the errors of a saved result, given the window and the files."""


@dataclass(frozen=True)
class Case:
    """A call of the library on simulated files, and the function that computes its errors."""

    row: str
    """Name that selects the case on the command line (`--cases`)."""
    group: str
    """Row of the table in which the case is counted."""
    verb: str
    see: See
    judge: Judge
    how: Callable[[Window], Mapping[str, Any]] = lambda window: {}
    slip: str = ""

    @property
    def name(self) -> str:
        """Name that is unique among the cases of a window."""
        return self.slip.replace("/", " of ") or self.group


def simulated(kind: Any, **options: Any) -> See:
    """Return a function that simulates a sensor's files; its view changes between windows."""

    def see(window: Window, folder: Path) -> list[Path]:
        own = {**options, "seed": window.number}
        if kind == "depth":
            own["camera"] = window.of(("front", "side"))
        made = recon.simulate(window.path, kind, **own)
        return list(made.save(folder / ("seen" if len(made) > 1 else "seen.npz"), overwrite=True))

    return see


def a_minute(window: Window, folder: Path) -> list[Path]:
    """Simulate noisy joints of a clip that is played forwards and backwards for a minute."""
    source = load_motion(window.source).motion.resample(window.truth.fps)
    window.save(there_and_back(source, 60.0), folder / "truth.npz")
    made = recon.simulate(folder / "truth.npz", "joints3d", noise=0.04, seed=window.number)
    return list(made.save(folder / "seen.npz", overwrite=True))


def a_batch(window: Window, folder: Path) -> list[Path]:
    """Write a manifest of clips of noisy joints of the window, with other noise in every clip."""
    manifest(folder, window.truth[None], BATCH)
    return [folder / "all.jsonl"]


def with_gaps(window: Window, folder: Path) -> list[Path]:
    """Simulate 43 markers, of whose positions three tenths are hidden in gaps."""
    (path,) = simulated("markers3d", noise=0.005)(window, folder)
    seen = load_observation(path)
    assert isinstance(seen, PositionsFile)
    kept = seen.visible & ~_hidden(window, *seen.visible.shape)
    positions = np.where(kept[..., None], seen.positions, 0.0)
    save_observation(path, replace(seen, positions=positions, visible=kept))
    return [path]


def trc_with_gaps(window: Window, folder: Path) -> list[Path]:
    """Write Plug-in Gait's markers with 3 mm of noise and such gaps to a TRC file."""
    path = folder / "seen.trc"
    path.unlink(missing_ok=True)
    export(window.path, "--trc", path, "--markers", "pig")
    lines = path.read_text(encoding="utf-8").splitlines()
    rows = [line.split("\t") for line in lines[5:] if line.strip()]
    random = np.random.default_rng(window.number)
    values = np.array([row[2 : 2 + 3 * ((len(row) - 2) // 3)] for row in rows], dtype=float)
    values += 3.0 * random.standard_normal(values.shape)
    hidden = _hidden(window, len(rows), values.shape[1] // 3).repeat(3, axis=1)
    texts = np.where(hidden, "", np.char.mod("%.4f", values))
    done = ["\t".join([*row[:2], *own]) for row, own in zip(rows, texts.tolist(), strict=True)]
    path.write_text("\n".join([*lines[:5], *done, ""]), encoding="utf-8")
    return [path]


def _hidden(window: Window, frames: int, points: int) -> np.ndarray:
    """Return a mask (frames, points) of the positions in gaps."""
    random, fps = np.random.default_rng(1000 + window.number), window.truth.fps
    hidden = np.zeros((frames, points), dtype=bool)
    for point in range(points):
        while hidden[:, point].mean() < _GAP_SHARE:
            first = random.integers(-round(_GAP_SECONDS[0] * fps), frames)
            last = first + round(random.uniform(*_GAP_SECONDS) * fps)
            hidden[max(first, 0) : last, point] = True
    return hidden


def on_the_ground(window: Window, folder: Path) -> list[Path]:
    """Write the true motion at 20 Hz on the ground, as the retargeting benchmark does."""
    motion = grounded(window.truth.resample(20.0), window.body)
    window.save(motion, folder / "motion.npz")
    return [folder / "motion.npz"]


def evaluated(metric: str) -> Judge:
    """Return a judge that computes a metric of `recon.evaluate`, and the CRPS if possible."""

    def judge(window: Window, files: Sequence[Path], out: Path) -> Values:
        seen = files[0] if files[0].suffix == ".npz" else None
        found = recon.evaluate(out, window.path, observation=seen)
        return {"error": found[metric], **_crps(window, load_motion(out))}

    return judge


def _crps(window: Window, found: MotionFile) -> Values:
    """Return the CRPS (m) of the standard deviations; empty if the world was estimated, too."""
    if found.joint_std is None or found.T_world_camera is not None:
        return {}
    joints, body = found.joints, window.body
    assert joints is not None
    away = (joints - body.pose(window.truth).joints[: len(joints)]).double().abs()
    std = found.joint_std[..., None].double().clamp(min=1e-6)
    normal = torch.distributions.Normal(0.0, 1.0)
    z = away / std
    score = z * (2 * normal.cdf(z) - 1) + 2 * normal.log_prob(z).exp() - 1 / math.sqrt(math.pi)
    return {"crps": float((std * score).mean())}


def of_stream(window: Window, _: Sequence[Path], out: Path) -> Values:
    """Return the error of the joints that a stream gave."""
    with np.load(out) as file:
        away = torch.from_numpy(file["joints"]) - window.body.pose(window.truth).joints
    return {"error": float(away.norm(dim=-1).mean())}


def of_minute(_: Window, files: Sequence[Path], out: Path) -> Values:
    """Return the error of the joints over the whole minute."""
    return {"error": recon.evaluate(out, files[0].with_name("truth.npz"))["joints_all"]}


def of_rate(window: Window, _: Sequence[Path], out: Path) -> Values:
    """Return the error of joints at another frame rate than the truth's."""
    return {"error": recon.evaluate(out, window.path)["joints_all"]}


def of_batch(window: Window, _: Sequence[Path], out: Path) -> Values:
    """Return the error of the joints of all clips of a batch."""
    away = fitted_joints(out, BATCH) - window.body.pose(window.truth).joints.double().numpy()
    return {"error": float(np.linalg.norm(away, axis=-1).mean())}


def of_retargeting(window: Window, files: Sequence[Path], out: Path) -> Values:
    """Return the physics errors of a retargeted motion, as shares of the plain copy's."""
    source, made = load_motion(files[0]).motion, load_motion(out).motion
    down = soles_down(source, window.body)
    copy = with_equal_pelvis_path(source, window.body, made.shape)
    samples = {name: [physics_samples(motion, window.body, down)]
               for name, motion in ((COPY, copy), (PHYSICS, made))}  # fmt: skip
    rows = pooled(samples, [True])
    pairs = zip(errors(rows[PHYSICS]), errors(rows[COPY]), strict=True)
    known = [a / b for a, b in pairs if a is not None and b]
    return {"error": sum(known) / len(known) if known else None}


def of_predictions(window: Window, _: Sequence[Path], out: Path) -> Values:
    """Return the mean displacement of all predictions from the truth."""
    true = window.body.pose(window.truth).joints[1:]
    made = [
        window.body.pose(load_motion(path).motion).joints for path in sorted(out.glob("*.npz"))
    ]
    away = [(own[: len(true)] - true[: len(own)]).norm(dim=-1).mean() for own in made]
    return {"error": float(torch.stack(away).mean())}


def slip_case(slip: Slip) -> Case:
    """Return the case of fitting a clip with a slip, compared with the fit of the clean one."""

    def see(window: Window, folder: Path) -> list[Path]:
        return _saved(slip.spoil(window.recording(slip.sensor), slip.size), folder)

    def judge(window: Window, _: Sequence[Path], out: Path) -> Values:
        recording = window.recording(slip.sensor)
        clean = out.parents[1] / f"clean {slip.sensor}"
        found, own, theirs = map(load_motion, (out, clean / out.name, clean / "there.npz"))
        observed = (
            np.ones((0, 0), dtype=bool) if found.observed is None else found.observed.numpy()
        )
        claimed = claimed_samples(slip, observed, recording.truth.frames)
        error, before, there = (
            motion_error(truly_placed(_placed(one), recording), recording, slip.measure, claimed)
            for one in (found, own, theirs)
        )
        said = json.loads(Path(f"{out}.json").read_text(encoding="utf-8"))
        repairs, warnings = ([Finding(one["code"], one["message"]) for one in said[key]]
                             for key in ("repairs", "warnings"))  # fmt: skip
        verdict = verdict_of(slip, window.name, before, error, repairs, warnings)
        named = float(verdict.named) if verdict.judged else None
        return {"error": error / there, "not caught": 1.0 - verdict.caught,
                "not named": None if named is None else 1.0 - named}  # fmt: skip

    return Case("slips", "slips", "fit", see, judge, _by_pose, slip.key)


def _by_pose(_: Window) -> Mapping[str, Any]:
    return {"prior": "pose"}


def _placed(found: MotionFile) -> Any:
    """Wrap a motion file's result with the fields that `truly_placed` reads."""
    T = found.T_world_camera
    return SimpleNamespace(motion=found.motion, T_world_camera=None if T is None else T[0])


def clean_case(sensor: Sensor) -> Case:
    """Return the case of fitting the clean clip in which slips are made."""

    def see(window: Window, folder: Path) -> list[Path]:
        return _saved(window.recording(sensor).clean, folder)

    def judge(window: Window, _: Sequence[Path], out: Path) -> Values:
        recording, found = window.recording(sensor), load_motion(out)
        every = torch.ones(recording.truth.frames, 22, dtype=torch.bool)
        measure = "pelvis" if sensor == "camera" else "world"
        there = truly_placed(_placed(found), recording)
        return {"error": motion_error(there, recording, measure, every)}

    return Case("slips", f"clean {sensor}", "fit", see, judge, _by_pose)


def _saved(seen: Sequence[Any], folder: Path) -> list[Path]:
    """Write observations to files and return their paths."""
    paths = [folder / f"seen{k}.npz" for k in range(len(seen))]
    for path, one in zip(paths, seen, strict=True):
        values, weights = (own[0].double().numpy() for own in (values_of(one), weights_of(one)))
        if isinstance(one, Keypoints2D):
            seen_by = one.camera.map(lambda t: t[0])
            camera = camera_arrays(seen_by.replace(camera_matrix=seen_by.camera_matrix[0]))
            if not one.ground_known:
                camera = replace(camera, T_camera_world=None)
            file = KeypointsFile(values, weights, "openpose25", one.fps, camera, one.start_time)
        else:
            kind = "joints3d" if isinstance(one, recon.Joints3D) else "markers3d"
            file = PositionsFile(
                kind, values, weights > 0, point_names(one), one.fps, one.start_time
            )
        save_observation(path, file)
    return paths


_SCANS: Mapping[str, Any] = {"noise": 0.005, "points": 300, "missing_frames": 0.85, "clothed": 1}
_PHONE: Mapping[str, Any] = {"noise": 3.0, "unknown_ground": True, **_LEGS_HIDDEN}
_SENSOR: Mapping[str, Any] = {"noise": 0.005, "left_over": ("ground",), **_LEGS_HIDDEN}
_ROWS = (
    Case("noisy", "noisy", "fit", simulated("joints3d", noise=0.04), evaluated("joints_all")),
    Case("pose", "noisy, pose prior", "fit", simulated("joints3d", noise=0.04),
         evaluated("joints_all"), _by_pose),
    Case("minute", "a minute", "fit", a_minute, of_minute),
    Case("rate", "300 Hz", "fit", simulated("joints3d", noise=0.04, fps=300.0), of_rate),
    Case("batch", f"batch of {BATCH}", "batch", a_batch, of_batch),
    Case("hidden", "hidden", "fit", simulated("markers3d", hide_below=0.9),
         evaluated("observed_hidden")),
    Case("cameras", "one camera", "fit", simulated("keypoints2d", **_PHONE),
         evaluated("root_joints_all")),
    Case("cameras", "three cameras", "fit",
         simulated("keypoints2d", noise=3.0, views=3, **_LEGS_HIDDEN), evaluated("joints_all")),
    Case("depth", "depth", "fit", simulated("depth", **_SENSOR), evaluated("root_joints_all")),
    Case("gaps", "gaps, fit", "fit", with_gaps, evaluated("observed_hidden")),
    Case("gaps", "gaps, convert", "convert", trc_with_gaps, evaluated("joints_all")),
    Case("completion", "scans", "complete", simulated("scans", **_SCANS), evaluated("vertices")),
    Case("completion", "landmarks", "complete",
         simulated("landmarks", noise=0.001, missing_frames=0.85), evaluated("vertices")),
    Case("retargeting", "retargeting, physics", "retarget", on_the_ground, of_retargeting,
         lambda window: {"shape": window.of(_SHAPES)}),
    Case("retargeting", "retargeting, network", "retarget", on_the_ground, of_retargeting,
         lambda window: {"shape": window.of(_SHAPES), "method": "network"}),
    Case("generation", "generation", "predict", lambda window, _: [window.path], of_predictions,
         lambda window: {"samples": 4, "at": 1 / 30, "seconds": 58 / 30, "seed": window.number}),
    Case("live", "live", "stream", simulated("joints3d", noise=0.04), of_stream,
         lambda _: {"prior": "humor"}),
)  # fmt: skip
CASES = (*dict.fromkeys(case.row for case in _ROWS), "slips")
"""Names that `--cases` accepts."""


def cases_of(window: Window, rows: Sequence[str]) -> Iterator[Case]:
    """Yield the cases that are run for a window."""
    yield from (case for case in _ROWS if case.row in rows)
    if "slips" in rows:
        yield from (clean_case(sensor) for sensor in SENSORS)
        yield from (
            slip_case(slip) for slip in SLIPS[window.number % _SLIPS_EVERY :: _SLIPS_EVERY]
        )

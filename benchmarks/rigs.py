"""Rigs: one of three cameras out of step and out of its calibration, found and put right.

    python -m benchmarks.rigs CORPUS --part validation --only 12 --json rigs.json
    python -m benchmarks.rigs CORPUS --part validation --only 4 --fit --json rigs_fit.json

Windows of 60 frames at 30 Hz before three cameras, three pixels of noise. One camera, another one
from window to window, is late by some milliseconds (every other window: early), turned about its
centre by some degrees about a random axis, and shifted by some centimetres, as no calibration
tells. `right` is the number of windows in which that view and no other was corrected, or, of a
clean rig, nothing was; `wrong` that in which another view was changed; `said` that in which it is
said instead that a view is wrong but not told which. `clock` and `turn` are errors of what was
found, medians and the largest, over the windows in which the right view was corrected. Of people
who stand nearly still, all joints below 0.1 m/s on average, no clock can be told and none needs to
be; these windows (`still`) are left out of `clock`. With `--fit`, errors of joints of fits: of the
rig as it should be, as it is, and as it was put right.
"""

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from torch import Generator, Tensor

from benchmarks.arguments import over_windows
from benchmarks.humor import evenly
from benchmarks.results import corpus_source, write
from observations.keypoints2d import Keypoints2D
from recon.benchmark.dataset import Splits
from recon.benchmark.windows import FPS, load_windows
from recon.body.model import BodyModel
from recon.core import rotations as so3
from recon.core.camera import full_hd_camera
from recon.core.motion import Motion
from recon.diagnosis.examination import screen
from recon.diagnosis.views.images import Images
from recon.diagnosis.views.rigs import corrections
from recon.fitting.clip import fit_clip
from recon.fitting.methods import FitOptions
from recon.reading.images import keypoints_of
from recon.simulation.images import dome, keypoints2d
from recon.simulation.points import Corruption

SEED = 0
NAMES = ("one", "two", "three")
FRAMES = 60
MARGIN = 15
"""Frames of a clip before and after a window, which a view that is late or early shows."""
PIXELS = 3.0
STILL = 0.1
"""Metres per second."""


@dataclass(frozen=True)
class Fault:
    """What is wrong with one camera."""

    late: float = 0.0
    """Seconds."""
    turn: float = 0.0
    """Degrees."""
    shift: float = 0.0
    """Metres."""

    @property
    def name(self) -> str:
        """How the table calls it."""
        return f"{1000 * self.late:.0f} ms, {self.turn:g} degrees, {100 * self.shift:g} cm"


FAULTS = (
    Fault(),
    *(Fault(late=ms / 1000) for ms in (20, 80, 200)),
    *(Fault(turn=degrees) for degrees in (0.3, 1.0, 2.0)),
    Fault(0.020, 0.3), Fault(0.080, 1.0), Fault(0.200, 2.0), Fault(0.080, 1.0, 0.02),
)  # fmt: skip


@dataclass(frozen=True)
class Rig:
    """One window as three cameras saw it."""

    views: tuple[Keypoints2D, ...]
    fault: Fault
    """Its sign is that of this window."""
    wrong: int
    speed: float
    """Mean speed of the joints, m/s."""
    turn: Tensor
    """Rotation from the true axes of that camera to those of the calibration."""


def main() -> None:
    parser = over_windows(__doc__)
    parser.add_argument("--only", type=int, default=None, help="use so many windows in all")
    parser.add_argument("--fit", action="store_true", help="fit 80 ms and 1 degree, too")
    arguments = parser.parse_args()
    body, splits = BodyModel.load(), Splits.load(arguments.splits)
    long = FRAMES + 2 * MARGIN
    windows = load_windows(arguments.corpus, splits, arguments.part, body, SEED, long)
    if arguments.only is not None:
        windows = windows.take(evenly(windows, arguments.only))
    truths = [windows.truth[k] for k in range(len(windows.names))]
    tables: dict[str, Any] = {}
    if arguments.fit:
        tables["fits"] = fits(truths, Fault(0.080, 1.0), body)
        print(tables["fits"])
    else:
        tables["found"] = {}
        for fault in FAULTS:
            tables["found"][fault.name] = row = judged(truths, fault, body)
            print(fault.name, {k: v for k, v in row.items() if k != "windows"}, flush=True)
    if arguments.json is not None:
        about = {"part": arguments.part, **windows.about}
        write(arguments.json, SEED, corpus_source(arguments.corpus, windows.files), **about,
              **tables)  # fmt: skip


def filmed(long: Motion, k: int, fault: Fault, body: BodyModel) -> Rig:
    """A window, and the camera that is at fault in it."""
    sign, wrong = 1.0 if k % 2 == 0 else -1.0, k % 3
    fault = replace(fault, late=sign * fault.late)
    times = long.times[MARGIN : MARGIN + FRAMES]
    lenses = dome(long.at(times, FPS), body, full_hd_camera(), 3, first=2.4 * k)
    generator = Generator().manual_seed(k)
    turn = so3.exp(math.radians(fault.turn) * _direction(generator))
    shift = fault.shift * _direction(generator)
    views: list[Keypoints2D] = []
    for v, lens in enumerate(lenses):
        moments = times - fault.late if v == wrong else times
        shown = long.at(moments, FPS).replace(start_time=0.0)
        seen = keypoints2d(shown, body, lens, Corruption(noise=PIXELS), 100 * k + v)
        view = keypoints_of(seen, body)
        if v == wrong:
            pose = view.camera.T_camera_world.clone()
            centre = -pose[..., :3, :3].mT @ pose[..., :3, 3:]
            pose[..., :3, :3] = turn @ pose[..., :3, :3]
            moved = centre + pose[..., :3, :3].mT @ shift[:, None]
            pose[..., :3, 3:] = -pose[..., :3, :3] @ moved
            view = view.replace(camera=view.camera.replace(T_camera_world=pose))
        views.append(view)
    joints = body.pose(long.at(times, FPS)).joints
    speed = float(joints.diff(dim=0).norm(dim=-1).mean()) * FPS
    return Rig(tuple(views), fault, wrong, speed, turn)


def _direction(generator: Generator) -> Tensor:
    axis = torch.randn(3, generator=generator)
    return axis / axis.norm()


def judged(truths: Sequence[Motion], fault: Fault, body: BodyModel) -> dict[str, Any]:
    """What is found in every window."""
    rows = [_judged(filmed(long, k, fault, body), body) for k, long in enumerate(truths)]
    right = [row for row in rows if row["right"]]
    moving = [row["clock"] for row in right if not row["still"]]
    return {
        "right": len(right),
        "wrong": sum(row["wrong"] for row in rows),
        "said": sum(row["said"] and not row["right"] for row in rows),
        "still": sum(row["still"] for row in rows),
        "clock": _spread(moving),
        "turn": _spread([row["turn"] for row in right]),
        "seconds": float(np.mean([row["seconds"] for row in rows])),
        "windows": rows,
    }


def _judged(rig: Rig, body: BodyModel) -> dict[str, Any]:
    images = Images.of(rig.views, NAMES, body)
    began = time.process_time()
    found = corrections(images)
    seconds = time.process_time() - began
    changed = [one.view for one in found.applied]
    clean = replace(rig.fault, late=abs(rig.fault.late)) == Fault()
    own = [one for one in found.applied if one.view == rig.wrong]
    late = sum(one.late for one in own) / FPS
    after = found.images.pose[rig.wrong, 0, :3, :3]
    apart = after @ images.pose[rig.wrong, 0, :3, :3].T @ rig.turn.double().numpy()
    return {
        "right": changed == ([] if clean else [rig.wrong]),
        "wrong": any(clean or v != rig.wrong for v in changed),
        "said": len(found.undecided) > 0,
        "still": rig.speed < STILL,
        "clock": abs(late - rig.fault.late),
        "turn": math.degrees(2 * math.asin(float(np.linalg.norm(apart - np.eye(3))) / 8**0.5)),
        "seconds": seconds,
    }


def _spread(errors: Sequence[float]) -> list[float] | None:
    """Median and largest; None of nothing."""
    return [float(np.median(errors)), max(errors)] if errors else None


def fits(truths: Sequence[Motion], fault: Fault, body: BodyModel) -> dict[str, Any]:
    """Mean distance of joints, metres, of fits to a rig as it should be, as it is, put right."""
    rows: dict[str, list[float]] = {"clean": [], "as it is": [], "put right": []}
    for k, long in enumerate(truths):
        truth = long.window(MARGIN, MARGIN + FRAMES).replace(start_time=0.0)
        clean, spoilt = filmed(long, k, Fault(), body), filmed(long, k, fault, body)
        for name, rig, repair in (
            ("clean", clean, False), ("as it is", spoilt, False), ("put right", spoilt, True)
        ):  # fmt: skip
            options = FitOptions(repair=repair)
            screened = screen(rig.views, NAMES, options, body)
            fitted = fit_clip(screened.observations, options, body)
            joints = fitted.result.body.joints[0].detach().cpu()
            away = joints - body.pose(truth).joints
            rows[name].append(float(away.norm(dim=-1).mean()))
    return {name: {"mean": float(np.mean(own)), "windows": own} for name, own in rows.items()}


if __name__ == "__main__":
    main()

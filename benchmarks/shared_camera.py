"""Two people in one film: what it is worth that they share a camera and a ground.

    python -m benchmarks.shared_camera CORPUS --part validation --json shared.json

Scenes of `benchmarks.crossings`, whose detections name nobody, filmed by a phone that nobody
calibrated. `together` is `recon.fit_people`, `alone` fits each person by `recon.fit`, both under
the pose prior. In the camera's frame, where both can be compared with the truth:

* `about` is the mean distance of the 22 joints about the pelvis;
* `between` is the mean error of the vector from one pelvis to the other;
* `floors` is how far the two people's grounds are apart, below where they are.
"""

import sys
import time
from collections.abc import Sequence

import numpy as np
import torch
from jaxtyping import Float
from rich.console import Console
from torch import Tensor

from benchmarks.arguments import over_windows
from benchmarks.crossings import LAYOUT, SEED, Scene, scenes, walkers
from benchmarks.results import corpus_source, write
from benchmarks.scores import cell
from recon.api.result import Result
from recon.batch.clips import fit_clips
from recon.benchmark.dataset import Splits
from recon.body.model import BodyModel
from recon.core.camera import transform
from recon.fitting.settings import DEFAULTS
from recon.formats.calibration import guessed_camera
from recon.people.everyone import PersonClip, everyone
from recon.people.together import fit_people
from recon.reading.clip import together
from recon.reading.views import SeenViews

SCENES = 6
COLUMNS = {"about": ("about the pelvis cm", 100.0), "between": ("between people cm", 100.0),
           "floors": ("floors apart cm", 100.0), "seconds": ("CPU s", 1.0)}  # fmt: skip


def main() -> None:
    parser = over_windows(__doc__)
    parser.add_argument("--only", type=int, default=SCENES, help="scenes")
    arguments = parser.parse_args()
    body = BodyModel.load()
    windows = walkers(arguments.corpus, Splits.load(arguments.splits), arguments.part, body)
    rows = [row for one in scenes(windows, body, arguments.only) for row in measured(one, body)]
    console = Console(width=None if sys.stdout.isatty() else 160)
    for how in ("alone", "together"):
        own = [row for row in rows if row["how"] == how]
        means = {key: float(np.mean([row[key] for row in own])) for key in COLUMNS}  # type: ignore[arg-type]
        console.print(how, {h: cell(means[key], f) for key, (h, f) in COLUMNS.items()})
    if arguments.json is not None:
        about = {"part": arguments.part, **windows.about}
        write(arguments.json, SEED, corpus_source(arguments.corpus, windows.files), **about,
              scenes=rows)  # fmt: skip


def measured(scene: Scene, body: BodyModel) -> list[dict[str, str | float]]:
    """Errors of the two people of a scene, alone and together."""
    people = detected(scene, body)
    if len(people) != 2:
        raise ValueError(f"expected two people, found {len(people)}")
    out: list[dict[str, str | float]] = []
    for how in ("alone", "together"):
        began = time.process_time()
        if how == "alone":
            results = fit_clips([one.clip for one in people], "pose")
        else:
            results = list(fit_people(people, "pose"))
        seconds = time.process_time() - began
        out.append({"kind": scene.kind, "how": how, **_errors(scene, results, body),
                    "seconds": seconds})  # fmt: skip
    return out


def detected(scene: Scene, body: BodyModel) -> list[PersonClip]:
    """The people of a scene as they are found in its detections."""
    size = scene.camera.image_size
    frames = scene.motions[0].frames
    seen = SeenViews(
        found=(scene.detections,), names=("phone",), cameras=(guessed_camera(size),),
        first_frame=0, frames=frames, fps=scene.motions[0].fps, up_given=False, decisions=(),
    )  # fmt: skip
    assert scene.detections.layout == LAYOUT
    return [
        PersonClip(one.number, together([("phone", one.views.files[0])], (), DEFAULTS, body))
        for one in everyone(seen).people
    ]


def _errors(scene: Scene, results: Sequence[Result], body: BodyModel) -> dict[str, float]:
    truth = [scene.camera.to_camera(body.pose(motion).joints) for motion in scene.motions]
    found = [_in_camera(one) for one in results]
    # who is who is told by where they are in the image, which every fit explains
    if _apart(found[0], truth[0]) + _apart(found[1], truth[1]) > _apart(
        found[0], truth[1]
    ) + _apart(found[1], truth[0]):
        truth = truth[::-1]
    pairs = list(zip(found, truth, strict=True))
    about = [((a - a[:, :1]) - (b - b[:, :1])).norm(dim=-1).mean() for a, b in pairs]
    ways = [(joints[0][:, 0] - joints[1][:, 0]) for joints in (found, truth)]
    return {
        "about": float(torch.stack(about).mean()),
        "between": float((ways[0] - ways[1]).norm(dim=-1).mean()),
        "floors": abs(_floor(results[0], found[0]) - _floor(results[1], found[0])),
    }


def _in_camera(result: Result) -> Float[Tensor, "time 22 3"]:
    assert result.T_world_camera is not None
    return transform(torch.linalg.inv(result.T_world_camera), result.joints)


def _apart(one: Float[Tensor, "time 22 3"], two: Float[Tensor, "time 22 3"]) -> float:
    """Mean distance of the pelvis in an image of unit focal length."""
    return float(
        (one[:, 0, :2] / one[:, 0, 2:] - two[:, 0, :2] / two[:, 0, 2:]).norm(dim=-1).mean()
    )


def _floor(result: Result, place: Float[Tensor, "time 22 3"]) -> float:
    """Height of a place of the camera's frame above a result's ground, metres."""
    assert result.T_world_camera is not None
    assert result.ground is not None
    there = transform(result.T_world_camera, place[:, 0].mean(0, keepdim=True))
    return float(there[0, 2] - result.ground[3])


if __name__ == "__main__":
    main()

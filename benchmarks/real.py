"""Real marker recordings with their lower markers hidden: given back without and with HuMoR.

    python -m benchmarks.real OBSERVATIONS --json real.json --pictures FOLDER

`hidden_markers.toml` lists the runs, walks and jumps, and those that are measured apart. Markers
below 0.9 m are hidden in every frame, as by a table; the fit sees the others. What is measured is
how far the hidden markers are from their place on the body that is given back, a centimetre or two
of which is how far any marker sits from its nominal landmark: the row of a fit that saw everything
tells that floor. At most three seconds of a recording, at 30 Hz or a little more. Pictures are of
CMU's recording only, which is free to show.

What is in the JSON already, of the same commit, is not run again; with `--minutes` the command
ends after the recording that is then under way, and goes on when it is run once more.
"""

import argparse
import tomllib
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from time import monotonic
from typing import Any

import torch

from benchmarks.results import earlier, recordings_source, write
from observations.markers3d import Markers3D
from observations.timing import at_observation_times
from priors.humor.collocation import Collocation
from priors.humor.prior import Humor
from priors.pose.prior import PosePrior, PoseWeights
from recon.body.model import BodyModel
from recon.core.motion import Motion
from recon.formats.mocap.reader import read_recording
from recon.formats.mocap.recording import MarkerRecording
from recon.ingest.markers.coverage import full_body_markers
from recon.method.reconstruction import Method, solve
from recon.view.frames import write_png
from recon.view.scene import GREY, Figure, Points, Show

LIST = Path(__file__).parent / "hidden_markers.toml"
PICTURED = "cmu_c3d/02_01.c3d"
SECONDS, HIDDEN_BELOW, NOISE = 3.0, 0.9, 0.02
"""Length of a clip; height below which markers are hidden; and the standard deviation of a marker
against its landmark, which skin and the hand that taped it make. Seconds and metres."""
POSE, HUMOR, EVERYTHING = "pose prior", "HuMoR", "pose prior, nothing hidden"


@dataclass(frozen=True)
class HiddenMarkers:
    """A recording of which the lower markers are hidden."""

    row: str
    """The mean it counts in (runs, walks or jumps), or `apart`."""
    path: str
    """Below the folder of observations."""
    person: str
    first: float = 0.0
    """Second of the recording at which the clip begins."""
    why: str = ""
    """The reason for being apart."""


def load_list(path: Path = LIST) -> tuple[HiddenMarkers, ...]:
    """The listed recordings, row after row."""
    table = tomllib.loads(path.read_text(encoding="utf-8"))
    return tuple(HiddenMarkers(row=row, **own) for row, rows in table.items() for own in rows)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("observations", type=Path, help="folder of marker recordings")
    parser.add_argument("--weights", default="open", help="of HuMoR: open, nc or a file")
    parser.add_argument("--minutes", type=float, default=None, help="begin no recording later")
    parser.add_argument("--pictures", type=Path, default=None)
    parser.add_argument("--json", type=Path, default=None)
    arguments = parser.parse_args()
    began, listed, body = monotonic(), load_list(), BodyModel.load()
    methods: dict[str, Method] = {
        POSE: PosePrior.load(weights=PoseWeights.for_noise(NOISE)),
        HUMOR: Collocation.for_noise(Humor.load(arguments.weights, body=body), NOISE),
    }
    rows: dict[str, dict[str, Any]] = earlier(arguments.json, "recordings")
    source = recordings_source(arguments.observations, [one.path for one in listed])
    for one in listed:
        late = arguments.minutes is not None and monotonic() - began > 60 * arguments.minutes
        if one.path in rows or late:
            continue
        seen = observation(arguments.observations / one.path, body, one.first)
        found, errors = given_back(seen, methods, body)
        rows[one.path] = {**asdict(one), "frames": seen.positions.shape[1], "error_cm": errors}
        print(one.path, {k: f"{value:.1f} cm" for k, value in errors.items()}, flush=True)
        if arguments.pictures is not None and one.path == PICTURED:
            draw(arguments.pictures / "real_markers.png", one.path, seen, found, body)
        if arguments.json is not None:
            write(arguments.json, None, source, recordings=rows)


def given_back(
    seen: Markers3D, methods: Mapping[str, Method], body: BodyModel
) -> tuple[dict[str, Motion], dict[str, float]]:
    """Motions by method from the upper markers, and the mean error of the hidden ones, cm.

    Last comes the pose prior's motion from all markers.
    """
    hidden = lower(seen)
    spoilt = seen.replace(visible=seen.visible & ~hidden)
    given = {label: (spoilt, method) for label, method in methods.items()}
    motions: dict[str, Motion] = {}
    errors: dict[str, float] = {}
    for label, (data, method) in {**given, EVERYTHING: (seen, methods[POSE])}.items():
        result = solve([data], method, body)
        there, when = at_observation_times(
            seen.predict(result.estimate), result.motion,
            fps=seen.fps, start_time=0.0, moments=seen.positions.shape[1],
        )  # fmt: skip
        away = (there - seen.positions[:, when]).norm(dim=-1)
        motions[label] = result.clip(0).detach()
        errors[label] = 100 * away[hidden[:, when]].mean().item()
    return motions, errors


def lower(seen: Markers3D) -> torch.Tensor:
    """Which positions are hidden."""
    return seen.visible & (seen.positions[..., 2] < HIDDEN_BELOW)


def draw(
    path: Path, name: str, seen: Markers3D, found: Mapping[str, Motion], body: BodyModel
) -> None:
    """Pictures of each method's motion, that of all markers behind it in grey."""
    upper = seen.visible & ~lower(seen)
    shows = [
        Show(
            f"{name}: {label}",
            (
                Figure(body, found[label], "reconstruction"),
                Figure(body, found[EVERYTHING], "all markers seen", colour=GREY, opacity=0.4),
            ),
            Points(seen.positions[0], upper[0], seen.positions[0]),
        )
        for label in (POSE, HUMOR)
    ]
    write_png(path, shows)


def observation(path: Path, body: BodyModel, first: float = 0.0) -> Markers3D:
    """Some seconds of a recording's known markers, thinned to 30 Hz or a little more."""
    recording = read_recording(path)
    assert isinstance(recording, MarkerRecording)
    markers = full_body_markers(recording, body)
    chosen = recording.select(markers.labels)
    step = max(1, int(chosen.fps // 30))
    start = round(first * chosen.fps)
    kept = slice(start, start + int(SECONDS * chosen.fps), step)
    return Markers3D(
        positions=torch.from_numpy(chosen.positions[kept]).float()[None],
        visible=torch.from_numpy(chosen.visible[kept])[None],
        vertices=markers.vertices,
        fps=chosen.fps / step,
    )


if __name__ == "__main__":
    main()

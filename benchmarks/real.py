"""Real marker recordings with their lower markers hidden: given back without and with HuMoR.

    python -m benchmarks.real OBSERVATIONS --json real.json --pictures FOLDER

Markers below 0.9 m are hidden in every frame, as by a table; the fit sees the others. What is
measured is how far the hidden markers are from their place on the body that is given back, a
centimetre or two of which is how far any marker sits from its nominal landmark: the row of a fit
that saw everything tells that floor. At most three seconds of a recording, at 30 Hz or a little
more. Pictures are of CMU's recording only, which is free to show.
"""

import argparse
from pathlib import Path

import torch

from benchmarks.results import recordings_source, write
from observations.markers3d import Markers3D
from observations.timing import at_observation_times
from priors.humor.collocation import Collocation
from priors.humor.prior import Humor
from priors.pose.prior import PosePrior, PoseWeights
from recon.body.model import BodyModel
from recon.formats.mocap.reader import read_recording
from recon.formats.mocap.recording import MarkerRecording
from recon.ingest.markers.coverage import full_body_markers
from recon.method.reconstruction import Method, solve
from recon.view.frames import write_png
from recon.view.show.colours import GREY
from recon.view.show.scene import Figure, Points, Show

RECORDINGS = (
    "cmu_c3d/02_01.c3d",
    "rehazenter/2014001_C1_01.c3d",
    "opensim/rajagopal_walk.trc",
    "nimblephysics/sprinter_run0350cms.trc",
)
PICTURED = "cmu_c3d/02_01.c3d"
SECONDS, HIDDEN_BELOW, NOISE = 3.0, 0.9, 0.02
"""Length of a clip; height below which markers are hidden; and the standard deviation of a marker
against its landmark, which skin and the hand that taped it make. Seconds and metres."""


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("observations", type=Path, help="folder of marker recordings")
    parser.add_argument("--pictures", type=Path, default=None)
    parser.add_argument("--json", type=Path, default=None)
    arguments = parser.parse_args()
    body = BodyModel.load()
    poses = PosePrior.load(weights=PoseWeights.for_noise(NOISE))
    methods: dict[str, Method] = {
        "pose prior": poses,
        "HuMoR": Collocation.for_noise(Humor.load(body=body), NOISE),
    }
    rows: dict[str, dict[str, float]] = {}
    for name in RECORDINGS:
        seen = observation(arguments.observations / name, body)
        everything = solve([seen], poses, body)
        hidden = seen.visible & (seen.positions[..., 2] < HIDDEN_BELOW)
        spoilt = seen.replace(visible=seen.visible & ~hidden)
        results = {label: solve([spoilt], method, body) for label, method in methods.items()}
        rows[name] = {}
        for label, result in {**results, "pose prior, nothing hidden": everything}.items():
            there, when = at_observation_times(
                seen.predict(result.estimate), result.motion,
                fps=seen.fps, start_time=0.0, moments=seen.positions.shape[1],
            )  # fmt: skip
            away = (there - seen.positions[:, when]).norm(dim=-1)
            rows[name][label] = 100 * away[hidden[:, when]].mean().item()
        print(name, {label: f"{value:.1f} cm" for label, value in rows[name].items()}, flush=True)
        if arguments.pictures is not None and name == PICTURED:
            truth = everything.clip(0).detach()
            shows = [
                Show(
                    f"{name}: {label}",
                    (
                        Figure(body, result.clip(0).detach(), "reconstruction"),
                        Figure(body, truth, "all markers seen", colour=GREY, opacity=0.4),
                    ),
                    Points(seen.positions[0], spoilt.visible[0], seen.positions[0]),
                )
                for label, result in results.items()
            ]
            write_png(arguments.pictures / "real_markers.png", shows)
    if arguments.json is not None:
        source = recordings_source(arguments.observations, rows)
        write(arguments.json, None, source, hidden_markers_cm=rows)


def observation(path: Path, body: BodyModel) -> Markers3D:
    """The first seconds of a recording's known markers, thinned to 30 Hz or a little more."""
    recording = read_recording(path)
    assert isinstance(recording, MarkerRecording)
    markers = full_body_markers(recording, body)
    chosen = recording.select(markers.labels)
    step = max(1, int(chosen.fps // 30))
    stop = int(SECONDS * chosen.fps)
    return Markers3D(
        positions=torch.from_numpy(chosen.positions[:stop:step]).float()[None],
        visible=torch.from_numpy(chosen.visible[:stop:step])[None],
        vertices=markers.vertices,
        fps=chosen.fps / step,
    )


if __name__ == "__main__":
    main()

"""Limits by kind of motion on the free windows of `recon bench`, and a picture of the worst.

    python -m benchmarks.failures CORPUS --json failures.json --png docs/failures.png

Noisy joints and hidden points under the pose prior and by collocation, window by window, with the
kind of motion that the description of each recording tells. The picture has three windows of
different clips whose hidden points collocation finds worst: fitted, and the truth in grey.
"""

from pathlib import Path

import torch

from benchmarks.arguments import over_windows
from benchmarks.results import corpus_source, write
from recon.benchmark.dataset import Splits, clip_files
from recon.benchmark.judged import bench
from recon.benchmark.methods import method_named
from recon.benchmark.protocols import PROTOCOLS, SeenWindow, seen_windows
from recon.benchmark.windows import bench_source
from recon.body.model import BodyModel
from recon.formats.motions import MotionFile
from recon.view.frames import write_png
from recon.view.scene import GREY, Figure, Points, Show
from training.humor.corpus import OTHER, described, kind_of

METHODS = ("pose", "collocation")
MEASURED = {"noisy-joints": "joints_all", "hidden-points": "observed_hidden"}
"""The metric that is kept of each protocol."""
SHOWN = 3
"""Windows in the picture."""


def main() -> None:
    parser = over_windows(__doc__)
    parser.add_argument("--png", type=Path, default=None)
    parser.add_argument("--only", type=int, default=None, help="use so many windows in all")
    arguments = parser.parse_args()
    corpus, part, only = arguments.corpus, arguments.part, arguments.only
    found = {
        protocol: bench(protocol, METHODS, corpus, part=part, only=only) for protocol in MEASURED
    }
    table = found["hidden-points"]
    files, clips = clip_files(corpus), [name.rsplit("@", 1)[0] for name in table.names]
    told = {clip: described(files[clip]) for clip in clips}
    windows = [
        {
            "name": name,
            "subject": subject,
            "kind": kind_of(told[clip]),
            "told": told[clip] if kind_of(told[clip]) == OTHER else None,
            **{
                f"{protocol}, {method}": own.values[method][MEASURED[protocol]][i]
                for protocol, own in found.items()
                for method in METHODS
            },
        }
        for i, (name, subject, clip) in enumerate(
            zip(table.names, table.subjects, clips, strict=True)
        )
    ]
    for window in windows:
        print(window)
    if arguments.png is not None:
        errors = table.values["collocation"]["observed_hidden"]
        worst = sorted(range(len(windows)), key=lambda i: -(errors[i] or 0.0))
        chosen: list[int] = []
        for i in worst:
            if clips[i] not in {clips[j] for j in chosen} and len(chosen) < SHOWN:
                chosen.append(i)
        body = BodyModel.load()
        source = bench_source(corpus, part, None, only, body)
        seen = seen_windows(PROTOCOLS["hidden-points"], source.windows, body)
        write_png(arguments.png, [show(seen[i], told[clips[i]], body) for i in chosen])
    if arguments.json is not None:
        listed = Splits.load(arguments.splits).apart
        read = corpus_source(corpus, {files[clip] for clip in clips})
        write(arguments.json, 0, read, part=part, apart=listed, rows=windows)


def show(window: SeenWindow, told: str, body: BodyModel) -> Show:
    """The fit of a window by collocation, and the truth."""
    given = method_named("collocation", body)(window.seen)
    if not isinstance(given, MotionFile):
        raise TypeError(f"expected a motion of collocation, got {type(given).__name__}")
    visible = torch.from_numpy(window.seen.visible)
    figures = (
        Figure(body, given.motion, "fit from points above 0.9 m"),
        Figure(body, window.truth, "truth", colour=GREY, opacity=0.4),
    )
    return Show(f"{window.name}: {told}", figures, Points(window.points.float(), visible))


if __name__ == "__main__":
    main()

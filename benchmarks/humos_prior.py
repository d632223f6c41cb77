"""The HUMOS prior in the optimiser: two protocols of `benchmarks.humor`, beside HuMoR and none.

    python -m benchmarks.humos_prior CORPUS --only 24 --json benchmarks/results/humos_prior.json
    python -m benchmarks.humos_prior CORPUS --part validation --only 8 --weights FILE

Windows of 60 frames; `stages 1-2` have single poses and smoothness, no motion prior; `codes`
moves codes and details, `HUMOS` the motion that they judge. Columns are
those of `benchmarks.humor`.
"""

from benchmarks.arguments import over_windows
from benchmarks.humor import COLUMNS, Entry, evenly, fitted_rows
from benchmarks.results import corpus_source, write
from benchmarks.scores import Rows, tables
from benchmarks.stage12 import SEED
from priors.humor.collocation import Collocation
from priors.humor.prior import Humor
from priors.humos.collocation import CodesFit, HumosFit
from priors.humos.prior import Humos
from priors.pose.prior import PosePrior, PoseWeights
from recon.benchmark.dataset import Splits
from recon.benchmark.protocols import noisy_joints, occluded_points
from recon.benchmark.windows import load_windows
from recon.body.model import BodyModel


def main() -> None:
    """Fit, print and write."""
    parser = over_windows(__doc__)
    parser.add_argument("--weights", default="open", help="of HUMOS: open, nc or a file")
    parser.add_argument("--only", type=int, default=None, help="use so many windows")
    given = parser.parse_args()
    body, splits = BodyModel.load(), Splits.load(given.splits)
    windows = load_windows(given.corpus, splits, given.part, body, SEED)
    if given.only is not None:
        windows = windows.take(evenly(windows, given.only))
    humos, humor = Humos.load(given.weights, body), Humor.load()

    def entries(noise: float) -> list[Entry]:
        return [
            Entry("stages 1-2", PosePrior.load(weights=PoseWeights.for_noise(noise))),
            Entry("HuMoR", Collocation.for_noise(humor, noise)),
            Entry("HUMOS", HumosFit.for_noise(humos, noise)),
            Entry("HUMOS, codes", CodesFit.for_noise(humos, noise)),
        ]

    joints = body.pose(windows.truth).joints
    noisy = noisy_joints(windows.truth, body, SEED)
    occluded, points = occluded_points(windows.truth, body)
    found: dict[str, dict[str, Rows]] = {}
    for name, observed, truth, noise in (
        ("noisy joints", noisy, joints, 0.04),
        ("occluded points", occluded, points, 0.0),
    ):
        found[name] = fitted_rows(windows, observed, truth, entries(noise), body)
        for shown in tables(f"{name}, {given.part}", COLUMNS[name], found[name]):
            print_wide(shown)
        if given.json is not None:
            source = corpus_source(given.corpus, windows.files)
            write(given.json, SEED, source, part=given.part, weights=given.weights,
                  windows=windows.about, tables=found)  # fmt: skip


def print_wide(table: object) -> None:
    """Prints every row of a table on one line, wherever it is printed to."""
    from rich.console import Console

    Console(width=180).print(table)


if __name__ == "__main__":
    main()

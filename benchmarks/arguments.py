"""The command line of `benchmarks.clouds`."""

import argparse
from pathlib import Path

from priors.training.dataset import SPLITS


def over_windows(about: str | None) -> argparse.ArgumentParser:
    """A parser of corpus, splits, part and the JSON to write; `clouds` adds its own."""
    parser = argparse.ArgumentParser(
        description=about, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("corpus", type=Path, help="folder of all converted motions")
    parser.add_argument("--splits", type=Path, default=SPLITS)
    parser.add_argument("--part", choices=("test", "validation"), default="test")
    parser.add_argument("--json", type=Path, default=None)
    return parser

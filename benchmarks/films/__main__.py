"""Measures the errors of motions that `recon fit film.mp4` finds.

    python -m benchmarks.films real OBSERVATIONS --out FOLDER
    python -m benchmarks.films real OBSERVATIONS --cases nothing --detections FOLDER
    python -m benchmarks.films rendered CORPUS --films FOLDER --out FOLDER
    python -m benchmarks.films crossing CORPUS --films FOLDER --out FOLDER

`real` is `benchmarks.films.real`: real films beside the fit of others' detections. `rendered` and
`crossing` are `benchmarks.films.rendered` and `.crossing`: rendered people, whose motion is known.
"""

import argparse

from benchmarks.films import crossing, real, rendered
from benchmarks.protocol import parser


def main() -> None:
    """Run one part, print and write its table."""
    arguments = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parts = arguments.add_subparsers(required=True)
    for part, data in ((real, "observations"), (rendered, "corpus"), (crossing, "corpus")):
        name = part.__name__.rpartition(".")[2]
        each = parts.add_parser(name, parents=[parser(None, data)], add_help=False)
        part.add_arguments(each)
        each.set_defaults(measure=part.measure)
    given = arguments.parse_args()
    given.measure(given)


if __name__ == "__main__":
    main()

"""HUMOS judged alone: what its network adds to a scaled copy, to physics alone and to fits.

    python -m benchmarks.bodies CORPUS KEPT --json benchmarks/results/bodies.json
    python -m benchmarks.bodies CORPUS KEPT --part test --each 12 --one-code RUN/humos.safetensors

Three studies. `network`: what is proposed for another body, with and without settling, beside a
scaled copy and physics alone, on clips and bodies of `benchmarks/identities.toml`. `whose`: A's
walk on B's body, and whose cadence, steps, sway and arm swing it has. `prior`: fits of noisy
joints and hidden points, person by person, beside stages 1-2 and physics.

Everybody judged is a stranger to the networks' training but where `whose` says so; the part is
validation by default, and test is for the end. KEPT is a folder of measured rows: what this commit
has measured with the same weights is not measured again, so an interrupted run goes on, and one
with more clips adds to it. `--one-code` are weights of one code per clip, as published, made by
`python -m benchmarks.humos_ablations CORPUS --out RUNS --only "one code per clip" --steps 1200`.
"""

import argparse
from pathlib import Path
from typing import Any

import torch
from rich.console import Console

from benchmarks.arguments import over_windows
from benchmarks.bodies import network, prior, whose
from benchmarks.bodies.kept import Kept
from benchmarks.results import ROOT, commit, corpus_source, write
from benchmarks.retarget_clips import SEED, load_jobs
from benchmarks.tables import humos as tables
from priors.humos.prior import Humos
from recon.benchmark.dataset import Splits
from recon.benchmark.windows import load_windows
from recon.body.model import BodyModel
from recon.formats.replacing import file_checksum

STUDIES = ("network", "whose", "prior")
ONE_CODE = "one code per clip"


def main() -> None:
    """Measure, print and write, study by study."""
    given = _arguments()
    torch.set_num_threads(1)
    body, splits = BodyModel.load(), Splits.load(given.splits)
    networks = {"": Humos.load(given.weights, body)}
    if given.one_code is not None:
        networks[ONE_CODE] = Humos.load(str(given.one_code), body)
    identity = {"weights": given.weights, "splits": file_checksum(given.splits)}
    if given.one_code is not None:
        identity["one code"] = file_checksum(given.one_code)
    kept = Kept(given.kept, identity, commit(ROOT))
    measured = {"network": _network, "whose": _whose, "prior": _prior}
    found: dict[str, Any] = {}
    for study in given.studies:
        found[study] = measured[study](given, splits, networks, kept, body)
        for name, table in tables.BY_STUDY[study].items():
            Console(width=200).print(f"{name}\n{table(found[study])}\n", markup=False)
        if given.json is not None:
            write(given.json, SEED, corpus_source(given.corpus), part=given.part,
                  weights=given.weights, **found)  # fmt: skip


def _network(
    given: argparse.Namespace,
    splits: Splits,
    networks: dict[str, Humos],
    kept: Kept,
    body: BodyModel,
) -> dict[str, Any]:
    """Clips of every subject on other bodies, by every method."""
    methods = dict(network.BASELINES)
    for name, one in networks.items():
        methods |= network.of_network(one, name)
    jobs = load_jobs(given.corpus, splits, given.part, "nc" if given.nc else "open", body)
    rows = [
        row
        for job in network.chosen(jobs, given.each)
        for row in kept.rows(
            f"network/{given.part}/{job.name}",
            lambda job=job: network.clip_rows(job, methods, body),
        )
    ]
    return {"each": given.each, "apart": list(splits.apart), "rows": rows}


def _whose(
    given: argparse.Namespace,
    splits: Splits,
    networks: dict[str, Humos],
    kept: Kept,
    body: BodyModel,
) -> dict[str, Any]:
    """Walks of all people outside test (or of everybody) on each other's bodies."""
    parts = ("train", "validation") + (("test", "apart") if given.part == "test" else ())
    people = whose.walkers(given.corpus, splits, parts, body, given.walks)
    made_by = whose.methods(networks)
    learned = {splits.subject(c) for c, p in splits.parts(_names(people)).items() if p == "train"}
    rows = [
        row
        for a, b in whose.pairs(people)
        for row in kept.rows(
            f"whose/{given.part}/{given.walks} walks of {a} as {b}",
            lambda a=a, b=b: whose.pair_rows(people[a], people[b], made_by, body),
        )
    ]
    recorded = {name: [dict(w.statistics) for w in walks] for name, walks in people.items()}
    return {"recorded": recorded, "spreads": whose.spreads(people),
            "learned": sorted(learned), "rows": rows}  # fmt: skip


def _prior(
    given: argparse.Namespace,
    splits: Splits,
    networks: dict[str, Humos],
    kept: Kept,
    body: BodyModel,
) -> dict[str, Any]:
    """Fits of every person's windows."""
    windows = load_windows(given.corpus, splits, given.part, body, prior.SEED)
    rows: list[dict[str, Any]] = []
    for person in sorted(set(windows.subjects)):
        some = prior.of_person(windows, person, given.windows)
        for protocol in prior.ERRORS:
            rows += kept.rows(
                f"prior/{given.part}/{given.windows} windows of {person}, {protocol}",
                lambda some=some, protocol=protocol: prior.window_rows(
                    some, protocol, networks[""], body
                ),
            )
    return {"windows": given.windows, "apart": list(splits.apart), "rows": rows}


def _names(people: dict[str, list[whose.Walk]]) -> list[str]:
    return [walk.clip for walks in people.values() for walk in walks]


def _arguments() -> argparse.Namespace:
    parser = over_windows(__doc__)
    parser.set_defaults(part="validation")
    parser.add_argument("kept", type=Path, help="folder of measured rows")
    parser.add_argument("--studies", nargs="+", choices=STUDIES, default=list(STUDIES))
    parser.add_argument("--weights", default="open", help="of HUMOS: open, nc or a file")
    parser.add_argument("--one-code", type=Path, default=None, help="weights of one code per clip")
    parser.add_argument("--each", type=int, default=4, help="clips of a subject, network")
    parser.add_argument("--walks", type=int, default=6, help="walks of a person, whose")
    parser.add_argument("--windows", type=int, default=6, help="windows of a person, prior")
    parser.add_argument("--nc", action="store_true", help="network: clips of nc licence, too")
    return parser.parse_args()


if __name__ == "__main__":
    main()

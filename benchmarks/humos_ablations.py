"""What each loss of the HUMOS prior is worth, and one code per clip beside many.

    python -m benchmarks.humos_ablations CORPUS --out RUNS [--warm RUN/warm.pt]
        --json benchmarks/results/humos_ablations.json
    python -m benchmarks.humos_ablations CORPUS --out RUNS --only "one code per clip" --steps 1200

Every row is 400 steps from body to body and back, begun with the same auto-encoder (1,500 steps,
or the one given; one code per clip has its own), on clips that weights of the package may learn
from. Judged on the test clips of `benchmarks/identities.toml`, without those that fly, on what the
networks propose alone: physics as in `benchmarks.retarget`, and the joint error of codes on the
clips' own bodies. The second command trains one code per clip as long as the weights of the
package were; a run that was interrupted goes on.
"""

import argparse
from dataclasses import replace
from pathlib import Path

import torch

from benchmarks.results import corpus_source, show, write
from benchmarks.retarget import itself, measured
from benchmarks.retarget_baselines import copied
from benchmarks.retarget_clips import Job, load_jobs
from benchmarks.retarget_shapes import reconstruction
from priors.humos.prior import Humos
from recon.benchmark.dataset import Splits
from recon.body.model import BodyModel
from recon.core.struct import concatenate
from recon.fitting.retargeting import proposed
from recon.physics.metrics import PhysicsSamples, physics_metrics
from training.humos.corpus import BodyCorpus
from training.humos.export import export_learned
from training.humos.run import HumosTraining
from training.humos.train import train_on

STEPS = 400
_ONE_CODE = 320
"""Numbers of a clip's one code, as published."""


def main() -> None:
    """Train what is missing, measure, print and write."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("corpus", type=Path)
    parser.add_argument("--out", type=Path, required=True, help="folder of the runs")
    parser.add_argument("--warm", type=Path, default=None, help="auto-encoder to begin with")
    parser.add_argument("--only", nargs="+", default=None, help="names of rows")
    parser.add_argument("--steps", type=int, default=STEPS, help="from body to body and back")
    parser.add_argument("--json", type=Path, default=None)
    ask = parser.parse_args()
    torch.set_num_threads(1)
    body, splits = BodyModel.load(), Splits.load()
    plain = HumosTraining(corpus=ask.corpus, out=ask.out, steps=ask.steps)
    learned = BodyCorpus.load(ask.corpus, splits, "train", "open", body, plain.speeds)
    checked = BodyCorpus.load(ask.corpus, splits, "validation", "open", body)
    jobs = [j for j in load_jobs(ask.corpus, splits, "test", "nc", body) if not j.flies]
    wanted = _wanted(ask.only, plain)
    warm = ask.warm
    if warm is None and any(one.codes == "windows" for one in wanted.values()):
        warm = _auto_encoder(plain, learned, checked)
    rows: dict[str, dict[str, float]] = {
        "truth": _physics(measured(itself, jobs, body)[0]),
        "copy": _physics(measured(copied, jobs, body)[0]),
    }
    for name, settings in wanted.items():
        begun = warm if settings.codes == "windows" else None
        run = replace(settings, warm=begun, out=ask.out / name.replace(" ", "_"))
        run.out.mkdir(parents=True, exist_ok=True)
        train_on(run, learned, checked)
        path = export_learned(run, run.out / "humos.safetensors", learned)
        rows[name] = judged(Humos.load(str(path), body), jobs)
        show(name, rows[name])
        if ask.json is not None:
            write(ask.json, 0, corpus_source(ask.corpus), clips=len(jobs), rows=rows)


def variants(full: HumosTraining) -> dict[str, HumosTraining]:
    """Runs that differ in one thing each."""
    return {
        "cycle": replace(full, physics=0.0, balance=0.0),
        "cycle + physics": replace(full, balance=0.0),
        "cycle + physics + balance": full,
        "without L_E": replace(full, same_code=0.0),
        "without L_KL": replace(full, kl=0.0),
        "one code per clip": replace(full, codes="clip", latent=_ONE_CODE),
    }


def _wanted(names: list[str] | None, full: HumosTraining) -> dict[str, HumosTraining]:
    """The runs of these names; None is all of them.

    Raises:
        ValueError: when no run has such a name.
    """
    every = variants(full)
    if names is None:
        return every
    if unknown := [name for name in names if name not in every]:
        raise ValueError(f"no row is called {', '.join(unknown)}; they are {', '.join(every)}")
    return {name: every[name] for name in names}


def judged(prior: Humos, jobs: list[Job]) -> dict[str, float]:
    """Physics of what the networks propose, and the error of their codes."""
    samples, more = measured(lambda _, m, s: proposed(m, s, prior), jobs, prior.body)
    error = reconstruction(prior, jobs)["mean cm"]
    return {**_physics(samples), "turned": more["turned"] or 0.0, "codes cm": error}


def _physics(samples: list[PhysicsSamples]) -> dict[str, float]:
    found = physics_metrics(concatenate(samples))
    columns = {
        "penetrate cm": ("penetrate", 100), "float cm": ("float", 100),
        "stable %": ("dynamic_stability", 100), "supported stable %": ("stability_supported", 100),
        "BoS cm": ("bos_distance", 100), "slip m/s": ("slip_in_contact", 1),
    }  # fmt: skip
    return {name: factor * (found[key] or 0.0) for name, (key, factor) in columns.items()}


def _auto_encoder(plain: HumosTraining, learned: BodyCorpus, checked: BodyCorpus) -> Path:
    run = replace(plain, out=plain.out / "auto-encoder", steps=0)
    run.out.mkdir(parents=True, exist_ok=True)
    train_on(run, learned, checked)
    return run.out / "warm.pt"


if __name__ == "__main__":
    main()

"""`python -m training PRIOR CORPUS --out FILE`: learn a prior from a converted corpus."""

from importlib import import_module
from pathlib import Path
from typing import Any, Literal

import tyro
from tyro.conf import Positional

from recon.cli import run_command
from recon.cli.places import Arguments, Overwrite, Place, Quiet, writes
from recon.formats.outputs import Output, OutputKind

_IN_STEPS = {
    "humor": "training.humor.train:HumorTraining",
    "humos": "training.humos.train:HumosTraining",
    "labels": "training.labels.train:LabelTraining",
    "look": "training.look.train:LookTraining",
}
"""Settings of runs that go on where they were cut; beside them are `train`, which takes the steps,
and `export_weights`."""
_AT_ONCE = {
    "pose": "training.pose:PoseTraining",
    "anchor": "training.anchor.train:AnchorTraining",
}
"""Settings of priors whose fit has a closed form; beside them is `export_weights`."""


def _is_former_run(folder: Path) -> bool:
    """Whether a folder has a checkpoint, or the log of a run that ended before its first one."""
    return (folder / "checkpoint.pt").is_file() or (folder / "train.log").is_file()


def _outputs_of_run(out: Path, given: Arguments) -> tuple[Output, ...]:
    """Outputs: the weights, and the log or the folder of the run, which can be resumed."""
    if given["prior"] in _AT_ONCE:
        return Output(out), Output(out.with_suffix(".log"))
    run = Output(out.with_suffix(""), OutputKind.CONTINUED, is_former=_is_former_run)
    return Output(out), run


@writes(Place("out", _outputs_of_run))
def train(
    prior: Positional[Literal["pose", "humor", "anchor", "humos", "labels", "look"]],
    corpus: Positional[Path],
    out: Path,
    steps: int | None = None,
    latent: int | None = None,
    device: Literal["cpu", "cuda"] = "cpu",
    seed: int = 0,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
) -> None:
    """Learn the weights of a prior.

    `pose` is a density of single poses, and `anchor` principal components of gait cycles: both
    take less than a minute and have no steps. `humor` is the transition network: hours on two
    cores. `humos` is the decoder that sees the body: an hour on one core. `labels` says which part
    of a body a point of a cloud shows: an hour on one core, and the clouds that it draws first a
    quarter of one. `look` proposes whole motions for what is seen of a clip: a day on two cores,
    ten minutes on a GPU. A run in steps that was cut goes on from its checkpoint.

    Args:
        prior: which one.
        corpus: folder that `recon convert --all` wrote.
        out: weights to write (.safetensors); logs and checkpoints are kept beside them.
        steps: of the optimiser; for `humos` of its second part, from body to body. Default:
            20,000 for `humor`; 1,200 for `humos`, after 1,500 of its auto-encoder; 12,000 for
            `labels`; 20,000 for `look`.
        latent: size of the code of `anchor` (default: 512) and of `humos` (default: 96 for every
            0.4 s).
        device: where to compute.
        seed: of everything random.
        overwrite: replace files that are there and recon did not write.
        quiet: say nothing but errors and, last, where the result is.
    """
    del quiet  # used by the decorator `writes`
    from recon.cli import console

    asked: dict[str, Any] = {"steps": steps, "latent": latent}
    asked = {name: value for name, value in asked.items() if value is not None}
    if latent is not None and prior not in ("anchor", "humos"):
        raise ValueError(f"{prior} has no choice of latent size: leave --latent out")
    if steps is not None and prior in _AT_ONCE:
        raise ValueError(f"{prior} is learned without steps: leave --steps out")
    if prior not in ("humor", "look") and device != "cpu":
        raise ValueError(f"{prior} is trained on the CPU only: give --device cpu")

    from recon.formats.reports import versions
    from recon.formats.writing import writing, writing_file
    from training.run import LOG, logged_to

    report = {"prior": prior, "corpus": str(corpus), "seed": seed, **asked}
    report["versions"] = versions()
    module, _, name = {**_IN_STEPS, **_AT_ONCE}[prior].partition(":")
    kind = import_module(module)
    if prior != "pose":
        asked["seed"] = seed
    if prior in _AT_ONCE:
        settings = getattr(kind, name)(corpus=corpus, out=out, **asked)
        outputs = _outputs_of_run(out, {"prior": prior})
        with (
            writing(*outputs, report=report, overwrite=overwrite) as (made, log),
            logged_to(log, "w"),
        ):
            LOG.info("settings: %s", settings)
            kind.export_weights(settings, made)
            LOG.info("wrote %s", out)
    else:
        if prior in ("humor", "look"):
            asked["device"] = device
        settings = getattr(kind, name)(corpus, out.with_suffix(""), **asked)
        kind.train(settings)
        with writing_file(out, report, overwrite=overwrite) as made:
            kind.export_weights(settings, made)
    console.print_last_line(str(out))


if __name__ == "__main__":
    raise SystemExit(run_command(lambda: tyro.cli(train, prog="python -m training")))

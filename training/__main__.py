"""`python -m training PRIOR CORPUS --out FILE`: learn a prior from a converted corpus."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, Literal

import tyro
from tyro.conf import Positional

from recon.cli import run_command
from recon.cli.places import Arguments, Overwrite, Place, Quiet, writes
from recon.formats.outputs import Kind, Output


def _is_former(folder: Path) -> bool:
    """Whether a folder has a checkpoint, or the log of a run that was cut before its first."""
    return (folder / "checkpoint.pt").is_file() or (folder / "train.log").is_file()


def _weights(out: Path, given: Arguments) -> tuple[Output, ...]:
    """The weights, and the log or the folder of the run, which goes on where it was cut."""
    if given["prior"] == "pose":
        return Output(out), Output(out.with_suffix(".log"))
    run = Output(out.with_suffix(""), Kind.CONTINUED, is_former=_is_former)
    return Output(out), run


@writes(Place("out", _weights))
def train(
    prior: Positional[Literal["pose", "humor", "anchor", "humos", "labels"]],
    corpus: Positional[Path],
    out: Path,
    data: Literal["open", "nc"] = "open",
    steps: int | None = None,
    latent: int | None = None,
    device: Literal["cpu", "cuda"] = "cpu",
    seed: int = 0,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
) -> None:
    """Learn the weights of a prior.

    `pose` is a density of single poses, takes seconds and has no steps. `humor` is the transition
    network: hours on two cores. `anchor` is the anchor-frame VAE of gait cycles: minutes on two
    cores. `humos` is the decoder that sees the body: an hour on one core. `labels` tells which
    part of a body a point of a cloud shows: an hour on one core, and the clouds that it draws
    first a quarter of one. A run that was cut goes on from its checkpoint.

    Args:
        prior: which one.
        corpus: folder that `recon convert --all` wrote.
        out: weights to write (.safetensors); logs and checkpoints are kept beside them.
        data: `open` learns from clips whose weights may be shipped, `nc` also from those under a
            non-commercial licence.
        steps: of the optimiser; for `anchor` of its first phase, on parameters; for `humos` of
            its second part, from body to body. Default: 20,000 for `humor`; 1,000 for `anchor`,
            followed by 2,500 on the surface; 1,200 for `humos`, after 1,500 of its auto-encoder;
            12,000 for `labels`.
        latent: size of the code of `anchor` (default: 256) and of `humos` (default: 96 for every
            0.4 s).
        device: where to compute.
        seed: of everything random.
        overwrite: replace files that are there and recon did not write.
        quiet: say nothing but errors and, last, where the result is.
    """
    del quiet  # heeded by `writes`
    from recon.cli import console

    asked = {"steps": steps, "latent": latent}
    asked = {name: value for name, value in asked.items() if value is not None}
    if prior in ("anchor", "humos", "labels") and device != "cpu":
        raise ValueError(f"{prior} is trained on the processor: give --device cpu")

    from recon.formats.reports import versions
    from recon.formats.writing import writing, writing_file

    report = {"prior": prior, "corpus": str(corpus), "data": data, "seed": seed, **asked}
    report["versions"] = versions()
    if prior == "pose":
        from training.pose import PoseTraining
        from training.pose import train as train_pose

        outputs = _weights(out, {"prior": prior})
        with writing(*outputs, report=report, overwrite=overwrite) as (made, log):
            train_pose(PoseTraining(corpus=corpus, out=made, log=log, data=data))
        console.last(str(out))
        return
    ask = {"corpus": corpus, "out": out.with_suffix(""), "data": data, "seed": seed, **asked}
    kinds = {"anchor": _anchor, "humos": _humos, "humor": _humor, "labels": _labels}
    export = kinds[prior](ask, device)
    with writing_file(out, report, overwrite=overwrite) as made:
        export(made)
    console.last(str(out))


Export = Callable[[Path], object]
"""Writes the weights of a run that is done."""


def _anchor(ask: dict[str, Any], _: str) -> Export:
    from training.anchor.run import AnchorTraining, export_weights
    from training.anchor.train import train as train_anchor

    run = AnchorTraining(**ask)
    train_anchor(run)
    return partial(export_weights, run)


def _humos(ask: dict[str, Any], _: str) -> Export:
    from training.humos.export import export_weights
    from training.humos.run import HumosTraining
    from training.humos.train import train as train_humos

    run = HumosTraining(**ask)
    train_humos(run)
    return partial(export_weights, run)


def _labels(ask: dict[str, Any], _: str) -> Export:
    from training.labels.shards import make_training_clouds
    from training.labels.train import LabelTraining, export_weights
    from training.labels.train import train as train_labels

    corpus, data, out = ask.pop("corpus"), ask.pop("data"), ask["out"]
    learned, checked = make_training_clouds(corpus, out / "clouds", data, ask["seed"])
    run = LabelTraining(corpus=learned, checked=checked, **ask)
    train_labels(run)
    return partial(export_weights, run)


def _humor(ask: dict[str, Any], device: str) -> Export:
    from training.humor.run import HumorTraining, export_weights
    from training.humor.train import train as train_humor

    run = HumorTraining(**{name: ask[name] for name in ask if name != "latent"}, device=device)
    train_humor(run)
    return partial(export_weights, run)


if __name__ == "__main__":
    raise SystemExit(run_command(lambda: tyro.cli(train, prog="python -m training")))

"""`recon train`: learn a prior from a converted corpus."""

from dataclasses import replace
from pathlib import Path
from typing import Literal

from tyro.conf import Positional


def train(
    prior: Positional[Literal["pose", "humor", "anchor", "humos"]],
    corpus: Positional[Path],
    out: Path,
    data: Literal["open", "nc"] = "open",
    steps: int | None = None,
    latent: int | None = None,
    device: Literal["cpu", "cuda"] = "cpu",
    seed: int = 0,
) -> None:
    """Learn the weights of a prior.

    `pose` is a density of single poses, takes seconds and has no steps. `humor` is the transition
    network: hours on two cores. `anchor` is the anchor-frame VAE of gait cycles: minutes on two
    cores. `humos` is the decoder that sees the body: an hour on one core. A run that was cut goes
    on from its checkpoint.

    Args:
        prior: which one.
        corpus: folder that `recon convert --all` wrote.
        out: weights to write (.safetensors); logs and checkpoints are kept beside them.
        data: `open` learns from clips whose weights may be shipped, `nc` also from those under a
            non-commercial licence.
        steps: of the optimiser; for `anchor` of its first phase, on parameters; for `humos` of
            its second part, from body to body. Default: 20,000 for `humor`; 1,000 for `anchor`,
            followed by 2,500 on the surface; 1,200 for `humos`, after 1,500 of its auto-encoder.
        latent: size of the code of `anchor` (default: 256) and of `humos` (default: 96 for every
            0.4 s).
        device: where to compute.
        seed: of everything random.
    """
    from recon.cli import console

    asked = {"steps": steps, "latent": latent}
    asked = {name: value for name, value in asked.items() if value is not None}
    if prior == "pose":
        from priors.training.pose import PoseTraining
        from priors.training.pose import train as train_pose

        train_pose(PoseTraining(corpus=corpus, out=out, data=data))
    elif prior == "anchor":
        from priors.training.anchor import train as train_anchor
        from priors.training.anchor_export import export_weights as export_anchor
        from priors.training.anchor_run import AnchorTraining

        _processor_only(prior, device)
        run = AnchorTraining(corpus=corpus, out=out.with_suffix(""), data=data, seed=seed)
        run = replace(run, **asked)
        train_anchor(run)
        export_anchor(run, out)
    elif prior == "humos":
        from priors.training.humos import train as train_humos
        from priors.training.humos_export import export_weights as export_humos
        from priors.training.humos_run import HumosTraining

        _processor_only(prior, device)
        run = HumosTraining(corpus=corpus, out=out.with_suffix(""), data=data, seed=seed)
        run = replace(run, **asked)
        train_humos(run)
        export_humos(run, out)
    else:
        from priors.training.humor import train as train_humor
        from priors.training.humor_run import HumorTraining, export_weights

        folder = out.with_suffix("")
        ask = {"data": data, "steps": steps or 20_000, "device": device, "seed": seed}
        run = HumorTraining(corpus=corpus, out=folder, **ask)
        train_humor(run)
        export_weights(run, out)
    console.say(str(out))


def _processor_only(prior: str, device: str) -> None:
    if device != "cpu":
        raise ValueError(f"{prior} is trained on the processor: give --device cpu")

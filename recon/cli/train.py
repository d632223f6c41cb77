"""`recon train`: learn a prior from a converted corpus."""

from dataclasses import replace
from pathlib import Path
from typing import Literal

from tyro.conf import Positional


def train(
    prior: Positional[Literal["pose", "humor", "anchor"]],
    corpus: Positional[Path],
    out: Path,
    data: Literal["open", "nc"] = "open",
    steps: int | None = None,
    latent: int = 256,
    device: Literal["cpu", "cuda"] = "cpu",
    seed: int = 0,
) -> None:
    """Learn the weights of a prior.

    `pose` is a density of single poses, takes seconds and has no steps. `humor` is the transition
    network: hours on two cores. `anchor` is the anchor-frame VAE of gait cycles: minutes on two
    cores. A run that was cut goes on from its checkpoint.

    Args:
        prior: which one.
        corpus: folder that `recon convert --all` wrote.
        out: weights to write (.safetensors); logs and checkpoints are kept beside them.
        data: `open` learns from clips whose weights may be shipped, `nc` also from those under a
            non-commercial licence.
        steps: of the optimiser; for `anchor` of its first phase, on parameters. Default: 20,000
            for `humor`, 1,000 for `anchor`, followed by 2,500 on the surface.
        latent: size of the code of `anchor`.
        device: where to compute.
        seed: of everything random.
    """
    from recon.cli import console

    if prior == "pose":
        from priors.training.pose import PoseTraining
        from priors.training.pose import train as train_pose

        train_pose(PoseTraining(corpus=corpus, out=out, data=data))
    elif prior == "anchor":
        from priors.training.anchor import train as train_anchor
        from priors.training.anchor_export import export_weights as export_anchor
        from priors.training.anchor_run import AnchorTraining

        if device != "cpu":
            raise ValueError("the anchor prior is trained on the processor: give --device cpu")
        asked = AnchorTraining(
            corpus=corpus, out=out.with_suffix(""), data=data, latent=latent, seed=seed
        )
        cycles = asked if steps is None else replace(asked, steps=steps)
        train_anchor(cycles)
        export_anchor(cycles, out)
    else:
        from priors.training.humor import train as train_humor
        from priors.training.humor_run import HumorTraining, export_weights

        folder = out.with_suffix("")
        ask = {"data": data, "steps": steps or 20_000, "device": device, "seed": seed}
        run = HumorTraining(corpus=corpus, out=folder, **ask)
        train_humor(run)
        export_weights(run, out)
    console.say(str(out))

"""`recon train`: learn a prior from a converted corpus."""

from pathlib import Path
from typing import Literal

from tyro.conf import Positional


def train(
    prior: Positional[Literal["pose", "humor"]],
    corpus: Positional[Path],
    out: Path,
    data: Literal["open", "nc"] = "open",
    steps: int = 20_000,
    device: Literal["cpu", "cuda"] = "cpu",
    seed: int = 0,
) -> None:
    """Learn the weights of a prior.

    `pose` is a density of single poses, takes seconds and has no steps. `humor` is the transition
    network: hours on two cores; a run that was cut goes on from its checkpoint.

    Args:
        prior: which one.
        corpus: folder that `recon convert --all` wrote.
        out: weights to write (.safetensors); logs and checkpoints are kept beside them.
        data: `open` learns from clips whose weights may be shipped, `nc` also from those under a
            non-commercial licence.
        steps: of the optimiser.
        device: where to compute.
        seed: of everything random.
    """
    from recon.cli import console

    if prior == "pose":
        from priors.training.pose import PoseTraining
        from priors.training.pose import train as train_pose

        train_pose(PoseTraining(corpus=corpus, out=out, data=data))
    else:
        from priors.training.humor import train as train_humor
        from priors.training.humor_run import HumorTraining, export_weights

        folder = out.with_suffix("")
        ask = {"data": data, "steps": steps, "device": device, "seed": seed}
        run = HumorTraining(corpus=corpus, out=folder, **ask)
        train_humor(run)
        export_weights(run, out)
    console.say(str(out))

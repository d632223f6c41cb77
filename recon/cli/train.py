"""`recon train`: learn a prior from a converted corpus."""

from pathlib import Path
from typing import Literal

from tyro.conf import Positional


def train(
    prior: Positional[Literal["pose"]],
    corpus: Positional[Path],
    out: Path,
    data: Literal["open", "nc"] = "open",
) -> None:
    """Learn the weights of a prior.

    `pose` is a density of single poses and takes seconds.

    Args:
        prior: which one.
        corpus: folder that `recon convert --all` wrote.
        out: weights to write (.safetensors); a log is written beside them.
        data: `open` learns from clips whose weights may be shipped, `nc` also from those under a
            non-commercial licence.
    """
    from recon.cli import console

    if prior == "pose":
        from priors.training.pose import PoseTraining
        from priors.training.pose import train as train_pose

        written = train_pose(PoseTraining(corpus=corpus, out=out, data=data))
        console.say(f"{written} and its log, {written.with_suffix('.log')}")

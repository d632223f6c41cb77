"""Trains priors that never saw a fold's people, by a short schedule, and keeps them."""

from dataclasses import dataclass
from pathlib import Path

from benchmarks.strangers.folds import Fold, write_splits
from priors.humor.prior import Humor
from priors.pose.prior import PoseDensity, PosePrior
from recon.formats.replacing import file_checksum
from training.humor.train import HumorTraining, export_weights, train
from training.humor.variation import VARIED
from training.pose import PoseTraining
from training.pose import export_weights as export_poses
from training.run import CHECKPOINT, read_state
from training.settings import identity_of_run, refuse_other_run

SAVED_EVERY = 60.0
"""Time (s) between saved checkpoints."""


@dataclass(frozen=True)
class Schedule:
    """Length of the training of a fold's HuMoR; the pose density has a closed form."""

    steps: int = 1500
    """Number of steps of the optimiser."""
    windows: int = 200
    """Number of windows per step."""
    width: int = 512
    """Number of units of the hidden layers."""


@dataclass(frozen=True)
class FoldPriors:
    """Priors of a fold: HuMoR and the pose density."""

    humor: Humor
    density: PoseDensity
    checksums: dict[str, str]
    """Checksums of their weights, by the name of the prior."""


def humor_settings(corpus: Path, folder: Path, schedule: Schedule) -> HumorTraining:
    """Return the settings of the training of a fold's HuMoR.

    It validates once, after its last step, so that nothing is chosen on the held-out people.
    """
    return HumorTraining(
        corpus=corpus,
        out=folder / "humor",
        splits=folder / "splits.toml",
        steps=schedule.steps,
        windows=schedule.windows,
        width=schedule.width,
        variation=VARIED,
        validate_every=schedule.steps,
        save_every=SAVED_EVERY,
    )


def trained(fold: Fold, corpus: Path, folder: Path, schedule: Schedule) -> FoldPriors:
    """Return a fold's priors: read them if trained already, else train or continue.

    Args:
        fold: the held-out people.
        corpus: folder of all converted motions.
        folder: folder of all folds; this one's files lie in a folder of its name.
        schedule: length of HuMoR's training.

    Raises:
        ValueError: when the folder holds a run that learned from other clips or otherwise.
    """
    own = folder / fold.name
    own.mkdir(parents=True, exist_ok=True)
    write_splits(fold.splits, own / "splits.toml")
    settings = humor_settings(corpus, own, schedule)
    weights = own / "humor.safetensors"
    if not finished(settings):
        weights.unlink(missing_ok=True)
        train(settings)
    if not weights.is_file():
        export_weights(settings, weights)

    poses = own / "pose.safetensors"
    export_poses(PoseTraining(corpus, out=poses, splits=settings.splits), poses)
    return FoldPriors(
        humor=Humor.load(weights),
        density=PosePrior.load(poses).density,
        checksums={path.stem: file_checksum(path) for path in (weights, poses)},
    )


def finished(settings: HumorTraining) -> bool:
    """Return whether the folder holds this run, with all of its steps.

    Raises:
        ValueError: when it holds another run.
    """
    state = read_state(settings.out / CHECKPOINT)
    if state is None:
        return False
    refuse_other_run(settings.out / CHECKPOINT, identity_of_run(settings), state.get("identity"))
    return state["step"] >= settings.steps

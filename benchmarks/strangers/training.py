"""Priors that never saw a fold's people: trained by a short schedule, kept, and gone on with."""

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
"""Seconds."""


@dataclass(frozen=True)
class Schedule:
    """How long a fold's HuMoR learns; the pose density has a closed form."""

    steps: int = 1500
    """Steps of the optimiser."""
    windows: int = 200
    """Windows per step."""
    width: int = 512
    """Units of the hidden layers."""


@dataclass(frozen=True)
class FoldPriors:
    """Priors of a fold: poses and steps."""

    humor: Humor
    density: PoseDensity
    checksums: dict[str, str]
    """Checksums of their weights, by the name of the prior."""


def humor_settings(corpus: Path, folder: Path, schedule: Schedule) -> HumorTraining:
    """The training of a fold's HuMoR.

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
    """A fold's priors: read where they are trained already, else trained, or gone on with.

    Args:
        fold: who is held out.
        corpus: folder of all converted motions.
        folder: of all folds; this one's files lie in a folder of its name.
        schedule: of HuMoR.

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
    """Whether the folder holds this run, with all of its steps.

    Raises:
        ValueError: when it holds another run.
    """
    state = read_state(settings.out / CHECKPOINT)
    if state is None:
        return False
    refuse_other_run(settings.out / CHECKPOINT, identity_of_run(settings), state.get("identity"))
    return state["step"] >= settings.steps

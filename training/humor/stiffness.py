"""Learning the mean curvature of a step (`priors.humor.steps`) from the corpus.

    python -m training.humor.stiffness CORPUS --out humor_steps.safetensors

Steps are drawn from all clips alike; the same corpus gives the same file. The file says which
networks and which pose density it was made of: with those of others it is as correct and slower.
"""

import logging
from pathlib import Path

import torch
import tyro
from jaxtyping import Float
from torch import Tensor

from priors.checkpoints import weights_path
from priors.humor.collocation import Collocation
from priors.humor.prior import Humor
from priors.humor.state import states_of
from priors.humor.steps import SPAN, Steps, posterior_outputs
from priors.pose.prior import PoseVariables
from recon.benchmark.dataset import SPLITS
from recon.core import rotations as so3
from recon.core.motion import Motion
from recon.core.struct import stack
from recon.formats.replacing import file_checksum
from recon.method.quadratic import FRAME
from training.run import LOG
from training.settings import CorpusSettings
from training.weights import save_checkpoint

_STEP = 1e-5
"""Metres, radians and standard deviations over which derivatives are differences."""


def main(
    corpus: tyro.conf.Positional[Path],
    splits: Path = SPLITS,
    steps: int = 128,
    seed: int = 0,
    out: Path = Path("humor_steps.safetensors"),
) -> None:
    """Learn the mean curvature of HuMoR's energies of steps, and write it.

    Args:
        corpus: folder of all converted motions.
        splits: table of the subjects that are held out.
        steps: drawn from the training clips.
        seed: of the draws.
        out: file to write.
    """
    known = CorpusSettings(corpus, out, splits=splits).load_clips("train", lesson="steps")
    clips = [clip.motion for clip in known if clip.motion.frames >= SPAN]
    drawn = drawn_windows(clips, steps, seed)
    roots = {
        name: half_precision_root(matrix)
        for name, matrix in step_curvatures(Humor.load(), drawn).items()
    }
    made_of = {kind: file_checksum(weights_path("open", kind)) for kind in ("humor", "pose")}
    about = {"data": "open", "steps": steps, "seed": seed, "made_of": made_of}
    save_checkpoint(out, "humor_steps", roots, about)
    LOG.info("wrote %s, from %d clips", out, len(clips))


def drawn_windows(clips: list[Motion], count: int, seed: int) -> Motion:
    """Cut short windows at random times out of random clips; axes (count, frames)."""
    random = torch.Generator().manual_seed(seed)

    def random_index(stop: int) -> int:
        return int(torch.randint(stop, (1,), generator=random))

    found: list[Motion] = []
    for _ in range(count):
        clip = clips[random_index(len(clips))]
        first = random_index(clip.frames - SPAN + 1)
        found.append(clip.window(first, first + SPAN).replace(start_time=0.0))
    return stack(found)


def step_curvatures(humor: Humor, motion: Motion) -> dict[str, Float[Tensor, "numbers numbers"]]:
    """Mean of JᵀJ for the middle steps of windows, in the heading of the frame before each."""
    exact = humor.to(dtype=torch.float64)
    motion = motion.to(dtype=torch.float64)
    prior = Collocation(exact)
    with torch.no_grad():
        base = prior.encode(motion)
        here = _residuals_of_middle_step(prior, base)
        columns = [
            tuple(
                (moved - at) / _STEP
                for moved, at in zip(_residuals_of_middle_step(prior, v), here, strict=True)
            )
            for v in _perturbed_variables(prior, base)
        ]
    error, latents = (torch.stack(part, 1) for part in zip(*columns, strict=True))
    turn = so3.undo_heading(motion.rotations[:, 1, 0])
    return {
        name: _mean_jtj(_jacobian_in_heading(jacobian, turn))
        for name, jacobian in (("error", error), ("latents", latents))
    }


def half_precision_root(matrix: Float[Tensor, "n n"]) -> Float[Tensor, "n n"]:
    """Return F in half precision with F Fᵀ equal to a given positive semidefinite matrix."""
    values, vectors = torch.linalg.eigh(matrix)
    return (vectors * values.clamp(min=0).sqrt()).half()


def _perturbed_variables(prior: Collocation, base: PoseVariables) -> list[PoseVariables]:
    """Variables with one number changed: copies for each number of all frames and of the shape."""
    found: list[PoseVariables] = []
    for k in range(SPAN * FRAME):
        steps = base.pose.new_zeros(len(base.pose), SPAN, FRAME)
        steps[:, k // FRAME, k % FRAME] = _STEP
        found.append(prior.from_steps(base, steps))
    for k in range(base.shape.shape[-1]):
        shape = base.shape.clone()
        shape[:, k] += _STEP
        found.append(base.derived(shape=shape))
    return found


def _residuals_of_middle_step(
    prior: Collocation, variables: PoseVariables
) -> tuple[Tensor, Tensor]:
    """Residuals of the middle step: whitened decoder errors, and latents against the prior."""
    motion = prior.poses.decode(variables).motion
    states = states_of(motion, prior.humor.body)
    middle = states.map(lambda t: t[:, 1:3])
    networks, pelvis = prior.humor.networks, prior.humor.pelvis(motion.shape)
    error = posterior_outputs(networks, middle, pelvis).error[:, 0] @ prior.humor.error_whitening
    steps = Steps.of(middle, pelvis)
    mean, log_variance = networks.posterior(steps.start, steps.end)
    prior_mean, prior_log_variance = networks.prior(steps.start)
    # KL is ½ (e^r - 1 - r + |away|²) with r the difference of the log-variances
    away = (mean - prior_mean) * (-0.5 * prior_log_variance).exp()
    ratio = 2 * (0.5 * (log_variance - prior_log_variance)).exp()
    return error, torch.cat((away, ratio), -1)[:, 0]


def _jacobian_in_heading(
    jacobian: Float[Tensor, "windows numbers rows"], turn: Float[Tensor, "windows 3 3"]
) -> Float[Tensor, "windows numbers rows"]:
    turned = jacobian.clone()
    for frame in range(SPAN):
        place = slice(frame * FRAME, frame * FRAME + 3)
        turned[:, place] = turn @ jacobian[:, place]
    return turned


def _mean_jtj(jacobian: Float[Tensor, "windows numbers rows"]) -> Tensor:
    flat = jacobian.transpose(0, 1).flatten(1)
    return flat @ flat.mT / len(jacobian)


if __name__ == "__main__":
    logging.basicConfig(level=logging.INFO)
    tyro.cli(main)

"""A result file against a truth file: what `recon evaluate` does."""

import json
from pathlib import Path

import torch

from observations.files import load
from recon.body import BodyModel
from recon.evaluation import ObservedPoints, evaluate, nearest_labels
from recon.formats.amass import MotionFile, load_motion
from recon.formats.files import replacing
from recon.formats.observation import PositionsFile, load_observation
from recon.motion import Motion
from recon.protocols import Estimate


def evaluate_files(
    result: Path, truth: Path, observation: Path | None, out: Path | None
) -> dict[str, float | None]:
    """All metrics of `result`, written to `out` if given.

    Raises:
        FileNotFoundError: when a file does not exist.
        ValueError: when a file is damaged, the bodies differ, or the truth does not cover the
            result's times.
    """
    ours, theirs = load_motion(result, torch.float64), load_motion(truth, torch.float64)
    body = BodyModel.load().to(dtype=torch.float64)
    for path, file in ((result, ours), (truth, theirs)):
        if file.checksum not in (None, body.checksum):
            raise ValueError(
                f"{path}: made with the body {file.body} ({file.checksum}), but this version's "
                f"is {body.name} ({body.checksum}); shapes of different bodies do not compare"
            )
    metrics = evaluate(
        ours.motion,
        theirs.motion,
        body,
        contacts=ours.contacts,
        truth_contacts=_there(theirs, "contacts", ours.motion),
        truth_visible=_visible(observation, theirs, ours.motion),
        observed=None if observation is None else _observed(ours, theirs, observation, body),
    )
    if out is not None:
        with replacing(out) as beside:
            beside.write_text(json.dumps(metrics, indent=1))
    return metrics


def _there(file: MotionFile, name: str, motion: Motion) -> torch.Tensor | None:
    labels = getattr(file, name)
    return None if labels is None else nearest_labels(labels, file.motion.times, motion.times)


def _visible(observation: Path | None, truth: MotionFile, motion: Motion) -> torch.Tensor | None:
    """Joints the sensor could see, from the simulated observation or the truth file."""
    if observation is not None:
        file = load_observation(observation)
        if file.truth_visible is not None:
            seen = torch.from_numpy(file.truth_visible)
            times = file.start_time + torch.arange(len(seen), dtype=torch.float64) / file.fps
            return nearest_labels(seen, times, motion.times)
    return _there(truth, "truth_visible", motion)


def _observed(
    ours: MotionFile, theirs: MotionFile, observation: Path, body: BodyModel
) -> ObservedPoints | None:
    """The observation's own points on the result and on the truth, at the result's frames."""
    if not isinstance(file := load_observation(observation), PositionsFile):
        return None
    adapter = load(observation, body.to(dtype=torch.float32))
    truth = theirs.motion.at(ours.motion.times, ours.motion.fps)
    predicted, actual = (
        adapter.predict(Estimate.of_clip(motion, body))[0] for motion in (ours.motion, truth)
    )
    seen = torch.from_numpy(file.visible)
    times = file.start_time + torch.arange(len(seen), dtype=torch.float64) / file.fps
    return ObservedPoints(predicted, actual, nearest_labels(seen, times, ours.motion.times))

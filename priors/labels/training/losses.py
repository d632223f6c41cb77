"""Losses and errors of labels whose truth is known."""

from collections.abc import Mapping

import torch
from torch import Tensor
from torch.nn.functional import binary_cross_entropy_with_logits, cross_entropy

from priors.labels.networks import STEPS, LabelNetwork, RawLabels
from priors.labels.standard import standard
from priors.labels.training.clouds import LabelledClouds

_PLACES, _ON_BODY = 0.3, 0.5
"""Weights of the losses of places and of on or off the body, beside that of regions."""


def said_of(network: LabelNetwork, clouds: LabelledClouds) -> RawLabels:
    """What a network says of windows, all moments in one row."""
    windows, moments = clouds.points.shape[:2]
    seen = standard(
        clouds.points.flatten(0, 1),
        clouds.present.flatten(0, 1),
        clouds.eyes.repeat_interleave(moments, 0),
        clouds.has_eye.repeat_interleave(moments),
        clouds.level.repeat_interleave(moments),
    )
    asked = torch.arange(moments)[:, None] + torch.arange(STEPS) - STEPS // 2
    inside = (asked >= 0) & (asked < moments)
    index = asked.clamp(0, moments - 1)
    neighbours = (moments * torch.arange(windows)[:, None, None] + index).flatten(0, 1)
    known = inside.repeat(windows, 1) & seen.present.any(-1)[neighbours]
    known[:, STEPS // 2] = True
    return network(seen, neighbours, known)


def losses(raw: RawLabels, clouds: LabelledClouds) -> dict[str, Tensor]:
    """Cross entropies, and the negative log-density of places; `total` is their weighted sum.

    Errors of the coordinates of a place are Laplace-distributed with standard deviation s:
    -log p = |e| √2 / s + log(√2 s).
    """
    region, present = clouds.regions.flatten(0, 1), clouds.present.flatten(0, 1)
    on_body = region >= 0
    found = cross_entropy(raw.regions[on_body], region[on_body], label_smoothing=0.01)
    stray = binary_cross_entropy_with_logits(raw.on_body[present], on_body[present].float())
    error = (raw.places - clouds.places.flatten(0, 1)).abs()[on_body]
    log_std = raw.log_std[on_body][:, None]
    place = (error * 2**0.5 * (-log_std).exp() + log_std).mean()
    total = found + _ON_BODY * stray + _PLACES * place
    return {"total": total, "regions": found, "on_body": stray, "places": place}


def errors(raw: RawLabels, clouds: LabelledClouds) -> Mapping[str, float]:
    """Share of points of wrong regions, mean and median errors of places (cm), strays not told."""
    region, present = clouds.regions.flatten(0, 1), clouds.present.flatten(0, 1)
    on_body = region >= 0
    right = raw.regions[on_body].argmax(-1) == region[on_body]
    away = (raw.places - clouds.places.flatten(0, 1)).norm(dim=-1)[on_body]
    told = (raw.on_body > 0)[present] == on_body[present]
    return {
        "wrong": 1 - float(right.float().mean()),
        "place_cm": 100 * float(away.mean()),
        "place_median_cm": 100 * float(away.median()),
        "stray_wrong": 1 - float(told.float().mean()),
    }

"""Decides over the whole film which side of the body is left, and how sure every keypoint is.

The networks see single images, in which left and right are easily mistaken, for whole stretches.
"""

from itertools import groupby

import numpy as np
from jaxtyping import Float

from recon.detections.records import Row
from recon.films.blazepose import MIRRORED
from recon.films.tracking import Sight


def rows_of_sights(sights: list[Sight]) -> list[Row]:
    """A row for every person and frame, by frame."""
    rows: list[Row] = []
    ordered = sorted(sights, key=lambda one: one.track)
    for _, track in groupby(ordered, key=lambda one: one.track):
        rows += _rows_of_track(list(track))
    return sorted(rows, key=lambda row: row[0])


def _rows_of_track(sights: list[Sight]) -> list[Row]:
    one, other = (
        np.stack([getattr(sight, name).pixels for sight in sights])
        for name in ("pose", "mirrored")
    )
    turned = other[:, MIRRORED]
    apart, crossed = (np.linalg.norm(one - way, axis=-1).mean(1) for way in (other, turned))
    other = np.where((crossed < apart)[:, None, None], turned, other)
    points = np.concatenate(((one + other) / 2, _confidence(sights)[..., None]), -1)
    return [(sight.frame, row, -1) for sight, row in zip(sights, points, strict=True)]


def _confidence(sights: list[Sight]) -> Float[np.ndarray, "frames 33"]:
    """How sure every keypoint is, from 0 to 1."""
    sure = [
        [one.visibility * one.presence * one.inside for one in (sight.pose, sight.mirrored)]
        for sight in sights
    ]
    return np.min(sure, axis=1)

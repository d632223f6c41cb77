"""Decides over the whole film which side of the body is left, and how sure every keypoint is.

The network sees single images, and mistakes left for right, often in many frames on end. Every
frame has four hypotheses: the landmarks found in the image, those found in its mirror image, and
both with left and right exchanged. Limbs do not jump to the other side of the body from one frame
to the next, so that the sequence in which they move least tells which names belong together;
which of the two sides is left is then decided by the majority of all frames.
"""

import numpy as np
import torch
from jaxtyping import Float, Int

from recon.detections.records import Row
from recon.films.blazepose import MIRRORED
from recon.films.tracking import Sight
from recon.solver.viterbi import cheapest_path

_SPREADS = (0.01, 0.05)
"""Bounds of the median distance that landmarks move from frame to frame, in sizes of the
body."""
_FARTHEST = 3.0
"""Movement, over this median, beyond which a landmark's cost no longer grows."""
_INDEPENDENT = 0.25
"""Share of the landmarks that err independently of each other."""
_EXCHANGE_COST = 0.05
"""Cost of exchanging left and right in one frame (log odds): small, as errors last for long."""
_BODY_SIZE = 0.5
"""Size of the body, as a share of the side of its region."""
_AGREEMENT = 0.1
"""Distance of two estimates of a landmark, in sizes of the body, up to which they are averaged."""
_USUAL, _HIDDEN, _PER_DISTANCE = 0.02, 0.06, 0.3
"""Error of a landmark that is surely seen, additional error of a hidden one (sizes of the body),
and error per distance from other estimates of the same landmark; all from the distances to
OpenPose's keypoints in three films of one person (Pose2Sim, 100 frames each)."""
_LEAST_SEEN = 0.05
"""Visibility times presence above which a landmark counts as seen."""


def rows_of_sights(sights: list[Sight]) -> list[Row]:
    """Return one person's keypoints and confidences, one row for each frame with a detection.

    Args:
        sights: detections of the person, by frame.
    """
    seen = np.stack([(sight.pose.pixels, sight.mirrored.pixels) for sight in sights])
    size = _BODY_SIZE * np.array([sight.pose.region.side for sight in sights])
    frames = np.array([sight.frame for sight in sights])
    chosen, other = _with_sides_named(seen, size, frames)
    apart = np.linalg.norm(chosen - other, axis=-1) / size[:, None]
    pixels = np.where((apart < _AGREEMENT)[..., None], (chosen + other) / 2, chosen)
    off = np.linalg.norm(pixels - _median_in_time(pixels), axis=-1) / size[:, None]
    points = np.concatenate((pixels, _landmark_confidence(sights, apart + off)[..., None]), -1)
    return [(sight.frame, row, -1) for sight, row in zip(sights, points, strict=True)]


def _with_sides_named(
    seen: Float[np.ndarray, "frames 2 33 2"],
    size: Float[np.ndarray, " frames"],
    frames: Int[np.ndarray, " frames"],
) -> tuple[Float[np.ndarray, "frames 33 2"], Float[np.ndarray, "frames 33 2"]]:
    """Decide left and right; return each landmark's position, and a second estimate of it.

    The first come from the image or from its mirror image; the second from the other of these two,
    with left and right named so that both lie nearer together.

    Args:
        seen: landmarks found in the image and in its mirror image, pixels.
        size: of the body, pixels.
        frames: numbers of the frames, rising.
    """
    namings = np.concatenate((seen, seen[:, :, MIRRORED]), 1)
    path = _likeliest_sides(namings, size, frames)
    rows = np.arange(len(path))
    chosen, other = namings[rows, path], seen[rows, 1 - path % 2]
    turned = other[:, MIRRORED]
    apart, crossed = (np.linalg.norm(chosen - one, axis=-1).mean(1) for one in (other, turned))
    return chosen, np.where((crossed < apart)[:, None, None], turned, other)


def _likeliest_sides(
    namings: Float[np.ndarray, "frames 4 33 2"],
    body_size: Float[np.ndarray, " frames"],
    frames: Int[np.ndarray, " frames"],
) -> Int[np.ndarray, " frames"]:
    """Return which of four namings of left and right is likeliest in each frame of a film.

    The landmarks of the likeliest ones move least. 0 and 1 are as found in the image and in its
    mirror image, 2 and 3 the same with left and right exchanged.
    """
    # exchanging sides costs 2, keeping them 0; both cost 1 where the mirror image disagrees
    distance_as_named, distance_exchanged = (
        np.linalg.norm(namings[:, 0] - namings[:, k], axis=-1).mean(-1) for k in (1, 3)
    )
    doubt = (distance_exchanged < distance_as_named).astype(float)
    naming_cost = _EXCHANGE_COST * np.stack((doubt, doubt, 2 - doubt, 2 - doubt), 1)
    moved = np.linalg.norm(namings[1:, :, None] - namings[:-1, None], axis=-1)
    moved /= body_size[1:, None, None, None]
    usual = np.median(moved.mean(-1).min((1, 2))) if len(moved) else _SPREADS[0]
    spread = np.clip(usual, *_SPREADS) * np.diff(frames)
    far = np.minimum(moved / spread[:, None, None, None], _FARTHEST)
    # cost of the movement between each naming of one frame and each naming of the next
    change = (_INDEPENDENT * np.square(far).sum(-1) / 2).swapaxes(-1, -2)
    path = cheapest_path(torch.from_numpy(naming_cost)[None], torch.from_numpy(change)[None])
    return path[0].numpy()


def _median_in_time(
    pixels: Float[np.ndarray, "frames 33 2"],
) -> Float[np.ndarray, "frames 33 2"]:
    """Return each coordinate's median over five frames, which removes jumps of two frames."""
    padded = np.pad(pixels, ((2, 2), (0, 0), (0, 0)), mode="edge")
    return np.median(np.stack([padded[k : k + len(pixels)] for k in range(5)]), axis=0)


def _landmark_confidence(
    sights: list[Sight], spread: Float[np.ndarray, "frames 33"]
) -> Float[np.ndarray, "frames 33"]:
    """Return confidences: the error of a surely seen landmark over each one's expected error.

    Args:
        sights: detections of one person.
        spread: distance of the two estimates of every landmark, plus that of their mean from the
            frames before and after, sizes of the body.
    """
    visible, present = (
        np.min([(getattr(one.pose, name), getattr(one.mirrored, name)) for one in sights], axis=1)
        for name in ("visibility", "presence")
    )
    inside = np.array([one.pose.inside & one.mirrored.inside for one in sights])
    error = _USUAL + _HIDDEN * (1 - visible) ** 1.5 + _PER_DISTANCE * spread
    seen = inside & (visible * present > _LEAST_SEEN)
    return np.where(seen, present * _USUAL / error, 0.0)

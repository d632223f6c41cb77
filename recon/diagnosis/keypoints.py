"""Checks of 2D keypoints: zeros, repeated frames, frozen points, outliers, jumps, frame order.

Detectors are noisy, so no keypoint has the same coordinates twice in a row; software that fills
gaps writes zeros, the last place, or the whole last frame again.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Bool

from observations.keypoints2d import Keypoints2D
from observations.keypoints3d import Keypoints3D
from recon.body.model import BodyModel
from recon.core.arrays import finite_median
from recon.core.limits import FEW_MOMENTS
from recon.diagnosis.exact import unchanged
from recon.diagnosis.exchanged_pairs import repaired_pairs
from recon.diagnosis.findings import (
    NOTHING,
    Finding,
    Findings,
    flagged,
    listed,
    run_checks,
    spans,
    stretches,
)
from recon.diagnosis.images import Images
from recon.diagnosis.named_points import NamedPoints
from recon.diagnosis.odds import (
    checked_against_each_other,
    mirrored_or_scaled_view_corrected,
    mirroring_repaired,
)
from recon.diagnosis.points import exchanged_back, exchanged_names
from recon.diagnosis.quick_fit import without_implausible
from recon.diagnosis.rays import Rays, scale_findings
from recon.diagnosis.rigs import ray_distance
from recon.diagnosis.sides import repaired_by_rays, repaired_sides
from recon.diagnosis.tracks import velocity_changes

_MIN_HELD_MOMENTS = 4
"""Number of consecutive frames at one place from which on a keypoint counts as held; two or three
may be chance where a detector writes whole pixels."""
_HELD_RATIO = 3
"""Number of frames at one place, as a multiple of what is usual, for a keypoint to be held."""
_MIN_REPEATED_SHARE, _MIN_KEYPOINTS = 0.9, 5
"""Share of a frame's keypoints that must repeat in a copied frame, and their least number."""
_MIN_PHOTOGRAPH_SHARE = 0.8
"""Share of copied frames from which on a view is a photograph rather than a film with copies."""

Seen = Bool[np.ndarray, "moments points"]


def repaired_zeros(images: Images) -> tuple[Images, Findings]:
    """Mark keypoints at (0, 0) as unseen, since files often write missing keypoints like that."""

    def finding(view: int, zeros: Seen) -> Finding:
        share, points = (
            zeros.sum() / images.seen[view].sum(),
            flagged(images.points, np.any(zeros, axis=0)),
        )
        return Finding(
            "zeros",
            f"{share:.2g} of the keypoints with a confidence lie at exactly (0, 0), which is how "
            f"missing ones are often written ({listed(points)}); they were taken as not seen. "
            "Write a confidence of 0 for them",
            points,
            stretches(np.any(zeros, axis=-1)),
            float(share),
        )

    return hide_keypoints(images, images.seen & (images.pixels == 0).all(-1), finding)


def repaired_copies(images: Images) -> tuple[Images, Findings]:
    """Mark the keypoints of frames that exactly copy the previous frame as unseen."""
    both = (images.seen[:, 1:] & images.seen[:, :-1]).sum(-1)
    same = unchanged(images.pixels, images.seen)[:, 1:].sum(-1)
    copied = (both >= _MIN_KEYPOINTS) & (same >= _MIN_REPEATED_SHARE * both)
    photographs = copied.sum(-1) > _MIN_PHOTOGRAPH_SHARE * copied.shape[1]
    copied = np.pad(copied & ~photographs[:, None], ((0, 0), (1, 0)))

    def finding(_: int, copies: Seen) -> Finding:
        frames = np.any(copies, axis=-1)
        return Finding(
            "repeated frames",
            f"{frames.sum()} frames are exact copies of the frame before them; they were taken as "
            "not seen. A film that was brought to a higher rate by repeating frames should be "
            "given at its own rate",
            (),
            stretches(frames),
            float(frames.mean()),
        )

    return hide_keypoints(images, np.repeat(copied[..., None], len(images.points), -1), finding)


def repaired_frozen(images: Images) -> tuple[Images, Findings]:
    """Mark keypoints as unseen where they keep exactly one place while others move."""
    length = np.zeros(images.seen.shape, dtype=int)
    for v, same in enumerate(unchanged(images.pixels, images.seen)):
        for point, own in enumerate(same.T):
            for first, last in stretches(own):
                length[v, first : last + 1, point] = last - first + 1
    usual = np.median(length.max(1), -1)
    held = length >= np.maximum(_MIN_HELD_MOMENTS - 1, _HELD_RATIO * (usual[:, None, None] + 1))

    def finding(_: int, frozen: Seen) -> Finding:
        frames, points = (
            stretches(np.any(frozen, axis=-1)),
            flagged(images.points, np.any(frozen, axis=0)),
        )
        return Finding(
            "constant point",
            f"{listed(points)} stayed at exactly the same pixel in {spans(frames)} while other "
            "keypoints moved, as written by software that repeats the last place of lost "
            "keypoints; they were taken as not seen there",
            points,
            frames,
            float(frozen.sum(0).max() / images.fps),
        )

    return hide_keypoints(images, held, finding)


def hide_keypoints(
    images: Images,
    wrong: Bool[np.ndarray, "views moments points"],
    finding_of_view: Callable[[int, Seen], Finding],
) -> tuple[Images, Findings]:
    """Mark wrong keypoints as unseen, and return a finding for each view with such ones."""
    rows = [v for v, here in enumerate(wrong) if here.any()]
    repairs = tuple(finding_of_view(v, wrong[v]).of_sensor(images.names[v]) for v in rows)
    return images.without(wrong), Findings(repairs)


_OUTLIER_M = 0.25
"""Distance (m at the body) of an outlier from its median over five frames; a hand that turns as
fast as hands do is 0.1 m away at 30 Hz."""
_OUTLIER_RATIO = 8.0
"""Distance of an outlier from its median over time, as a multiple of what is typical."""
_MEDIAN_FRAMES = 2
"""Number of frames before and after that the median of the outlier test covers."""
_SECOND_PASS = (4, 0.35)
"""Number of frames before and after, and distance (m), of a second pass of the outlier test: three
outliers in five frames hide each other."""
_MAX_ROUNDS = 5
"""Largest number of rounds; outliers hide each other, and make the body look larger than it is."""
_REPORTED_SHARE = 0.01
"""Share of outliers from which on they are left out and reported; fewer do no harm to a robust
fit."""
_JUMP_M = 0.05
"""Distance (m) by which half of the keypoints leave their paths within one frame when another
person is followed from there on. In good windows of validation people they do so by less than
0.075 m at 3 and 6 pixels of noise, and then in all frames."""
_JUMP_RATIO = 3.0
"""Ratio of a jump of half of the keypoints to its median over frames; good windows stay below 2.
Of 64 validation clips that switch to a person 0.3 m away, at 3 and 6 pixels of noise, 61 are above
3."""
_DISORDER_M = 0.12
"""Typical distance (m) from frame to frame above which frames may be out of order."""
_MIN_GROWTH = 1.25
"""Ratio of the distances moved in six frames and in one, below which they are out of order; a
moving body reaches two and more."""


def repaired_outliers(images: Images) -> tuple[Images, Findings]:
    """Mark keypoints as unseen that are far from where they are in neighbouring frames."""
    count = np.maximum(images.seen.sum((1, 2)), 1)
    wild = _all_outliers(images, np.zeros_like(images.seen), _MEDIAN_FRAMES, _OUTLIER_M)
    many = wild.sum((1, 2)) / count > _REPORTED_SHARE
    wild[many] = _all_outliers(
        images.view(np.flatnonzero(many).tolist()), wild[many], *_SECOND_PASS
    )
    share = wild.sum((1, 2)) / count

    def finding(v: int, outliers: Bool[np.ndarray, "moments points"]) -> Finding:
        return Finding(
            "outliers",
            f"{100 * share[v]:.2g} % of the keypoints are far from where they were just before "
            "and are just after; they were taken as not seen. Another detector, or a higher "
            "threshold of its confidence, may help",
            (),
            stretches(np.any(outliers, axis=-1)),
            float(share[v]),
        )

    return hide_keypoints(images, wild & many[:, None, None], finding)


def _all_outliers(
    images: Images, wild: Bool[np.ndarray, "views moments points"], reach: int, least: float
) -> Bool[np.ndarray, "views moments points"]:
    """Find outliers repeatedly, leaving out those found before; return a mask of all."""
    for _ in range(_MAX_ROUNDS):
        found = _far_from_median(images.without(wild), reach, least)
        if not found.any():
            break
        wild = wild | found
    return wild


def _far_from_median(
    images: Images, reach: int, least: float
) -> Bool[np.ndarray, "views moments points"]:
    """Return a mask of keypoints far from their median over the neighbouring frames."""
    seen, place = images.seen, images.shown
    if seen.shape[1] <= 2 * reach:
        return np.zeros_like(seen)
    edges = ((0, 0), (reach, reach), (0, 0), (0, 0))
    padded = np.pad(place, edges, constant_values=np.nan)
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * reach + 1, 1)
    enough = seen & (np.isfinite(windows[..., 0, :]).sum(-1) >= 3)
    away = np.linalg.norm(place - finite_median(windows), axis=-1) / images.scale[..., None]
    typical = [np.median(own[there]) if there.any() else 0.0
               for own, there in zip(away, enough, strict=True)]  # fmt: skip
    limit = np.maximum(least, _OUTLIER_RATIO * np.array(typical))
    return enough & (away > limit[:, None, None])


def identity_findings(images: Images) -> tuple[Finding, ...]:
    """Return a warning when another person is seen from some frame on, in one view or in all.

    Half of the keypoints of a view then leave their paths within one frame.
    """
    if images.scale.shape[1] < 4:
        return ()
    size = velocity_changes(images.shown) / images.scale[..., None]
    size = np.nan_to_num(finite_median(size))
    usual = np.array([np.median(one[one > 0]) if (one > 0).any() else 0.0 for one in size])
    changed = size > np.maximum(_JUMP_M, _JUMP_RATIO * usual[:, None])
    if not changed.any():
        return ()
    most = size.max(0)
    frames = [a + int(most[a : b + 1].argmax()) for a, b in stretches(np.any(changed, axis=0))]
    common = changed.sum(0) >= max(2, len(changed) / 2)
    names = ", ".join(flagged(images.names, np.any(changed, axis=1)))
    return (
        Finding(
            "identity change",
            f"the whole body jumps within one frame ({spans([(t, t) for t in frames])}), as when "
            "detections go over to another person, the film is cut or the camera is pushed; fit "
            f"the parts separately with --between, or choose one person (--person). The motion "
            f"about frame {frames[0]} is not to be trusted",
            (),
            tuple((t, t) for t in frames),
            float(most[frames].max()),
        ).of_sensor("all views" if len(changed) > 1 and common.any() else names),
    )


def order_findings(images: Images) -> tuple[Finding, ...]:
    """Return warnings for views whose frames are out of order: neighbours are not similar."""
    found: list[Finding] = []
    for v, name in enumerate(images.names):
        one, six = (_typical_distance_moved(images, v, lag) for lag in (1, 6))
        if one > _DISORDER_M and six < _MIN_GROWTH * one:
            finding = Finding(
                "frame order",
                f"the body typically moves by {one:.2f} m from one frame to the next, and no "
                "further in six frames: the frames seem to be out of order. Check how files are "
                "numbered (frame_2 must not follow frame_10)",
                value=one,
            )
            found.append(finding.of_sensor(name))
    return tuple(found)


def _typical_distance_moved(images: Images, view: int, frames: int) -> float:
    """Return the median distance (m) that the keypoints move in a number of frames."""
    place = images.shown[view]
    way = (place[frames:] - place[:-frames]) / images.scale[view, frames:, None, None]
    way = np.linalg.norm(finite_median(way.swapaxes(-1, -2)), axis=-1)
    return float(np.median(way[np.isfinite(way)])) if np.isfinite(way).any() else 0.0


_NEARLY_THROUGHOUT = 0.9
"""Share of frames with a person upside down, or lying, from which on a view gets a warning."""
_LIES = 2.0
"""Distance of shoulders from hips across the vertical, over that along it, of who lies."""


def turned_film_findings(images: Images) -> tuple[Finding, ...]:
    """Warn of views with somebody upside down nearly throughout, or lying, with no floor known."""
    named = [[f"{side}_{part}" for side in ("left", "right")] for part in ("shoulder", "hip")]
    if not {*named[0], *named[1]} <= {*images.points}:
        return ()
    rows = [[*map(images.points.index, some)] for some in named]
    trunk = images.shown[:, :, rows[0]].sum(2) - images.shown[:, :, rows[1]].sum(2)
    # the world's z axis in the image; that of cameras without a pose counts as upright
    up = np.where([[[v.unposed]] for v in images.views], [0.0, -1.0], images.pose[..., :2, 2])
    along, across = (trunk * up).sum(-1), (trunk * up[..., ::-1] * [1, -1]).sum(-1)
    most = _NEARLY_THROUGHOUT * np.maximum(np.isfinite(along).sum(-1), 1)
    beside = (np.abs(across) > _LIES * np.abs(along)).sum(-1) > most
    beside &= [not one.ground_known for one in images.views]
    upside = ~beside & ((along < 0).sum(-1) > most)
    said = {
        "the person is upside down nearly throughout: if y of the keypoints counts upwards, write "
        "the image's height less y; if the film is turned, turn it before detection": upside,
        "the person lies nearly throughout; if not, turn the film by 90 degrees": beside,
    }
    return tuple(Finding("mirrored", words).of_sensor(name) for words, there in said.items()
                 for name, here in zip(images.names, there, strict=True) if here)  # fmt: skip


_MAX_MISS_M = 0.06
"""Median distance (m) by which rays of views may miss each other for points to be triangulated."""


def repaired_names(images: Images) -> tuple[Images, Findings]:
    """Undo exchanges of points' names that are the same in all views, such as left and right.

    Rays of such points meet, so the names are checked on the triangulated body.
    """
    if len(images.names) < 2 or ray_distance(images) > _MAX_MISS_M:
        return images, NOTHING
    points, exists = Rays.of(images).triangulated()
    points = np.where(exists[..., None], points, 0.0)
    given = Keypoints3D(points[None], exists[None], images.views[0].points, images.fps)
    named = NamedPoints.of(given, images.body)
    pairs = exchanged_names(without_implausible(named), images.body)
    if not pairs:
        return images, NOTHING
    order = np.arange(len(images.points))
    for a, b in pairs:
        order[[a, b]] = b, a
    found = exchanged_back(named, pairs, np.ones(len(exists), dtype=bool))[1].of_sensor(
        "all views"
    )
    pixels, confidence = images.pixels[:, :, order], images.confidence[:, :, order]
    return replace(images, pixels=pixels, confidence=confidence), found


def screen_views(
    views: Sequence[Keypoints2D], names: Sequence[str], body: BodyModel
) -> tuple[list[Keypoints2D], Findings]:
    """Check one clip's views, and repair what can be repaired surely.

    The order is: exact repetitions, outliers, mirrored images, and names that change within the
    clip; then, for views of one clock and layout, whether they see the same body at the same time;
    then jumps of the whole body, the order of the frames, and the body's size. Below a rate of
    `FEW_MOMENTS`, outliers, jumps and frame order are not checked.

    Args:
        views: 2D keypoints of one clip, with a batch axis of length one.
        names: names of the views, for messages.
        body: body model to be fitted.

    Returns:
        The views to fit, and all findings. Unchanged views are the very same objects.
    """
    out, found = list(views), NOTHING
    for rows, given in grouped_views(views, names, body):
        images, more = screen_group(given)
        for k, view in zip(rows, images.sensors, strict=True):
            out[k] = view
        found += more
    return out, found


def screen_group(images: Images) -> tuple[Images, Findings]:
    """Repair and check views of one clock and keypoint layout; also return the findings."""
    images, found = run_checks(images, (repaired_zeros, repaired_copies, repaired_frozen))
    continuous = images.fps >= FEW_MOMENTS
    disorder = order_findings(images) if continuous else ()
    # frames in a wrong order would look like outliers
    if continuous and not disorder:
        images, more = repaired_outliers(images)
        found += more
    names = (
        mirroring_repaired, mirrored_or_scaled_view_corrected, repaired_by_rays, repaired_names,
        repaired_sides, repaired_pairs,
    )  # fmt: skip
    images, more = run_checks(images, names)
    images, contradictions = checked_against_each_other(images)
    found += more + contradictions
    if contradictions.repairs:  # corrected views may show exchanged sides: search again
        images, more = repaired_sides(images)
        found += more
    jumps = identity_findings(images) if continuous and not disorder else ()
    return images, found + Findings(
        warnings=(*jumps, *disorder, *turned_film_findings(images), *scale_findings(images))
    )


def grouped_views(
    views: Sequence[Keypoints2D], names: Sequence[str], body: BodyModel
) -> list[tuple[list[int], Images]]:
    """Group views by clock, length and layout; return each group's indices and images."""
    groups: dict[tuple[object, ...], list[int]] = {}
    for k, view in enumerate(views):
        clock = (view.fps, view.start_time, *view.pixels.shape, view.points.names)
        groups.setdefault(clock, []).append(k)
    return [
        (rows, Images.of([views[k] for k in rows], [names[k] for k in rows], body))
        for rows in groups.values()
    ]

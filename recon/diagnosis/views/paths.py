"""What the paths of keypoints in an image tell: outliers, jumps of the whole body, lost order."""

import warnings

import numpy as np
from jaxtyping import Bool, Float

from recon.diagnosis.findings import Finding, Findings, spans, stretches
from recon.diagnosis.views.exact import hidden
from recon.diagnosis.views.images import Images

_OUTLIER = 0.25
"""Metres at the body by which an outlier is away from the median of five frames; a hand that
turns about as fast as hands do is 0.1 m away at 30 Hz."""
_TYPICAL = 8.0
"""Factor by which an outlier is farther away than keypoints of its view usually are."""
_MEDIAN_FRAMES = 2
"""Frames to either side in that median."""
_WIDER = (4, 0.35)
"""Frames to either side, and metres, for a second pass: of three outliers in five frames none can
be told."""
_MAX_ROUNDS = 5
"""Largest number of rounds; outliers hide each other, and make the body look larger than it is."""
_MANY = 0.01
"""Share of outliers that is worth a word; fewer do no harm to a robust fit."""
_JUMP = 0.05
"""Metres by which half of all keypoints leave their paths within one frame when another person
is followed from there on; good windows of validation people stay below 0.075 m at 3 and 6 pixels
of noise, and then do so in all frames."""
_SUDDEN = 3.0
"""Factor by which the jump exceeds the median of the frames; good windows stay below 2. Of 64
validation clips that go over to somebody 0.3 m away, at 3 and at 6 pixels of noise, 61 are above
3."""
_DISORDER = 0.12
"""Metres that a body typically goes from frame to frame when frames are out of order."""
_GROWTH = 1.25
"""Factor by which a body must be farther from where it was six frames ago than from where it was
one frame ago; one that moves reaches two and more."""


def repaired_outliers(images: Images) -> tuple[Images, Findings]:
    """Keypoints far from where they are in the frames before and after are made unseen."""
    wild = _wild(images, np.zeros_like(images.seen), _MEDIAN_FRAMES, _OUTLIER)
    many = _share(wild, images) > _MANY
    wild[many] = _wild(images.view(np.flatnonzero(many).tolist()), wild[many], *_WIDER)
    share = _share(wild, images)

    def said(v: int, here: Bool[np.ndarray, "moments points"]) -> Finding:
        return Finding(
            "outliers",
            f"{100 * share[v]:.2g} % of the keypoints are far from where they were just before "
            "and are just after; they were taken as not seen. Another detector, or a higher least "
            "confidence, may help",
            (),
            stretches(np.any(here, axis=-1)),
            float(share[v]),
        )

    return hidden(images, wild & many[:, None, None], said)


def _share(
    wild: Bool[np.ndarray, "views moments points"], images: Images
) -> Float[np.ndarray, " views"]:
    return wild.sum((1, 2)) / np.maximum(images.seen.sum((1, 2)), 1)


def _wild(
    images: Images, wild: Bool[np.ndarray, "views moments points"], reach: int, least: float
) -> Bool[np.ndarray, "views moments points"]:
    """The outliers known and those that show when the known ones are left out."""
    for _ in range(_MAX_ROUNDS):
        found = _away(images.without(wild), reach, least)
        if not found.any():
            break
        wild = wild | found
    return wild


def _away(images: Images, reach: int, least: float) -> Bool[np.ndarray, "views moments points"]:
    """Keypoints farther than some metres from the median of the frames around them."""
    seen = images.seen
    if seen.shape[1] <= 2 * reach:
        return np.zeros_like(seen)
    place = np.where(seen[..., None], images.pixels, np.nan)
    ends = (reach, reach)
    padded = np.pad(place, ((0, 0), ends, (0, 0), (0, 0)), constant_values=np.nan)
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * reach + 1, 1)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # windows without any keypoint
        away = np.linalg.norm(place - np.nanmedian(windows, -1), axis=-1)
    away = np.nan_to_num(away / images.scale[..., None])
    enough = np.isfinite(windows[..., 0, :]).sum(-1) >= 3
    typical = np.array(
        [
            np.median(own[there]) if there.any() else 0.0
            for own, there in zip(away, seen & enough, strict=True)
        ]
    )
    return seen & enough & (away > np.maximum(least, _TYPICAL * typical)[:, None, None])


def jumps(images: Images) -> Float[np.ndarray, "views moments"]:
    """Metres by which half of the keypoints leave, within one step, the paths before and after.

    The step that leads to a moment, against the mean of the steps before and after it; zero
    where fewer than four moments in a row are seen.
    """
    place = np.where(images.seen[..., None], images.pixels, np.nan)
    step = np.diff(place, axis=1) / images.scale[:, 1:, None, None]
    out = np.zeros_like(images.scale)
    if images.scale.shape[1] < 4:
        return out
    away = np.linalg.norm(step[:, 1:-1] - (step[:, :-2] + step[:, 2:]) / 2, axis=-1)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # frames without any keypoint
        out[:, 2:-1] = np.nan_to_num(np.nanmedian(away, -1))
    return out


def changes_of_person(images: Images) -> Bool[np.ndarray, "views moments"]:
    """Moments from which on somebody else is followed: everything jumps at once."""
    size = jumps(images)
    usual = np.array([np.median(one[one > 0]) if (one > 0).any() else 0.0 for one in size])
    return size > np.maximum(_JUMP, _SUDDEN * usual[:, None])


def identity_findings(images: Images) -> tuple[Finding, ...]:
    """Whether another person is seen from some moment on, by one view or by all."""
    changed = changes_of_person(images)
    if not changed.any():
        return ()
    size = jumps(images).max(0)
    where = np.zeros(changed.shape[1], dtype=bool)
    for a, b in stretches(np.asarray(changed.any(0))):
        where[a + int(size[a : b + 1].argmax())] = True
    common = changed.sum(0) >= max(2, len(changed) / 2)
    if len(changed) > 1 and common.any():
        names = "all views"
    else:
        names = ", ".join(n for n, own in zip(images.names, changed, strict=True) if own.any())
    first = int(np.flatnonzero(where)[0])
    return (
        Finding(
            "identity change",
            f"the whole body jumps within one frame ({spans(stretches(where))}), as when "
            "detections go over to another person, the film is cut or the camera is pushed; fit "
            f"the parts separately with --between, or choose one person (--person). The motion "
            f"about frame {first} is not to be trusted",
            (),
            stretches(where),
            float(size[where].max()),
        ).of(names),
    )


def order_findings(images: Images) -> tuple[Finding, ...]:
    """Whether the frames of a view are out of order: no frame is near the one before it."""
    found: list[Finding] = []
    for v, name in enumerate(images.names):
        one, six = (_typical_way(images, v, lag) for lag in (1, 6))
        if one > _DISORDER and six < _GROWTH * one:
            said = Finding(
                "frame order",
                f"the body typically moves by {one:.2f} m from one frame to the next, and no "
                "further in six frames: the frames seem to be out of order. Check how files are "
                "numbered (frame_2 must not follow frame_10)",
                value=one,
            )
            found.append(said.of(name))
    return tuple(found)


def _typical_way(images: Images, view: int, lag: int) -> float:
    """Median distance at the body that it goes in some frames, all keypoints together, metres."""
    place = np.where(images.seen[view][..., None], images.pixels[view], np.nan)
    way = (place[lag:] - place[:-lag]) / images.scale[view, lag:, None, None]
    way = way[np.isfinite(way[..., 0]).any(-1)]
    if len(way) == 0:
        return 0.0
    return float(np.median(np.linalg.norm(np.nanmedian(way, -2), axis=-1)))

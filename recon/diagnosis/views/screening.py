"""2D keypoints before a fit: what is wrong with them, and the repairs that are sure."""

from collections.abc import Sequence

from observations.keypoints2d import Keypoints2D
from recon.body.model import BodyModel
from recon.diagnosis.findings import NOTHING, Findings, in_turn
from recon.diagnosis.views.exact import repaired_copies, repaired_held, repaired_zeros
from recon.diagnosis.views.images import Images
from recon.diagnosis.views.odds import all_mirrored, another_image, checked_together
from recon.diagnosis.views.pairs import repaired_pairs
from recon.diagnosis.views.paths import identity_findings, order_findings, repaired_outliers
from recon.diagnosis.views.rays import scale_findings
from recon.diagnosis.views.sides import repaired_sides

_EXACT = (repaired_zeros, repaired_copies, repaired_held)
"""What can be repaired in one view without knowing what it shows."""
_NAMES = (all_mirrored, another_image, repaired_sides, repaired_pairs)
"""Mirrored images, and keypoints that are given back their names."""


def screen_views(
    views: Sequence[Keypoints2D], names: Sequence[str], body: BodyModel
) -> tuple[list[Keypoints2D], Findings]:
    """Check one clip's views, and repair what can be repaired surely.

    First what repeats bit for bit, outliers, mirrored images, and names that change within the
    clip; then, for views of one clock and layout, whether they see the same body at the same
    time; then jumps of the whole body, the order of the frames, and the size of the body.

    Args:
        views: of one clip, with a batch axis of length one.
        names: of the views, for messages.
        body: whose keypoints they are.

    Returns:
        The views to fit, and what was found. Views that are good are the very same objects.
    """
    out, found = list(views), NOTHING
    for rows in _together(views):
        given = Images.of([views[k] for k in rows], [names[k] for k in rows], body)
        images, more = screened(given)
        for k, view in zip(rows, images.into([views[k] for k in rows], given), strict=True):
            out[k] = view
        found += more
    return out, found


def screened(images: Images) -> tuple[Images, Findings]:
    """The views of one clock and layout after all repairs, and what was found."""
    images, found = in_turn(images, _EXACT)
    disorder = order_findings(images)
    # frames out of order look like outliers
    images, more = in_turn(images, _NAMES if disorder else (repaired_outliers, *_NAMES))
    images, together = checked_together(images)
    found += more + together
    if together.repairs:  # names may have been hidden by what was wrong besides
        images, more = repaired_sides(images)
        found += more
    jumps = () if disorder else identity_findings(images)
    return images, found + Findings(warnings=(*jumps, *disorder, *scale_findings(images)))


def _together(views: Sequence[Keypoints2D]) -> list[list[int]]:
    """Numbers of the views that share clock, length and layout, in groups."""
    groups: dict[tuple[object, ...], list[int]] = {}
    for k, view in enumerate(views):
        clock = (view.fps, view.start_time, *view.pixels.shape, view.points.names)
        groups.setdefault(clock, []).append(k)
    return list(groups.values())

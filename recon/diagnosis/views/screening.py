"""2D keypoints before a fit: what is wrong with them, and the repairs that are sure."""

from collections.abc import Callable, Sequence

from observations.keypoints2d import Keypoints2D
from recon.body.model import BodyModel
from recon.diagnosis.findings import Finding
from recon.diagnosis.views.exact import repaired_copies, repaired_held, repaired_zeros
from recon.diagnosis.views.images import Images
from recon.diagnosis.views.odds import all_mirrored, another_image, checked_together
from recon.diagnosis.views.pairs import repaired_pairs
from recon.diagnosis.views.paths import identity_findings, order_findings, repaired_outliers
from recon.diagnosis.views.rays import scale_findings
from recon.diagnosis.views.sides import repaired_sides

Repair = Callable[[Images], tuple[Images, list[Finding]]]

_EXACT: tuple[Repair, ...] = (
    repaired_zeros,
    repaired_copies,
    repaired_held,
)
"""What can be repaired in one view without knowing what it shows."""
_NAMES: tuple[Repair, ...] = (repaired_sides, repaired_pairs)
"""Keypoints that are given back their names."""


def screen_views(
    views: Sequence[Keypoints2D], names: Sequence[str], body: BodyModel
) -> tuple[list[Keypoints2D], list[Finding], list[Finding]]:
    """Check one clip's views, and repair what can be repaired surely.

    First what repeats bit for bit, outliers, mirrored images, and names that change within the
    clip; then, for views of one clock and layout, whether they see the same body at the same
    time; then jumps of the whole body, the order of the frames, and the size of the body.

    Args:
        views: of one clip, with a batch axis of length one.
        names: of the views, for messages.
        body: whose keypoints they are.

    Returns:
        The views to fit, repairs, and warnings. Views that are good are the very same objects.
    """
    out = list(views)
    repairs: list[Finding] = []
    warnings: list[Finding] = []
    for rows in _together(views):
        given = Images.of([views[k] for k in rows], [names[k] for k in rows], body)
        images, repaired, warned = screened(given)
        for k, view in zip(rows, images.into([views[k] for k in rows], given), strict=True):
            out[k] = view
        repairs += repaired
        warnings += warned
    return out, repairs, warnings


def screened(images: Images) -> tuple[Images, list[Finding], list[Finding]]:
    """The views of one clock and layout after all repairs, repairs and warnings."""
    repairs: list[Finding] = []
    for repair in _EXACT:
        images, found = repair(images)
        repairs += found
    disorder = order_findings(images)
    if not disorder:  # frames out of order look like outliers
        images, found = repaired_outliers(images)
        repairs += found
    mirrored = all_mirrored(images)
    mirrored = mirrored.then(another_image(mirrored.images))
    images, repairs = mirrored.images, [*repairs, *mirrored.repairs]
    for repair in _NAMES:
        images, found = repair(images)
        repairs += found
    together = checked_together(images)
    images, repairs = together.images, [*repairs, *together.repairs]
    if together.repairs:  # names may have been hidden by what was wrong besides
        images, found = repaired_sides(images)
        repairs += found
    warnings = [
        *mirrored.warnings,
        *together.warnings,
        *([] if disorder else identity_findings(images)),
        *disorder,
        *scale_findings(images),
    ]
    return images, repairs, warnings


def _together(views: Sequence[Keypoints2D]) -> list[list[int]]:
    """Numbers of the views that share clock, length and layout, in groups."""
    groups: dict[tuple[object, ...], list[int]] = {}
    for k, view in enumerate(views):
        clock = (view.fps, view.start_time, *view.pixels.shape, view.points.names)
        groups.setdefault(clock, []).append(k)
    return list(groups.values())

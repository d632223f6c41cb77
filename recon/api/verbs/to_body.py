"""`recon.to_body`: a motion on another body's mesh, with the other's own shape coefficients."""

import numpy as np

from recon.api.given import BodyLike, MotionLike, body_given, motion_given
from recon.api.motion_file import described
from recon.api.results.motion import Made
from recon.diagnosis.findings import Finding
from recon.ingest.onto.transfer import transfer

_NEAR = 0.005
"""Metres of the median distance between the surfaces up to which the bodies agree."""


def to_body(motion: MotionLike, target: BodyLike, *, body: BodyLike = None) -> Made:
    """Bring a motion onto another body, whose surface lies where that of the first one does.

    Shape and poses are fitted to the first body's surface, so the shape of the result means what
    it means on the target: betas of a SMPL file are SMPL's. The person and the motion stay the
    same; `recon.retarget` moves another person. Nothing is random.

    `about` of the result has the distance of the target's vertices from the first surface, over
    frames spread over the motion: `median_mm` and `percentile_95_mm`.

    Args:
        motion: one clip: a motion, a result, a motion file or its arrays.
        target: the body to bring it onto; a SMPL-family file, or None for the bundled body.
        body: whose motion it is; a SMPL-family file, or None for the bundled body.

    Raises:
        ReconError: when the motion is damaged or of another body.
        FileNotFoundError: when a file does not exist.
    """
    own, other = body_given(body), body_given(target)
    given = motion_given(motion, own)
    found = transfer(given.motion, own, other)
    median, most = (1000 * float(np.quantile(found.distances, share)) for share in (0.5, 0.95))
    warnings = () if median <= 1000 * _NEAR else (
        Finding(
            "body surface",
            f"the bodies {own.name!r} and {other.name!r} do not agree: half of the surface is "
            f"more than {median:.0f} mm away",
            value=median / 1000,
        ),
    )  # fmt: skip
    ground = given.file.ground
    level = None if ground is None else float(ground[3] / ground[2])
    file = described(found.motion, other, level, observed=given.file.observed)
    about = {
        "source": own.name,
        "target": other.name,
        "median_mm": round(median, 2),
        "percentile_95_mm": round(most, 2),
    }
    line = f"surface of {other.name!r}: median {median:.1f} mm from that of {own.name!r}"
    return Made(file, other, warnings, about, (line,))

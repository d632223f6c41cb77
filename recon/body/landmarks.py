"""Named points on the bundled body's surface.

A landmark is a vertex of the bundled mesh (`assets/landmarks.json`, found geometrically by
`scripts/build_landmarks.py`). Bodies with another mesh have other vertices: these numbers do not
hold for SMPL files.
"""

import json
from collections.abc import Mapping
from functools import cache
from importlib.resources import files
from types import MappingProxyType
from typing import cast

from recon.core.errors import ReconError

_SIDED = (
    "acromion", "elbow_lateral", "elbow_medial", "wrist_radial", "wrist_ulnar", "hand",
    "thigh_lateral", "knee_lateral", "knee_medial", "ankle_lateral", "ankle_medial", "heel",
    "big_toe",
)  # fmt: skip
KEYPOINTS_43: tuple[str, ...] = (
    "nose", "head_top", "back_head", "left_ear", "right_ear",
    "c7", "t10", "sternal_notch", "xiphoid", "navel", "sacrum",
    "left_chest", "right_chest", "left_asis", "right_asis", "left_psis", "right_psis",
    *(f"left_{name}" for name in _SIDED),
    *(f"right_{name}" for name in _SIDED),
)  # fmt: skip
"""43 landmarks spread over the body, like the virtual markers of HuMoR's experiments (section 5).

Five on the head, twelve on the trunk, six per arm and seven per leg; left and right mirror
each other.
"""

LANDMARKS_16: tuple[str, ...] = (
    "left_front_head", "sternal_notch",
    *(
        f"{side}_{name}"
        for side in ("left", "right")
        for name in (
            "acromion", "elbow_lateral", "wrist_radial", "asis", "knee_lateral", "ankle_lateral",
            "toe2_base",
        )
    ),
)  # fmt: skip
"""16 landmarks as sparse as a marker recording gets, one for every segment that moves by itself.

Nearly all marker protocols put a marker on each; of heads, those that mark them at all mark the
temples' front.
"""


@cache
def landmarks() -> Mapping[str, int]:
    """Vertex number on the bundled body of every landmark, by name."""
    text = files("recon").joinpath("assets", "landmarks.json").read_text(encoding="utf-8")
    return MappingProxyType(cast("dict[str, int]", json.loads(text)))


def landmark(name: str) -> int:
    """Vertex number of a landmark on the bundled body."""
    try:
        return landmarks()[name]
    except KeyError:
        raise ReconError(
            f"no landmark {name!r}; there are: {', '.join(sorted(landmarks()))}"
        ) from None

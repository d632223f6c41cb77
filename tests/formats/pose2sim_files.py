"""Tables of joint centres as Pose2Sim writes them."""

from pathlib import Path

import numpy as np
from jaxtyping import Float

from recon.core.layouts import keypoint_names

FPS = 60
_NAMES = {
    "mid_hip": "Hip", "head_top": "Head", "upper_neck": "Neck", "nose": "Nose", "neck": "Neck",
}  # fmt: skip


def write_trc(
    path: Path, layout: str, points: Float[np.ndarray, "time points 3"], first: int
) -> None:
    """Joint centres as Pose2Sim writes them: y, z, x of a world with z up, metres, one per row."""
    names = [_spelled(name) for name in keypoint_names(layout)]
    values = points[..., [1, 2, 0]]
    rate, count = str(FPS), str(len(points))
    lines = [
        f"PathFileType\t4\t(X/Y/Z)\t{path.name}",
        "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame"
        "\tOrigNumFrames",
        "\t".join([rate, rate, count, str(len(names)), "m", rate, str(first), count]),
        "Frame#\tTime\t" + "\t\t\t".join(names) + "\t\t\t",
        "\t\t" + "\t".join(f"X{k}\tY{k}\tZ{k}" for k in range(1, len(names) + 1)) + "\t",
    ]
    for t, row in enumerate(values):
        cells = ["" if np.isnan(x) else f"{x:.6f}" for x in row.ravel()]
        lines.append("\t".join([str(first + t), f"{(first + t) / FPS:.6f}", *cells]))
    path.write_text("\n".join(lines) + "\n")


def _spelled(name: str) -> str:
    """A keypoint as Pose2Sim spells it: RBigToe."""
    if name in _NAMES:
        return _NAMES[name]
    side, _, rest = name.partition("_")
    return side[0].upper() + rest.title().replace("_", "")

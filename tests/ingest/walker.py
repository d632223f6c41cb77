"""Markers on the skin of somebody who walks, as a laboratory would have recorded them."""

import numpy as np
import torch

from recon.body.landmarks import landmark
from recon.body.model import BodyModel
from recon.core.motion import Motion
from recon.ingest.marker_sets import nominal_offsets
from recon.mocap.recording import MarkerRecording

MARKERS = {
    "LASI": "left_asis", "RASI": "right_asis", "LPSI": "left_psis", "RPSI": "right_psis",
    "LKNE": "left_knee_lateral", "RKNE": "right_knee_lateral", "LTHI": "left_thigh_lateral",
    "RTHI": "right_thigh_lateral", "LTIB": "left_shank_lateral", "RTIB": "right_shank_lateral",
    "LANK": "left_ankle_lateral", "RANK": "right_ankle_lateral", "LHEE": "left_heel",
    "RHEE": "right_heel", "LTOE": "left_toe2_base", "RTOE": "right_toe2_base", "C7": "c7",
    "T10": "t10", "CLAV": "sternal_notch", "STRN": "xiphoid", "LSHO": "left_acromion",
    "RSHO": "right_acromion", "LELB": "left_elbow_lateral", "RELB": "right_elbow_lateral",
    "LWRA": "left_wrist_radial", "LWRB": "left_wrist_ulnar", "RWRA": "right_wrist_radial",
    "RWRB": "right_wrist_ulnar", "LFHD": "left_front_head", "RFHD": "right_front_head",
    "LBHD": "left_back_head", "RBHD": "right_back_head",
}  # fmt: skip
LABELS = tuple(MARKERS)


def recorded(motion: Motion, body: BodyModel) -> MarkerRecording:
    """What markers show of a motion, without noise."""
    vertices = [landmark(name) for name in MARKERS.values()]
    posed = body.pose(motion)
    bones = body.weights[vertices].argmax(-1)
    offsets = nominal_offsets(body, vertices)
    points = posed.points(torch.tensor(vertices))
    points = points + (posed.orientations[:, bones] @ offsets[..., None])[..., 0]
    return MarkerRecording(
        name="made-up",
        marker_names=LABELS,
        positions=points.double().numpy(),
        visible=np.ones(points.shape[:2], dtype=bool),
        fps=motion.fps,
        decisions=(),
    )

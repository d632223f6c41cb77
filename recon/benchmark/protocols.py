"""Defines the protocols of the benchmark: what is seen, and what is evaluated.

Which data of a true motion are given, with which noise, and which frames count.
"""

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from observations.joints3d import Joints3D
from observations.markers3d import Markers3D
from recon.benchmark.windows import FPS, FRAMES, TrueWindows
from recon.body.landmarks import KEYPOINTS_43, landmark
from recon.body.model import BodyModel
from recon.core.errors import ReconError
from recon.core.motion import Motion
from recon.core.skeleton import JOINTS, descendants, joint_index
from recon.formats.observations import PositionsFile

_LEGS = descendants(joint_index("left_hip")) + descendants(joint_index("right_hip"))
UPPER_BODY = tuple(joint for joint in range(len(JOINTS)) if joint not in _LEGS)
"""Numbers of the joints from the pelvis up."""


def noisy_joints(
    truth: Motion,
    body: BodyModel,
    seed: int,
    noise: float = 0.04,
    joints: tuple[int, ...] = tuple(range(len(JOINTS))),
) -> Joints3D:
    """Simulate joints (by default all 22) with Gaussian noise, metres per coordinate."""
    positions = body.pose(truth).joints
    random = torch.Generator().manual_seed(seed)
    errors = torch.randn(positions.shape, generator=random, dtype=torch.float64)
    seen = (positions + noise * errors.to(positions))[..., list(joints), :]
    return Joints3D(
        positions=seen,
        visible=torch.ones(seen.shape[:-1], dtype=torch.bool),
        joints=joints,
        fps=truth.fps,
    )


def with_gap(observed: Joints3D, gap: slice) -> Joints3D:
    """Hide all joints in a range of frames (in-betweening)."""
    positions, visible = observed.positions.clone(), observed.visible.clone()
    positions[:, gap], visible[:, gap] = 0.0, False
    return observed.replace(positions=positions, visible=visible)


def occluded_points(
    truth: Motion, body: BodyModel
) -> tuple[Markers3D, Float[Tensor, "clips time 43 3"]]:
    """Simulate 43 noise-free skin points, hidden below 0.9 m; return all true points as well."""
    vertices = tuple(landmark(name) for name in KEYPOINTS_43)
    points = body.pose(truth).points(torch.tensor(vertices))
    visible = points[..., 2] >= 0.9
    return (
        Markers3D(
            positions=points.where(visible[..., None], 0.0),
            visible=visible,
            vertices=vertices,
            fps=truth.fps,
        ),
        points,
    )


def sensor_of(seen: PositionsFile) -> Joints3D | Markers3D:
    """Convert the contents of a window's observation file to a sensor with a batch axis of 1."""
    positions = torch.from_numpy(seen.positions).float()[None]
    visible = torch.from_numpy(seen.visible)[None]
    if seen.kind == "joints3d":
        joints = tuple(joint_index(name) for name in seen.names)
        return Joints3D(positions, visible, joints, seen.fps)
    vertices = tuple(landmark(name) for name in seen.names)
    return Markers3D(positions, visible, vertices, seen.fps)


GAP = ((FRAMES - round(FPS)) // 2, (FRAMES + round(FPS)) // 2)
"""Frames of a window between which nothing is seen: one second in its middle."""

Columns = Mapping[str, tuple[str, float]]
"""Headings of metrics, and what turns metres into centimetres and shares into per cent."""
_FEET: Columns = {
    "accel_error": ("accel. error m/s²", 1.0),
    "slip_speed": ("slip cm/s", 100.0),
    "seconds": ("CPU s", 1.0),
}
_GAPS: Columns = {"root_joints_all": ("pose cm", 100.0), **_FEET}


@dataclass(frozen=True)
class BenchProtocol:
    """A benchmark protocol: how true motions are observed, and which metrics are reported."""

    name: str
    about: str
    """What is seen and what is judged, one sentence."""
    noise: float
    """Standard deviation of every coordinate that is seen, metres; methods are told it."""
    see: Callable[[Motion, BodyModel, int], Joints3D | Markers3D]
    """What a sensor sees of true motions with one leading axis, by a seed."""
    columns: Columns
    """What the table shows; the first metric is the one to compare methods by."""
    judged: tuple[int, int] = (0, FRAMES)
    """The first frame over which errors are taken, and the one after the last."""


PROTOCOLS: Mapping[str, BenchProtocol] = {
    own.name: own
    for own in (
        BenchProtocol(
            "noisy-joints",
            "22 joints with 4 cm of noise on every coordinate; errors of all joints",
            0.04,
            noisy_joints,
            {
                "joints_all": ("joints cm", 100.0),
                "joints_legs": ("legs cm", 100.0),
                **_FEET,
            },
        ),
        BenchProtocol(
            "hidden-points",
            "43 points of the skin without noise, those below 0.9 m hidden; errors of the hidden",
            0.0,
            lambda truth, body, _: occluded_points(truth, body)[0],
            {
                "observed_hidden": ("hidden points cm", 100.0),
                "observed_all": ("all points cm", 100.0),
                "joints_all": ("joints cm", 100.0),
                "joints_legs": ("legs cm", 100.0),
                **_FEET,
            },
        ),
        BenchProtocol(
            "gap",
            "22 joints with 1 cm of noise, nothing seen for one second; errors within it",
            0.01,
            lambda truth, body, seed: with_gap(noisy_joints(truth, body, seed, 0.01), slice(*GAP)),
            {"joints_all": ("joints cm", 100.0), "joints_legs": ("legs cm", 100.0), **_GAPS},
            GAP,
        ),
        BenchProtocol(
            "upper-body",
            "14 joints from the pelvis up with 1 cm of noise, no legs; errors of the legs",
            0.01,
            lambda truth, body, seed: noisy_joints(truth, body, seed, 0.01, UPPER_BODY),
            {"joints_legs": ("legs cm", 100.0), "joints_all": ("joints cm", 100.0), **_GAPS},
        ),
    )
}


def protocol_named(name: str) -> BenchProtocol:
    """Return the benchmark protocol with this name.

    Raises:
        ReconError: names the protocols there are.
    """
    if name not in PROTOCOLS:
        raise ReconError(f"there is no protocol {name!r}; there are {', '.join(PROTOCOLS)}")
    return PROTOCOLS[name]


@dataclass(frozen=True)
class SeenWindow:
    """A window: the data that a method gets, and the truth that is withheld."""

    name: str
    """Clip and first second, such as `07_01@0.20`."""
    seen: PositionsFile
    truth: Motion
    touching: Bool[Tensor, "time 22"]
    """True contacts."""
    points: Float[Tensor, "time points 3"]
    """True places of the points that are seen, metres."""
    vertices: tuple[int, ...]
    """Vertices of points of the skin; empty for joints."""

    @property
    def file_name(self) -> str:
        """Name of the window's observation file, and of a prediction for it."""
        return f"{self.name.replace('/', '_')}.npz"


def seen_windows(
    protocol: BenchProtocol, windows: TrueWindows, body: BodyModel
) -> list[SeenWindow]:
    """Simulate the observations of all windows under a protocol.

    Noise depends on the name of the window alone, so that it is the same whichever other windows
    there are.
    """
    return [
        _seen_window(protocol, name, windows.truth[[i]], windows.contacts[i], body)
        for i, name in enumerate(windows.names)
    ]


def _seen_window(
    protocol: BenchProtocol, name: str, truth: Motion, touching: Tensor, body: BodyModel
) -> SeenWindow:
    seed = int.from_bytes(hashlib.sha256(name.encode()).digest()[:4])
    sensor = protocol.see(truth, body, seed)
    visible = sensor.visible[0].numpy()
    names = KEYPOINTS_43 if sensor.on_skin else sensor.point_names(body)
    file = PositionsFile(
        kind="markers3d" if sensor.on_skin else "joints3d",
        positions=sensor.positions[0].double().numpy(),
        visible=visible,
        names=tuple(names),
        fps=float(sensor.fps),
        std=np.where(visible, protocol.noise, 0.0) if protocol.noise > 0 else None,
    )
    return SeenWindow(
        name=name,
        seen=file,
        truth=truth[0],
        touching=touching,
        points=sensor.predict(body.pose(truth))[0],
        vertices=tuple(landmark(name) for name in names) if sensor.on_skin else (),
    )


def noise_of(seen: PositionsFile) -> float:
    """Standard deviation of a window's noise, metres; zero if it has none."""
    return 0.0 if seen.std is None else float(torch.from_numpy(seen.std[seen.visible]).median())

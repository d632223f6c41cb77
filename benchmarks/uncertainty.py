"""Compares errors of fits with the standard deviations that `recon.fit` states.

    python -m benchmarks.uncertainty CORPUS --out FOLDER
    python -m benchmarks.uncertainty CORPUS --part validation --only 6 --prior pose

Windows of two seconds of joints, markers, three cameras, one camera with and one without a known
pose, and depth. The table has the share of errors along an axis of at most 1.645 standard
deviations (0.90 if these are right), the median standard deviation beside the root mean square
error of an axis, and the rank correlation of standard deviations with the errors of joints. Seen
and hidden joints are evaluated separately. Where the ground was found, its height and its normal
are evaluated likewise, a row per clip; so is how often feet touch at a stated probability.
Constants were chosen on validation.
"""

import math
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
from jaxtyping import Bool, Float
from torch import Tensor

import recon
from benchmarks.cameras import in_true_world
from benchmarks.clouds import Seen, write_files
from benchmarks.protocol import NINE_TENTHS, Cell, Table, evenly, number, over_windows, tell_of
from benchmarks.slips.recordings import Sensor, recording_of
from recon import BodyModel
from recon.benchmark.dataset import Splits
from recon.benchmark.windows import TrueWindows, load_windows
from recon.core.skeleton import FEET
from recon.simulation.points import Corruption

DEPTH = "depth, hidden below 0.9 m for a third"
PROTOCOLS: dict[str, tuple[Sensor, Corruption, bool]] = {
    "joints, 4 cm": ("joints3d", Corruption(noise=0.04), True),
    "joints, 2 cm, hidden below 0.9 m for a third":
        ("joints3d", Corruption(noise=0.02, hide_below=0.9, during=(0.67, 1.33)), True),
    "joints, 2 cm, ground not known": ("joints3d", Corruption(noise=0.02), False),
    "markers, 1 cm, hidden below 0.9 m":
        ("markers3d", Corruption(noise=0.01, hide_below=0.9), True),
    "three cameras, 4 px": ("cameras", Corruption(noise=4.0), True),
    "one camera of known pose, 4 px": ("cameras", Corruption(noise=4.0), True),
    "one camera, ground not known, 4 px": ("camera", Corruption(noise=4.0), False),
}  # fmt: skip
"""Sensor, noise, and whether the ground is known; the protocol of depth is separate."""
_SHARES = ((0.0, 0.2), (0.2, 0.4), (0.4, 0.6), (0.6, 0.8), (0.8, 1.0))


@dataclass(frozen=True)
class Judged:
    """Errors of one fit, with the standard deviations and contacts that it states."""

    error: Float[Tensor, "time 22 3"]
    std: Float[Tensor, "time 22"]
    observed: Bool[Tensor, "time 22"]
    height: tuple[float, float] | None
    """Error and standard deviation of the height of a ground that was found, metres."""
    normal: tuple[float, float, float] | None
    """Errors of its normal about two axes, and their standard deviation, degrees; None where the
    vertical is known."""
    contacts: tuple[Tensor, Tensor] | None
    """Stated probabilities that feet touch, and whether they do."""


def main() -> None:
    """Fit all windows, print and write the tables."""
    arguments = over_windows(__doc__)
    names = [*PROTOCOLS, DEPTH]
    arguments.set_defaults(only=12)
    arguments.add_argument("--prior", choices=("pose", "humor"), nargs="+",
                           default=["pose", "humor"])  # fmt: skip
    arguments.add_argument("--protocols", choices=names, nargs="+", default=names)
    given = arguments.parse_args()
    body = BodyModel.load()
    windows = load_windows(given.corpus, Splits.load(given.splits), given.part, body)
    clips = evenly(windows, given.only)
    found: dict[str, list[Judged]] = {}
    for prior in given.prior:
        for name in given.protocols:
            found[f"{name}; {prior}"] = [judged(windows, k, name, prior, body) for k in clips]
    tell_of(given, 0, tables(found), windows.files)


def judged(windows: TrueWindows, clip: int, name: str, prior: str, body: BodyModel) -> Judged:
    """Fit one window and compare its errors with their standard deviations."""
    if name == DEPTH:
        seen = Seen(windows.truth[clip], body, clip)
        camera = seen.camera
        with tempfile.TemporaryDirectory() as folder:
            files = write_files(seen, "depth, sensor unknown", Path(folder))
            result = recon.fit(files, prior, body=body)
    else:
        sensor, corruption, ground = PROTOCOLS[name]
        recording = recording_of(windows, clip, sensor, body, corruption)
        camera = recording.cameras[0] if recording.cameras else None
        views = recording.clean[: 1 if name.startswith("one") else None]
        result = recon.fit(views, prior, body=body, ground="auto" if ground else "unknown")
    truth = windows.truth[clip]
    place = torch.eye(4) if camera is None else camera.T_world_camera
    there, _ = in_true_world(result, place, body)
    frames = min(truth.frames, there.frames)
    assert result.joint_std is not None
    error = (body.pose(there).joints - body.pose(truth).joints[:frames])[:frames]
    said = result.contact_probability
    feet = list(FEET)
    return Judged(
        error.detach(), result.joint_std[:frames], result.observed[:frames],
        *_ground(result, place),
        None if said is None else
        (said[:frames, feet].flatten(), windows.contacts[clip][:frames, feet].flatten()),
    )  # fmt: skip


def _ground(
    result: recon.Result, T_world_camera: Float[Tensor, "4 4"]
) -> tuple[tuple[float, float] | None, tuple[float, float, float] | None]:
    """Return errors of a found ground, with the standard deviations that the fit states."""
    std, found = result.ground_std, result.T_world_camera
    if std is None or result.ground is None:
        return None, None
    if found is None:
        return (float(result.ground[3]), std.height), None
    height = float(found[2, 3] - T_world_camera[2, 3])
    x, y, _ = (T_world_camera[:3, :3] @ found[:3, :3].mT.to(T_world_camera))[:, 2].tolist()
    return (height, std.height), (math.degrees(x), math.degrees(y), math.degrees(std.normal))


def tables(found: Mapping[str, Sequence[Judged]]) -> dict[str, Table]:
    """Build the tables of joints, grounds and contacts."""
    joints: list[list[Cell]] = []
    grounds: list[list[Cell]] = []
    contacts: list[list[Cell]] = []
    for name, rows in found.items():
        error, std = torch.cat([r.error for r in rows]), torch.cat([r.std for r in rows])
        observed = torch.cat([r.observed for r in rows])
        for kind, some in (("seen", observed), ("hidden", ~observed)):
            if some.any():
                joints.append([name, kind, *_of_joints(error[some], std[some])])
        heights = [r.height for r in rows if r.height is not None]
        normals = [r.normal for r in rows if r.normal is not None]
        if heights:
            grounds.append([name, "height, cm", *_of_ground(heights, 100)])
        if normals:
            grounds.append([name, "normal, degrees", *_of_ground(normals, 1)])
        told = [r.contacts for r in rows if r.contacts is not None]
        if told:
            said, truth = (torch.cat(own) for own in zip(*told, strict=True))
            contacts.append([name, *_touching(said, truth)])
    first = ("data; prior", None)
    return {
        "uncertainty": Table(
            [first, ("joints", None), ("within 1.645 std (0.9)", 2), ("error of an axis, cm", 2),
             ("median std, cm", 2), ("rank correlation", 2)], joints,
        ),
        "uncertainty-grounds": Table(
            [first, ("ground", None), ("within 1.645 std (0.9)", 2), ("median error", 1),
             ("RMS error", 1), ("median std", 1)], grounds,
        ),
        "uncertainty-contacts": Table(
            [("feet that touch, %, where the probability is", None),
             *((f"{low:.1f}-{high:.1f}", 0) for low, high in _SHARES)], contacts,
        ),
    }  # fmt: skip


def _of_joints(error: Float[Tensor, "rows 3"], std: Float[Tensor, " rows"]) -> list[Cell]:
    within = (error.abs() <= NINE_TENTHS * std[:, None]).double().mean()
    rms = error.double().square().mean().sqrt()
    ranks = torch.stack((error.norm(dim=-1), std.to(error))).argsort(-1).argsort(-1).double()
    correlation = float(torch.corrcoef(ranks)[0, 1])
    return [number(float(within)), number(float(rms), 100), number(float(std.median()), 100),
            number(correlation)]  # fmt: skip


def _of_ground(rows: Sequence[tuple[float, ...]], factor: float) -> list[Cell]:
    """Summarise rows that have errors and, as the last value, their standard deviation."""
    told = torch.tensor(rows, dtype=torch.float64)
    error, std = told[:, :-1], told[:, -1:]
    numbers = (error.abs().median(), error.square().mean().sqrt(), std.median())
    within = float((error.abs() <= NINE_TENTHS * std).double().mean())
    return [number(within), *(number(float(one), factor) for one in numbers)]


def _touching(said: Float[Tensor, " rows"], truth: Bool[Tensor, " rows"]) -> list[Cell]:
    """Return how often (%) feet touch, by ranges of the stated probability."""
    groups = [(said >= low) & ((said < high) | (high == 1.0)) for low, high in _SHARES]
    return [number(truth[some].double().mean().item(), 100) if some.any() else None
            for some in groups]  # fmt: skip


if __name__ == "__main__":
    main()

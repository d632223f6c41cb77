"""What `recon convert` of a recording costs and how well it goes, beside another version of recon.

    python -m benchmarks.convert BASELINE OBSERVATIONS --json convert.json

BASELINE is a source checkout of the other version, for example `git worktree add BASELINE 0ce0517`
for 0.1.0; OBSERVATIONS holds recordings of markers. CPU seconds are those of one thread: `work`
from reading the file to writing the motion, `process` of a whole Python process with its imports.
Versions take turns; the lesser of their times counts where there are several runs.

`residual` is the mean distance of markers from their places. For `left out` each fifth known
marker is hidden and found again on the motion, rigidly aligned with the markers, at the constant
offset that it has in each tenth frame (in recordings of up to ten seconds). `unmade` are steps of
a joint that exceed those of the markers about it by more than 25 mm; `beyond` is how far the
largest step of any joint exceeds that of any marker. `slip` is the speed of feet that stand.
"""

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from benchmarks.results import ROOT, recordings_source, write
from recon.body.model import BodyModel
from recon.core import rotations as so3
from recon.core.motion import Motion
from recon.formats.mocap.reader import read_recording
from recon.formats.mocap.recording import MarkerRecording
from recon.formats.motions import load_motion
from recon.ingest.markers.coverage import MarkerSet, full_body_markers
from recon.ingest.markers.jumps import unmade_steps

RUNS = 1
FOLD = 5
OFFSET_EVERY = 10
RECORDINGS = (
    "choreonet/ll_qq_03_1.c3d",
    "rehazenter/2014001_C1_01.c3d",
    "bmc/Gait.c3d",
    "opensim/rajagopal_walk.trc",
    "biomechzoo/HC030A22.c3d",
    "vendors/btk_T.trc",
    "cmu_c3d/06_01.c3d",
    "mocap/cmu/bvh31/02_01.bvh.xz",
    "choreonet/ll_lb_11_1.c3d",
    "nimblephysics/sprinter_run0500cms.trc",
    "choreonet/ll_qq_04_2.c3d",
    "choreonet/mm_hez_02_1.c3d",
    "mocap/cmu/asfamc/03_01.amc.xz",
    "nimblephysics/nick_freeform_001.c3d",
    "choreonet/ll_lb_08_1.c3d",
    "cmu_c3d/02_05.c3d",
    "choreonet/ll_lb_05_1.c3d",
    "mocaprecovery/135_02.c3d",
    "choreonet/22.c3d",
    "choreonet/6.c3d",
    "choreonet/ll_lb_10_1.c3d",
)
"""Recordings of markers below OBSERVATIONS, and of skeletons beside it; short ones first."""
_SHORT = 10.0
"""Seconds up to which markers are left out: that takes another conversion by both versions."""
_DRIVER = """
import json, sys, time
from dataclasses import replace
began = time.process_time()
import recon.ingest.single as single
imported = time.process_time()
path, out, hidden = sys.argv[1], sys.argv[2], json.loads(sys.argv[3])
body = single.BodyModel.load()
recording = single.read_recording(path)
if hidden:
    visible = recording.visible.copy()
    visible[:, [recording.marker_names.index(name) for name in hidden]] = False
    recording = replace(recording, visible=visible)
found = single.convert(recording, body)
found.save(out, body)
report = dict(found.report)
print(json.dumps({
    "work": time.process_time() - imported, "residual_mm": report["residual_mm"],
    "slip_mps": report["slip_mps"], "seconds": report["seconds"], "frames": report["frames"],
}))
"""
"""Runs under both versions: it names nothing that one of them has not."""

Row = dict[str, Any]


@dataclass(frozen=True)
class Known:
    """The known markers of a recording."""

    recording: MarkerRecording
    markers: MarkerSet
    body: BodyModel

    @property
    def positions(self) -> Float[Tensor, "time markers 3"]:
        """Places of the markers, metres."""
        return torch.from_numpy(self.recording.positions).float()

    @property
    def visible(self) -> Bool[Tensor, "time markers"]:
        """Whether a marker was seen."""
        return torch.from_numpy(self.recording.visible)


def known(path: Path, body: BodyModel) -> Known:
    """The recording of markers in a file."""
    recording = read_recording(path)
    if not isinstance(recording, MarkerRecording):
        raise TypeError(f"{path}: expected markers, got a skeleton")
    markers = full_body_markers(recording, body)
    return Known(recording.select(markers.labels), markers, body)


def converted(tree: Path, path: Path, out: Path, hidden: tuple[str, ...] = ()) -> Row:
    """What one version reports of a conversion, and CPU seconds of its process."""
    environment = {**os.environ, "PYTHONPATH": str(tree), "OMP_NUM_THREADS": "1"}
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    words = [sys.executable, "-c", _DRIVER, str(path), str(out), json.dumps(hidden)]
    done = subprocess.run(
        words, env=environment, cwd=out.parent, capture_output=True, text=True, check=False
    )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode != 0:
        raise RuntimeError(f"{tree} cannot convert {path}: {done.stderr.strip()[-300:]}")
    spent = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return {**json.loads(done.stdout.splitlines()[-1]), "process": spent}


def measured(baseline: Path, path: Path, folder: Path) -> Row:
    """Costs of both versions; the motions they made lie in the folder."""
    trees = {"baseline": baseline, "ours": ROOT}
    rows: dict[str, list[Row]] = {name: [] for name in trees}
    for run in range(RUNS):
        for name in list(trees)[:: 1 if run % 2 else -1]:
            rows[name].append(converted(trees[name], path, folder / f"{name}.npz"))
    found: Row = {key: rows["ours"][0][key] for key in ("frames", "seconds")}
    for name, runs in rows.items():
        least = {key: min(row[key] for row in runs) for key in ("work", "process")}
        found[name] = {
            **least, "residual_mm": runs[0]["residual_mm"], "slip_mps": runs[0]["slip_mps"]
        }  # fmt: skip
    for key in ("work", "process"):
        found[f"{key}_ratio"] = found["ours"][key] / found["baseline"][key]
    return found


def judged(row: Row, baseline: Path, path: Path, folder: Path, body: BodyModel) -> None:
    """Add the steps of joints, and the errors of markers that are left out, of both versions."""
    seen = known(path, body)
    hidden = seen.markers.labels[::FOLD]
    for name, tree in (("baseline", baseline), ("ours", ROOT)):
        row[name] |= steps(folder / f"{name}.npz", seen)
        if row["seconds"] > _SHORT:
            continue
        converted(tree, path, folder / "hidden.npz", hidden)
        row[name]["left_out_mm"] = left_out(folder / "hidden.npz", seen)


def within(seen: Known, motion: Motion) -> Known:
    """The markers in the frames of a motion: ends at which nobody is seen may be left out."""
    if motion.frames == seen.recording.frames:
        return seen
    first = round((motion.start_time - seen.recording.start_time) * seen.recording.fps)
    return replace(seen, recording=seen.recording.window(first, first + motion.frames))


def steps(path: Path, seen: Known) -> Row:
    """Steps of joints that no marker makes, and the largest one beyond all markers, mm."""
    motion = load_motion(path).motion
    seen = within(seen, motion)
    joints = seen.body.pose(motion).joints
    bones = tuple(seen.body.weights[list(seen.markers.vertices)].argmax(-1).tolist())
    unmade = unmade_steps(joints, seen.positions, seen.visible, bones)
    both = seen.visible[1:] & seen.visible[:-1]
    made = seen.positions.diff(dim=0).norm(dim=-1).where(both, 0.0).amax(-1)
    beyond = joints.diff(dim=0).norm(dim=-1).amax(-1) - made
    return {
        "unmade": int(unmade.any(-1).sum()),
        "beyond_mm": 1000 * float(beyond[both.any(-1)].max()),
    }


def left_out(path: Path, seen: Known) -> float:
    """Mean distance of hidden markers from their places on a motion, mm."""
    motion = load_motion(path).motion
    seen = within(seen, motion)
    posed = seen.body.pose(motion)
    vertices = torch.tensor(seen.markers.vertices)
    bones = seen.body.weights[vertices].argmax(-1)
    skin, turns = posed.points(vertices), posed.orientations[:, bones]
    hidden = torch.arange(len(vertices)) % FOLD == 0
    # conversions are moved onto the ground and levelled: back to where the markers are
    places = skin + (turns @ seen.markers.nominal[..., None])[..., 0]
    counted = seen.visible & ~hidden
    turn, shift = aligned(seen.positions[counted], places[counted])
    local = turns.mT @ ((seen.positions @ turn.mT + shift - skin)[..., None])
    ends = seen.visible[::OFFSET_EVERY, :, None]
    own = local[::OFFSET_EVERY, ..., 0].where(ends, 0.0).sum(0) / ends.sum(0).clamp(min=1)
    away = (local[..., 0] - own).norm(dim=-1)
    asked = seen.visible & hidden
    asked[::OFFSET_EVERY] = False
    return 1000 * float(away[asked].mean())


def aligned(points: Float[Tensor, "n 3"], to: Float[Tensor, "n 3"]) -> tuple[Tensor, Tensor]:
    """Rotation and shift, metres, that bring points nearest to others."""
    middle, goal = points.mean(0), to.mean(0)
    turn = so3.nearest((to - goal).mT @ (points - middle))
    return turn, goal - turn @ middle


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("baseline", type=Path)
    parser.add_argument("observations", type=Path)
    parser.add_argument("--json", type=Path, required=True)
    parser.add_argument("--only", nargs="*", default=[])
    options = parser.parse_args()
    torch.set_num_threads(1)
    baseline, root = options.baseline.resolve(), options.observations.resolve()
    body = BodyModel.load()
    rows: dict[str, dict[str, Row]] = {"rows": {}, "skeletons": {}}
    wanted = options.only or RECORDINGS
    with tempfile.TemporaryDirectory() as name, torch.no_grad():
        folder = Path(name)
        for recording in wanted:
            skeleton = recording.startswith("mocap/")
            path = (root.parent if skeleton else root) / recording
            row = measured(baseline, path, folder)
            if not skeleton:
                judged(row, baseline, path, folder, body)
            rows["skeletons" if skeleton else "rows"][recording] = row
            print(recording, json.dumps(row), flush=True)
            # as it goes, since it takes long
            write(options.json, None, recordings_source(root, rows["rows"]), runs=RUNS, **rows)


if __name__ == "__main__":
    main()

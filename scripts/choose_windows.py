"""Choose the test windows of the benchmarks and write them into recon/benchmark/splits.toml.

    python scripts/choose_windows.py CORPUS --manifests DATA/mocap

The choice is seeded and made from the manifests' names, so that the same data always gives the
same windows; CORPUS is only read for the clips that are looked at. For every test subject,
windows are taken in rounds over kinds of clips (CMU: each clip is a kind; Bandai-Namco: action
and style), so that no clip gives a second window before every clip of its subject has given one
where possible. A window begins anywhere on the 30 Hz grid. Windows of one clip never share a
frame; when a clip has no room left, it drops out. Frames next to a glitch that the manifest lists
and clips of `SKIPPED` are left out. Windows of 60 and of 90 frames are chosen separately.

The validation windows are not touched: the hyperparameters of version 0.1.0 were chosen on them.
"""

import argparse
import csv
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from recon.benchmark.dataset import SPLITS, Splits, clip_files
from recon.formats.motions import load_motion

FPS = 30.0
SEED = 2021
SKIPPED = {"49_21"}  # hangs on ropes
COUNTS = {
    60: {"07": 12, "49": 26, "d2C": 26, "16": 8},
    90: {"07": 5, "49": 18, "d2C": 18, "16": 5},
}
"""Windows wanted, by their number of frames and by subject."""
MARK = "# Below: written by scripts/choose_windows.py\n"


@dataclass(frozen=True)
class Listed:
    """A clip as its manifest describes it."""

    name: str
    seconds: float
    glitches: tuple[float, ...]
    """Seconds at which a joint jumps."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("corpus", type=Path)
    parser.add_argument("--manifests", type=Path, required=True)
    parser.add_argument("--splits", type=Path, default=SPLITS)
    parser.add_argument("--names", action="store_true", help="print the clips that are looked at")
    arguments = parser.parse_args()

    splits = Splits.load(arguments.splits)
    listed = read_manifests(arguments.manifests)
    files = {} if arguments.names else clip_files(arguments.corpus)
    chosen: dict[int, list[tuple[str, float]]] = {}
    for frames, wanted in COUNTS.items():
        rows: list[tuple[str, float]] = []
        for subject, count in wanted.items():
            own = [c for c in listed.values() if splits.subject(c.name) == subject]
            order = candidates(own, frames, np.random.default_rng([SEED, frames, 0]))
            order = order[: max(count, 1)]
            if arguments.names:
                print("\n".join(order))
                continue
            usable = {
                name: usable_starts(files[name], listed[name].glitches, frames)
                for name in order
                if present(files, name)
            }
            random = np.random.default_rng([SEED, frames, len(rows), 1])
            rows += spread(usable, count, frames, random)
        chosen[frames] = rows
    if not arguments.names:
        write(arguments.splits, chosen)


def present(files: Mapping[str, Path], name: str) -> bool:
    """Whether the corpus holds the clip.

    Raises:
        ValueError: when it does not; without it the choice would depend on what was converted.
    """
    if name not in files:
        raise ValueError(f"{name} is not in the corpus; convert it first (recon convert --all)")
    return True


def read_manifests(folder: Path) -> dict[str, Listed]:
    """Every clip that a manifest lists, by name.

    The first frame of a cgspeed file is a T-pose that the conversion drops. Glitches are given
    as the frame before the jump.
    """
    found: dict[str, Listed] = {}
    for path in sorted(folder.rglob("manifest.csv")):
        with path.open(newline="", encoding="utf-8") as file:
            for row in csv.DictReader(file):
                if not row["fps"] or not row["frames"]:
                    continue
                name = row["clip"] or Path(row["path"]).name.split(".")[0]
                rate = float(row["fps"])
                lead = 1 if "T-pose" in row.get("note", "") else 0
                numbers = re.findall(r"\d+", row.get("glitch_frames") or "")
                found[name] = Listed(
                    name=name,
                    seconds=(int(row["frames"]) - lead) / rate,
                    glitches=tuple(int(number) / rate for number in numbers),
                )
    return found


def candidates(clips: Iterable[Listed], frames: int, random: np.random.Generator) -> list[str]:
    """The clips that are long enough, in rounds over their kinds, at random within a kind."""
    kinds: dict[str, list[str]] = {}
    for clip in sorted(clips, key=lambda c: c.name):
        if clip.name not in SKIPPED and clip.seconds * FPS >= frames + 2:
            kinds.setdefault(kind(clip.name), []).append(clip.name)
    for names in kinds.values():
        random.shuffle(names)
    order: list[str] = []
    while any(kinds.values()):
        rest = [name for name in random.permutation(sorted(kinds)) if kinds[name]]
        order += [kinds[name].pop(0) for name in rest]
    return order


def usable_starts(path: Path, glitches: Iterable[float], frames: int) -> np.ndarray:
    """First frames (30 Hz) of windows that lie inside the clip and hold no glitch."""
    motion = load_motion(path).motion.resample(FPS)
    starts = np.arange(max(motion.frames - frames + 1, 0))
    for glitch in glitches:
        frame = glitch * FPS
        starts = starts[(starts > frame + 2) | (starts + frames - 1 < frame - 2)]
    return starts


def spread(
    usable: Mapping[str, np.ndarray], count: int, frames: int, random: np.random.Generator
) -> list[tuple[str, float]]:
    """Up to `count` windows that share no frame, round after round over the clips.

    Raises:
        ValueError: when the clips have no room for so many.
    """
    free = {clip: starts for clip, starts in usable.items() if len(starts) > 0}
    rows: list[tuple[str, float]] = []
    while len(rows) < count:
        if not free:
            raise ValueError(f"room for {len(rows)} windows of {frames} frames, wanted {count}")
        for clip in list(free)[: count - len(rows)]:
            start = int(random.choice(free[clip]))
            rows.append((clip, start / FPS))
            left = free[clip][np.abs(free[clip] - start) >= frames]
            if len(left) > 0:
                free[clip] = left
            else:
                del free[clip]
    return sorted(rows)


def kind(clip: str) -> str:
    """What two clips of one kind share: CMU clips are each their own, others action and style."""
    return clip.rsplit("_", 1)[0] if clip.startswith("dataset-") else clip


def write(path: Path, chosen: Mapping[int, list[tuple[str, float]]]) -> None:
    head = path.read_text(encoding="utf-8").partition(MARK)[0].rstrip()
    lines = [head, "", MARK.rstrip(), "", "[windows.test]"]
    lines.append("# Clip and first second (from the clip's first frame), by the number of frames")
    lines.append("# at 30 Hz. Windows of one length share no frame.")
    for frames, rows in chosen.items():
        lines.append(f"{frames} = [")
        lines += [f'    ["{clip}", {start:.4f}],' for clip, start in rows]
        lines.append("]")
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()

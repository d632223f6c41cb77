"""Choose the benchmark's 60-frame windows and write them into benchmarks/splits.toml.

    python scripts/choose_windows.py CORPUS --manifests DATA/mocap

Seeded: the same corpus gives the same windows. Test: 16 windows of each test subject, validation:
5 of each CMU subject with clean ground truth and 7 of Bandai-Namco's held-out clips. Windows of a
subject are spread over kinds of clips (CMU: each clip is a kind; Bandai-Namco: action and style),
and begin anywhere on the 30 Hz grid; a second window of one clip begins as far as it can from the
first, so windows overlap where clips are short. Left out: frames next to a glitch that the
manifest lists, and clips of `SKIPPED`.
"""

import argparse
import csv
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from priors.training.dataset import SPLITS, Splits, clip_files
from recon.formats.amass import load_motion

FPS = 30.0
FRAMES = 60
SEED = 2021
SKIPPED = {"49_21"}  # hangs on ropes
TEST = {"07": 16, "16": 16, "49": 16, "d2C": 16}
VALIDATION = {"06": 5, "10": 5, "12": 5, "27": 5, "32": 5, "d1": 2, "d2A": 3, "d2B": 2}
MARK = "# Below: written by scripts/choose_windows.py\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("corpus", type=Path)
    parser.add_argument("--manifests", type=Path, required=True)
    parser.add_argument("--splits", type=Path, default=SPLITS)
    arguments = parser.parse_args()

    splits = Splits.load(arguments.splits)
    files = clip_files(arguments.corpus)
    parts = splits.parts(list(files))
    glitches = read_glitches(arguments.manifests)
    chosen = {}
    for part, wanted in (("test", TEST), ("validation", VALIDATION)):
        rows = []
        for subject, count in wanted.items():
            clips = [c for c in files if parts.get(c) == part and splits.subject(c) == subject]
            usable = {c: usable_starts(files[c], glitches.get(c, ())) for c in clips}
            usable = {c: s for c, s in usable.items() if len(s) > 0 and c not in SKIPPED}
            rows += spread(usable, count, np.random.default_rng([SEED, len(rows)]))
        chosen[part] = rows
    write(arguments.splits, chosen)


def read_glitches(folder: Path) -> dict[str, list[float]]:
    """Seconds of listed glitches by clip (frame i means between frames i and i + 1)."""
    found: dict[str, list[float]] = {}
    for path in sorted(folder.rglob("manifest.csv")):
        with path.open(newline="") as file:
            for row in csv.DictReader(file):
                frames = [int(f) for f in row.get("glitch_frames", "").replace(";", " ").split()]
                found[row["clip"]] = [f / float(row["fps"]) for f in frames]
    return found


def usable_starts(path: Path, glitches: Iterable[float]) -> np.ndarray:
    """First frames (30 Hz) of windows that lie inside the clip and hold no glitch."""
    motion = load_motion(path).motion
    last = int((motion.frames - 1) / motion.fps * FPS + 1e-6)
    starts = np.arange(last - FRAMES + 2)
    for glitch in glitches:
        frame = glitch * FPS
        starts = starts[(starts > frame + 2) | (starts + FRAMES - 1 < frame - 2)]
    return starts


def spread(
    usable: dict[str, np.ndarray], count: int, random: np.random.Generator
) -> list[tuple[str, float]]:
    """`count` windows, round after round over kinds of clips."""
    kinds: dict[str, list[str]] = {}
    for clip in sorted(usable):
        kinds.setdefault(kind(clip), []).append(clip)
    for clips in kinds.values():
        random.shuffle(clips)
    taken: dict[str, list[int]] = {}
    rows: list[tuple[str, float]] = []
    while len(rows) < count:
        for name in random.permutation(sorted(kinds))[: count - len(rows)]:
            clips = kinds[name]
            clip = clips[0]
            kinds[name] = [*clips[1:], clip]
            starts, before = usable[clip], taken.setdefault(clip, [])
            if before:
                distance = np.abs(starts[:, None] - np.array(before)).min(1)
                start = int(starts[distance.argmax()])
            else:
                start = int(random.choice(starts))
            before.append(start)
            rows.append((clip, start / FPS))
    return sorted(rows)


def kind(clip: str) -> str:
    return clip.rsplit("_", 1)[0] if clip.startswith("dataset-") else clip


def write(path: Path, chosen: dict[str, list[tuple[str, float]]]) -> None:
    head = path.read_text(encoding="utf-8").partition(MARK)[0].rstrip()
    lines = [head, "", MARK.rstrip(), "", "[windows]"]
    lines.append("# Clip and first second (from the clip's first frame); 60 frames at 30 Hz each.")
    for part, rows in chosen.items():
        lines.append(f"{part} = [")
        lines += [f'    ["{clip}", {start:.4f}],' for clip, start in rows]
        lines.append("]")
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()

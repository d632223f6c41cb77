"""CPU seconds of pictures and films of the bundled 120 frames, beside another version of recon.

    python -m benchmarks.pictures BASELINE --json pictures.json

BASELINE is a source checkout of the other version, as for `benchmarks.start`. The two versions
take turns in both orders; every time is that of a whole process, start included.
"""

import argparse
import shutil
import tempfile
from pathlib import Path

from benchmarks.results import ROOT, write
from benchmarks.start import TORCH, cpu_seconds, in_turns

RUNS = 3
CLIP = "demo.npz"
PICTURES = {"recon view --png": "sheet.png", "recon view --mp4": "film.mp4"}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("baseline", type=Path)
    parser.add_argument("--json", type=Path, required=True)
    options = parser.parse_args()
    baseline = options.baseline.resolve()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        shutil.copy(ROOT / "recon" / "assets" / CLIP, folder)
        for tree in (baseline, ROOT):  # compiles modules and brings files into memory
            drawn(PICTURES["recon view --png"], tree, folder)
        rows = {
            row: in_turns(lambda tree, file=file: drawn(file, tree, folder), baseline, RUNS)
            for row, file in PICTURES.items()
        }
        words = ("-c", "import torch")
        rows[TORCH] = in_turns(lambda tree: cpu_seconds(words, tree, folder), baseline, RUNS)
    both = {key: sum(rows[row][key] for row in PICTURES) for key in ("baseline", "ours")}
    rows["the two together"] = {**both, "ratio": both["ours"] / both["baseline"]}
    for row, values in rows.items():
        print(f"{row:<40}", *(f"{value:6.2f}" for value in values.values()))
    write(options.json, None, runs=RUNS, rows=rows)


def drawn(file: str, tree: Path, folder: Path) -> float:
    """CPU seconds of drawing one file, which must be there afterwards."""
    path = folder / file
    flag = f"--{path.suffix[1:]}"
    seconds = cpu_seconds(("-m", "recon", "view", CLIP, flag, file), tree, folder)
    path.unlink()
    path.with_name(f"{file}.json").unlink(missing_ok=True)
    return seconds


if __name__ == "__main__":
    main()

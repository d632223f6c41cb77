"""Runs every benchmark one after the other, for all tables of the documents.

    make bench          # RECON_DATA names the folder of real recordings
    python -m benchmarks.all --only humor real --out out

Converts the corpus first (resumable; about half an hour on two cores). Every benchmark writes its
tables into --out; what is copied from there into benchmarks/results is what `make tables` writes
into the documents. `clients` and `mutants` have commands of their own in the Makefile.
"""

import argparse
import os
import re
import subprocess
import sys
from pathlib import Path

_CLOUDS = ("clouds", "CORPUS", "--part", "test", "--cases")
_MIXED = ("depth, sensor unknown", "2D", "2D + depth", "joints", "joints + depth")
COMMANDS: dict[str, tuple[str, ...]] = {
    "humor": ("humor", "CORPUS"),
    "cameras": ("cameras", "CORPUS", "--only", "24"),
    "two": ("two", "CORPUS"),
    "coordinates": ("coordinates", "CORPUS"),
    "depth": (*_CLOUDS, "depth"),
    "depth_mixed": (*_CLOUDS, *_MIXED, "--only", "12"),
    "depth_walks": (*_CLOUDS, "walks"),
    "films_real": ("films", "real", "OBSERVATIONS"),
    "films_rendered": ("films", "rendered", "CORPUS", "--films", "FILMS"),
    "real": ("real", "OBSERVATIONS"),
    "strangers": ("strangers", "CORPUS", "FOLDS"),
    "generation": ("generation", "CORPUS"),
    "uncertainty": ("uncertainty", "CORPUS"),
    "slips": ("slips", "CORPUS", "OBSERVATIONS", "--good", "300"),
    "refine": ("refine", "CORPUS"),
    "recordings": ("complete", "CORPUS", "--part", "test", "--parts", "recordings"),
    "completion": ("complete", "CORPUS", "--parts", "cycles"),
    "retarget": ("retarget", "CORPUS", "--weights", "open"),
    "speed": ("speed", "CORPUS"),
    "forces": ("forces", "OBSERVATIONS"),
}  # fmt: skip
"""Modules below benchmarks and their arguments. CORPUS and OBSERVATIONS are folders of data, other
names in capitals are files or folders that earlier runs wrote below --out."""


def main() -> None:
    """Convert the corpus, then run every benchmark."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("out"))
    parser.add_argument("--only", nargs="+", choices=COMMANDS, default=list(COMMANDS))
    given = parser.parse_args()
    out = given.out.resolve()
    data = Path(os.environ.get("RECON_DATA", ""))
    if not (data / "mocap").is_dir():
        sys.exit("set RECON_DATA to the folder of real recordings (with mocap/, observations/)")
    places = {"CORPUS": out / "corpus", "OBSERVATIONS": data / "observations"}
    run("training.conversion", str(data), str(places["CORPUS"]))
    for name in given.only:
        module, *arguments = (placed(word, places, out) for word in COMMANDS[name])
        run(f"benchmarks.{module}", *arguments, "--out", str(out))


def placed(argument: str, places: dict[str, Path], out: Path) -> str:
    """Return a command's argument, with its folder in place of a name in capitals."""
    if argument in places:
        return str(places[argument])
    return str(out / argument.lower()) if re.fullmatch("[A-Z_]+", argument) else argument


def run(module: str, *arguments: str) -> None:
    """Run one benchmark in a process of its own, with one thread."""
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    subprocess.run([sys.executable, "-m", module, *arguments], env=environment, check=True)


if __name__ == "__main__":
    main()
